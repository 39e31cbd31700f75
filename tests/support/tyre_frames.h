#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "calib/parallel.h"
#include "fit/ground_plane.h"
#include "fit/wheel_axis.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline::testing {

// What a perfect measurement of one frame of the virtual rig would hold, on a pixel grid.
struct TyreFrame {
  double time_s = 0;
  int step_px = 1;
  Image<Eigen::Vector3d> point_mm, undeformed_mm;  // rig frame; NaN where not seen by both cameras
  Image<double> thickness_mm;
  Image<Eigen::Matrix3d> cov_mm2;
  Rigid3 ground_from_rig;
  WheelAxis axis;

  GroundPlane Ground() const {
    GroundPlane plane;
    plane.normal = ground_from_rig.rotation.row(2);
    plane.offset_mm = -ground_from_rig.translation_mm.z();
    return plane;
  }
};

inline TyreFrame TrueTyreFrame(const VirtualRig& rig, int frame, int step_px) {
  TyreFrame result;
  result.time_s = rig.FrameTime(frame);
  result.step_px = step_px;
  const auto truth = rig.Truth(frame);
  result.ground_from_rig = truth->ground_from_rig();
  const Rigid3 rig_from_ground = result.ground_from_rig.Inverse();
  const WheelState wheel = rig.tyre()->Wheel(result.time_s);
  result.axis = WheelAxis::Through(rig_from_ground * Eigen::Vector3d(0, 0, wheel.centre_height_mm),
                                   rig_from_ground.rotation * wheel.axis);
  const ImageSize image = rig.scenario().rig.left.size();
  const ImageSize size{(image.width - 1) / step_px + 1, (image.height - 1) / step_px + 1};
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  result.point_mm = Image<Eigen::Vector3d>(size, Eigen::Vector3d::Constant(kNone));
  result.undeformed_mm = result.point_mm;
  result.thickness_mm = Image<double>(size, kNone);
  result.cov_mm2 = Image<Eigen::Matrix3d>(size, Eigen::Matrix3d::Constant(kNone));
  ForEachIndex(result.point_mm.pixel_count(), [&](std::size_t i) {
    const auto columns = static_cast<std::size_t>(size.width);
    const auto point =
        truth->UnderLeftPixel(step_px * Eigen::Vector2d(static_cast<double>(i % columns),
                                                        static_cast<double>(i / columns)));
    if (!point || !point->in_right || point->hidden_in_right) return;
    result.point_mm.data()[i] = rig_from_ground * point->position_mm;
    result.undeformed_mm.data()[i] =
        rig_from_ground * (point->position_mm - point->displacement_mm);
    result.thickness_mm.data()[i] = rig.tyre()->CarcassThickness(point->material_mm.y());
  });
  return result;
}

// The frame as noise would have it: sigma_mm along the viewing ray, a fifth of it across; points
// within `shared` grid steps share noise as overlapping square subsets do.
inline TyreFrame WithNoise(TyreFrame frame, double sigma_mm, int shared, std::mt19937& random) {
  const ImageSize size = frame.point_mm.size();
  std::normal_distribution<double> normal;
  Image<Eigen::Vector3d> white({size.width + shared, size.height + shared},
                               Eigen::Vector3d::Zero());
  for (Eigen::Vector3d& value : white.values()) {
    for (double& component : value) component = normal(random);
  }
  for (int r = 0; r < size.height; ++r) {
    for (int c = 0; c < size.width; ++c) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (int i = 0; i < shared; ++i) {
        for (int j = 0; j < shared; ++j) sum += white(r + i, c + j) / shared;
      }
      const Eigen::Vector3d ray = frame.point_mm(r, c).normalized();
      const Eigen::Matrix3d root =
          sigma_mm * (0.8 * ray * ray.transpose() + 0.2 * Eigen::Matrix3d::Identity());
      frame.point_mm(r, c) += root * sum;
      frame.cov_mm2(r, c) = root * root.transpose();
    }
  }
  return frame;
}

inline Scenario TyreScenario(const char* name, const Eigen::Vector3d& mounting_deg) {
  Scenario scenario = MakeScenario(name);
  scenario.motion.mounting_rad = mounting_deg * std::numbers::pi / 180;
  return scenario;
}

// A torque arm that swings by 3 degrees as the vehicle's speed does, and a vehicle that pitches.
inline void LetTheArmSwing(Scenario& scenario) {
  std::get<TyreOptions>(scenario.surface).speed_swing_mm_s = 400;
  scenario.motion.flexure_rad_per_m_s2 = 1.2 * std::numbers::pi / 180;
  scenario.motion.wheelbase_mm = 2794;
}

}  // namespace plumbline::testing
