#include "apps/rig_input.h"

#include <fmt/format.h>

#include <filesystem>

#include "calib/error.h"
#include "io/rig_file.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

void RequireFile(const std::string& file) {
  if (fs::is_regular_file(file)) return;
  throw InputError(fmt::format("There is no rig file '{}'.", file));
}

// Only files of our own calibration have it.
std::optional<double> WorkingDistance(const std::string& file) {
  try {
    const NamedArray array = ReadRigArray(file, "working_distance");
    if (array.values.size() == 1 && array.values[0] > 0) return array.values[0];
  } catch (const InputError&) {
  }
  return std::nullopt;
}

}  // namespace

RigInput OpenRig(const std::string& text, const ForeignCalibrationOptions& options) {
  // A file whose name has a comma in it is a file first.
  const std::size_t comma = fs::exists(text) ? std::string::npos : text.find(',');
  if (comma != std::string::npos) {
    const std::string left = text.substr(0, comma);
    const std::string right = text.substr(comma + 1);
    RequireFile(left);
    RequireFile(right);
    return {ReadCameraModelPair(left, right), {}, {left, right}, {}};
  }
  RequireFile(text);
  const std::string extension = fs::path(text).extension().string();
  if (extension == ".h5" || extension == ".hdf5") {
    return {ReadRigFile(text), WorkingDistance(text), {text}, {}};
  }
  if (extension == ".cameramodel") {
    throw InputError(fmt::format(
        "'{}' is one camera; give both, as --rig left.cameramodel,right.cameramodel.", text));
  }
  StereoCalibrationFile file = ReadStereoCalibrationFile(text, options);
  return {std::move(file.rig), {}, {text}, std::move(file.notes)};
}

}  // namespace plumbline
