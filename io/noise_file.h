#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <map>
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

// A noise file: TOML with a table for each camera: "camera" where there is one only, "left" and
// "right" of a rig.
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
using NoiseFile = std::map<std::string, CameraNoise>;

// Throws InputError naming the file and what is missing or wrong.
NoiseFile ReadNoiseFile(const std::filesystem::path& path);

// The noise of one camera: "left", "right" or "camera". A file that holds one camera only answers
// to any name. Throws InputError, also when it holds others and not this one.
CameraNoise ReadCameraNoise(const std::filesystem::path& path, const std::string& camera);

// Written to a temporary name and renamed. Throws EnvironmentError.
void WriteNoiseFile(const std::filesystem::path& path, const NoiseFile& file);

}  // namespace plumbline
