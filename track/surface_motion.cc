#include "track/surface_motion.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "calib/error.h"
#include "calib/parallel.h"

namespace plumbline {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
using Matrix32 = Eigen::Matrix<double, 3, 2>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6f = Eigen::Matrix<float, 6, 1>;

void CheckSizes(const SurfaceState& from, const SurfaceState& to) {
  if (from.size() == to.size() && from.along_modes_mm.size() == to.along_modes_mm.size()) return;
  throw InputError(
      "Two instants of a surface have different grids or calibration modes; they have to be of one "
      "run.");
}

// One match's part in a sum: d sum / d error, with the sign, its scale and the reference's share.
struct Part {
  const Image<Eigen::Matrix<float, 3, 2>>* derivative;
  const Image<float>* scale;
  const Image<float>* share;
  double sign;
};

template <std::size_t kParts>
Eigen::Matrix3d CovarianceOfSum(const std::array<Part, kParts>& parts, std::size_t i,
                                const Eigen::Matrix2d& unit) {
  Matrix32 common = Matrix32::Zero();
  Eigen::Matrix3d cov = Eigen::Matrix3d::Zero();
  for (const Part& part : parts) {
    const auto share = static_cast<double>(part.share->data()[i]);
    const Matrix32 beta = part.sign * static_cast<double>(part.scale->data()[i]) *
                          part.derivative->data()[i].template cast<double>();
    common += std::sqrt(share) * beta;
    cov += (1 - share) * (beta * unit * beta.transpose());
  }
  return cov + common * unit * common.transpose();
}

std::array<Part, 2> PartsOf(const SurfaceState& instant, double sign) {
  return {Part{&instant.d_left, &instant.scale_left, &instant.share_left, sign},
          Part{&instant.d_right, &instant.scale_right, &instant.share_right, sign}};
}

// What the subsets leave out of a point.
Eigen::Matrix3d LeftOutAt(const SurfaceState& instant, std::size_t i) {
  return instant.cov_left_out_mm2.empty() ? Eigen::Matrix3d::Zero().eval()
                                          : CovarianceOf(instant.cov_left_out_mm2.data()[i]);
}

// Of a point at q from the centroid: what rotation and translation do to it.
Eigen::Matrix<double, 3, 6> RigidJacobian(const Eigen::Vector3d& q) {
  Eigen::Matrix<double, 3, 6> J;
  J << -Skew(q), Eigen::Matrix3d::Identity();
  return J;
}

}  // namespace

SurfaceMotion MotionBetween(const SurfaceState& from, const SurfaceState& to,
                            const Image<Eigen::Vector3f>& cov_px2) {
  CheckSizes(from, to);
  SurfaceMotion motion;
  const ImageSize size = from.size();
  motion.value_mm = Image<Eigen::Vector3d>(
      size, Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
  motion.cov_random_mm2 = Image<Vector6f>(size, Vector6f::Constant(kNone));
  motion.sigma_calibration_mm = Image<Eigen::Vector3f>(size, Eigen::Vector3f::Constant(kNone));
  const std::size_t modes = from.along_modes_mm.size();
  const auto before = PartsOf(from, -1), after = PartsOf(to, 1);
  const std::array<Part, 4> parts = {before[0], before[1], after[0], after[1]};
  ForEachIndex(from.point_mm.pixel_count(), [&](std::size_t i) {
    const Eigen::Vector3d moved = to.point_mm.data()[i] - from.point_mm.data()[i];
    if (!moved.allFinite()) return;
    motion.value_mm.data()[i] = moved;
    motion.cov_random_mm2.data()[i] =
        TriangleOf(Eigen::Matrix3d(CovarianceOfSum(parts, i, CovarianceOf(cov_px2.data()[i])) +
                                   LeftOutAt(from, i) + LeftOutAt(to, i)));
    if (modes == 0) return;
    Eigen::Vector3f variance = Eigen::Vector3f::Zero();
    for (std::size_t k = 0; k < modes; ++k) {
      variance += (to.along_modes_mm[k].data()[i] - from.along_modes_mm[k].data()[i]).cwiseAbs2();
    }
    motion.sigma_calibration_mm.data()[i] = variance.cwiseSqrt();
  });
  return motion;
}

Image<Vector6f> CovarianceOf(const SurfaceState& instant, const Image<Eigen::Vector3f>& cov_px2) {
  Image<Vector6f> cov(instant.size(), Vector6f::Constant(kNone));
  const auto parts = PartsOf(instant, 1);
  ForEachIndex(cov.pixel_count(), [&](std::size_t i) {
    if (!instant.point_mm.data()[i].allFinite()) return;
    cov.data()[i] = TriangleOf(Eigen::Matrix3d(
        CovarianceOfSum(parts, i, CovarianceOf(cov_px2.data()[i])) + LeftOutAt(instant, i)));
  });
  return cov;
}

Image<Eigen::Vector3f> CalibrationSigma(const SurfaceState& instant) {
  Image<Eigen::Vector3f> sigma(instant.size(), Eigen::Vector3f::Constant(kNone));
  if (instant.along_modes_mm.empty()) return sigma;
  ForEachIndex(sigma.pixel_count(), [&](std::size_t i) {
    Eigen::Vector3f variance = Eigen::Vector3f::Zero();
    for (const auto& mode : instant.along_modes_mm) variance += mode.data()[i].cwiseAbs2();
    sigma.data()[i] = variance.cwiseSqrt();
  });
  return sigma;
}

SurfaceRigidMotion RigidMotionBetween(const SurfaceState& from, const SurfaceState& to,
                                      const SurfaceMotion& motion, double correlation_area_points) {
  CheckSizes(from, to);
  SurfaceRigidMotion rigid;
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < motion.value_mm.pixel_count(); ++i) {
    if (motion.value_mm.data()[i].allFinite()) places.push_back(i);
  }
  if (places.size() < 3) return rigid;
  const auto n = static_cast<Eigen::Index>(places.size());
  Eigen::Matrix3Xd a(3, n), b(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    a.col(i) = from.point_mm.data()[places[static_cast<std::size_t>(i)]];
    b.col(i) = to.point_mm.data()[places[static_cast<std::size_t>(i)]];
  }
  const Eigen::Matrix4d fitted = Eigen::umeyama(a, b, false);
  rigid.motion = {fitted.topLeftCorner<3, 3>(), fitted.topRightCorner<3, 1>()};
  rigid.about_mm = a.rowwise().mean();
  const Eigen::Vector3d after = b.rowwise().mean();
  // Normal equations of a small rotation about the centroid and its translation.
  Matrix6 normal = Matrix6::Zero(), noise = Matrix6::Zero();
  double squares = 0;
  const std::size_t modes = from.along_modes_mm.size();
  rigid.along_modes.assign(modes, Eigen::Matrix<double, 6, 1>::Zero());
  for (Eigen::Index i = 0; i < n; ++i) {
    const std::size_t place = places[static_cast<std::size_t>(i)];
    const Eigen::Matrix<double, 3, 6> J = RigidJacobian(b.col(i) - after);
    normal += J.transpose() * J;
    noise += J.transpose() * CovarianceOf(motion.cov_random_mm2.data()[place]) * J;
    squares += (b.col(i) - rigid.motion * Eigen::Vector3d(a.col(i))).squaredNorm();
    for (std::size_t k = 0; k < modes; ++k) {
      // The motion that is seen along the mode, less the nominal one.
      const Eigen::Vector3d d =
          to.along_modes_mm[k].data()[place].cast<double>() -
          rigid.motion.rotation * from.along_modes_mm[k].data()[place].cast<double>();
      rigid.along_modes[k] += J.transpose() * d;
    }
  }
  const Eigen::LDLT<Matrix6> solver(normal);
  const auto pivots = solver.vectorD();
  if (!(pivots.minCoeff() > 1e-12 * pivots.maxCoeff())) return rigid;
  const Matrix6 inverse = solver.solve(Matrix6::Identity());
  rigid.found = true;
  rigid.cov_random = correlation_area_points * inverse * noise * inverse;
  for (Eigen::Matrix<double, 6, 1>& change : rigid.along_modes) {
    change = (inverse * change).eval();
    rigid.cov_calibration += change * change.transpose();
  }
  if (modes == 0) rigid.cov_calibration.setConstant(std::numeric_limits<double>::quiet_NaN());
  rigid.rms_mm = std::sqrt(squares / static_cast<double>(n));
  return rigid;
}

SurfaceMotion WithoutRigidMotion(const SurfaceState& from, const SurfaceState& to,
                                 const SurfaceMotion& motion, const SurfaceRigidMotion& rigid) {
  CheckSizes(from, to);
  SurfaceMotion left = motion;
  const Rigid3 back = rigid.motion.Inverse();
  const Eigen::Matrix3d& turn = back.rotation;
  const Eigen::Vector3d after = rigid.motion * rigid.about_mm;
  const std::size_t modes = from.along_modes_mm.size();
  ForEachIndex(motion.value_mm.pixel_count(), [&](std::size_t i) {
    if (!motion.value_mm.data()[i].allFinite()) return;
    left.value_mm.data()[i] = back * to.point_mm.data()[i] - from.point_mm.data()[i];
    const Eigen::Matrix<double, 3, 6> J = RigidJacobian(to.point_mm.data()[i] - after);
    const Eigen::Matrix3d cov =
        CovarianceOf(motion.cov_random_mm2.data()[i]) + J * rigid.cov_random * J.transpose();
    const Eigen::Matrix3d turned = turn * cov * turn.transpose();
    left.cov_random_mm2.data()[i] = TriangleOf(turned);
    if (modes == 0) return;
    Eigen::Vector3d variance = Eigen::Vector3d::Zero();
    for (std::size_t k = 0; k < modes; ++k) {
      const Eigen::Vector3d moved =
          turn * (to.along_modes_mm[k].data()[i].cast<double>() - J * rigid.along_modes[k]) -
          from.along_modes_mm[k].data()[i].cast<double>();
      variance += moved.cwiseAbs2();
    }
    left.sigma_calibration_mm.data()[i] = variance.cwiseSqrt().cast<float>();
  });
  return left;
}

}  // namespace plumbline
