#include "track/rig_rotation.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "calib/error.h"
#include "track/internal/covariance_root.h"
#include "track/internal/maximise.h"
#include "track/internal/pose_filter.h"

namespace plumbline {
namespace {

using internal::AnglesAndHeight;
using internal::LikelihoodOf;
using internal::PoseLikelihood;
using internal::PoseModel;
using internal::SmoothedPose;
using Of = PoseObservation::Of;

constexpr double kDegree = std::numbers::pi / 180;
// Where nothing is known of the first frame.
const RigPose kWide(0.5, 0.3, 100);
// Of an obstacle of which nothing is known.
constexpr double kAnyObstacle_mm = 200;
// Where no frame tells the roll: an axle's camber hardly changes.
constexpr double kStiffRoll = 0.1 * kDegree;
constexpr int kSweeps = 3;
constexpr internal::SearchSteps kSearch{12, 14};
constexpr int kOutlierRounds = 20;

double InWheel(const GroundPlane& plane, const WheelAxis& axis, Eigen::Vector3d* normal) {
  *normal = axis.rotation.transpose() * plane.normal;
  return plane.SignedDistance(axis.origin_in_rig_mm());
}

// Likeliest where frames or their reverse say so: a bad first frame misleads the filter, and as the
// last one of the reverse it does not.
PoseLikelihood BothWays(std::span<const PoseObservation> frames, const PoseModel& model) {
  PoseLikelihood forwards = LikelihoodOf(frames, model, false);
  PoseLikelihood backwards = LikelihoodOf(frames, model, true);
  return forwards.log_likelihood >= backwards.log_likelihood ? forwards : backwards;
}

// The noise of the largest likelihood, one component after the other; those that are given stay.
PoseModel Likeliest(std::span<const PoseObservation> frames, PoseModel model,
                    const std::array<bool, 3>& given, double* log_likelihood) {
  // log10 of rad, rad, mm a sqrt(s); of what drives the rates, a s^1.5.
  const Eigen::Array3d low =
      model.with_rate ? Eigen::Array3d(-4, -6, -1) : Eigen::Array3d(-6, -6, -3);
  const Eigen::Array3d high = model.with_rate ? Eigen::Array3d(2, 0, 5) : Eigen::Array3d(0, 0, 3);
  for (int k = 0; k < 3; ++k) {
    if (!given[static_cast<std::size_t>(k)])
      model.noise[k] = std::pow(10, (low[k] + 2 * high[k]) / 3);
  }
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (int k = 0; k < 3; ++k) {
      if (given[static_cast<std::size_t>(k)]) continue;
      const double best = internal::Maximise(low[k], high[k], kSearch, [&](double exponent) {
        PoseModel tried = model;
        tried.noise[k] = std::pow(10, exponent);
        return BothWays(frames, tried).log_likelihood;
      });
      model.noise[k] = std::pow(10, best);
    }
  }
  *log_likelihood = BothWays(frames, model).log_likelihood;
  return model;
}

PoseModel ModelOf(std::span<const PoseObservation> frames, const RigRotationOptions& options) {
  PoseModel walk;
  walk.unseen_height_mm = options.unseen_height_mm_per_sqrt_s;
  walk.prior = options.prior;
  walk.prior_sigma = options.prior_sigma;
  walk.obstacle_mm = options.obstacle_height_mm;
  walk.sigma_obstacle_mm = std::isfinite(options.sigma_obstacle_height_mm)
                               ? options.sigma_obstacle_height_mm
                               : kAnyObstacle_mm;
  for (int k = 0; k < 3; ++k) {
    if (std::isfinite(walk.prior_sigma[k])) continue;
    walk.prior_sigma[k] = kWide[k];
    for (const PoseObservation& frame : frames) {
      if (k < AnglesAndHeight(frame)) {
        walk.prior[k] = frame.pose[k];
        break;
      }
      if (k == 2 && frame.top) {
        walk.prior[k] = frame.top->below_axis_mm + walk.obstacle_mm;
        break;
      }
    }
  }
  const std::optional<double> given[3] = {options.pitch_deg_per_sqrt_s, options.roll_deg_per_sqrt_s,
                                          options.height_mm_per_sqrt_s};
  std::array<bool, 3> held{};
  for (int k = 0; k < 3; ++k) {
    held[static_cast<std::size_t>(k)] = given[k].has_value();
    if (given[k]) walk.noise[k] = *given[k] * (k < 2 ? kDegree : 1);
  }
  const bool tells_roll = std::any_of(frames.begin(), frames.end(), [](const PoseObservation& f) {
    return AnglesAndHeight(f) > 1;
  });
  if (!held[1] && !tells_roll) {
    held[1] = true;
    walk.noise[1] = kStiffRoll;
  }
  double walk_likelihood = 0, rate_likelihood = 0;
  PoseModel rate = walk;
  walk = Likeliest(frames, walk, held, &walk_likelihood);
  if (held[0] || held[2]) return walk;
  rate.with_rate = true;
  rate = Likeliest(frames, rate, held, &rate_likelihood);
  return rate_likelihood > walk_likelihood ? rate : walk;
}

// The upper bound of chi-square with so many degrees of freedom at a small share (Wilson and
// Hilferty, PNAS 17(12), 1931).
double ChiSquareBound(int degrees, double share) {
  double low = 0, high = 40;  // of the normal's upper tail
  for (int k = 0; k < 60; ++k) {
    const double middle = (low + high) / 2;
    (std::erfc(middle / std::numbers::sqrt2) / 2 > share ? low : high) = middle;
  }
  const double spread = 2.0 / (9.0 * degrees);
  return degrees * std::pow(1 - spread + low * std::sqrt(spread), 3);
}

// Smooths, and leaves the observation out (or takes it back) about which the rest is surest that it
// was wrong, until there is none.
std::vector<SmoothedPose> SmoothWithout(std::span<const PoseObservation> frames,
                                        const PoseModel& model, double share,
                                        std::vector<std::uint8_t>* taken) {
  const double bounds[4] = {0, ChiSquareBound(1, share), ChiSquareBound(2, share),
                            ChiSquareBound(3, share)};
  for (int round = 0;; ++round) {
    std::vector<SmoothedPose> poses = internal::SmoothPoses(frames, *taken, model);
    if (round == kOutlierRounds) return poses;
    double worst = 1;
    std::size_t at = frames.size();
    for (std::size_t k = 0; k < frames.size(); ++k) {
      if (frames[k].of == Of::kNothing) continue;
      const bool in = (*taken)[k] != 0;
      const double ratio =
          internal::Contradiction(frames[k], poses[k], in) / bounds[AnglesAndHeight(frames[k])];
      const double wrong = in ? ratio : 1 / ratio;
      if (wrong > worst) {
        worst = wrong;
        at = k;
      }
    }
    if (at == frames.size()) return poses;
    (*taken)[at] = (*taken)[at] != 0 ? 0 : 1;
  }
}

void CheckInput(std::span<const PoseObservation> frames, std::span<const WheelAxis> axes) {
  for (std::size_t k = 0; k < frames.size(); ++k) {
    if (k > 0 && !(frames[k].time_s > frames[k - 1].time_s)) {
      throw InputError(fmt::format(
          "Frame {} is not later than the one before; give the frames in the order of their times.",
          k));
    }
    if (frames[k].of == Of::kNothing) continue;
    for (const PoseObservation& other : frames) {
      if (other.of != Of::kNothing && other.along_modes.size() != frames[k].along_modes.size()) {
        throw std::invalid_argument("SmoothRigRotation: frames with different calibration modes");
      }
    }
    if (frames[k].top && frames[k].top->along_modes_mm.size() != frames[k].along_modes.size()) {
      throw std::invalid_argument("SmoothRigRotation: a top without its calibration modes");
    }
    if (!axes.empty() && axes.size() != frames[k].along_modes.size()) {
      throw std::invalid_argument("SmoothRigRotation: not an axis for each calibration mode");
    }
  }
}

RigRotationFrame FrameOf(const PoseObservation& frame, const SmoothedPose& smoothed, bool taken,
                         const WheelAxis& axis, std::span<const WheelAxis> axis_along_modes,
                         const RigRotationOptions& options) {
  using From = RigRotationFrame::From;
  RigRotationFrame result;
  result.time_s = frame.time_s;
  result.pose = smoothed.pose;
  result.errors = smoothed.errors;
  result.cov_random = smoothed.cov;
  result.along_modes = smoothed.along_modes;
  result.sigma_random = result.cov_random.diagonal().cwiseMax(0).cwiseSqrt();
  for (const RigPose& change : smoothed.along_modes) {
    result.sigma_calibration += change.cwiseAbs2();
  }
  result.sigma_calibration = result.sigma_calibration.cwiseSqrt();
  result.problem = frame.why;
  // What frames have in common, others do not take off.
  const Eigen::Matrix3d alone = internal::PoseWithoutCommon(smoothed.errors.cov);
  if (frame.of != Of::kNothing && !taken) {
    result.from = From::kOutlier;
    result.problem = "the other frames contradict what this one says by itself: left out";
  } else if (AnglesAndHeight(frame) > 1) {
    result.from = frame.over_obstacle ? From::kObstacle : From::kPlane;
    result.lean = 1 - (alone(0, 0) / frame.cov(0, 0) + alone(1, 1) / frame.cov(1, 1)) / 2;
  } else if (frame.of == Of::kPitch) {
    result.from = From::kPitch;
    result.lean = 1 - alone(0, 0) / frame.cov(0, 0) / 2;
  }
  result.lean = std::clamp(result.lean, 0.0, 1.0);
  const RigPose sigma =
      (result.sigma_random.cwiseAbs2() + result.sigma_calibration.cwiseAbs2()).cwiseSqrt();
  const RigPose limit(options.max_sigma_rad, options.max_sigma_rad, options.max_sigma_height_mm);
  const char* names[3] = {"pitch", "roll", "height"};
  std::string unknown;
  for (int k = 0; k < 3; ++k) {
    result.known[static_cast<std::size_t>(k)] = sigma[k] <= limit[k];
    if (result.known[static_cast<std::size_t>(k)]) continue;
    unknown += fmt::format("{}{}", unknown.empty() ? "" : " and ", names[k]);
  }
  result.found = unknown.empty();
  if (!result.found) {
    result.problem = fmt::format("the frames around do not tell the {} of the ground{}{}", unknown,
                                 frame.why.empty() ? "" : "; in this one ", frame.why);
    return result;
  }
  result.ground.frame_from_rig = GroundOf(result.pose, axis);
  for (std::size_t m = 0; m < result.along_modes.size(); ++m) {
    result.ground.along_modes.push_back(
        GroundOf(result.pose + result.along_modes[m],
                 axis_along_modes.empty() ? axis : axis_along_modes[m]));
  }
  return result;
}

}  // namespace

RigPose PoseOf(const GroundPlane& plane, const WheelAxis& axis) {
  Eigen::Vector3d n;
  const double height_mm = InWheel(plane, axis, &n);
  return {std::atan2(n.x(), n.z()), -std::asin(std::clamp(n.y(), -1.0, 1.0)), height_mm};
}

Eigen::Matrix3d PoseJacobian(const GroundPlane& plane, const WheelAxis& axis) {
  Eigen::Vector3d n;
  InWheel(plane, axis, &n);
  const Eigen::Vector3d from_centroid = axis.origin_in_rig_mm() - plane.centroid;
  Eigen::Matrix3d J;
  const Eigen::Vector3d d_normal[2] = {-plane.e2, plane.e1};
  for (int k = 0; k < 2; ++k) {
    const Eigen::Vector3d d = axis.rotation.transpose() * d_normal[k];
    J(0, k) = (n.z() * d.x() - n.x() * d.z()) / (n.x() * n.x() + n.z() * n.z());
    J(1, k) = -d.y() / std::sqrt(1 - n.y() * n.y());
    J(2, k) = d_normal[k].dot(from_centroid);
  }
  J.col(2) << 0, 0, -1;
  return J;
}

GroundPlane PlaneOf(const RigPose& pose, const WheelAxis& axis) {
  const double cp = std::cos(pose[0]), sp = std::sin(pose[0]);
  const double cr = std::cos(pose[1]), sr = std::sin(pose[1]);
  GroundPlane plane;
  plane.normal = axis.rotation * Eigen::Vector3d(sp * cr, -sr, cp * cr);
  plane.offset_mm = plane.normal.dot(axis.origin_in_rig_mm()) - pose[2];
  plane.centroid = axis.origin_in_rig_mm() - pose[2] * plane.normal;
  plane.e2 = axis.direction_in_rig();
  plane.e2 = (plane.e2 - plane.e2.dot(plane.normal) * plane.normal).normalized();
  plane.e1 = plane.e2.cross(plane.normal);
  return plane;
}

Rigid3 GroundOf(const RigPose& pose, const WheelAxis& axis) {
  const GroundPlane plane = PlaneOf(pose, axis);
  return GroundFromRig(plane, axis.direction_in_rig().cross(plane.normal), axis.origin_in_rig_mm());
}

Eigen::Matrix<double, 6, 3> GroundJacobian(const RigPose& pose, const WheelAxis& axis) {
  constexpr double kStep = 1e-5;
  const Rigid3 back = GroundOf(pose, axis).Inverse();
  Eigen::Matrix<double, 6, 3> J;
  for (int k = 0; k < 3; ++k) {
    const Rigid3 moved = GroundOf(pose + kStep * RigPose::Unit(k), axis) * back;
    J.col(k) << moved.RotationVector() / kStep, moved.translation_mm / kStep;
  }
  return J;
}

PoseObservation ObservePlane(double time_s, const GroundPlane& plane, const WheelAxis& axis,
                             std::span<const GroundPlane> along_modes,
                             std::span<const WheelAxis> axis_along_modes) {
  if (!axis_along_modes.empty() && axis_along_modes.size() != along_modes.size()) {
    throw std::invalid_argument("ObservePlane: not an axis for each calibration mode");
  }
  PoseObservation frame;
  frame.time_s = time_s;
  frame.of = Of::kPlane;
  frame.pose = PoseOf(plane, axis);
  const Eigen::Matrix3d J = PoseJacobian(plane, axis);
  frame.cov = J * plane.cov * J.transpose();
  for (std::size_t m = 0; m < along_modes.size(); ++m) {
    frame.along_modes.push_back(
        PoseOf(along_modes[m], axis_along_modes.empty() ? axis : axis_along_modes[m]) - frame.pose);
  }
  return frame;
}

PoseObservation ObservePitch(double time_s, const DeformationSymmetry& symmetry,
                             std::span<const double> pitch_along_modes_rad) {
  PoseObservation frame;
  frame.time_s = time_s;
  frame.of = Of::kPitch;
  frame.pose[0] = symmetry.pitch_rad;
  const double sigma_rad = std::hypot(symmetry.sigma_noise_rad, symmetry.sigma_asymmetry_rad);
  frame.cov(0, 0) = sigma_rad * sigma_rad;
  frame.common[0][0] = symmetry.sigma_asymmetry_rad;
  for (const double pitch_rad : pitch_along_modes_rad) {
    frame.along_modes.emplace_back(pitch_rad - symmetry.pitch_rad, 0, 0);
  }
  return frame;
}

void RigRotationOptions::Check() const {
  for (const auto& noise : {pitch_deg_per_sqrt_s, roll_deg_per_sqrt_s, height_mm_per_sqrt_s}) {
    if (noise && !(*noise >= 0 && std::isfinite(*noise))) {
      throw UsageError("The noise of the rig's rotation has to be 0 or more.");
    }
  }
  if (!(unseen_height_mm_per_sqrt_s >= 0 && std::isfinite(unseen_height_mm_per_sqrt_s))) {
    throw UsageError("The noise of the axle's height over obstacles has to be 0 or more.");
  }
  if (!(prior_sigma.array() > 0).all() || !prior.allFinite()) {
    throw UsageError("What is known of the first frame needs finite values and positive sigmas.");
  }
  if (!(sigma_obstacle_height_mm > 0) || !std::isfinite(obstacle_height_mm)) {
    throw UsageError("What is known of an obstacle's height needs a value and a positive sigma.");
  }
  if (!(outlier_share > 0 && outlier_share < 0.1)) {
    throw UsageError("The share of frames that are taken for outliers lies between 0 and 0.1.");
  }
  if (!(max_sigma_rad > 0) || !(max_sigma_height_mm > 0)) {
    throw UsageError("The largest sigmas of a pose must be positive.");
  }
}

RigRotation SmoothRigRotation(std::span<const PoseObservation> frames, const WheelAxis& axis,
                              std::span<const WheelAxis> axis_along_modes,
                              const RigRotationOptions& options) {
  options.Check();
  CheckInput(frames, axis_along_modes);
  RigRotation result;
  const bool any = std::any_of(frames.begin(), frames.end(),
                               [](const PoseObservation& f) { return f.of != Of::kNothing; });
  if (!any) {
    result.problem = "no frame tells how the ground lies; give the rig's rotation by hand";
    for (const PoseObservation& frame : frames) {
      result.frames.emplace_back();
      result.frames.back().time_s = frame.time_s;
      result.frames.back().problem = frame.why;
    }
    return result;
  }
  const PoseModel model = ModelOf(frames, options);
  result.with_rate = model.with_rate;
  result.noise = model.noise;
  std::vector<std::uint8_t> taken = BothWays(frames, model).taken;
  const std::vector<SmoothedPose> poses =
      SmoothWithout(frames, model, options.outlier_share, &taken);
  for (std::size_t k = 0; k < frames.size(); ++k) {
    result.frames.push_back(
        FrameOf(frames[k], poses[k], taken[k] != 0, axis, axis_along_modes, options));
    result.found = result.found || result.frames.back().found;
    result.outliers += result.frames.back().from == RigRotationFrame::From::kOutlier ? 1 : 0;
  }
  if (!result.found) result.problem = result.frames.front().problem;
  return result;
}

Eigen::Matrix3d RandomCovariance(std::span<const RigRotationFrame> frames, std::size_t a,
                                 std::size_t b) {
  PoseErrors::Matrix cov = frames[b].errors.cov;
  for (std::size_t k = b; k-- > a;) cov = (frames[k].errors.gain * cov).eval();
  return internal::PoseOf(cov);
}

double SigmaOfTurn(std::span<const RigRotationFrame> frames, std::size_t a, std::size_t b) {
  return std::sqrt(std::max(0.0, RandomCovariance(frames, a, a)(0, 0) +
                                     RandomCovariance(frames, b, b)(0, 0) -
                                     2 * RandomCovariance(frames, a, b)(0, 0)));
}

Eigen::MatrixXd RandomRoot(std::span<const RigRotationFrame> frames) {
  const auto rows = static_cast<Eigen::Index>(3 * frames.size());
  Eigen::MatrixXd joint(rows, rows);
  for (std::size_t a = 0; a < frames.size(); ++a) {
    for (std::size_t b = a; b < frames.size(); ++b) {
      const auto i = static_cast<Eigen::Index>(3 * a), j = static_cast<Eigen::Index>(3 * b);
      const Eigen::Matrix3d cov = RandomCovariance(frames, a, b);
      joint.block<3, 3>(i, j) = cov;
      joint.block<3, 3>(j, i) = cov.transpose();
    }
  }
  return internal::CovarianceRoot(joint);
}

Rigid3 ManualGround(const Eigen::Vector3d& turns_deg,
                    const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                    const std::optional<WheelAxis>& axis) {
  Rigid3 ground_from_rig;
  for (int k = 0; k < 3; ++k) {
    ground_from_rig.rotation =
        RotationFromVector(turns_deg[k] * kDegree * Eigen::Vector3d::Unit(k)) *
        ground_from_rig.rotation;
  }
  double lowest_mm = std::numeric_limits<double>::infinity();
  for (const Eigen::Vector3d& point : undeformed_in_rig_mm.values()) {
    const double z_mm = ground_from_rig.rotation.row(2).dot(point);
    if (z_mm < lowest_mm) lowest_mm = z_mm;
  }
  if (!std::isfinite(lowest_mm)) {
    throw InputError(
        "There is no undeformed point to put the ground's height at; give a wheel's reference.");
  }
  const Eigen::Vector3d origin = axis ? axis->origin_in_rig_mm() : Eigen::Vector3d::Zero();
  ground_from_rig.translation_mm = -(ground_from_rig.rotation * origin);
  ground_from_rig.translation_mm.z() = -lowest_mm;
  return ground_from_rig;
}

}  // namespace plumbline
