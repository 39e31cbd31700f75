#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "calib/board.h"
#include "io/virtual_rig/board_albedo.h"
#include "io/virtual_rig/board_poses.h"
#include "io/virtual_rig/board_surface.h"
#include "io/virtual_rig/virtual_rig.h"
#include "io/virtual_rig/wheel_channels.h"

namespace plumbline {

// Photographs of a calibration board by the cameras of a scenario.
struct CalibrationPhotographs {
  BoardSpec board;
  BoardPrint print;
  BoardFlaws flaws;
  BoardPoseOptions poses;
};

struct RecordingOptions {
  enum class Images { kPng, kMkv, kAvi } images = Images::kPng;
  std::optional<CalibrationPhotographs> calibration;
  ChannelOptions channels;
  std::string recipe_toml;  // stored in truth.h5 and beside it
  bool overwrite = false;   // write into a folder that is not empty
};

struct Recording {
  int frames = 0;  // written
  int calibration_pairs = 0;
  bool interrupted = false;
  std::vector<std::filesystem::path> files;  // folders and files, in the order of the documentation
};

// Told after each pair of images; returning false ends the recording after it, files whole.
using RecordingProgress = std::function<bool(const std::string& stage, int done, int total)>;

// Writes what a real recording would leave behind, and the truth of it:
//
//   left/ right/        00000.png ... by index of exposure (dropped frames are missing), or
//                       left.mkv right.mkv
//   timestamps.csv      for --timestamps
//   channels.csv        what the vehicle logged (tyre only)
//   calibration/left calibration/right calibration/board.csv
//                       photographs of the board, and where its points really are on it (mm)
//   rig.h5              the true cameras, without uncertainty
//   truth.h5            docs/file_format.md
//   recipe.toml         all settings: the same recipe makes the same images again
//
// Throws InputError when the folder is there and not empty, EnvironmentError, and what VirtualRig
// and DrawBoardPoses throw.
Recording WriteRecording(const VirtualRig& rig, const std::filesystem::path& folder,
                         const RecordingOptions& options, const RecordingProgress& progress);

// One photograph pair of a board in a pose (left_from_board), as the scenario's cameras and light
// take it. `pair` tells its noise from that of others.
StereoFrame TakeBoardPhotographs(const Scenario& scenario,
                                 const CalibrationPhotographs& photographs,
                                 const Rigid3& left_from_board, int pair);

}  // namespace plumbline
