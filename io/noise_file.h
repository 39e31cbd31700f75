#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <optional>
#include <string>

#include "calib/image.h"
#include "match/noise_model.h"

namespace plumbline {

// What is known of the noise of one camera.
struct CameraNoise {
  NoiseModel model;                               // in grey levels of `bits`
  Eigen::Matrix2d cov = Eigen::Matrix2d::Zero();  // of (offset_grey2, slope_grey)
  int bits = 8;
  int frames = 0;  // that it was found from
  ImageSize size;
  double lowest_grey = 0, highest_grey = 0;  // between which it was found
  std::string created;                       // ISO 8601, UTC; empty: when it is written

  // The same for images of another number of bits, with the scale that 2^bits gives.
  NoiseModel ForBits(int image_bits) const;
};

// How one component of a quantity scatters between pairs while nothing moves: root mean squares
// over points (see NoiseFloorMeasurement). All in the quantity's unit.
struct FloorComponent {
  double noise = kNotMeasured;      // of the difference between two pairs
  double predicted = kNotMeasured;  // the same as the sigmas have it
  double sigma_ratio =
      kNotMeasured;  // of noise / predicted, from how few points and pairs there are
  // What all points did together since the first pair; it is not in the others, but in a strain's.
  double common = kNotMeasured;
  double bias = kNotMeasured;  // of the mean of the later pairs, from the first one
  double predicted_bias = kNotMeasured;

  double ratio() const { return noise / predicted; }
  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// The noise floor of a rig, from static pairs.
struct NoiseFloor {
  int frames = 0;           // the first one too
  std::int64_t points = 0;  // that all frames have
  std::int64_t strain_points = 0;
  int step_px = 0, subset_px = 0;
  std::string frame;  // whose axes the displacement is told in: "ground" or "rig"
  std::array<FloorComponent, 2> left_px, right_px;      // x, y of the images
  std::array<FloorComponent, 3> displacement_mm;        // x, y, z
  std::optional<std::array<FloorComponent, 3>> strain;  // xx, yy, xy
  std::string strain_measure;
  int vsg_px = 0;
};

// A noise file: TOML with a table for each camera: "camera" where there is one only, "left" and
// "right" of a rig; and of a rig "floor", where it was measured.
//
//   format = "plumbline-noise"
//   [left]
//   bits = 8
//   offset_grey2 = 0.52            # variance at grey level 0, rounding (1/12) not included
//   slope_grey = 0.0134            # its growth with the grey level
//   sigma_offset_grey2 = 0.011
//   sigma_slope_grey = 0.0003
//   offset_slope_correlation = -0.9
//   ...
//   [floor]
//   frames = 10
//   ...
//   [floor.displacement_mm]        # likewise left_px, right_px and strain; a number a component
//   noise = [0.0006, 0.0004, 0.0024]
//   predicted = [0.0006, 0.0004, 0.0023]
//   ratio = [1.0, 1.0, 1.04]
//   ...
struct NoiseFile {
  std::map<std::string, CameraNoise> cameras;
  std::optional<NoiseFloor> floor;
};

// Throws InputError naming the file and what is missing or wrong.
NoiseFile ReadNoiseFile(const std::filesystem::path& path);

// The noise of one camera: "left", "right" or "camera". A file that holds one camera only answers
// to any name. Throws InputError, also when it holds others and not this one.
CameraNoise ReadCameraNoise(const std::filesystem::path& path, const std::string& camera);

// Written to a temporary name and renamed. Throws EnvironmentError.
void WriteNoiseFile(const std::filesystem::path& path, const NoiseFile& file);

}  // namespace plumbline
