#include "io/virtual_rig/rig_design.h"

#include <cmath>

#include "calib/error.h"

namespace plumbline {
namespace {

using Distortion = Eigen::Matrix<double, 5, 1>;

Camera MakeCamera(const RigDesign& design, double focal_px, const Distortion& distortion,
                  const Eigen::Vector2d& decentring_mm) {
  const Eigen::Vector2d shift = decentring_mm * 1000 / design.pixel_um;
  Eigen::VectorXd p(9);
  p << focal_px, 1.0007 * focal_px, (design.image_size.width - 1) / 2.0 + shift.x(),
      (design.image_size.height - 1) / 2.0 + shift.y(), distortion;
  return Camera(LensModel{}, design.image_size, p);
}

}  // namespace

void RigDesign::Check() const {
  if (image_size.width < 16 || image_size.height < 16) {
    throw UsageError("An image must be at least 16x16 px.");
  }
  if (!(lens_mm > 0) || !(pixel_um > 0) || !(baseline_mm > 0) || !(distance_mm > 0)) {
    throw UsageError("Lens, pixel, baseline and distance of a rig must be positive.");
  }
  const double corner = std::hypot(image_size.width, image_size.height) / 2 / focal_px();
  if (corner > 1.6) {
    throw UsageError(
        "The lens is too short for this sensor: corners over 58 degrees off the axis cannot be "
        "rendered with the OPENCV5 lens model; take a longer lens or a smaller sensor.");
  }
}

RigDesign DesignOf(RigKind kind) {
  switch (kind) {
    case RigKind::kWide640:
      return {};
    case RigKind::kWide1280:
      return {.image_size = {1280, 1024}, .pixel_um = 5};
    default:
      return {.image_size = {1280, 1024},
              .lens_mm = 25,
              .pixel_um = 5.32,
              .baseline_mm = 130,
              .distance_mm = 500,
              .converging = true};
  }
}

StereoRig MakeRig(const RigDesign& design) {
  design.Check();
  const double f = design.focal_px();
  Distortion left, right;
  if (f < design.image_size.width) {
    left << -0.200, 0.050, 4e-4, -3e-4, -0.002;
    right << -0.196, 0.048, -2e-4, 5e-4, -0.0015;
  } else {
    left << -0.09, 0.15, 2e-4, -1e-4, 0;
    right << -0.08, 0.12, -1e-4, 2e-4, 0;
  }
  Rigid3 right_from_left = Rigid3::FromRotationVector(
      {0.004, -0.006, 0.003},
      {-design.baseline_mm, 0.0075 * design.baseline_mm, -0.0125 * design.baseline_mm});
  if (design.converging) {
    const double half_rad = std::atan(design.baseline_mm / 2 / design.distance_mm);
    const Eigen::Vector3d target(0, 0, std::hypot(design.baseline_mm / 2, design.distance_mm));
    right_from_left = Rigid3::FromRotationVector({0.001, 2 * half_rad, -0.002}, {0, 0, 0});
    right_from_left.translation_mm = target - right_from_left.rotation * target;
  }
  return {MakeCamera(design, f, left, {0.023, -0.017}),
          MakeCamera(design, 0.997 * f, right, {-0.019, 0.028}),
          right_from_left,
          {},
          ""};
}

Rigid3 MakeRigPose(const StereoRig& rig, double distance_mm) {
  // Image x along the ground's x, the view along -z; the middle of the two cameras over the origin,
  // and the rig turned so that both optical axes are as steep.
  const Rigid3 left_from_right = rig.right_from_left.Inverse();
  const Eigen::Vector3d between = left_from_right.translation_mm;
  const Eigen::Vector3d look =
      (Eigen::Vector3d::UnitZ() + left_from_right.rotation.col(2)).normalized();
  const Eigen::Vector3d across = (between - look.dot(between) * look).normalized();
  Eigen::Matrix3d rows;
  rows.row(0) = across.transpose();
  rows.row(1) = -look.cross(across).transpose();
  rows.row(2) = -look.transpose();
  return {rows, Eigen::Vector3d(0, 0, distance_mm) - rows * (between / 2)};
}

}  // namespace plumbline
