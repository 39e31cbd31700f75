#include "io/virtual_rig/internal/board_ink.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h10.h>
#include <apriltag/tag36h11.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <opencv2/aruco/charuco.hpp>
#include <stdexcept>
#include <string_view>

namespace plumbline::internal {
namespace {

struct Dictionary {
  std::string_view name;
  int number;
};
constexpr std::array<Dictionary, 21> kDictionaries = {{
    {"DICT_4X4_50", cv::aruco::DICT_4X4_50},
    {"DICT_4X4_100", cv::aruco::DICT_4X4_100},
    {"DICT_4X4_250", cv::aruco::DICT_4X4_250},
    {"DICT_4X4_1000", cv::aruco::DICT_4X4_1000},
    {"DICT_5X5_50", cv::aruco::DICT_5X5_50},
    {"DICT_5X5_100", cv::aruco::DICT_5X5_100},
    {"DICT_5X5_250", cv::aruco::DICT_5X5_250},
    {"DICT_5X5_1000", cv::aruco::DICT_5X5_1000},
    {"DICT_6X6_50", cv::aruco::DICT_6X6_50},
    {"DICT_6X6_100", cv::aruco::DICT_6X6_100},
    {"DICT_6X6_250", cv::aruco::DICT_6X6_250},
    {"DICT_6X6_1000", cv::aruco::DICT_6X6_1000},
    {"DICT_7X7_50", cv::aruco::DICT_7X7_50},
    {"DICT_7X7_100", cv::aruco::DICT_7X7_100},
    {"DICT_7X7_250", cv::aruco::DICT_7X7_250},
    {"DICT_7X7_1000", cv::aruco::DICT_7X7_1000},
    {"DICT_ARUCO_ORIGINAL", cv::aruco::DICT_ARUCO_ORIGINAL},
    {"DICT_APRILTAG_16h5", cv::aruco::DICT_APRILTAG_16h5},
    {"DICT_APRILTAG_25h9", cv::aruco::DICT_APRILTAG_25h9},
    {"DICT_APRILTAG_36h10", cv::aruco::DICT_APRILTAG_36h10},
    {"DICT_APRILTAG_36h11", cv::aruco::DICT_APRILTAG_36h11},
}};

cv::Ptr<cv::aruco::Dictionary> DictionaryOf(const BoardSpec& spec) {
  for (const Dictionary& d : kDictionaries) {
    if (d.name == spec.dictionary) return cv::aruco::getPredefinedDictionary(d.number);
  }
  throw std::invalid_argument("MakeBoardAlbedo: no dictionary " + spec.dictionary);
}

using TagFamily = std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)>;

TagFamily FamilyOf(const std::string& name) {
  if (name == "tag36h11") return {tag36h11_create(), tag36h11_destroy};
  if (name == "tag36h10") return {tag36h10_create(), tag36h10_destroy};
  if (name == "tag25h9") return {tag25h9_create(), tag25h9_destroy};
  if (name == "tag16h5") return {tag16h5_create(), tag16h5_destroy};
  throw std::invalid_argument("MakeBoardAlbedo: no tag family " + name);
}

// What Kalibr adds to the border of one module that the families are published with.
constexpr int kWider = 1;

}  // namespace

Shade MarkerWhite(const MarkerBits& bits, int marker, double module_mm, const EdgeRamp& ramp,
                  double x_mm, double y_mm) {
  // The borders between modules that are nearest; the four modules around their crossing.
  const int column = NearestInt(x_mm / module_mm), row = NearestInt(y_mm / module_mm);
  const double from_column = x_mm - column * module_mm, from_row = y_mm - row * module_mm;
  const double right = ramp(from_column), below = ramp(from_row);
  const double upper =
      (1 - right) * bits.At(marker, column - 1, row - 1) + right * bits.At(marker, column, row - 1);
  const double lower =
      (1 - right) * bits.At(marker, column - 1, row) + right * bits.At(marker, column, row);
  return {(1 - below) * upper + below * lower,
          std::min(ramp.Clear(from_column), ramp.Clear(from_row))};
}

MarkerBits ArucoBits(const BoardSpec& spec) {
  const auto dictionary = DictionaryOf(spec);
  MarkerBits bits;
  bits.size = dictionary->markerSize + 2;
  const int count = spec.columns * spec.rows / 2;
  for (int marker = 0; marker < count; ++marker) {
    cv::Mat image;  // one pixel a module
    dictionary->drawMarker(marker, bits.size, image, 1);
    for (int row = 0; row < bits.size; ++row) {
      for (int column = 0; column < bits.size; ++column) {
        bits.white.push_back(image.at<std::uint8_t>(row, column) > 127);
      }
    }
  }
  return bits;
}

std::vector<int> MarkerOfSquare(const BoardSpec& spec) {
  const auto board =
      cv::aruco::CharucoBoard::create(spec.columns, spec.rows, 1.0F, 0.5F, DictionaryOf(spec));
  std::vector<int> markers(static_cast<std::size_t>(spec.columns * spec.rows), -1);
  for (std::size_t k = 0; k < board->ids.size(); ++k) {
    const cv::Point3f& corner = board->objPoints[k][0];
    const int column = static_cast<int>(std::floor(corner.x));
    const int row = static_cast<int>(std::floor(corner.y));
    markers[static_cast<std::size_t>(row * spec.columns + column)] = board->ids[k];
  }
  return markers;
}

int TagsOfFamily(const std::string& family) { return static_cast<int>(FamilyOf(family)->ncodes); }

MarkerBits TagBits(const std::string& family_name, int count, int border_modules) {
  const TagFamily family = FamilyOf(family_name);
  const int wider = border_modules - 1;
  MarkerBits bits;
  bits.size = family->width_at_border + 2 * wider;
  const int area = bits.size * bits.size;
  bits.white.assign(static_cast<std::size_t>(count * area), 0);
  for (int tag = 0; tag < count; ++tag) {
    const std::uint64_t code = family->codes[tag];
    for (std::uint32_t i = 0; i < family->nbits; ++i) {
      const int column = static_cast<int>(family->bit_x[i]) + wider;
      const int row = static_cast<int>(family->bit_y[i]) + wider;
      const auto place = static_cast<std::size_t>(tag * area + row * bits.size + column);
      bits.white[place] = (code >> (family->nbits - 1 - i)) & 1U;  // the first bit is the highest
    }
  }
  return bits;
}

MarkerBits KalibrTagBits(const BoardSpec& spec) {
  return TagBits(spec.dictionary, spec.columns * spec.rows, 1 + kWider);
}

int ModulesPerSide(const BoardSpec& spec) {
  if (spec.kind == BoardSpec::Kind::kAprilGrid) {
    return FamilyOf(spec.dictionary)->width_at_border + 2 * kWider;
  }
  return DictionaryOf(spec)->markerSize + 2;
}

}  // namespace plumbline::internal
