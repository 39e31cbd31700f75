#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "calib/stereo_rig.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline::testing {

// Two pinhole cameras, the right one beside the left and turned so that both look at the point
// (0, 0, distance_mm) of the rig frame.
inline StereoRig ConvergentRig(ImageSize size, double focal_px, double distance_mm,
                               double baseline_mm) {
  Eigen::VectorXd lens = Eigen::VectorXd::Zero(8);
  lens.head<4>() << focal_px, focal_px, 0.5 * (size.width - 1), 0.5 * (size.height - 1);
  StereoRig rig{Camera({LensModel::Kind::kOpenCv4}, size, lens),
                Camera({LensModel::Kind::kOpenCv4}, size, lens),
                {},
                {},
                ""};
  const double angle = std::atan2(baseline_mm, distance_mm);
  // The right camera sits at (baseline, 0, 0); its axis points at the middle.
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()).toRotationMatrix();
  rig.right_from_left = {turn, turn * Eigen::Vector3d(-baseline_mm, 0, 0)};
  return rig;
}

// A speckled surface in the rig frame: a plane or a cylinder about its own y axis, stretched within
// itself, put somewhere. Material coordinates (mm) are those of the sheet when it lies flat and
// unstretched.
struct SpeckledSheet {
  Rigid3 rig_from_sheet;  // the sheet's z points away from the cameras
  Eigen::Matrix2d stretch = Eigen::Matrix2d::Identity();  // from material to the sheet, mm
  double radius_mm = 0;     // of the cylinder, which bulges towards the cameras; 0: flat
  double px_per_mm = 3.75;  // of the speckle pattern; as the cameras see it, or less

  // The place in the rig frame of a material point.
  Eigen::Vector3d PointInRig(const Eigen::Vector2d& material_mm) const {
    const Eigen::Vector2d s = stretch * material_mm;
    if (radius_mm == 0) return rig_from_sheet * Eigen::Vector3d(s.x(), s.y(), 0);
    const double a = s.x() / radius_mm;
    return rig_from_sheet *
           Eigen::Vector3d(radius_mm * std::sin(a), s.y(), radius_mm * (1 - std::cos(a)));
  }

  // Where a ray in the rig frame meets it; NaN where it does not.
  Eigen::Vector2d MaterialSeen(const Eigen::Vector3d& from, const Eigen::Vector3d& along) const {
    const Rigid3 back = rig_from_sheet.Inverse();
    const Eigen::Vector3d o = back * from, d = back.rotation * along;
    const Eigen::Vector2d none = Eigen::Vector2d::Constant(NAN);
    if (radius_mm == 0) {
      const double t = -o.z() / d.z();
      return stretch.inverse() * (o + t * d).head<2>();
    }
    // Circle in x and z about (0, radius).
    const Eigen::Vector2d p(o.x(), o.z() - radius_mm), q(d.x(), d.z());
    const double a = q.squaredNorm(), b = p.dot(q), c = p.squaredNorm() - radius_mm * radius_mm;
    const double root = b * b - a * c;
    if (root < 0) return none;
    const Eigen::Vector3d hit = o + (-b - std::sqrt(root)) / a * d;
    const double angle = std::atan2(hit.x(), radius_mm - hit.z());
    return stretch.inverse() * Eigen::Vector2d(radius_mm * angle, hit.y());
  }

  // Photographs of it.
  GrayImage Left(const StereoRig& rig, double noise_grey, std::uint32_t noise_seed,
                 const RenderedSpeckleOptions& options = {}) const {
    return Seen(rig.left, Rigid3(), noise_grey, noise_seed, options);
  }
  GrayImage Right(const StereoRig& rig, double noise_grey, std::uint32_t noise_seed,
                  const RenderedSpeckleOptions& options = {}) const {
    return Seen(rig.right, rig.right_from_left.Inverse(), noise_grey, noise_seed, options);
  }

  // The material seen at a pixel of the left camera.
  Eigen::Vector2d MaterialAt(const StereoRig& rig, const Eigen::Vector2d& left_px) const {
    return MaterialSeen(Eigen::Vector3d::Zero(), rig.left.Unproject(left_px));
  }

 private:
  GrayImage Seen(const Camera& camera, const Rigid3& rig_from_camera, double noise_grey,
                 std::uint32_t noise_seed, const RenderedSpeckleOptions& options) const {
    return RenderSpeckle(
        camera.size(),
        [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
          const Eigen::Vector2d seen = MaterialSeen(
              rig_from_camera.translation_mm, rig_from_camera.rotation * camera.Unproject(pixel));
          // Beyond the rim of a cylinder: a piece of speckle that is nowhere else.
          return seen.allFinite() ? (px_per_mm * seen).eval()
                                  : (pixel + Eigen::Vector2d(9e5, 7e5)).eval();
        },
        noise_grey, noise_seed, options);
  }
};

// Green-Lagrange strain (xx, yy, xy) of one sheet since another, within its tangent plane at a
// material point: x along the projection of `x_in_rig`, y = n x x, n towards the cameras.
inline Eigen::Vector3d TrueStrain(const SpeckledSheet& before, const SpeckledSheet& now,
                                  const Eigen::Vector2d& material_mm,
                                  const Eigen::Vector3d& x_in_rig) {
  const auto tangents = [&](const SpeckledSheet& sheet) {
    constexpr double kStep_mm = 1e-3;
    Eigen::Matrix<double, 3, 2> t;
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d step = kStep_mm * Eigen::Vector2d::Unit(k);
      t.col(k) = (sheet.PointInRig(material_mm + step) - sheet.PointInRig(material_mm - step)) /
                 (2 * kStep_mm);
    }
    return t;
  };
  const Eigen::Matrix<double, 3, 2> T = tangents(before), t = tangents(now);
  Eigen::Vector3d n = T.col(0).cross(T.col(1)).normalized();
  if (n.dot(before.PointInRig(material_mm)) > 0) n = -n;
  Eigen::Matrix<double, 3, 2> axes;
  axes.col(0) = (x_in_rig - x_in_rig.dot(n) * n).normalized();
  axes.col(1) = n.cross(axes.col(0));
  const Eigen::Matrix2d back = (axes.transpose() * T).inverse();
  const Eigen::Matrix2d green =
      0.5 * (back.transpose() * t.transpose() * t * back - Eigen::Matrix2d::Identity());
  return {green(0, 0), green(1, 1), green(0, 1)};
}

}  // namespace plumbline::testing
