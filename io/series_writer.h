#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "calib/rigid3.h"
#include "calib/status.h"
#include "calib/stereo_rig.h"

namespace plumbline {

// The surface at the points of a grid in the left image, as /surface of the series holds it. All of
// one size (rows, columns). Values in `frame`; NaN where status is not kOk.
struct Surface {
  Image<Eigen::Vector3f> position_mm;
  Image<Eigen::Vector3f> sigma_random_mm;  // one standard deviation from independent noise
  Image<Eigen::Vector3f>
      sigma_calibration_mm;  // one standard deviation from the calibration, common to all points
  Image<float> correlation;  // NaN where the matcher has none
  Image<float> epipolar_px;
  Image<Status> status;
};

// The ground plane of one frame, as /ground holds it.
struct GroundRecord {
  bool found = false;
  std::string problem;  // why not
  Eigen::Vector3d normal_in_rig;
  double offset_mm = 0;
  Eigen::Matrix3d cov_random, cov_calibration;  // order and units of GroundPlane::cov
  Rigid3 ground_from_rig;
  double rms_mm = 0;
  double inlier_fraction = 0;
};

struct SeriesFrame {
  std::int64_t index = 0;
  double time_s = 0;
  std::string left_id, right_id;
  std::string problem;  // empty, or why this frame has no surface
  int dropped_before = 0;
  Surface surface;
  GroundRecord ground;
};

struct SeriesHeader {
  StereoRig rig;
  Image<Eigen::Vector2f> grid_px;  // (row, col): where the points sit in the left image
  int step_px = 1;
  int subset_px = 0;        // the matcher's window
  std::string recipe_toml;  // full, defaults filled in
  std::vector<std::filesystem::path> inputs;
};

// Writes one run. Frames are committed one by one; Close() finishes the file, written under a
// temporary name and renamed. Throws EnvironmentError naming the file (folder not writable, disk
// full).
class SeriesWriter {
 public:
  SeriesWriter(const std::filesystem::path& file, const SeriesHeader& header);
  ~SeriesWriter();
  void Commit(const SeriesFrame& frame);
  void Close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
