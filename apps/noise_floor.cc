#include "apps/noise_floor.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "calib/rigid3.h"

namespace plumbline {
namespace {

// Where the quantities stand among all components.
constexpr Eigen::Index kLeft = 0, kRight = 2, kDisplacement = 4, kStrain = 7, kAll = 10;
using Components = Eigen::Matrix<double, kAll, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

// What the pairs since the reference say of one point.
struct PointSums {
  Components sum = Components::Zero(), squares = Components::Zero(), variance = Components::Zero();
  int frames = 0, strain_frames = 0;
};

// Of one pair.
struct PairPoint {
  std::size_t place;
  Eigen::Vector2d grid;          // column, row
  Eigen::Vector3d reference_mm;  // where it was
  Components value = Components::Zero(), variance = Components::Zero();
  bool has_strain = false;
};

Eigen::Vector2d VariancesOf(const Eigen::Vector3f& cov_px2) {
  return Eigen::Vector2f(cov_px2[0], cov_px2[2]).cast<double>();
}

// Of a right match, what its own image's noise does.
Eigen::Vector2d OwnVariance(const MatchField& match, std::size_t i) {
  return (1 - static_cast<double>(match.right_reference_share.data()[i])) *
         VariancesOf(match.right_cov_px2.data()[i]);
}

// Takes the affine motion over the image out of components `first` and the one after.
void TakeOutAffine(std::vector<PairPoint>& points, Eigen::Index first, Components& common) {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (const PairPoint& p : points) centre += p.grid / static_cast<double>(points.size());
  const auto row = [&](const PairPoint& p) {
    return Eigen::Vector3d(1, p.grid.x() - centre.x(), p.grid.y() - centre.y());
  };
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Matrix<double, 3, 2> rhs = Eigen::Matrix<double, 3, 2>::Zero();
  for (const PairPoint& p : points) {
    normal += row(p) * row(p).transpose();
    rhs += row(p) * p.value.segment<2>(first).transpose();
  }
  const Eigen::Matrix<double, 3, 2> affine = normal.completeOrthogonalDecomposition().solve(rhs);
  for (PairPoint& p : points) {
    const Eigen::Vector2d together = affine.transpose() * row(p);
    p.value.segment<2>(first) -= together;
    common.segment<2>(first) += together.cwiseAbs2();
  }
}

// Takes the rigid motion out, adding to `lost` the variance that the noise loses with it (or gains,
// where noise along another axis turns the surface): with
// theta = N^-1 sum J' d, N = sum J' J, a residual d - J theta has the variance
//   C - 2 area J N^-1 J' C + J cov(theta) J',  cov(theta) = area N^-1 (sum J' C J) N^-1,
// where `area` neighbouring points share one noise.
void TakeOutRigid(std::vector<PairPoint>& points, const RigidMotionRecord& rigid, double area,
                  Components& common, Components& lost) {
  if (!rigid.found) return;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const PairPoint& p : points) centre += p.reference_mm / static_cast<double>(points.size());
  const auto jacobian = [&](const PairPoint& p) {
    Eigen::Matrix<double, 3, 6> J;
    J << -Skew(p.reference_mm - centre), Eigen::Matrix3d::Identity();
    return J;
  };
  Matrix6 normal = Matrix6::Zero(), noise = Matrix6::Zero();
  for (const PairPoint& p : points) {
    const Eigen::Matrix<double, 3, 6> J = jacobian(p);
    normal += J.transpose() * J;
    noise += J.transpose() * p.variance.segment<3>(kDisplacement).asDiagonal() * J;
  }
  const Matrix6 inverse = normal.ldlt().solve(Matrix6::Identity());
  const Matrix6 cov = area * inverse * noise * inverse;
  const Eigen::Matrix3d turn =
      Rigid3::FromRotationVector(rigid.rotation_rad, Eigen::Vector3d::Zero()).rotation -
      Eigen::Matrix3d::Identity();
  for (PairPoint& p : points) {
    const Eigen::Vector3d together = turn * (p.reference_mm - centre) + rigid.translation_mm;
    p.value.segment<3>(kDisplacement) -= together;
    common.segment<3>(kDisplacement) += together.cwiseAbs2();
    const Eigen::Matrix<double, 3, 6> J = jacobian(p);
    const Eigen::Vector3d leverage = (J * inverse * J.transpose()).diagonal();
    lost.segment<3>(kDisplacement) +=
        2 * area * leverage.cwiseProduct(p.variance.segment<3>(kDisplacement)) -
        (J * cov * J.transpose()).diagonal();
  }
}

}  // namespace

struct NoiseFloorMeasurement::Impl {
  void AddReference(const SeriesFrame& frame);
  std::vector<PairPoint> PointsOf(const SeriesFrame& frame) const;
  FloorComponent ComponentOf(Eigen::Index component, std::int64_t points, double area) const;
  bool Counts(const PointSums& p, bool strain) const {
    return (strain ? p.strain_frames : p.frames) == later;
  }

  int step_px = 0, subset_px = 0, vsg_px = 0;
  bool has_strain = false;
  std::string strain_measure, frame_name;
  double area = 1;

  std::vector<PointSums> points;  // empty: there is no reference yet
  Image<Status> reference_status;
  Image<Eigen::Vector2f> reference_right_px;
  std::vector<Eigen::Vector2d> reference_right_variance;  // without the reference image's part
  int later = 0;                                          // pairs, after the reference
  Components common = Components::Zero(),
             lost = Components::Zero();  // sums over pairs, mean points
};

NoiseFloorMeasurement::NoiseFloorMeasurement(const SeriesHeader& header,
                                             double correlation_area_points)
    : impl_(std::make_unique<Impl>()) {
  impl_->step_px = header.step_px;
  impl_->subset_px = header.subset_px;
  impl_->vsg_px = header.vsg_px;
  impl_->has_strain = header.contents.strain;
  impl_->strain_measure = header.strain_measure;
  impl_->area = correlation_area_points;
}

NoiseFloorMeasurement::~NoiseFloorMeasurement() = default;

void NoiseFloorMeasurement::Impl::AddReference(const SeriesFrame& frame) {
  const std::size_t count = frame.surface.status.pixel_count();
  points.resize(count);
  reference_status = frame.surface.status;
  reference_right_px = frame.match.right_displacement_px;
  for (std::size_t i = 0; i < count; ++i) {
    reference_right_variance.push_back(OwnVariance(frame.match, i));
  }
  frame_name = frame.surface.frame == SurfaceFrame::kGround ? "ground" : "rig";
}

std::vector<PairPoint> NoiseFloorMeasurement::Impl::PointsOf(const SeriesFrame& frame) const {
  std::vector<PairPoint> found;
  const auto columns = static_cast<std::size_t>(reference_status.width());
  const MatchField& match = frame.match;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (frame.surface.status.data()[i] != Status::kOk ||
        reference_status.data()[i] != Status::kOk) {
      continue;
    }
    PairPoint p;
    p.place = i;
    const std::size_t row = i / columns, column = i % columns;
    p.grid = {static_cast<double>(column), static_cast<double>(row)};
    const Eigen::Vector3f& moved = frame.displacement.value_mm.data()[i];
    p.reference_mm = (frame.surface.position_mm.data()[i] - moved).cast<double>();
    p.value.segment<2>(kLeft) = match.left_displacement_px.data()[i].cast<double>();
    p.variance.segment<2>(kLeft) = VariancesOf(match.left_cov_px2.data()[i]);
    p.value.segment<2>(kRight) =
        (match.right_displacement_px.data()[i] - reference_right_px.data()[i]).cast<double>();
    p.variance.segment<2>(kRight) = OwnVariance(match, i) + reference_right_variance[i];
    p.value.segment<3>(kDisplacement) = moved.cast<double>();
    p.variance.segment<3>(kDisplacement) =
        frame.displacement.sigma_random_mm.data()[i].cast<double>().cwiseAbs2();
    if (!p.value.allFinite() || !p.variance.allFinite()) continue;
    p.has_strain = has_strain && frame.strain.status.data()[i] == Status::kOk;
    if (p.has_strain) {
      p.value.segment<3>(kStrain) = frame.strain.value.data()[i].cast<double>();
      p.variance.segment<3>(kStrain) =
          frame.strain.sigma_random.data()[i].cast<double>().cwiseAbs2();
    }
    found.push_back(p);
  }
  return found;
}

void NoiseFloorMeasurement::Add(const SeriesFrame& frame) {
  Impl& impl = *impl_;
  if (!frame.problem.empty()) return;
  if (impl.points.empty()) {
    impl.AddReference(frame);
    return;
  }
  if (frame.surface.status.size() != impl.reference_status.size()) {
    throw std::invalid_argument("The frames of a noise floor have one grid.");
  }
  ++impl.later;
  std::vector<PairPoint> found = impl.PointsOf(frame);
  Components common = Components::Zero(), lost = Components::Zero();
  TakeOutAffine(found, kLeft, common);
  TakeOutAffine(found, kRight, common);
  TakeOutRigid(found, frame.rigid_motion, impl.area, common, lost);
  const auto all = static_cast<double>(found.size());
  std::int64_t strains = 0;
  Eigen::Vector3d mean_strain = Eigen::Vector3d::Zero();
  for (const PairPoint& p : found) {
    PointSums& sums = impl.points[p.place];
    sums.sum += p.value;
    sums.squares += p.value.cwiseAbs2();
    sums.variance += p.variance;
    ++sums.frames;
    sums.strain_frames += p.has_strain;
    lost.head<kDisplacement>() +=
        std::min(1.0, 3 * impl.area / all) * p.variance.head<kDisplacement>();
    strains += p.has_strain;
    mean_strain += p.value.segment<3>(kStrain);
  }
  if (found.empty()) return;
  common /= all;
  if (strains > 0) {
    common.segment<3>(kStrain) = (mean_strain / static_cast<double>(strains)).cwiseAbs2();
  }
  impl.common += common;
  impl.lost += lost / all;
}

FloorComponent NoiseFloorMeasurement::Impl::ComponentOf(Eigen::Index component, std::int64_t count,
                                                        double shared_by) const {
  const double pairs = later, n = static_cast<double>(count);
  double scatter = 0, bias = 0, variance = 0;
  for (const PointSums& p : points) {
    if (!Counts(p, component >= kStrain)) continue;
    const double sum = p.sum[component];
    scatter += 2 / pairs * std::max(0.0, p.squares[component] - sum * sum / (pairs + 1));
    bias += sum * sum / (pairs * pairs);
    variance += p.variance[component] / pairs;
  }
  const double predicted = std::max(0.0, variance / n - lost[component] / pairs);
  FloorComponent out;
  out.noise = std::sqrt(scatter / n);
  out.predicted = std::sqrt(predicted);
  out.sigma_ratio = 1 / std::sqrt(2 * pairs * std::max(1.0, n / shared_by));
  out.common = std::sqrt(common[component] / pairs);
  out.bias = std::sqrt(bias / n);
  out.predicted_bias = std::sqrt(predicted * (1 + 1 / pairs) / 2);
  return out;
}

NoiseFloor NoiseFloorMeasurement::Result() const {
  const Impl& impl = *impl_;
  if (impl.later < 1) {
    throw InputError(
        "A noise floor needs two good static pairs or more (ten are good); there are fewer.");
  }
  NoiseFloor floor;
  floor.frames = impl.later + 1;
  floor.points = std::count_if(impl.points.begin(), impl.points.end(),
                               [&](const PointSums& p) { return impl.Counts(p, false); });
  if (floor.points == 0) {
    throw InputError(
        "No point was found in all of the static pairs, so that there is no noise floor: did "
        "something move?");
  }
  floor.step_px = impl.step_px;
  floor.subset_px = impl.subset_px;
  floor.frame = impl.frame_name;
  const auto fill = [&](auto& components, Eigen::Index first, std::int64_t count, double area) {
    for (FloorComponent& component : components) {
      component = impl.ComponentOf(first++, count, area);
    }
  };
  fill(floor.left_px, kLeft, floor.points, impl.area);
  fill(floor.right_px, kRight, floor.points, impl.area);
  fill(floor.displacement_mm, kDisplacement, floor.points, impl.area);
  floor.strain_points = std::count_if(impl.points.begin(), impl.points.end(),
                                      [&](const PointSums& p) { return impl.Counts(p, true); });
  if (!impl.has_strain || floor.strain_points == 0) {
    floor.strain_points = 0;
    return floor;
  }
  floor.vsg_px = impl.vsg_px;
  floor.strain_measure = impl.strain_measure;
  const double side = static_cast<double>(impl.vsg_px) / impl.step_px;
  fill(floor.strain.emplace(), kStrain, floor.strain_points, side * side);
  return floor;
}

}  // namespace plumbline
