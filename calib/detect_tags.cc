#include "calib/detect_tags.h"

#include <fmt/format.h>

#include <array>

#include "calib/error.h"
#include "calib/internal/find_tags.h"
#include "calib/internal/opencv_image.h"

namespace plumbline {

std::string TagFamilyOf(std::string_view name) {
  constexpr std::array<std::string_view, 4> kFamilies = {"tag36h11", "tag36h10", "tag25h9",
                                                         "tag16h5"};
  for (const std::string_view family : kFamilies) {
    if (name == family || name == family.substr(3)) return std::string(family);
  }
  throw UsageError(
      fmt::format("There is no family of tags '{}'; there are 36h11, 36h10, 25h9 and 16h5.", name));
}

std::vector<DetectedTag> DetectTags(const GrayImage& image, const std::string& family) {
  constexpr int kPublishedBorder = 1, kCorrectedBits = 1;
  return internal::FindTags(internal::ToMat8(image), family, kPublishedBorder, kCorrectedBits);
}

}  // namespace plumbline
