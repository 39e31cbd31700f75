#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "calib/image.h"
#include "calib/mode_triangulation.h"
#include "fit/carcass_thickness.h"
#include "fit/surface_points.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// The points of one frame on the survey's grid, in the rig frame.
struct FramePoints {
  double time_s = 0;
  SurfacePoints now, undeformed;
  Image<Eigen::Vector3d> material;  // angle (rad), place along the axis (mm), radius (mm)
  Image<Eigen::Matrix3d> cov_mm2;
  Image<double> thickness_mm;
  std::vector<Image<double>> thickness_along_modes;  // of the carcass: the last ones of all modes
  // What one standard deviation of the frame's own pose of the cameras does to the points, along
  // each of its directions; none where it was not refined.
  std::vector<Image<Eigen::Vector3f>> along_pose_mm;
};

// What the frames of a survey hold, one at a time. Keeps references.
class PointsOfFrames {
 public:
  // axes: along the modes of the reference.
  PointsOfFrames(const WheelReference& reference, const RollingWheel& rolling,
                 const std::vector<WheelAxis>& axes)
      : reference_(reference), rolling_(rolling), modes_(reference.rig), axes_(axes) {}

  // All but the time.
  FramePoints Of(std::size_t f, const CarcassThickness& carcass) const;

 private:
  void AddPoseErrors(const RollingFrame& frame, const std::vector<Eigen::Vector2d>& left,
                     const std::vector<Eigen::Vector2d>& right, FramePoints* out) const;
  void AddModes(std::size_t f, const std::vector<Eigen::Vector2d>& left,
                const std::vector<Eigen::Vector2d>& right, FramePoints* out) const;

  const WheelReference& reference_;
  const RollingWheel& rolling_;
  ModeTriangulation modes_;
  const std::vector<WheelAxis>& axes_;
};

}  // namespace plumbline::internal
