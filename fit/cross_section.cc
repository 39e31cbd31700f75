#include "fit/cross_section.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

#include "calib/error.h"
#include "fit/outline.h"

namespace plumbline {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
using Piece = std::vector<SectionPoint>;

class Cutter {
 public:
  Cutter(const SurfacePoints& surface, const CutPlane& plane,
         const NeighbourCorrelation& neighbours)
      : surface_(surface), plane_(plane), neighbours_(neighbours) {}

  std::vector<Piece> Pieces() const {
    Image<std::uint8_t> behind(surface_.size(), 0);
    for (std::size_t i = 0; i < behind.pixel_count(); ++i) behind.data()[i] = Distance(i) <= 0;
    std::vector<Piece> pieces;
    for (const std::vector<GridEdge>& loop : OutlinesOf(behind)) AddPieces(loop, pieces);
    for (Piece& piece : pieces) Turn(piece);
    std::sort(pieces.begin(), pieces.end(), [](const Piece& a, const Piece& b) {
      return a.front().along_mm < b.front().along_mm;
    });
    for (Piece& piece : pieces) {
      for (std::size_t k = 0; k < piece.size(); ++k) SetSigmas(piece, k);
    }
    return pieces;
  }

 private:
  double Distance(std::size_t place) const {
    return plane_.normal.dot(surface_.point_mm.data()[place]) - plane_.offset_mm;
  }

  // Nothing where an end of the edge is missing.
  std::optional<SectionPoint> Crossing(const GridEdge& edge) const {
    const int columns = surface_.size().width, rows = surface_.size().height;
    const int i = edge.axis == 0 ? edge.i + 1 : edge.i, j = edge.axis == 0 ? edge.j : edge.j + 1;
    if (edge.i < 0 || edge.j < 0 || i >= columns || j >= rows) return std::nullopt;
    SectionPoint point;
    point.from = static_cast<std::size_t>(edge.j * columns + edge.i);
    point.to = static_cast<std::size_t>(j * columns + i);
    const double a = Distance(point.from), b = Distance(point.to);
    if (!std::isfinite(a) || !std::isfinite(b)) return std::nullopt;
    point.share = a / (a - b);
    point.position_mm = (1 - point.share) * surface_.point_mm.data()[point.from] +
                        point.share * surface_.point_mm.data()[point.to];
    point.along_mm = plane_.along.dot(point.position_mm);
    point.up_mm = plane_.up().dot(point.position_mm);
    return point;
  }

  // The stretches of an outline between edges that are missing.
  void AddPieces(const std::vector<GridEdge>& loop, std::vector<Piece>& pieces) const {
    std::vector<std::optional<SectionPoint>> points;
    points.reserve(loop.size() + 1);
    for (const GridEdge& edge : loop) points.push_back(Crossing(edge));
    const auto missing = std::find(points.begin(), points.end(), std::nullopt);
    if (missing == points.end()) {
      Piece closed;
      closed.reserve(points.size() + 1);
      for (const auto& point : points) closed.push_back(*point);
      std::rotate(closed.begin(),
                  std::min_element(closed.begin(), closed.end(),
                                   [](const SectionPoint& a, const SectionPoint& b) {
                                     return a.along_mm < b.along_mm;
                                   }),
                  closed.end());
      closed.push_back(closed.front());
      pieces.push_back(std::move(closed));
      return;
    }
    std::rotate(points.begin(), missing, points.end());
    Piece piece;
    points.push_back(std::nullopt);
    for (const auto& point : points) {
      if (point) {
        piece.push_back(*point);
      } else if (!piece.empty()) {
        pieces.push_back(std::move(piece));
        piece.clear();
      }
    }
  }

  static void Turn(Piece& piece) {
    if (piece.back().along_mm < piece.front().along_mm) std::reverse(piece.begin(), piece.end());
  }

  // Across the line, in the plane; nothing for a piece of one point.
  std::optional<Eigen::Vector3d> NormalAt(const Piece& piece, std::size_t k) const {
    const SectionPoint& before = piece[k > 0 ? k - 1 : 0];
    const SectionPoint& after = piece[std::min(k + 1, piece.size() - 1)];
    const Eigen::Vector3d tangent = after.position_mm - before.position_mm;
    if (!(tangent.norm() > 0)) return std::nullopt;
    return plane_.normal.cross(tangent.normalized());
  }

  void SetSigmas(Piece& piece, std::size_t k) const {
    SectionPoint& point = piece[k];
    point.sigma_random_mm = point.sigma_calibration_mm = kNaN;
    const auto across = NormalAt(piece, k);
    if (!across) return;
    const Eigen::Vector3d edge =
        surface_.point_mm.data()[point.to] - surface_.point_mm.data()[point.from];
    const Eigen::RowVector3d by =
        (*across - plane_.normal * across->dot(edge) / plane_.normal.dot(edge)).transpose();
    const std::array<PointChange, 2> changes = {PointChange{point.from, (1 - point.share) * by},
                                                PointChange{point.to, point.share * by}};
    const MeasuredScalar across_line = MeasuredSum(changes, 0, surface_, neighbours_);
    point.sigma_random_mm = across_line.sigma_random;
    point.sigma_calibration_mm = across_line.sigma_calibration();
  }

  const SurfacePoints& surface_;
  const CutPlane& plane_;
  const NeighbourCorrelation& neighbours_;
};

SectionPoint Gap() {
  SectionPoint gap;
  gap.position_mm.setConstant(kNaN);
  gap.along_mm = gap.up_mm = gap.sigma_random_mm = gap.sigma_calibration_mm = gap.share = kNaN;
  return gap;
}

}  // namespace

CutPlane CutPlane::AtX(double x_mm) {
  return {Eigen::Vector3d::UnitX(), x_mm, Eigen::Vector3d::UnitY()};
}

CutPlane CutPlane::AtY(double y_mm) {
  return {-Eigen::Vector3d::UnitY(), -y_mm, Eigen::Vector3d::UnitX()};
}

CutPlane CutPlane::Upright(const Eigen::Vector2d& through_mm, double direction_rad) {
  const double c = std::cos(direction_rad), s = std::sin(direction_rad);
  const Eigen::Vector3d normal(s, -c, 0);
  return {normal, normal.head<2>().dot(through_mm), {c, s, 0}};
}

void CutPlane::Check() const {
  constexpr double kTiny = 1e-9;
  if (!(std::abs(normal.norm() - 1) < kTiny) || !std::isfinite(offset_mm)) {
    throw UsageError("A section's plane needs a normal of length 1 and an offset in mm.");
  }
  if (!(std::abs(along.norm() - 1) < kTiny) || !(std::abs(along.dot(normal)) < kTiny)) {
    throw UsageError("A section is drawn along a direction of length 1 that lies in its plane.");
  }
}

std::vector<SectionPoint> CutSurface(const SurfacePoints& surface, const CutPlane& plane,
                                     const NeighbourCorrelation& neighbours) {
  plane.Check();
  surface.Check();
  std::vector<SectionPoint> line;
  for (const Piece& piece : Cutter(surface, plane, neighbours).Pieces()) {
    if (!line.empty()) line.push_back(Gap());
    line.insert(line.end(), piece.begin(), piece.end());
  }
  return line;
}

}  // namespace plumbline
