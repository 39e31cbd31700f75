#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "io/internal/bytes.h"
#include "io/series_writer.h"

namespace plumbline::internal {

// The datasets of /surface that hold one value or vector a point, in the order of the file.
struct PointField {
  std::string_view name;
  int components;
  bool is_status;  // bytes; else 32-bit floats
  std::string_view units;
  std::string_view long_name;
};

enum PointFieldIndex {
  kPosition,
  kErrorsRandom,
  kErrorsCalibration,
  kErrors,
  kCorrelation,
  kEpipolar,
  kPointStatus,
  kCovariance,  // last: optional
  kPointFieldCount
};

inline constexpr std::array<PointField, kPointFieldCount> kPointFields = {{
    {"position", 3, false, "mm", "position of the surface point"},
    {"position_errors_random", 3, false, "mm", "standard deviation from independent noise"},
    {"position_errors_calibration", 3, false, "mm",
     "standard deviation from the calibration, common to all points"},
    {"position_errors", 3, false, "mm",
     "standard deviation, random and calibration parts combined in quadrature"},
    {"correlation", 1, false, "1", "score of the match"},
    {"epipolar_px", 1, false, "pixel", "signed distance of the match from the epipolar line"},
    {"status", 1, true, "1", "why there is no value here, or ok"},
    {"covariance", 6, false, "mm2", "random covariance of the position: xx, xy, xz, yy, yz, zz"},
}};

// Size of the grid, and how it is cut: a chunk holds `band_rows` rows of one frame.
struct SeriesShape {
  std::int32_t rows = 0;
  std::int32_t columns = 0;
  std::int32_t band_rows = 1;
  std::int32_t has_covariance = 0;

  int bands() const { return (rows + band_rows - 1) / band_rows; }
  int fields() const { return has_covariance != 0 ? kPointFieldCount : kCovariance; }
  std::size_t ChunkBytes(int field) const;

  // Chunks of about 1 MiB at most, what HDF5's default cache holds.
  static SeriesShape For(ImageSize grid, bool has_covariance);
};

// One frame as the journal keeps it: everything but the surface, and the surface as compressed HDF5
// chunks (shuffle, deflate level 1), ready to be copied into the file.
struct FrameRecord {
  SeriesFrame frame;  // its surface holds no images, only `frame`
  bool has_surface = false;
  struct Chunk {
    int field = 0;
    int band = 0;
    std::span<const std::uint8_t> bytes;
  };
  std::vector<Chunk> chunks;
};

// Compresses with all threads; the bytes do not depend on their number. Throws
// std::invalid_argument when the surface does not fit the shape.
std::vector<std::uint8_t> EncodeFrame(const SeriesFrame& frame, const SeriesShape& shape);

// `chunks` point into `bytes`. Throws std::runtime_error on what EncodeFrame() did not write.
FrameRecord DecodeFrame(std::span<const std::uint8_t> bytes, const SeriesShape& shape);

}  // namespace plumbline::internal
