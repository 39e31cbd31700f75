#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/region.h"
#include "calib/image.h"
#include "calib/rectify.h"
#include "calib/stereo_rig.h"
#include "fit/ground_plane.h"
#include "io/image_source.h"
#include "io/series_writer.h"
#include "match/disparity.h"

namespace plumbline {

struct MeasureOptions {
  int step_px = 1;  // between points, in the rectified left image
  std::optional<PixelRegion> roi;
  Image<std::uint8_t> mask;               // of the left image; empty: all of it
  std::optional<double> min_distance_mm;  // from the left camera; both or neither
  std::optional<double> max_distance_mm;
  // Without distances the range is found from each pair; where that fails, within a tenth of this
  // distance (of the calibration board, say).
  std::optional<double> likely_distance_mm;
  RectificationOptions rectification;
  DisparityOptions disparity;          // its range is taken from the distances
  GroundPlaneOptions ground;           // correlation_area_points is taken from the matcher's window
  bool point_covariance = false;       // also deliver each point's 3x3 random covariance
  bool turn_into_ground_frame = true;  // false: positions stay in the rig frame

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Numbers that sum one frame up, for people. Sigmas are one standard deviation.
struct FrameSummary {
  std::int64_t grid_points = 0;       // that the region and the mask let through
  std::int64_t valid_points = 0;      // with a position
  std::int64_t plane_points = 0;      // inliers
  double plane_distance_mm = 0;       // mean z of the inliers in the rig frame
  double median_sigma_random_mm = 0;  // of a point along the plane's normal; NaN without one
  double median_sigma_calibration_mm = 0;
  int min_disparity_px = 0, max_disparity_px = 0;  // searched
};

struct MeasuredFrame {
  SeriesFrame frame;
  FrameSummary summary;
};

// From a synchronised pair of photographs to a surface with error bars: the only place that wires
// the libraries together.
//
//   rectify -> disparity with sigma -> raw pixels with covariance -> points with covariance
//           -> ground plane -> ground frame -> the same once a calibration mode
//
// Frames:  see DESIGN's ground, rig. Positions are in `ground` where a plane was found, else in
//          `rig`; Surface::frame of each frame tells.
// Random:  position errors come from the disparity's sigma; in the ground frame the height also
//          carries the plane's own random error. The position along the rows of the left image is
//          where the point is defined, and has no error of its own.
// Calibration: the whole chain behind the matches is evaluated again once a mode. In the rig frame
//          the rigid motion that a mode gives to all points at once is taken out, as it says
//          nothing about the surface. Where the rig carries no modes, these errors are NaN:
//          unknown.
// Epipolar distances are NaN: the matcher searches along epipolar lines only, so that nothing is
//          measured across them.
class StereoMeasurement {
 public:
  // Throws UsageError from the options; InputError when the cameras have no view in common, the
  // mask has another size than the left image, or region and mask leave nothing.
  StereoMeasurement(const StereoRig& rig, const MeasureOptions& options);
  ~StereoMeasurement();

  // (row, col): the raw left pixel of each grid point; NaN where the lens model has none.
  const Image<Eigen::Vector2f>& grid_px() const;
  int window_px() const;  // side of the window that gives a value

  // Throws InputError when the images are not of the rig's size. A frame that cannot be measured
  // for another reason comes back with a `problem` and an empty surface.
  MeasuredFrame Measure(const StereoFrame& pair) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

}  // namespace plumbline
