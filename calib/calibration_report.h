#pragma once

#include <string>

#include "calib/calibrate.h"

namespace plumbline {

// What a photograph set covers of a camera's image, in a coarse grid of cells: points found a cell.
Image<int> CoverageMap(const Calibration& calibration, int camera, int columns = 12, int rows = 8);

// Uncertainty of what the rig will measure, at the working distance in the middle of the common
// field.
struct WorkingUncertainty {
  double length_mm = 0;  // the length spoken of: a tenth of the working distance
  double sigma_length_random_mm =
      0;  // from matching noise of `matching_sigma_px` in each coordinate
  double sigma_length_calibration_mm = 0;
  double sigma_length_scale_mm = 0;
  double matching_sigma_px = 0.05;
  Eigen::Vector3d sigma_point_random_mm;       // x, y, z of the rig
  Eigen::Vector3d sigma_point_calibration_mm;  // the rigid motion of the rig frame taken out
};
WorkingUncertainty UncertaintyAtWorkingDistance(const Calibration& calibration);

// The report in plain words, for a terminal: what was found and how sure it is, the worst
// photographs, what would improve it.
std::string CalibrationReport(const Calibration& calibration);

}  // namespace plumbline
