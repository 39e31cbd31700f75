#pragma once

#include <memory>
#include <optional>

#include "calib/image.h"
#include "calib/status.h"

namespace plumbline {

// Disparity of a rectified pair: the left pixel (x, y) is seen at (x - value(y, x), y) on the
// right.
struct DisparityMap {
  Image<float> value_px;  // NaN where status is not kOk
  Image<float> sigma_px;  // one standard deviation; NaN where status is not kOk
  Image<Status> status;
};

enum class DisparityMethod { kBm, kSgbm };

struct DisparityOptions {
  DisparityMethod method = DisparityMethod::kSgbm;
  std::optional<int> min_disparity_px;  // both or neither; neither: found automatically
  std::optional<int> max_disparity_px;
  int block_px = 5;
  double uniqueness_percent = 10;
  double left_right_tolerance_px = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Throws InputError when the images differ in size or are too small for the range.
DisparityMap ComputeDisparity(const GrayImage& left_rectified, const GrayImage& right_rectified,
                              const DisparityOptions& options);

}  // namespace plumbline
