#include "fit/contact_patch.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>

#include "calib/error.h"

namespace plumbline {
namespace {

using Change = Eigen::Matrix<double, ContactPatch::kResults, 3>;

// A corner of the outline, between a point in contact (a) and its neighbour (b).
struct Corner {
  Eigen::Vector2d at;
  std::size_t a = 0, b = 0;
  double share = 0;                     // of the way from a to b
  bool unseen = false;                  // there is no b: the corner is a itself
  Eigen::Vector2d per_threshold{0, 0};  // how it moves, a mm of threshold
};

class Finder {
 public:
  Finder(const Image<Eigen::Vector3d>& position_mm, const Image<double>& thickness_mm,
         double threshold_mm)
      : position_(position_mm), thickness_(thickness_mm), threshold_(threshold_mm) {}

  std::vector<std::vector<Corner>> Outlines() const {
    Image<std::uint8_t> inside(position_.size(), 0);
    for (std::size_t i = 0; i < inside.pixel_count(); ++i) {
      inside.data()[i] = Gap(i) <= threshold_ ? 1 : 0;
    }
    std::vector<std::vector<Corner>> outlines;
    for (const std::vector<GridEdge>& loop : OutlinesOf(inside)) {
      std::vector<Corner> outline;
      for (const GridEdge& edge : loop) outline.push_back(CornerOn(edge));
      outlines.push_back(std::move(outline));
    }
    return outlines;
  }

 private:
  double Gap(std::size_t place) const {
    return position_.data()[place].z() - thickness_.data()[place];
  }

  // Nothing beyond the grid.
  std::optional<std::size_t> PlaceOf(int i, int j) const {
    if (i < 0 || j < 0 || i >= position_.width() || j >= position_.height()) return std::nullopt;
    return static_cast<std::size_t>(j) * static_cast<std::size_t>(position_.width()) +
           static_cast<std::size_t>(i);
  }

  Corner CornerOn(const GridEdge& edge) const {
    std::optional<std::size_t> a = PlaceOf(edge.i, edge.j);
    std::optional<std::size_t> b =
        edge.axis == 0 ? PlaceOf(edge.i + 1, edge.j) : PlaceOf(edge.i, edge.j + 1);
    if (!a || !(Gap(*a) <= threshold_)) std::swap(a, b);
    Corner corner;
    corner.a = *a;
    const Eigen::Vector2d from = position_.data()[*a].head<2>();
    corner.at = from;
    if (!b || !std::isfinite(Gap(*b))) {
      corner.unseen = true;
      return corner;
    }
    corner.b = *b;
    const Eigen::Vector2d along = position_.data()[*b].head<2>() - from;
    const double rise = Gap(*b) - Gap(*a);
    corner.share = (threshold_ - Gap(*a)) / rise;
    corner.at += corner.share * along;
    corner.per_threshold = along / rise;
    return corner;
  }

  const Image<Eigen::Vector3d>& position_;
  const Image<double>& thickness_;
  double threshold_;
};

Polygon PolygonOf(const std::vector<Corner>& outline) {
  Polygon polygon;
  for (const Corner& corner : outline) polygon.push_back(corner.at);
  return polygon;
}

// What moving one corner does to the results.
using ByCorner = Eigen::Matrix<double, ContactPatch::kResults, 2>;

class Influences {
 public:
  explicit Influences(const PolygonMeasures& measures) : measures_(measures) {}

  void Add(const std::vector<Corner>& outline, double* d_area_d_threshold_mm) {
    for (std::size_t k = 0; k < outline.size(); ++k) {
      const Corner& corner = outline[k];
      const Corner& before = outline[(k + outline.size() - 1) % outline.size()];
      const Corner& after = outline[(k + 1) % outline.size()];
      const ByCorner by = Of(corner.at, before.at, after.at);
      *d_area_d_threshold_mm += by.row(0).dot(corner.per_threshold);
      Change& a = changes_.try_emplace(corner.a, Change::Zero()).first->second;
      if (corner.unseen) {
        a.leftCols<2>() += by;
        continue;
      }
      Change& b = changes_.try_emplace(corner.b, Change::Zero()).first->second;
      a.leftCols<2>() += (1 - corner.share) * by;
      b.leftCols<2>() += corner.share * by;
      // A higher point moves the corner as a lower threshold would, by its share.
      const ContactPatch::Results per_gap = by * corner.per_threshold;
      a.col(2) -= (1 - corner.share) * per_gap;
      b.col(2) -= corner.share * per_gap;
    }
  }

  std::vector<ContactPatch::Influence> ByPlace() const {
    std::vector<ContactPatch::Influence> all;
    for (const auto& [place, change] : changes_) all.push_back({place, change});
    return all;
  }

 private:
  ByCorner Of(const Eigen::Vector2d& at, const Eigen::Vector2d& before,
              const Eigen::Vector2d& after) const {
    const auto turned = [](const Eigen::Vector2d& v) { return Eigen::Vector2d(v.y(), -v.x()); };
    ByCorner by = ByCorner::Zero();
    by.row(0) = turned(after - before).transpose() / 2;
    by(1, 0) = (at.x() == measures_.high.x() ? 1 : 0) - (at.x() == measures_.low.x() ? 1 : 0);
    by(2, 1) = (at.y() == measures_.high.y() ? 1 : 0) - (at.y() == measures_.low.y() ? 1 : 0);
    // Moment: sum of cross(p, q) (p + q) / 6 over the sides; the centroid is moment / area.
    Eigen::Matrix2d moment = Eigen::Matrix2d::Zero();
    const auto side = [&](const Eigen::Vector2d& p, const Eigen::Vector2d& q, double sign,
                          const Eigen::Vector2d& other) {
      const double cross = p.x() * q.y() - p.y() * q.x();
      moment +=
          (cross * Eigen::Matrix2d::Identity() + sign * (p + q) * turned(other).transpose()) / 6;
    };
    side(before, at, -1, before);
    side(at, after, 1, after);
    by.middleRows<2>(3) = (moment - measures_.centroid * by.row(0)) / measures_.area;
    const Eigen::Vector2d extent = measures_.high - measures_.low;
    by.row(5) = (by.row(0) - measures_.area * (by.row(1) / extent.x() + by.row(2) / extent.y())) /
                extent.prod();
    return by;
  }

  PolygonMeasures measures_;
  std::map<std::size_t, Change> changes_;
};

}  // namespace

void ContactPatchOptions::Check() const {
  if (!std::isfinite(threshold_mm)) {
    throw UsageError("The gap up to which a tyre is in contact has to be a number of mm.");
  }
  if (!(least_share >= 0 && least_share < 1)) {
    throw UsageError(fmt::format(
        "The share of the largest outline below which others are specks lies in 0 to 1; {} does "
        "not.",
        least_share));
  }
}

std::optional<ContactPatch> FindContactPatch(const Image<Eigen::Vector3d>& position_mm,
                                             const Image<double>& thickness_mm,
                                             const ContactPatchOptions& options, std::string* why) {
  options.Check();
  if (position_mm.size() != thickness_mm.size()) {
    throw std::invalid_argument("FindContactPatch: points and thickness are of different grids");
  }
  std::vector<std::vector<Corner>> outlines =
      Finder(position_mm, thickness_mm, options.threshold_mm).Outlines();
  double largest = 0;  // signed: negative where the grid is seen mirrored in the ground
  std::vector<double> areas;
  for (const std::vector<Corner>& outline : outlines) {
    areas.push_back(MeasurePolygons({PolygonOf(outline)}).area);
    if (std::abs(areas.back()) > std::abs(largest)) largest = areas.back();
  }
  if (largest == 0) {
    if (why != nullptr) {
      *why = fmt::format("no point has a gap of at most {} mm to the ground", options.threshold_mm);
    }
    return std::nullopt;
  }
  ContactPatch patch;
  std::vector<std::vector<Corner>> kept;
  for (std::size_t k = 0; k < outlines.size(); ++k) {
    if (!(std::abs(areas[k]) > options.least_share * std::abs(largest))) {
      ++patch.left_out;
      continue;
    }
    if (largest < 0) std::reverse(outlines[k].begin(), outlines[k].end());
    kept.push_back(std::move(outlines[k]));
    patch.contours_mm.push_back(PolygonOf(kept.back()));
  }
  const PolygonMeasures measures = MeasurePolygons(patch.contours_mm);
  patch.area_mm2 = measures.area;
  patch.centroid_mm = measures.centroid;
  patch.length_mm = measures.high.x() - measures.low.x();
  patch.width_mm = measures.high.y() - measures.low.y();
  patch.shape_factor = patch.area_mm2 / (patch.length_mm * patch.width_mm);
  Influences influences(measures);
  for (const std::vector<Corner>& outline : kept) {
    influences.Add(outline, &patch.d_area_d_threshold_mm);
    for (std::size_t k = 0; k < outline.size(); ++k) {
      const Corner &from = outline[k], &to = outline[(k + 1) % outline.size()];
      const double side = (to.at - from.at).norm();
      patch.perimeter_mm += side;
      if (from.unseen || to.unseen) patch.unseen_perimeter_mm += side;
    }
  }
  patch.influences = influences.ByPlace();
  return patch;
}

ContactPatch::Covariance ContactPatch::CovarianceOf(
    const std::function<Eigen::Matrix3d(std::size_t)>& cov_mm2,
    const std::function<double(std::size_t, std::size_t)>& correlation) const {
  // Each point's error is a root of its covariance times three numbers of variance 1, which go
  // together between points as the correlation says.
  std::vector<Change> scaled;
  for (const Influence& influence : influences) {
    const Eigen::Matrix3d root = Eigen::LLT<Eigen::Matrix3d>(cov_mm2(influence.place)).matrixL();
    scaled.push_back(influence.change * root);
  }
  Covariance covariance = Covariance::Zero();
  for (std::size_t a = 0; a < scaled.size(); ++a) {
    covariance += scaled[a] * scaled[a].transpose();
    for (std::size_t b = 0; b < a; ++b) {
      const double rho = correlation(influences[a].place, influences[b].place);
      if (rho == 0) continue;
      const Covariance both = rho * scaled[a] * scaled[b].transpose();
      covariance += both + both.transpose();
    }
  }
  return covariance;
}

ContactPatch::Results ContactPatch::results() const {
  Results all;
  all << area_mm2, length_mm, width_mm, centroid_mm, shape_factor;
  return all;
}

ContactPatch::Results ContactPatch::ChangeWith(const Image<Eigen::Vector3d>& error_mm) const {
  Results change = Results::Zero();
  for (const Influence& influence : influences) {
    change += influence.change * error_mm.data()[influence.place];
  }
  return change;
}

Image<Eigen::Vector3d> OuterSurface(const Image<Eigen::Vector3d>& position_mm,
                                    const Image<double>& thickness_mm) {
  if (position_mm.size() != thickness_mm.size()) {
    throw std::invalid_argument("OuterSurface: points and thickness are of different grids");
  }
  Image<Eigen::Vector3d> outer(position_mm.size(),
                               Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
  for (int r = 1; r + 1 < position_mm.height(); ++r) {
    for (int c = 1; c + 1 < position_mm.width(); ++c) {
      const Eigen::Vector3d along = position_mm(r, c + 1) - position_mm(r, c - 1);
      const Eigen::Vector3d across = position_mm(r + 1, c) - position_mm(r - 1, c);
      Eigen::Vector3d normal = along.cross(across).normalized();
      if (normal.z() > 0) normal = -normal;
      outer(r, c) = position_mm(r, c) + thickness_mm(r, c) * normal;
    }
  }
  return outer;
}

}  // namespace plumbline
