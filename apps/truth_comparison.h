#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>

#include "io/series_writer.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline {

// One measured frame held against what the virtual rig knows. Sigmas are one standard deviation.
struct TruthComparison {
  std::int64_t points = 0;     // compared
  std::int64_t unfounded = 0;  // measured where the left camera sees no surface
  // Distance of the measured points from the true ones in the rig frame, as they are: the frame's
  // own uncertainty (the rigid motion that calibration modes make) included.
  double rms_distance_mm = kNotMeasured;
  // The same after the rigid motion that brings the points together which agree (within 6 medians
  // of their distances): the shape alone.
  double rms_shape_mm = kNotMeasured;
  // Of that, the part along the z axis of the frame that positions are given in, and what was
  // claimed for it. The median tells of the surface, the root mean square of its worst points.
  double rms_height_mm = kNotMeasured;
  double median_height_error_mm = kNotMeasured;  // absolute
  double median_sigma_random_mm = kNotMeasured;
  double median_sigma_calibration_mm = kNotMeasured;  // NaN: unknown
  // Share of the points whose error along z is within one and two claimed sigmas (both parts).
  double within_one_sigma = kNotMeasured, within_two_sigma = kNotMeasured;
  // Of a rolling tyre's displacement from its undeformed wheel: error towards the axis, around it
  // and along it, root mean square, and the median of its size. What the wheel angle is off lies in
  // the part around the axis alone.
  Eigen::Vector3d rms_displacement_mm = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d median_displacement_error_mm = Eigen::Vector3d::Constant(kNotMeasured);
  // Share of the points whose error of displacement is within two claimed sigmas (both parts).
  Eigen::Vector3d within_two_sigma_displacement = Eigen::Vector3d::Constant(kNotMeasured);
  // Ground plane: measured less true tilt about the rig's x and y axes, and what was claimed. NaN
  // without a plane.
  Eigen::Vector2d tilt_error_rad = Eigen::Vector2d::Constant(kNotMeasured);
  Eigen::Vector2d sigma_tilt_rad = Eigen::Vector2d::Constant(kNotMeasured);

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// `measured` with its grid of left pixels (row, col); `truth` of the same exposure. The truth is
// evaluated at each measured point's own pixel, where its matches say that it is by now: nothing is
// interpolated.
TruthComparison CompareWithTruth(const SeriesFrame& measured, const Image<Eigen::Vector2f>& grid_px,
                                 const TrueFrame& truth);

}  // namespace plumbline
