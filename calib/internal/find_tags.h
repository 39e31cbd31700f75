#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "calib/detect_tags.h"

namespace plumbline::internal {

using Tag = DetectedTag;

// AprilTags by the AprilRobotics library in a CV_8UC1 image, sorted by id. `family` is its name for
// it (tag36h11, tag36h10, tag25h9, tag16h5); `border_bits` the width of the black border: 1 as
// published, 2 as printed by Kalibr; `corrected_bits` how many may be wrong, 0 to 3. Throws
// std::invalid_argument on another family.
std::vector<Tag> FindTags(const cv::Mat& image, const std::string& family, int border_bits = 1,
                          int corrected_bits = 2);

// The same by OpenCV's marker finder, which follows contours and therefore sees Kalibr's tags,
// whose corners touch black squares, where the other one does not.
std::vector<Tag> FindTagsByContours(const cv::Mat& image, const std::string& family,
                                    int border_bits);

}  // namespace plumbline::internal
