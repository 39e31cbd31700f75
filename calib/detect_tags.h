#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// AprilTags on whatever is photographed, one by one: no board that says where they lie.

// One square tag in a photograph.
struct DetectedTag {
  int id = 0;
  // Of the black border, in the upright tag: bottom left, bottom right, top right, top left. Raw
  // px; (0, 0) is the centre of the top-left pixel: half a pixel less than the apriltag library
  // says.
  std::array<Eigen::Vector2d, 4> corners;
  int wrong_bits = 0;  // corrected ones
};

// A family by its name (36h11, 36h10, 25h9, 16h5), with or without "tag" before it: as the apriltag
// library calls it. Throws UsageError naming those there are.
std::string TagFamilyOf(std::string_view name);

// All tags of a family (as TagFamilyOf() gives it) that an image shows, by the AprilRobotics
// library, sorted by id; an id may be there more than once. The border is one module wide, as
// published. Corners are where the lines through the edges of the border meet.
//
// Small families are read where there is no tag: with one bit corrected, a dark quadrangle of
// random bits is a tag of 36h11 once in 790 000 times, of 16h5 once in 32.
//
// Throws std::invalid_argument on another family. Pure and thread-safe.
[[nodiscard]] std::vector<DetectedTag> DetectTags(const GrayImage& image,
                                                  const std::string& family);

}  // namespace plumbline
