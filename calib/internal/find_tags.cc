#include "calib/internal/find_tags.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h10.h>
#include <apriltag/tag36h11.h>

#include <algorithm>
#include <memory>
#include <opencv2/aruco.hpp>
#include <stdexcept>

namespace plumbline::internal {
namespace {

struct FamilyFunctions {
  const char* name;
  apriltag_family_t* (*create)();
  void (*destroy)(apriltag_family_t*);
  int dictionary;  // OpenCV's name for it
};
constexpr FamilyFunctions kFamilies[] = {
    {"tag36h11", tag36h11_create, tag36h11_destroy, cv::aruco::DICT_APRILTAG_36h11},
    {"tag36h10", tag36h10_create, tag36h10_destroy, cv::aruco::DICT_APRILTAG_36h10},
    {"tag25h9", tag25h9_create, tag25h9_destroy, cv::aruco::DICT_APRILTAG_25h9},
    {"tag16h5", tag16h5_create, tag16h5_destroy, cv::aruco::DICT_APRILTAG_16h5},
};

const FamilyFunctions& FunctionsOf(const std::string& name) {
  for (const FamilyFunctions& family : kFamilies) {
    if (name == family.name) return family;
  }
  throw std::invalid_argument("FindTags: no family " + name);
}

void SortById(std::vector<Tag>& tags) {
  std::sort(tags.begin(), tags.end(), [](const Tag& a, const Tag& b) {
    return a.id != b.id ? a.id < b.id : a.corners[0].x() < b.corners[0].x();
  });
}

}  // namespace

std::vector<Tag> FindTags(const cv::Mat& image, const std::string& family, int border_bits,
                          int corrected_bits) {
  const FamilyFunctions& functions = FunctionsOf(family);
  const std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> tags_of_family(
      functions.create(), functions.destroy);
  // A wider border moves the data bits inwards.
  const int wider = border_bits - 1;
  tags_of_family->width_at_border += 2 * wider;
  tags_of_family->total_width += 2 * wider;
  for (std::uint32_t i = 0; i < tags_of_family->nbits; ++i) {
    tags_of_family->bit_x[i] += static_cast<std::uint32_t>(wider);
    tags_of_family->bit_y[i] += static_cast<std::uint32_t>(wider);
  }
  const std::unique_ptr<apriltag_detector_t, void (*)(apriltag_detector_t*)> detector(
      apriltag_detector_create(), apriltag_detector_destroy);
  apriltag_detector_add_family_bits(detector.get(), tags_of_family.get(), corrected_bits);
  detector->quad_decimate = 1;
  detector->refine_edges = true;
  detector->nthreads = 1;
  const cv::Mat whole = image.isContinuous() ? image : image.clone();
  image_u8_t view = {whole.cols, whole.rows, whole.cols, whole.data};
  const std::unique_ptr<zarray_t, void (*)(zarray_t*)> found(
      apriltag_detector_detect(detector.get(), &view), apriltag_detections_destroy);
  std::vector<Tag> tags;
  for (int i = 0; i < zarray_size(found.get()); ++i) {
    apriltag_detection_t* detection = nullptr;
    zarray_get(found.get(), i, static_cast<void*>(&detection));
    Tag tag;
    tag.id = detection->id;
    tag.wrong_bits = detection->hamming;
    for (std::size_t k = 0; k < 4; ++k) {
      tag.corners[k] = {detection->p[k][0] - 0.5, detection->p[k][1] - 0.5};
    }
    tags.push_back(tag);
  }
  SortById(tags);
  return tags;
}

std::vector<Tag> FindTagsByContours(const cv::Mat& image, const std::string& family,
                                    int border_bits) {
  const auto parameters = cv::aruco::DetectorParameters::create();
  parameters->markerBorderBits = border_bits;
  parameters->adaptiveThreshWinSizeMax = 43;
  parameters->adaptiveThreshWinSizeStep = 8;
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> corners;
  const auto dictionary = cv::aruco::getPredefinedDictionary(FunctionsOf(family).dictionary);
  cv::aruco::detectMarkers(image, dictionary, corners, ids, parameters);
  std::vector<Tag> tags;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    Tag tag;
    tag.id = ids[i];
    // OpenCV goes clockwise, and its tags stand on their heads.
    for (std::size_t k = 0; k < 4; ++k) {
      const cv::Point2f& p = corners[i][(5 - k) % 4];
      tag.corners[k] = {p.x, p.y};
    }
    tags.push_back(tag);
  }
  SortById(tags);
  return tags;
}

}  // namespace plumbline::internal
