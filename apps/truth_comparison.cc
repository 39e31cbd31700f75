#include "apps/truth_comparison.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <optional>
#include <vector>

#include "apps/internal/surface_points.h"
#include "calib/median.h"

namespace plumbline {
namespace {

// About the wheel, and what was claimed for it (both parts).
struct DisplacementError {
  Eigen::Vector3d value_mm, sigma_mm;
};

// The points that both sides have, in the frame of the measured positions.
struct Pairs {
  std::vector<Eigen::Vector3d> measured, truth;
  std::vector<Eigen::Vector3d> sigma_random, sigma_calibration;
  std::vector<DisplacementError> displacement;  // of those that have one from the wheel
  std::int64_t unfounded = 0;
};

Eigen::Vector3d FromAxis(const Eigen::Vector3d& place, const WheelRecord& wheel) {
  const Eigen::Vector3d from = place - wheel.centre_mm;
  return from - wheel.axis * wheel.axis.dot(from);
}

// Of a displacement: towards the wheel's axis, around and along it. The first is how much nearer
// the point has come, which hangs on no wheel angle.
Eigen::Vector3d AboutTheWheel(const Eigen::Vector3d& displacement, const Eigen::Vector3d& at,
                              const WheelRecord& wheel) {
  const Eigen::Vector3d here = FromAxis(at, wheel);
  return {FromAxis(at - displacement, wheel).norm() - here.norm(),
          displacement.dot(wheel.axis.cross(here.normalized())), displacement.dot(wheel.axis)};
}

// As if the errors along the axes of the frame were independent.
Eigen::Vector3d SigmaAboutTheWheel(const SeriesFrame& frame, std::size_t i) {
  const Eigen::Vector3d& axis = frame.wheel.axis;
  const Eigen::Vector3d from =
      FromAxis(frame.surface.position_mm.data()[i].cast<double>(), frame.wheel).normalized();
  const auto squares = [](const Eigen::Vector3f& sigma) -> Eigen::Vector3d {
    return sigma.allFinite() ? sigma.cast<double>().cwiseAbs2().eval() : Eigen::Vector3d::Zero();
  };
  const Eigen::Vector3d variance = squares(frame.displacement.sigma_random_mm.data()[i]) +
                                   squares(frame.displacement.sigma_calibration_mm.data()[i]);
  Eigen::Matrix3d about;
  about << from.transpose(), axis.cross(from).transpose(), axis.transpose();
  return (about.cwiseAbs2() * variance).cwiseSqrt();
}

Pairs PairUp(const SeriesFrame& frame, const Image<Eigen::Vector2f>& grid_px,
             const TrueFrame& truth) {
  const Surface& surface = frame.surface;
  const bool in_ground = surface.frame == SurfaceFrame::kGround;
  const Rigid3 frame_from_rig = in_ground ? frame.ground.ground_from_rig : Rigid3();
  const Rigid3 rig_from_true_ground = truth.ground_from_rig().Inverse();
  // Material points are elsewhere in the left image by now.
  const bool follows = !frame.match.left_displacement_px.empty();
  const bool on_wheel = frame.wheel.found && !frame.displacement.value_mm.empty();
  std::vector<std::optional<Eigen::Vector3d>> found(surface.status.pixel_count());
  std::vector<Eigen::Vector3d> displacement(found.size());
  tbb::parallel_for(std::size_t{0}, found.size(), [&](std::size_t i) {
    if (surface.status.data()[i] != Status::kOk) return;
    Eigen::Vector2d pixel = grid_px.data()[i].cast<double>();
    if (follows) pixel += frame.match.left_displacement_px.data()[i].cast<double>();
    const auto point = truth.UnderLeftPixel(pixel);
    if (!point) return;
    found[i] = frame_from_rig * (rig_from_true_ground * point->position_mm);
    displacement[i] =
        frame_from_rig.rotation * (rig_from_true_ground.rotation * point->displacement_mm);
  });
  Pairs pairs;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (surface.status.data()[i] != Status::kOk) continue;
    if (!found[i]) {
      ++pairs.unfounded;
      continue;
    }
    pairs.truth.push_back(*found[i]);
    pairs.measured.emplace_back(surface.position_mm.data()[i].cast<double>());
    pairs.sigma_random.emplace_back(surface.sigma_random_mm.data()[i].cast<double>());
    pairs.sigma_calibration.emplace_back(surface.sigma_calibration_mm.data()[i].cast<double>());
    if (!on_wheel || !frame.displacement.value_mm.data()[i].allFinite()) continue;
    pairs.displacement.push_back(
        {AboutTheWheel(frame.displacement.value_mm.data()[i].cast<double>(), pairs.measured.back(),
                       frame.wheel) -
             AboutTheWheel(displacement[i], *found[i], frame.wheel),
         SigmaAboutTheWheel(frame, i)});
  }
  return pairs;
}

// The rigid motion that brings both together, by the points that agree: a few wrong ones, however
// far away, must not turn all others.
Rigid3 RobustRigidMotion(const Pairs& pairs) {
  constexpr int kPasses = 4;
  constexpr double kFarOff = 6;  // medians of the distances
  Rigid3 align = internal::BestRigidMotion(pairs.measured, pairs.truth);
  for (int pass = 0; pass < kPasses; ++pass) {
    std::vector<double> distance;
    for (std::size_t i = 0; i < pairs.measured.size(); ++i) {
      distance.push_back((align * pairs.measured[i] - pairs.truth[i]).norm());
    }
    const double limit = kFarOff * Median(distance);
    std::vector<Eigen::Vector3d> measured, truth;
    for (std::size_t i = 0; i < distance.size(); ++i) {
      if (distance[i] > limit) continue;
      measured.push_back(pairs.measured[i]);
      truth.push_back(pairs.truth[i]);
    }
    if (measured.size() < 3 || measured.size() == distance.size()) break;
    align = internal::BestRigidMotion(measured, truth);
  }
  return align;
}

void ComparePlanes(const GroundRecord& measured, const TrueFrame& truth, TruthComparison* result) {
  if (!measured.found) return;
  GroundRecord exact;
  exact.normal_in_rig = truth.ground_from_rig().rotation.row(2).transpose();
  const GroundAngles angles = AnglesOf(measured);
  result->tilt_error_rad = (angles.angle_rad - AnglesOf(exact).angle_rad).head<2>();
  for (int k = 0; k < 2; ++k) {
    const double calibration = angles.sigma_calibration_rad[k];
    result->sigma_tilt_rad[k] =
        std::hypot(angles.sigma_random_rad[k], std::isfinite(calibration) ? calibration : 0);
  }
}

void CompareDisplacements(const std::vector<DisplacementError>& errors, TruthComparison* result) {
  if (errors.empty()) return;
  for (Eigen::Index k = 0; k < 3; ++k) {
    double squares = 0, within = 0;
    std::vector<double> sizes;
    for (const DisplacementError& error : errors) {
      squares += error.value_mm[k] * error.value_mm[k];
      sizes.push_back(std::abs(error.value_mm[k]));
      within += sizes.back() <= 2 * error.sigma_mm[k] ? 1 : 0;
    }
    const auto count = static_cast<double>(errors.size());
    result->rms_displacement_mm[k] = std::sqrt(squares / count);
    result->within_two_sigma_displacement[k] = within / count;
    result->median_displacement_error_mm[k] = Median(std::move(sizes));
  }
}

}  // namespace

TruthComparison CompareWithTruth(const SeriesFrame& measured, const Image<Eigen::Vector2f>& grid_px,
                                 const TrueFrame& truth) {
  TruthComparison result;
  ComparePlanes(measured.ground, truth, &result);
  if (measured.surface.position_mm.empty()) return result;
  const Pairs pairs = PairUp(measured, grid_px, truth);
  result.unfounded = pairs.unfounded;
  result.points = static_cast<std::int64_t>(pairs.measured.size());
  if (result.points < 3) return result;
  CompareDisplacements(pairs.displacement, &result);
  const Rigid3 align = RobustRigidMotion(pairs);
  double distance2 = 0, shape2 = 0, height2 = 0;
  std::vector<double> height, random, calibration;
  std::int64_t within_one = 0, within_two = 0;
  for (std::size_t i = 0; i < pairs.measured.size(); ++i) {
    distance2 += (pairs.measured[i] - pairs.truth[i]).squaredNorm();
    const Eigen::Vector3d error = align * pairs.measured[i] - pairs.truth[i];
    shape2 += error.squaredNorm();
    height2 += error.z() * error.z();
    height.push_back(std::abs(error.z()));
    random.push_back(pairs.sigma_random[i].z());
    const double common = pairs.sigma_calibration[i].z();
    if (std::isfinite(common)) calibration.push_back(common);
    const double sigma = std::hypot(random.back(), std::isfinite(common) ? common : 0);
    within_one += std::abs(error.z()) <= sigma;
    within_two += std::abs(error.z()) <= 2 * sigma;
  }
  const auto n = static_cast<double>(result.points);
  result.rms_distance_mm = std::sqrt(distance2 / n);
  result.rms_shape_mm = std::sqrt(shape2 / n);
  result.rms_height_mm = std::sqrt(height2 / n);
  result.median_height_error_mm = Median(height);
  result.median_sigma_random_mm = Median(random);
  if (!calibration.empty()) result.median_sigma_calibration_mm = Median(calibration);
  result.within_one_sigma = static_cast<double>(within_one) / n;
  result.within_two_sigma = static_cast<double>(within_two) / n;
  return result;
}

}  // namespace plumbline
