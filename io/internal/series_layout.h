#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "io/internal/bytes.h"
#include "io/series_frame.h"

namespace plumbline::internal {

// What a series may hold beside what every series holds. The place in this list is the bit in the
// journal.
using ContentFlag = bool SeriesContents::*;
struct OptionalContent {
  std::string_view name;
  std::string_view path;  // it is there where a file has this group or dataset
  ContentFlag flag;
};
inline constexpr std::array<OptionalContent, 6> kOptionalContents = {{
    {"covariance", "/surface/covariance", &SeriesContents::covariance},
    {"displacement", "/displacement", &SeriesContents::displacement},
    {"strain", "/strain", &SeriesContents::strain},
    {"wheel", "/wheel", &SeriesContents::wheel},
    {"patch", "/patch", &SeriesContents::patch},
    {"slip", "/slip", &SeriesContents::slip},
}};

// needs: what has to be in the contents; null: every series holds it.
inline bool Holds(const SeriesContents& contents, ContentFlag needs) {
  return needs == nullptr || contents.*needs;
}

// The groups that hold a vector a point, with its sigmas.
enum PointGroup : std::uint8_t { kSurface, kDisplacement, kStrain, kSlip, kPointGroupCount };
struct PointGroupFacts {
  std::string_view path;
  std::string_view signal;  // the dataset of the vectors
  std::string_view what;    // they are
  ContentFlag needs;
  bool in_surface_frame;  // their components are along the axes of Surface::frame
};
inline constexpr std::array<PointGroupFacts, kPointGroupCount> kPointGroups = {{
    {"/surface", "position", "position", nullptr, true},
    {"/displacement", "value", "displacement", &SeriesContents::displacement, true},
    {"/strain", "green_lagrange", "strain", &SeriesContents::strain, false},
    {"/slip", "velocity", "velocity", &SeriesContents::slip, true},
}};

// The vectors of a group in a frame, their random and their calibration sigmas.
template <typename Frame>
auto VectorImages(Frame& frame, PointGroup group) {
  using Images = std::array<decltype(&frame.surface.position_mm), 3>;
  switch (group) {
    case kDisplacement: {
      auto& field = frame.displacement;
      return Images{&field.value_mm, &field.sigma_random_mm, &field.sigma_calibration_mm};
    }
    case kStrain: {
      auto& field = frame.strain;
      return Images{&field.green_lagrange, &field.sigma_random, &field.sigma_calibration};
    }
    case kSlip: {
      auto& field = frame.slip;
      return Images{&field.velocity_mm_s, &field.sigma_random_mm_s, &field.sigma_calibration_mm_s};
    }
    default: {
      auto& field = frame.surface;
      return Images{&field.position_mm, &field.sigma_random_mm, &field.sigma_calibration_mm};
    }
  }
}

// The axis of a point field's components: a dataset of names in the field's group.
struct ComponentAxis {
  std::string_view name;  // empty: the field has one component and no such axis
  int count;
  std::array<std::string_view, 6> labels;
};
inline constexpr ComponentAxis kOneNumber{"", 1, {}};
inline constexpr ComponentAxis kXyz{"component", 3, {"x", "y", "z"}};
inline constexpr ComponentAxis kPlaneTensor{"component", 3, {"xx", "yy", "xy"}};
inline constexpr ComponentAxis kPrincipals{"principal_component", 2, {"first", "second"}};
inline constexpr ComponentAxis kSpaceTensor{
    "covariance_component", 6, {"xx", "xy", "xz", "yy", "yz", "zz"}};

// long_name of uncertainties, of points and of records.
inline constexpr std::string_view kRandomSigma = "standard deviation from independent noise";
inline constexpr std::string_view kCalibrationSigma = "standard deviation from the calibration";
inline constexpr std::string_view kCombinedSigma =
    "standard deviation, random and calibration parts combined in quadrature";

// What of a point a field holds.
enum class PointPart : std::uint8_t {
  kValue,
  kRandom,
  kCalibration,
  kCombined,
  kPrincipal,
  kPrincipalAngle,
  kCovariance,
  kCorrelation,
  kEpipolar,
  kStatus,  // bytes; all others are 32-bit floats
};

// A dataset that holds one value or vector a point.
struct PointField {
  PointGroup group;
  PointPart part;
  std::string_view name;
  const ComponentAxis* axis;
  std::string_view units;
  std::string_view long_name;
  ContentFlag needs;

  std::string Path() const;
  bool is_status() const { return part == PointPart::kStatus; }
};

// All of them, in the order of the file.
std::span<const PointField> PointFields();
const PointField& FieldOf(PointGroup group, PointPart part);

// Size of the grid, how it is cut (a chunk holds `band_rows` rows of one frame), and what is held.
struct SeriesShape {
  std::int32_t rows = 0;
  std::int32_t columns = 0;
  std::int32_t band_rows = 1;
  std::uint32_t content_bits = 0;  // by the place in kOptionalContents

  SeriesContents contents() const;
  int bands() const { return (rows + band_rows - 1) / band_rows; }
  std::size_t ChunkBytes(const PointField& field) const;

  // Chunks of about 1 MiB at most, what HDF5's default cache holds.
  static SeriesShape For(ImageSize grid, const SeriesContents& contents);
};

// One frame as the journal keeps it: everything but the points, and these as compressed HDF5 chunks
// (shuffle, deflate level 1), ready to be copied into the file.
struct FrameRecord {
  SeriesFrame frame;  // holds no images; of the surface only `frame`
  bool has_surface = false;
  struct Chunk {
    std::size_t field = 0;  // place in PointFields()
    int band = 0;
    std::span<const std::uint8_t> bytes;
  };
  std::vector<Chunk> chunks;
};

// Compresses with all threads; the bytes do not depend on their number. Throws
// std::invalid_argument when the surface or another field does not fit the shape.
std::vector<std::uint8_t> EncodeFrame(const SeriesFrame& frame, const SeriesShape& shape);

// `chunks` point into `bytes`. Throws std::runtime_error on what EncodeFrame() did not write.
FrameRecord DecodeFrame(std::span<const std::uint8_t> bytes, const SeriesShape& shape);

}  // namespace plumbline::internal
