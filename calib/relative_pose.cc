#include "calib/relative_pose.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "calib/error.h"
#include "calib/internal/epipolar_residual.h"
#include "calib/median.h"

namespace plumbline {
namespace {

using internal::EpipolarResidual;
using internal::MatchRays;
using Vector5 = Eigen::Matrix<double, 5, 1>;
using Matrix5 = Eigen::Matrix<double, 5, 5>;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Matrix32 = Eigen::Matrix<double, 3, 2>;

constexpr int kMinPoints = 12;
constexpr int kMaxIterations = 50;
constexpr double kCauchyScale = 2.4;  // of a sigma: 95 % efficient on normal noise
constexpr double kMadToSigma = 1.4826;
constexpr double kInformationRatio = 100;

Vector6 ChangeOf(const Rigid3& motion) {
  Vector6 change;
  change << motion.RotationVector(), motion.translation_mm;
  return change;
}

// d w' / d dw at dw = 0 of exp(w') = exp(dw) exp(w): the inverse left Jacobian of SO(3) (Barfoot,
// State Estimation for Robotics, 2017, section 7.1).
Eigen::Matrix3d InverseLeftJacobian(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  const double factor =
      angle < 1e-4 ? 1.0 / 12 : 1 / (angle * angle) - 1 / (2 * angle * std::tan(angle / 2));
  const Eigen::Matrix3d W = Skew(w);
  return Eigen::Matrix3d::Identity() - 0.5 * W + factor * W * W;
}

// How `change` moves when its motion is followed by a small one, (rotation, translation).
Matrix6 ChangeJacobian(const Vector6& change) {
  Matrix6 J = Matrix6::Identity();
  J.topLeftCorner<3, 3>() = InverseLeftJacobian(change.head<3>());
  J.bottomLeftCorner<3, 3>() = -Skew(change.tail<3>());
  return J;
}

// Two unit vectors across t and each other.
Matrix32 Across(const Eigen::Vector3d& t) {
  Matrix32 B;
  B.col(0) = t.unitOrthogonal();
  B.col(1) = t.normalized().cross(B.col(0));
  return B;
}

// The pose with a baseline of unit length, its derivatives' basis, and how it moves.
struct UnitPose {
  Eigen::Matrix3d R;
  Eigen::Vector3d t;
  Matrix32 B;

  explicit UnitPose(const Rigid3& pose)
      : R(pose.rotation), t(pose.translation_mm.normalized()), B(Across(t)) {}

  UnitPose Moved(const Vector5& step) const {
    return UnitPose(Rigid3::FromRotationVector(step.head<3>(), B * step.tail<2>()) * Rigid3{R, t});
  }
  Rigid3 WithBaseline(double length_mm) const { return {R, t * length_mm}; }
};

// The matches that take part, as columns.
struct Matches {
  std::vector<MatchRays> rays;
  std::vector<Eigen::Vector2d> left, right;  // px
  double alike = 1;                          // that share one noise
};

Matches TakeMatches(const StereoRig& rig, std::span<const StereoObservation> observations,
                    const RelativePoseOptions& options) {
  const std::size_t most = static_cast<std::size_t>(options.max_points);
  const std::size_t taken = std::min(observations.size(), most);
  std::vector<Eigen::Vector2d> left, right;
  std::vector<std::size_t> index;
  for (std::size_t i = 0; i < taken; ++i) {
    const std::size_t at = i * observations.size() / taken;
    // The length between these two is to be independent of the pose's noise.
    const auto& known = options.known_distance;
    if (known && (at == known->a || at == known->b)) continue;
    index.push_back(at);
    left.push_back(observations[at].left);
    right.push_back(observations[at].right);
  }
  const std::size_t n = index.size();
  std::vector<Eigen::Vector3d> r0(n), r1(n);
  std::vector<Matrix32> F0(n), F1(n);
  rig.left.UnprojectWithPixelJacobians(left, r0, F0);
  rig.right.UnprojectWithPixelJacobians(right, r1, F1);
  Matches matches;
  matches.alike = std::max(1.0, options.alike_points * static_cast<double>(taken) /
                                    std::max(1.0, static_cast<double>(observations.size())));
  const UnitPose pose(rig.right_from_left);
  for (std::size_t i = 0; i < n; ++i) {
    if (!r0[i].allFinite() || !r1[i].allFinite()) continue;
    matches.rays.push_back({r0[i], r1[i], F0[i], F1[i], observations[index[i]].cov_px2});
    matches.left.push_back(left[i]);
    matches.right.push_back(right[i]);
    if (!(internal::EvaluateEpipolar(matches.rays.back(), pose.R, pose.t, pose.B).sigma > 0)) {
      throw std::invalid_argument(
          fmt::format("RefineRelativePose: cov_px2 of observation {} gives no variance across its "
                      "epipolar line",
                      index[i]));
    }
  }
  return matches;
}

// Gauss-Newton over a set of weights that follow from the residuals.
class EpipolarFit {
 public:
  EpipolarFit(const Matches& matches, const Rigid3& start, double outlier_sigmas)
      : matches_(matches), pose_(start), outlier_sigmas_(outlier_sigmas) {
    const auto needed = static_cast<std::size_t>(std::ceil(kMinPoints * matches.alike));
    if (matches.rays.size() < needed) {
      throw InputError(fmt::format(
          "The pose of the right camera needs at least {} matches, and there are {}; measure more "
          "points.",
          needed, matches.rays.size()));
    }
    weight_.resize(matches.rays.size());
    // While the scale falls the robust weights only have to come near.
    Iterate(&EpipolarFit::Cauchy, 1e-2);
    Iterate(&EpipolarFit::Inliers, 1e-10);
    const Eigen::SelfAdjointEigenSolver<Matrix5> eigen(H_);
    if (!(eigen.eigenvalues()[0] > kInformationRatio * static_cast<double>(matches.rays.size()))) {
      Refuse();
    }
    cov_ = H_.inverse();
  }

  const UnitPose& pose() const { return pose_; }
  const Matrix5& cov() const { return cov_; }  // of (dw, db), rad
  const std::vector<EpipolarResidual>& residuals() const { return residuals_; }
  bool Used(std::size_t i) const { return weight_[i] > 0; }

 private:
  [[noreturn]] static void Refuse() {
    throw InputError(
        "The matches do not determine the pose of the right camera; take points that are spread "
        "over the whole image, not along a line or in one corner.");
  }

  void Evaluate() {
    residuals_.resize(matches_.rays.size());
    std::vector<double> size(residuals_.size());
    for (std::size_t i = 0; i < residuals_.size(); ++i) {
      residuals_[i] = internal::EvaluateEpipolar(matches_.rays[i], pose_.R, pose_.t, pose_.B);
      size[i] = std::abs(residuals_[i].z);
    }
    scale_ = std::max(1.0, kMadToSigma * Median(std::move(size)));
  }
  double Cauchy(double z) const {
    const double x = z / (kCauchyScale * scale_);
    return 1 / (1 + x * x);
  }
  double Inliers(double z) const { return std::abs(z) <= outlier_sigmas_ * scale_ ? 1 : 0; }

  // Until a step moves the pose by less than `tolerance` sigmas and the weights stand.
  void Iterate(double (EpipolarFit::*weight)(double) const, double tolerance) {
    for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
      Evaluate();
      H_.setZero();
      Vector5 gradient = Vector5::Zero();
      double changed = 0;
      for (std::size_t i = 0; i < residuals_.size(); ++i) {
        const EpipolarResidual& r = residuals_[i];
        const double w = (this->*weight)(r.z);
        changed = std::max(changed, std::abs(w - weight_[i]));
        weight_[i] = w;
        if (w == 0) continue;
        H_ += w * r.d_a.transpose() * r.d_a;
        gradient += w * r.z * r.d_z.transpose();
      }
      const Vector5 step = -H_.ldlt().solve(gradient);
      if (!(step.norm() < kFar_rad)) Refuse();
      const double moved = std::sqrt(step.dot(H_ * step)) / scale_;
      if (moved < tolerance && changed < 0.1) return;
      pose_ = pose_.Moved(step);
    }
  }

  static constexpr double kFar_rad = 0.3;  // no rig moves so far between two frames

  const Matches& matches_;
  UnitPose pose_;
  double outlier_sigmas_;
  double scale_ = 1;
  std::vector<EpipolarResidual> residuals_;
  std::vector<double> weight_;
  Matrix5 H_ = Matrix5::Zero(), cov_ = Matrix5::Zero();
};

// The known distance, as this rig measures it.
class Ruler {
 public:
  Ruler(std::span<const StereoObservation> observations, const DistanceBetweenObservations& known)
      : known_(known), a_(observations[known.a]), b_(observations[known.b]) {}

  double FactorOfBaseline(const StereoRig& rig) const {
    return known_.distance_mm / Measure(rig).length_mm;
  }

  // d log(factor) / d (dw, dv) of right_from_left, and the variance that is not the pose's.
  void Derive(const StereoRig& rig, Eigen::Matrix<double, 1, 6>* d_motion, double* variance) const {
    const Measured at = Measure(rig);
    const Eigen::RowVector3d along = at.along.transpose() / at.length_mm;
    Eigen::Matrix<double, 6, 6> d_parameters = Matrix6::Identity();  // over (dw, dv)
    d_parameters.topLeftCorner<3, 3>() = InverseLeftJacobian(rig.right_from_left.RotationVector());
    d_parameters.bottomLeftCorner<3, 3>() = -Skew(rig.right_from_left.translation_mm);
    *d_motion = -along *
                (TriangulationParameterJacobian(rig, a_.left, a_.right) -
                 TriangulationParameterJacobian(rig, b_.left, b_.right))
                    .rightCols<6>() *
                d_parameters;
    const double relative = known_.sigma_mm / known_.distance_mm;
    *variance = relative * relative + along.dot(at.cov_mm2 * along.transpose());
  }

 private:
  struct Measured {
    double length_mm;
    Eigen::Vector3d along;    // unit, from b to a
    Eigen::Matrix3d cov_mm2;  // of the difference
  };
  Measured Measure(const StereoRig& rig) const {
    const TriangulatedPoint a = Triangulate(rig, a_);
    const TriangulatedPoint b = Triangulate(rig, b_);
    const Eigen::Vector3d difference = a.point_in_rig - b.point_in_rig;
    if (!(difference.norm() > 0)) {
      throw std::invalid_argument(
          "RefineRelativePose: the observations of the known distance cannot be triangulated, or "
          "are one point");
    }
    return {difference.norm(), difference.normalized(), a.cov_mm2 + b.cov_mm2};
  }

  DistanceBetweenObservations known_;
  StereoObservation a_, b_;
};

// The right camera's pose with the length of its baseline from the ruler or, without one, as given.
Rigid3 Scaled(const StereoRig& rig, const UnitPose& pose, double baseline_mm,
              const std::optional<Ruler>& ruler) {
  if (!ruler) return pose.WithBaseline(baseline_mm);
  StereoRig at = rig;
  at.right_from_left = pose.WithBaseline(baseline_mm);
  return pose.WithBaseline(baseline_mm * ruler->FactorOfBaseline(at));
}

// How far the constraint of each match moves when its rays are those of the mode: to first order in
// what the mode moves pixels.
Vector5 StepAlongMode(const Matches& matches, const EpipolarFit& fit, const StereoRig& along) {
  const std::size_t n = matches.rays.size();
  std::vector<Eigen::Vector3d> ray(n);
  std::vector<Eigen::Vector2d> left(n), right(n);
  for (std::size_t i = 0; i < n; ++i) ray[i] = matches.rays[i].r0;
  along.left.Project(ray, left);
  for (std::size_t i = 0; i < n; ++i) ray[i] = matches.rays[i].r1;
  along.right.Project(ray, right);
  Vector5 gradient = Vector5::Zero();
  const UnitPose& pose = fit.pose();
  for (std::size_t i = 0; i < n; ++i) {
    if (!fit.Used(i)) continue;
    const MatchRays& m = matches.rays[i];
    const Eigen::Vector3d r0 = m.r0 + m.F0 * (matches.left[i] - left[i]);
    const Eigen::Vector3d r1 = m.r1 + m.F1 * (matches.right[i] - right[i]);
    const double moved = r1.dot(pose.t.cross(pose.R * r0)) - m.r1.dot(pose.t.cross(pose.R * m.r0));
    gradient += fit.residuals()[i].d_a.transpose() * (moved / fit.residuals()[i].sigma);
  }
  return -fit.cov() * gradient;
}

Matrix6 CalibrationPart(const StereoRig& rig, const Matches& matches, const EpipolarFit& fit,
                        const std::optional<Ruler>& ruler, const Vector6& change) {
  std::vector<Vector6> differences(static_cast<std::size_t>(rig.modes.count()));
  tbb::parallel_for(std::size_t{0}, differences.size(), [&](std::size_t k) {
    const StereoRig along = rig.AlongMode(static_cast<int>(k));
    const UnitPose pose = fit.pose().Moved(StepAlongMode(matches, fit, along));
    differences[k] = ChangeOf(Scaled(along, pose, along.baseline_mm(), ruler) *
                              along.right_from_left.Inverse()) -
                     change;
  });
  Matrix6 cov = Matrix6::Zero();
  for (const Vector6& d : differences) cov += d * d.transpose();
  return cov;
}

Matrix6 RandomPart(const StereoRig& refined, const EpipolarFit& fit,
                   const std::optional<Ruler>& ruler, const Vector6& change) {
  const Eigen::Vector3d& t = refined.right_from_left.translation_mm;
  Eigen::Matrix<double, 6, 5> motion = Eigen::Matrix<double, 6, 5>::Zero();  // over (dw, db)
  motion.topLeftCorner<3, 3>().setIdentity();
  motion.bottomRightCorner<3, 2>() = t.norm() * fit.pose().B;
  Matrix6 cov = Matrix6::Zero();
  if (ruler) {
    Eigen::Matrix<double, 1, 6> d_motion;
    double variance = 0;
    ruler->Derive(refined, &d_motion, &variance);
    Vector6 lengthening = Vector6::Zero();
    lengthening.tail<3>() = t;
    motion += lengthening * (d_motion * motion);
    cov = variance * lengthening * lengthening.transpose();
  }
  cov += motion * fit.cov() * motion.transpose();
  const Matrix6 J = ChangeJacobian(change);
  return J * cov * J.transpose();
}

// change' cov^-1 change over all six directions, or all but that along t.
double ChiSquared(const Vector6& change, const Matrix6& cov, const Eigen::Vector3d& t,
                  int degrees_of_freedom) {
  Eigen::MatrixXd E = Matrix6::Identity();
  if (degrees_of_freedom == 5) {
    E = Eigen::MatrixXd::Zero(6, 5);
    E.topLeftCorner<3, 3>().setIdentity();
    E.bottomRightCorner<3, 2>() = Across(t);
  }
  const Eigen::VectorXd y = E.transpose() * change;
  const Eigen::MatrixXd C = E.transpose() * cov * E;
  // Radians and millimetres differ by orders.
  const Eigen::VectorXd scale = C.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::VectorXd scaled = scale.cwiseProduct(y);
  return scaled.dot((scale.asDiagonal() * C * scale.asDiagonal()).ldlt().solve(scaled));
}

// Distances of the points used from their epipolar lines with a pose.
struct EpipolarDistances {
  double mean_px = 0, rms_px = 0;

  EpipolarDistances(const Matches& matches, const EpipolarFit& fit, const Rigid3& right_from_left) {
    const UnitPose pose(right_from_left);
    double sum = 0, squares = 0, points = 0;
    for (std::size_t i = 0; i < matches.rays.size(); ++i) {
      if (!fit.Used(i)) continue;
      const MatchRays& m = matches.rays[i];
      const internal::EpipolarConstraint at(m.r0, m.F0, m.r1, m.F1, pose.R, pose.t);
      const double distance_px = at.a / at.per_px();
      sum += distance_px;
      squares += distance_px * distance_px;
      points += 1;
    }
    mean_px = sum / points;
    rms_px = std::sqrt(squares / points);
  }
};

// How the matches lie about their epipolar lines.
void SetScatter(const Rigid3& before, const Matches& matches, const EpipolarFit& fit,
                const std::optional<Rigid3>& other, RelativePose& out) {
  double z2 = 0, expected = 0;
  for (std::size_t i = 0; i < matches.rays.size(); ++i) {
    if (!fit.Used(i)) {
      ++out.mismatches;
      continue;
    }
    ++out.points;
    const EpipolarResidual& r = fit.residuals()[i];
    z2 += r.z * r.z;
    expected += r.sigma_px * r.sigma_px;
  }
  out.sigma0 = std::sqrt(z2 / (out.points - 5));
  out.epipolar_sigma_px = std::sqrt(expected / out.points);
  const EpipolarDistances at_rig(matches, fit, before);
  out.epipolar_mean_before_px = at_rig.mean_px;
  out.epipolar_rms_before_px = at_rig.rms_px;
  out.epipolar_rms_after_px = EpipolarDistances(matches, fit, out.right_from_left).rms_px;
  out.epipolar_rms_other_px = other ? EpipolarDistances(matches, fit, *other).rms_px
                                    : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

void RelativePoseOptions::Check() const {
  if (max_points < kMinPoints) {
    throw UsageError(fmt::format("The pose of the right camera needs at least {} points, not {}.",
                                 kMinPoints, max_points));
  }
  if (!(outlier_sigmas >= 2)) {
    throw UsageError("Matches can be called wrong from 2 sigmas on, not below.");
  }
  if (!(alike_points >= 1)) {
    throw UsageError("At least one match has a noise: alike_points is 1 or more.");
  }
  if (known_distance &&
      !(known_distance->distance_mm > 0 && known_distance->sigma_mm >= 0 &&
        std::isfinite(known_distance->distance_mm) && std::isfinite(known_distance->sigma_mm))) {
    throw UsageError("The known distance must be positive, and its sigma not negative.");
  }
}

RelativePose RefineRelativePose(const StereoRig& rig,
                                std::span<const StereoObservation> observations,
                                const RelativePoseOptions& options) {
  options.Check();
  std::optional<Ruler> ruler;
  if (const auto& known = options.known_distance) {
    if (std::max(known->a, known->b) >= observations.size()) {
      throw std::invalid_argument(
          fmt::format("RefineRelativePose: a known distance between observations {} and {} of {}",
                      known->a, known->b, observations.size()));
    }
    ruler.emplace(observations, *known);
  }
  const Matches matches = TakeMatches(rig, observations, options);
  const EpipolarFit fit(matches, rig.right_from_left, options.outlier_sigmas);

  RelativePose out;
  StereoRig refined = rig;
  refined.right_from_left = out.right_from_left = Scaled(rig, fit.pose(), rig.baseline_mm(), ruler);
  out.change = ChangeOf(out.right_from_left * rig.right_from_left.Inverse());
  SetScatter(rig.right_from_left, matches, fit, options.other_pose, out);
  out.cov_random = RandomPart(refined, fit, ruler, out.change);
  out.cov_random *=
      matches.alike * (options.scale_by_scatter ? std::max(1.0, out.sigma0 * out.sigma0) : 1);
  out.cov_calibration = CalibrationPart(rig, matches, fit, ruler, out.change);
  out.degrees_of_freedom = ruler ? 6 : 5;
  out.chi2 = ChiSquared(out.change, out.cov_random + out.cov_calibration,
                        out.right_from_left.translation_mm, out.degrees_of_freedom);
  return out;
}

PoseChange Between(const RelativePose& earlier, const RelativePose& later) {
  const Rigid3 motion = later.right_from_left * earlier.right_from_left.Inverse();
  // Small motions after each pose, from what their covariances are of.
  const auto small = [](const RelativePose& pose) -> Matrix6 {
    const Matrix6 inverse = ChangeJacobian(pose.change).inverse();
    return inverse * pose.cov_random * inverse.transpose();
  };
  Matrix6 carry = Matrix6::Zero();  // one before the motion as one after it
  carry.topLeftCorner<3, 3>() = carry.bottomRightCorner<3, 3>() = motion.rotation;
  carry.bottomLeftCorner<3, 3>() = Skew(motion.translation_mm) * motion.rotation;
  PoseChange out;
  out.change = ChangeOf(motion);
  const Matrix6 J = ChangeJacobian(out.change);
  out.cov_random = J * (small(later) + carry * small(earlier) * carry.transpose()) * J.transpose();
  out.degrees_of_freedom = std::max(earlier.degrees_of_freedom, later.degrees_of_freedom);
  out.chi2 = ChiSquared(out.change, out.cov_random, later.right_from_left.translation_mm,
                        out.degrees_of_freedom);
  return out;
}

}  // namespace plumbline
