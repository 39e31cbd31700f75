#include "calib/triangulate.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "calib/internal/common_perpendicular.h"
#include "calib/internal/epipolar_residual.h"

namespace plumbline {
namespace {

using internal::CommonPerpendicular;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kChunk = 256;  // correspondences whose rays are held on the stack
constexpr std::size_t kChunksPerTask = 4;

using Matrix32 = Eigen::Matrix<double, 3, 2>;

// The right camera in the rig frame.
struct RightCamera {
  explicit RightCamera(const StereoRig& rig)
      : rotation(rig.right_from_left.rotation.transpose()),
        centre(-(rotation * rig.right_from_left.translation_mm)) {}
  Eigen::Matrix3d rotation;  // left_from_right
  Eigen::Vector3d centre;    // mm
};

// The derivative of the midpoint along one direction in which the rays and the centre move by df0,
// df1, dc. From f0.w = f1.w = 0, w = depth0 f0 - depth1 f1 - c, by the implicit function theorem.
class MidpointDerivative {
 public:
  MidpointDerivative(const Eigen::Vector3d& f0, const Eigen::Vector3d& f1,
                     const Eigen::Vector3d& centre, double depth0, double depth1)
      : f0_(f0), f1_(f1), w_(depth0 * f0 - depth1 * f1 - centre), depth0_(depth0), depth1_(depth1) {
    Eigen::Matrix2d A;
    A << f0.dot(f0), -f0.dot(f1), f0.dot(f1), -f1.dot(f1);
    inverse_ = A.inverse();
  }

  Eigen::Vector3d Along(const Eigen::Vector3d& df0, const Eigen::Vector3d& df1,
                        const Eigen::Vector3d& dc) const {
    const Eigen::Vector3d dw = depth0_ * df0 - depth1_ * df1 - dc;  // at constant depths
    const Eigen::Vector2d d_depth =
        -inverse_ * Eigen::Vector2d(df0.dot(w_) + f0_.dot(dw), df1.dot(w_) + f1_.dot(dw));
    return 0.5 * (d_depth[0] * f0_ + depth0_ * df0 + dc + d_depth[1] * f1_ + depth1_ * df1);
  }

 private:
  Eigen::Vector3d f0_, f1_, w_;
  double depth0_, depth1_;
  Eigen::Matrix2d inverse_;
};

bool IsCovariance(const Eigen::Matrix4d& S) {
  if (!S.allFinite()) return false;
  return (S - S.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * S.cwiseAbs().maxCoeff();
}

void CheckCovariance(const StereoObservation& o, const std::string& which) {
  if (!o.left.allFinite() || !o.right.allFinite() || IsCovariance(o.cov_px2)) return;
  throw std::invalid_argument("Triangulate: cov_px2 of " + which +
                              " is not finite and symmetric; its order is (left x, left y, right "
                              "x, right y), in px^2");
}

// Everything of one correspondence but the lens: r0, r1 are the unit rays in their own cameras, F0
// and F1 their derivatives with respect to the pixels.
TriangulatedPoint TriangulateRays(const StereoRig& rig, const RightCamera& right,
                                  const Eigen::Vector3d& r0, const Matrix32& F0,
                                  const Eigen::Vector3d& r1, const Matrix32& F1,
                                  const Eigen::Matrix4d& S) {
  TriangulatedPoint out;
  out.point_in_rig.setConstant(kNaN);
  out.cov_mm2.setConstant(kNaN);
  out.d_point_d_pixels.setConstant(kNaN);
  out.epipolar_px = out.sigma_epipolar_px = kNaN;
  if (!r0.allFinite() || !r1.allFinite()) {
    out.status = Status::kOutsideImage;
    return out;
  }

  const internal::EpipolarConstraint constraint(r0, F0, r1, F1, rig.right_from_left.rotation,
                                                rig.right_from_left.translation_mm);
  const double per_px = constraint.per_px();
  out.epipolar_px = constraint.a / per_px;
  const Eigen::Vector4d d_epipolar = constraint.d_pixels / per_px;
  out.sigma_epipolar_px = std::sqrt(d_epipolar.dot(S * d_epipolar));

  const Eigen::Vector3d f1 = right.rotation * r1;
  double depth0 = 0, depth1 = 0;
  if (!CommonPerpendicular(r0, f1, right.centre, &depth0, &depth1)) {
    out.status = Status::kBehindCamera;
    return out;
  }
  out.point_in_rig = 0.5 * (depth0 * r0 + right.centre + depth1 * f1);
  const MidpointDerivative derivative(r0, f1, right.centre, depth0, depth1);
  const Matrix32 d_f1 = right.rotation * F1;
  const Eigen::Vector3d zero = Eigen::Vector3d::Zero();
  Eigen::Matrix<double, 3, 4>& J = out.d_point_d_pixels;
  for (int k = 0; k < 2; ++k) {
    J.col(k) = derivative.Along(F0.col(k), zero, zero);
    J.col(2 + k) = derivative.Along(zero, d_f1.col(k), zero);
  }
  const Eigen::Matrix3d cov = J * S * J.transpose();
  out.cov_mm2 = 0.5 * (cov + cov.transpose());
  return out;
}

void TriangulateChunk(const StereoRig& rig, std::span<const StereoObservation> observations,
                      std::span<TriangulatedPoint> out) {
  std::array<Eigen::Vector2d, kChunk> q0, q1;
  std::array<Eigen::Vector3d, kChunk> r0, r1;
  std::array<Matrix32, kChunk> F0, F1;
  const std::size_t n = observations.size();
  for (std::size_t i = 0; i < n; ++i) {
    q0[i] = observations[i].left;
    q1[i] = observations[i].right;
  }
  rig.left.UnprojectWithPixelJacobians({q0.data(), n}, {r0.data(), n}, {F0.data(), n});
  rig.right.UnprojectWithPixelJacobians({q1.data(), n}, {r1.data(), n}, {F1.data(), n});
  const RightCamera right(rig);
  for (std::size_t i = 0; i < n; ++i) {
    out[i] = TriangulateRays(rig, right, r0[i], F0[i], r1[i], F1[i], observations[i].cov_px2);
  }
}

void TriangulateChunk(const StereoRig& rig, std::span<const Eigen::Vector2d> left,
                      std::span<const Eigen::Vector2d> right, std::span<Eigen::Vector3d> out) {
  std::array<Eigen::Vector3d, kChunk> r0, r1;
  const std::size_t n = left.size();
  rig.left.Unproject(left, {r0.data(), n});
  rig.right.Unproject(right, {r1.data(), n});
  const RightCamera camera(rig);
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Vector3d f1 = camera.rotation * r1[i];
    double depth0 = 0, depth1 = 0;
    if (CommonPerpendicular(r0[i], f1, camera.centre, &depth0, &depth1)) {
      out[i] = 0.5 * (depth0 * r0[i] + camera.centre + depth1 * f1);
    } else {
      out[i].setConstant(kNaN);  // also where a ray is NaN
    }
  }
}

// Runs f(first, count) over [0, n) in chunks that do not depend on the number of threads.
template <typename F>
void ForEachChunk(std::size_t n, const F& f) {
  const std::size_t chunks = (n + kChunk - 1) / kChunk;
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, chunks, kChunksPerTask),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t c = range.begin(); c != range.end(); ++c) {
                        f(c * kChunk, std::min(kChunk, n - c * kChunk));
                      }
                    });
}

}  // namespace

TriangulatedPoint Triangulate(const StereoRig& rig, const StereoObservation& observation) {
  CheckCovariance(observation, "the observation");
  TriangulatedPoint out;
  TriangulateChunk(rig, {&observation, 1}, std::span<TriangulatedPoint>(&out, 1));
  return out;
}

std::vector<TriangulatedPoint> Triangulate(const StereoRig& rig,
                                           std::span<const StereoObservation> observations) {
  for (std::size_t i = 0; i < observations.size(); ++i) {
    if (!observations[i].left.allFinite() || IsCovariance(observations[i].cov_px2)) continue;
    CheckCovariance(observations[i], "observation " + std::to_string(i));
  }
  std::vector<TriangulatedPoint> out(observations.size());
  ForEachChunk(observations.size(), [&](std::size_t first, std::size_t count) {
    TriangulateChunk(rig, observations.subspan(first, count),
                     std::span<TriangulatedPoint>(out).subspan(first, count));
  });
  return out;
}

std::vector<Eigen::Vector3d> TriangulatePoints(const StereoRig& rig,
                                               std::span<const Eigen::Vector2d> left,
                                               std::span<const Eigen::Vector2d> right) {
  if (left.size() != right.size()) {
    throw std::invalid_argument("TriangulatePoints: " + std::to_string(left.size()) +
                                " left pixels, but " + std::to_string(right.size()) +
                                " right ones");
  }
  std::vector<Eigen::Vector3d> out(left.size());
  ForEachChunk(left.size(), [&](std::size_t first, std::size_t count) {
    TriangulateChunk(rig, left.subspan(first, count), right.subspan(first, count),
                     std::span<Eigen::Vector3d>(out).subspan(first, count));
  });
  return out;
}

Eigen::MatrixXd TriangulationParameterJacobian(const StereoRig& rig, const Eigen::Vector2d& left,
                                               const Eigen::Vector2d& right) {
  Eigen::MatrixXd J = Eigen::MatrixXd::Constant(3, rig.ParameterCount(), kNaN);
  const Camera::Unprojection at0 = rig.left.UnprojectWithJacobians(left);
  const Camera::Unprojection at1 = rig.right.UnprojectWithJacobians(right);
  const RightCamera camera(rig);
  const Eigen::Vector3d f1 = camera.rotation * at1.ray;
  double depth0 = 0, depth1 = 0;
  if (!CommonPerpendicular(at0.ray, f1, camera.centre, &depth0, &depth1)) return J;
  const MidpointDerivative derivative(at0.ray, f1, camera.centre, depth0, depth1);

  const Eigen::Vector3d zero = Eigen::Vector3d::Zero();
  Eigen::Index column = 0;
  for (Eigen::Index k = 0; k < at0.d_ray_d_parameters.cols(); ++k) {
    J.col(column++) = derivative.Along(at0.d_ray_d_parameters.col(k), zero, zero);
  }
  for (Eigen::Index k = 0; k < at1.d_ray_d_parameters.cols(); ++k) {
    J.col(column++) = derivative.Along(zero, camera.rotation * at1.d_ray_d_parameters.col(k), zero);
  }
  // f1 = R' r1, c = -R' t.
  Eigen::Matrix3d dR[3];
  RotationFromVector(rig.right_from_left.RotationVector(), dR);
  for (const Eigen::Matrix3d& d : dR) {
    J.col(column++) = derivative.Along(zero, d.transpose() * at1.ray,
                                       -(d.transpose() * rig.right_from_left.translation_mm));
  }
  for (int k = 0; k < 3; ++k) {
    J.col(column++) = derivative.Along(zero, zero, -camera.rotation.col(k));
  }
  return J;
}

}  // namespace plumbline
