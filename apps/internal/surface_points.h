#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "calib/rectify.h"
#include "calib/stereo_rig.h"
#include "match/disparity.h"

namespace plumbline::internal {

// The valid points of one frame as lists, with the grid point each belongs to.
struct SurfacePoints {
  std::vector<std::size_t> grid_index;        // row * columns + column
  std::vector<Eigen::Vector2d> left, right;   // px, raw images
  std::vector<Eigen::Vector3d> point_in_rig;  // mm
  std::vector<Eigen::Matrix3d> cov_mm2;       // in rig, random
};

// Grid point (row, column) sits at the rectified left pixel (x0 + column * step, y0 + row * step).
struct MeasurementGrid {
  int x0 = 0, y0 = 0, step_px = 1;
  Image<Eigen::Vector2d> raw_left;  // px, raw image; NaN where there is none
  // 1: wanted; else the status says why not.
  Image<std::uint8_t> use;
  Image<Status> status;  // kOk where wanted
};

// What one rectified disparity says in raw pixels. The left pixel is where the point is defined and
// has no error; that of the disparity moves the right one along its epipolar line.
struct RawMatch {
  Eigen::Vector2d left, right;
  Eigen::Matrix4d cov_px2;  // (left x, left y, right x, right y)
};
RawMatch MatchFromDisparity(const Rectification& rectification,
                            const Eigen::Vector2d& rectified_left, const Eigen::Vector2d& raw_left,
                            double disparity_px, double sigma_px);

// Points of the grid that have a disparity, in parallel; `status` (of the grid's size) gets the
// reason where there is none.
SurfacePoints TriangulateDisparity(const StereoRig& rig, const Rectification& rectification,
                                   const DisparityMap& disparity, const MeasurementGrid& grid,
                                   Image<Status>& status);

// The rigid motion that takes `from` onto `to` best (least squares, Umeyama, PAMI 1991, without
// scale). At most some 20 000 of the points are used; NaN ones are left out.
Rigid3 BestRigidMotion(const std::vector<Eigen::Vector3d>& from,
                       const std::vector<Eigen::Vector3d>& to);

}  // namespace plumbline::internal
