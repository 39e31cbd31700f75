#pragma once

#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "io/virtual_rig/rig_design.h"
#include "track/rim_angles.h"
#include "track/wheel_reference.h"
#include "track/wheel_tags.h"

namespace plumbline::testing {

// A wheel with tags at known places, seen by a wide rig, without any image: what its corners would
// be seen at.
class TaggedWheel {
 public:
  // Tags of size_mm evenly around, radius_mm from the axis, 25 mm to both sides in turn.
  TaggedWheel(int count, double radius_mm, double size_mm) {
    for (int id = 0; id < count; ++id) {
      const double phi = 2 * std::numbers::pi * (id + 0.5) / count;
      const Eigen::Vector3d outwards(std::sin(phi), 0, -std::cos(phi)),
          along(std::cos(phi), 0, std::sin(phi));
      const Eigen::Vector3d centre =
          radius_mm * outwards + (id % 2 == 0 ? 25.0 : -25.0) * Eigen::Vector3d::UnitY();
      const double h = size_mm / 2;
      WheelTag tag;
      tag.id = id;
      const double u[4] = {-h, h, h, -h}, v[4] = {-h, -h, h, h};
      for (std::size_t k = 0; k < 4; ++k) {
        tag.corner_mm[k] = centre + u[k] * along + v[k] * Eigen::Vector3d::UnitY();
      }
      tag.along_modes_mm = Eigen::MatrixXd::Zero(wheel.rig.modes.count(), 12);
      wheel.tags.tags.push_back(tag);
    }
    wheel.tags.family = "tag36h11";
  }

  // Frames evenly over a turn, placed.
  void AddFrames(int count) {
    for (int f = 0; f < count; ++f) {
      WheelFrame frame;
      frame.index = f;
      frame.angle_rad = 2 * std::numbers::pi * f / count;
      frame.status = WheelFrameStatus::kPlaced;
      wheel.frames.push_back(frame);
    }
    wheel.cov_angles_random_rad2 = Eigen::MatrixXd::Zero(count, count);
    wheel.axis_along_modes = Eigen::MatrixXd::Zero(wheel.rig.modes.count(), 4);
    wheel.angles_along_modes_rad = Eigen::MatrixXd::Zero(wheel.rig.modes.count(), count);
  }

  // Three modes: a turn of the right camera, a focal length, the baseline.
  void AddModes() {
    const Eigen::Index P = wheel.rig.ParameterCount();
    wheel.rig.modes.modes = Eigen::MatrixXd::Zero(3, P);
    wheel.rig.modes.modes(0, P - 5) = 1e-4;
    wheel.rig.modes.modes(1, 0) = 0.1;
    wheel.rig.modes.modes.row(2).tail<3>() =
        2e-4 * wheel.rig.right_from_left.translation_mm.transpose();
    for (WheelTag& tag : wheel.tags.tags) tag.along_modes_mm = Eigen::MatrixXd::Zero(3, 12);
  }

  // The tags that are well inside of both images at an angle, with noise.
  StereoTags See(double angle_rad, double sigma_px, std::mt19937& random) const {
    std::normal_distribution<double> normal(0, 1);
    StereoTags seen;
    for (const WheelTag& tag : wheel.tags.tags) {
      // Behind the rig the lens model means nothing.
      const double phi = MaterialAngleOf(tag) - angle_rad;
      if (std::cos(phi) < 0.5) continue;
      const TagProjection there = ProjectTag(wheel.rig, wheel.axis, tag.corner_mm, angle_rad);
      StereoTag one;
      one.id = tag.id;
      bool inside = true;
      for (std::size_t k = 0; k < 4; ++k) {
        const Eigen::Vector4d p = there.pixels.segment<4>(static_cast<Eigen::Index>(4 * k));
        one.left_px[k] = p.head<2>();
        one.right_px[k] = p.tail<2>();
        inside = inside && wheel.rig.left.Contains(one.left_px[k]) &&
                 wheel.rig.right.Contains(one.right_px[k]);
        for (Eigen::Vector2d* q : {&one.left_px[k], &one.right_px[k]}) {
          q->x() += sigma_px * normal(random);
          q->y() += sigma_px * normal(random);
        }
      }
      if (inside) seen.tags.push_back(one);
    }
    return seen;
  }

  static double MaterialAngleOf(const WheelTag& tag) {
    const Eigen::Vector3d centre = tag.Centre();
    return std::atan2(centre.x(), -centre.z());
  }

  // The tags in it are the true ones.
  WheelReference wheel{.rig = MakeRig(DesignOf(RigKind::kWide640)),
                       .axis = WheelAxis::Through({20, 3, -224}, {0.03, -1, 0.02})};
};

}  // namespace plumbline::testing
