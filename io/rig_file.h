#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "calib/stereo_rig.h"

namespace plumbline {

// A table of numbers for a results file.
struct NamedArray {
  std::string name;  // a path below the group, as "board/points"
  std::string units;
  std::string long_name;
  std::vector<std::size_t> shape;  // empty: one number
  std::vector<double> values;      // row-major
  // Names of one-dimensional arrays among the same extras that are the axes of its dimensions; ""
  // or left out: a plain index.
  std::vector<std::string> axes;
};

// What a calibration leaves behind beside the rig.
struct RigFileExtras {
  std::vector<NamedArray> arrays;            // residuals, target points, coverage...
  std::map<std::string, std::string> texts;  // attributes of /rig
  // .cameramodel texts with optimisation inputs; empty: made from the rig, without.
  std::string left_model_text, right_model_text;
  std::string recipe_toml;
  std::vector<std::filesystem::path> inputs;  // recorded with sizes and SHA-256
};

// Writes a rig file: root attribute format = "plumbline-rig" and the group /rig that every series
// has too (docs/file_format.md). Written to a temporary name and renamed.
//
// Throws EnvironmentError naming the file, std::invalid_argument when an extra's size and shape
// disagree.
void WriteRigFile(const std::filesystem::path& path, const StereoRig& rig,
                  const RigFileExtras& extras = {});

// Reads the rig of a rig file or of a series, bit for bit as it was written.
//
// Throws InputError naming the file and what is missing or wrong in it.
StereoRig ReadRigFile(const std::filesystem::path& path);

// One array of the group /rig of such a file. Throws InputError.
NamedArray ReadRigArray(const std::filesystem::path& path, const std::string& name);

}  // namespace plumbline
