#pragma once

#include <filesystem>

#include "calib/image.h"

namespace plumbline {

// How grey levels of a 16-bit PNG stand for disparities: d = grey / steps_per_px + offset_px.
// Grey 0 means that there is no value.
struct DisparityPngScale {
  double steps_per_px = 256;
  double offset_px = 0;
};

// 256 steps a px from 0, which other programs expect (the KITTI convention), where the disparities
// lie in it; else the offset is a whole number 1 to 2 px below them, and the steps are halved until
// they fit.
DisparityPngScale ChooseDisparityPngScale(const Image<float>& disparity_px);

// Writes a 16-bit grey PNG; what is not finite becomes 0. The scale is stated in the file too, in a
// text chunk named Description. Throws UsageError when a value does not fit the scale;
// EnvironmentError when the file cannot be written, naming it. The file appears whole or not at
// all.
void WriteDisparityPng(const std::filesystem::path& file, const Image<float>& disparity_px,
                       const DisparityPngScale& scale);

// Writes a portable float map ("Pf"), 32 bits, little-endian, bottom row first; what is not finite
// becomes infinity, as in the Middlebury sets. Exact. Throws EnvironmentError naming the file.
void WritePfm(const std::filesystem::path& file, const Image<float>& image);

// Reads a one-channel portable float map of either byte order; what is not finite becomes NaN.
// Throws InputError naming the file and what is wrong in it.
Image<float> ReadPfm(const std::filesystem::path& file);

}  // namespace plumbline
