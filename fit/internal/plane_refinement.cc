#include "fit/internal/plane_refinement.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace plumbline::internal {
namespace {

constexpr double kHuber = 2.5;
// A fixed grain and tbb's deterministic reduction add the parts in the same order whatever the
// number of threads.
constexpr std::size_t kGrain = 16384;

template <typename Sum, typename AddPoint>
Sum SumOver(std::size_t count, const AddPoint& add_point) {
  return tbb::parallel_deterministic_reduce(
      tbb::blocked_range<std::size_t>(0, count, kGrain), Sum{},
      [&](const tbb::blocked_range<std::size_t>& range, Sum sum) {
        for (std::size_t i = range.begin(); i != range.end(); ++i) add_point(i, sum);
        return sum;
      },
      [](Sum a, const Sum& b) {
        a.Add(b);
        return a;
      });
}

struct FirstMoment {
  std::size_t count = 0;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  void Add(const FirstMoment& other) {
    count += other.count;
    sum += other.sum;
  }
};

struct SecondMoment {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  void Add(const SecondMoment& other) { sum += other.sum; }
};

struct NormalEquations {
  Eigen::Matrix3d jtj = Eigen::Matrix3d::Zero();           // all weights 1
  Eigen::Matrix3d weighted_jtj = Eigen::Matrix3d::Zero();  // with Huber's weights
  Eigen::Vector3d weighted_jtr = Eigen::Vector3d::Zero();
  double psi_squared = 0;
  double inside = 0;  // residuals within Huber's k: the mean derivative of psi
  double distance_squared = 0;
  double count = 0;
  void Add(const NormalEquations& other) {
    jtj += other.jtj;
    weighted_jtj += other.weighted_jtj;
    weighted_jtr += other.weighted_jtr;
    psi_squared += other.psi_squared;
    inside += other.inside;
    distance_squared += other.distance_squared;
    count += other.count;
  }
};

NormalEquations Accumulate(std::span<const Eigen::Vector3d> points_mm,
                           std::span<const Eigen::Matrix3d> cov_mm2,
                           std::span<const std::uint8_t> use, const LocalPlane& plane, double scale,
                           double sigma_floor_mm) {
  return SumOver<NormalEquations>(points_mm.size(), [&](std::size_t i, NormalEquations& sum) {
    if (use[i] == 0) return;
    const PlaneResidual r = EvaluatePlaneResidual(plane, points_mm[i], cov_mm2[i], sigma_floor_mm);
    const double u = std::abs(r.whitened) / scale;
    const double weight = u <= kHuber ? 1.0 : kHuber / u;
    const Eigen::Matrix3d jjt = r.d_whitened_d_step * r.d_whitened_d_step.transpose();
    sum.jtj += jjt;
    sum.weighted_jtj += weight * jjt;
    sum.weighted_jtr += weight * r.whitened * r.d_whitened_d_step;
    sum.psi_squared += weight * weight * r.whitened * r.whitened;
    sum.inside += u <= kHuber ? 1.0 : 0.0;
    sum.distance_squared += r.distance_mm * r.distance_mm;
    sum.count += 1;
  });
}

}  // namespace

Eigen::Vector3d LocalPlane::NormalTurned(double a, double b) const {
  return RotationFromTurn(a, b) * normal;
}

Eigen::Matrix3d LocalPlane::RotationFromTurn(double a, double b) const {
  const Eigen::Vector3d turn = a * e1 + b * e2;
  const double angle = turn.norm();
  if (angle == 0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
}

LocalPlane LocalPlane::Moved(const Eigen::Vector3d& step) const {
  const Eigen::Matrix3d rotation = RotationFromTurn(step[0], step[1]);
  LocalPlane moved;
  moved.normal = (rotation * normal).normalized();
  moved.e1 = (rotation * e1).normalized();
  moved.e2 = moved.normal.cross(moved.e1);
  moved.centroid = centroid + step[2] * normal;
  return moved;
}

LocalPlane MakeLocalPlane(const Eigen::Vector3d& normal, const Eigen::Vector3d& centroid) {
  LocalPlane plane;
  plane.normal = normal.normalized();
  const Eigen::Vector3d axis =
      std::abs(plane.normal.x()) < 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
  plane.e1 = (axis - axis.dot(plane.normal) * plane.normal).normalized();
  plane.e2 = plane.normal.cross(plane.e1);
  plane.centroid = centroid;
  return plane;
}

PlaneResidual EvaluatePlaneResidual(const LocalPlane& plane, const Eigen::Vector3d& point_mm,
                                    const Eigen::Matrix3d& cov_mm2, double sigma_floor_mm) {
  PlaneResidual r;
  const Eigen::Vector3d q = point_mm - plane.centroid;
  const Eigen::Vector3d Cn = cov_mm2 * plane.normal;
  const double variance = std::max(plane.normal.dot(Cn), sigma_floor_mm * sigma_floor_mm);
  r.distance_mm = plane.normal.dot(q);
  r.sigma_mm = std::sqrt(variance);
  r.whitened = r.distance_mm / r.sigma_mm;
  // e1 x n = -e2 and e2 x n = e1 are the normal's derivatives; those of the variance are 2 n'C dn.
  r.d_whitened_d_step[0] = (-plane.e2.dot(q) + r.distance_mm * plane.e2.dot(Cn) / variance);
  r.d_whitened_d_step[1] = (plane.e1.dot(q) - r.distance_mm * plane.e1.dot(Cn) / variance);
  r.d_whitened_d_step[2] = -1.0;
  r.d_whitened_d_step /= r.sigma_mm;
  return r;
}

Moments PointMoments(std::span<const Eigen::Vector3d> points_mm,
                     std::span<const std::uint8_t> use) {
  const auto first = SumOver<FirstMoment>(points_mm.size(), [&](std::size_t i, FirstMoment& sum) {
    if (use[i] == 0) return;
    ++sum.count;
    sum.sum += points_mm[i];
  });
  Moments moments;
  moments.count = first.count;
  if (first.count == 0) return moments;
  moments.mean = first.sum / static_cast<double>(first.count);
  const auto second =
      SumOver<SecondMoment>(points_mm.size(), [&](std::size_t i, SecondMoment& sum) {
        if (use[i] == 0) return;
        const Eigen::Vector3d q = points_mm[i] - moments.mean;
        sum.sum += q * q.transpose();
      });
  moments.cov = second.sum / static_cast<double>(first.count);
  return moments;
}

PlaneSolution RefinePlane(std::span<const Eigen::Vector3d> points_mm,
                          std::span<const Eigen::Matrix3d> cov_mm2,
                          std::span<const std::uint8_t> use, const LocalPlane& start) {
  PlaneSolution solution;
  solution.plane = start;
  // A covariance of zero (exact synthetic points) must not divide by zero: a nanometre at a metre.
  const double floor_mm = 1e-9 * std::max(1.0, start.centroid.norm());
  // Huber's k counts in units of the scatter seen, so that sigmas that are too small do not turn
  // the fit into one of absolute values.
  double scale = 1;
  NormalEquations sums = Accumulate(points_mm, cov_mm2, use, solution.plane,
                                    std::numeric_limits<double>::infinity(), floor_mm);
  for (int iteration = 0; iteration < 20; ++iteration) {
    const double dof = std::max(1.0, sums.count - 3);
    const double share_inside = std::max(sums.inside / sums.count, 0.1);
    scale = std::max(1.0, std::sqrt(sums.psi_squared / dof) / share_inside);
    const Eigen::Vector3d step = -sums.weighted_jtj.ldlt().solve(sums.weighted_jtr);
    solution.plane = solution.plane.Moved(step);
    sums = Accumulate(points_mm, cov_mm2, use, solution.plane, scale, floor_mm);
    const Eigen::Matrix3d normal_matrix = sums.weighted_jtj;
    // Converged when the step is far below the uncertainty it is part of.
    if (step.dot(normal_matrix * step) < 1e-16 * scale * scale) break;
  }
  const double dof = std::max(1.0, sums.count - 3);
  const double share_inside = std::max(sums.inside / sums.count, 0.1);
  solution.scatter_ratio = std::sqrt(sums.psi_squared / dof) / share_inside;
  solution.inverse_normal_matrix = sums.jtj.inverse();
  solution.rms_mm = std::sqrt(sums.distance_squared / sums.count);
  return solution;
}

}  // namespace plumbline::internal
