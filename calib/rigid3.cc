#include "calib/rigid3.h"

namespace plumbline {

Rigid3 Rigid3::FromRotationVector(const Eigen::Vector3d& r_rad, const Eigen::Vector3d& t_mm) {
  return {RotationFromVector(r_rad), t_mm};
}

Eigen::Vector3d Rigid3::RotationVector() const {
  const Eigen::AngleAxisd angle_axis(rotation);
  return angle_axis.angle() * angle_axis.axis();
}

Rigid3 Rigid3::Inverse() const {
  return {rotation.transpose(), -(rotation.transpose() * translation_mm)};
}

Eigen::Matrix4d Rigid3::Matrix() const {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = rotation;
  m.topRightCorner<3, 1>() = translation_mm;
  return m;
}

Rigid3 operator*(const Rigid3& a, const Rigid3& b) {
  return {a.rotation * b.rotation, a.rotation * b.translation_mm + a.translation_mm};
}

Eigen::Matrix3d Skew(const Eigen::Vector3d& a) {
  Eigen::Matrix3d m;
  m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return m;
}

Eigen::Matrix3d RotationFromVector(const Eigen::Vector3d& r_rad, Eigen::Matrix3d* dR) {
  const double angle = r_rad.norm();
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  if (angle > 0) R = Eigen::AngleAxisd(angle, r_rad / angle).toRotationMatrix();
  if (dR == nullptr) return R;
  const double angle2 = r_rad.squaredNorm();
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d e = Eigen::Vector3d::Unit(k);
    if (angle < 1e-7) {
      // Second order in r: exp = I + [r] + [r]^2 / 2.
      dR[k] = Skew(e) + 0.5 * (Skew(e) * Skew(r_rad) + Skew(r_rad) * Skew(e));
    } else {
      const Eigen::Vector3d w =
          r_rad[k] * r_rad + r_rad.cross((Eigen::Matrix3d::Identity() - R) * e);
      dR[k] = Skew(w / angle2) * R;
    }
  }
  return R;
}

}  // namespace plumbline
