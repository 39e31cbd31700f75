#include "io/virtual_rig/recording.h"

#include <fmt/format.h>

#include "calib/error.h"
#include "io/image_writer.h"
#include "io/internal/durable_file.h"
#include "io/rig_file.h"
#include "io/series_writer.h"
#include "io/virtual_rig/truth_series.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

// Apart from the streams of frames, which count up from 0.
constexpr std::uint64_t kPhotographStream = std::uint64_t{1} << 40;
// A board has sharper edges than a speckle.
constexpr int kPhotographSamples = 6;

void MakeFolder(const fs::path& folder) {
  std::error_code failed;
  fs::create_directories(folder, failed);
  if (failed) internal::ThrowSystemError("cannot make the folder", folder, failed.value());
}

void RefuseFullFolder(const fs::path& folder, bool overwrite) {
  if (overwrite || !fs::exists(folder)) return;
  if (fs::is_directory(folder) && fs::is_empty(folder)) return;
  throw InputError(fmt::format(
      "'{}' is there already and not empty; choose another folder with -o, or say --overwrite.",
      folder.string()));
}

// Both sides of a recording, as images or as videos.
class PairWriter {
 public:
  PairWriter(const fs::path& folder, const Scenario& scenario, RecordingOptions::Images images) {
    if (images == RecordingOptions::Images::kPng) {
      for (const char* side : {"left", "right"}) {
        sides_.push_back(folder / side);
        MakeFolder(sides_.back());
      }
      return;
    }
    const char* ending = images == RecordingOptions::Images::kMkv ? ".mkv" : ".avi";
    if (scenario.sensor.bits > 8) {
      throw UsageError("Videos hold 8 bits a pixel; write PNG images to keep more.");
    }
    const ImageSize sizes[] = {scenario.rig.left.size(), scenario.rig.right.size()};
    for (std::size_t k = 0; k < 2; ++k) {
      sides_.push_back(folder / (std::string(k == 0 ? "left" : "right") + ending));
      videos_.push_back(
          std::make_unique<VideoWriter>(sides_.back(), sizes[k], scenario.frames_per_second));
    }
  }

  void Add(int frame, const GrayImage& left, const GrayImage& right) {
    const GrayImage* images[] = {&left, &right};
    for (std::size_t k = 0; k < 2; ++k) {
      if (videos_.empty()) {
        WritePng(sides_[k] / fmt::format("{:05}.png", frame), *images[k]);
      } else {
        videos_[k]->Add(*images[k]);
      }
    }
  }

  void Close() {
    for (const auto& video : videos_) video->Close();
  }

  const std::vector<fs::path>& sides() const { return sides_; }

 private:
  std::vector<fs::path> sides_;
  std::vector<std::unique_ptr<VideoWriter>> videos_;
};

// False when it was stopped.
bool WritePhotographs(const VirtualRig& rig, const fs::path& folder,
                      const CalibrationPhotographs& photographs, const RecordingProgress& progress,
                      Recording* recording) {
  const Scenario& scenario = rig.scenario();
  const std::vector<Rigid3> poses =
      DrawBoardPoses(scenario.rig, photographs.board, photographs.print, photographs.poses);
  PairWriter writer(folder / "calibration", scenario, RecordingOptions::Images::kPng);
  recording->files.push_back(folder / "calibration");
  const int total = static_cast<int>(poses.size());
  for (int k = 0; k < total; ++k) {
    const StereoFrame pair =
        TakeBoardPhotographs(scenario, photographs, poses[static_cast<std::size_t>(k)], k);
    writer.Add(k, pair.left, pair.right);
    ++recording->calibration_pairs;
    if (!progress("photographing the board", k + 1, total)) return false;
  }
  return true;
}

}  // namespace

StereoFrame TakeBoardPhotographs(const Scenario& scenario,
                                 const CalibrationPhotographs& photographs,
                                 const Rigid3& left_from_board, int pair) {
  const BoardSurface board(photographs.board, photographs.print, photographs.flaws,
                           left_from_board);
  const auto albedo = MakeBoardAlbedo(photographs.board, photographs.print);
  const auto instant = board.At(0);
  RenderOptions render = scenario.render;
  render.samples_per_px = std::max(render.samples_per_px, kPhotographSamples);
  StereoFrame frame;
  frame.index = pair;
  frame.left_id = fmt::format("left/{:05}.png", pair);
  frame.right_id = fmt::format("right/{:05}.png", pair);
  const auto take = [&](const Camera& camera, const Rigid3& camera_from_rig, std::uint64_t side) {
    const Exposure exposure{instant.get(), instant.get(), camera_from_rig, camera_from_rig};
    const Light light = MakeLight(scenario.lighting, camera, Rigid3(), 1);
    return Expose(Render(camera, exposure, *albedo, light, render), scenario.sensor, scenario.seed,
                  kPhotographStream + 2 * static_cast<std::uint64_t>(pair) + side);
  };
  frame.left = take(scenario.rig.left, Rigid3(), 0);
  frame.right = take(scenario.rig.right, scenario.rig.right_from_left, 1);
  return frame;
}

Recording WriteRecording(const VirtualRig& rig, const fs::path& folder,
                         const RecordingOptions& options, const RecordingProgress& progress) {
  const Scenario& scenario = rig.scenario();
  RefuseFullFolder(folder, options.overwrite);
  MakeFolder(folder);
  Recording recording;
  recording.files = {folder / "recipe.toml", folder / "rig.h5"};
  internal::WriteBytes(recording.files[0], options.recipe_toml);
  RigFileExtras extras;
  extras.recipe_toml = options.recipe_toml;
  WriteRigFile(recording.files[1], scenario.rig, extras);
  if (options.calibration &&
      !WritePhotographs(rig, folder, *options.calibration, progress, &recording)) {
    recording.interrupted = true;
    return recording;
  }
  const std::vector<Channel> channels = LogWheelChannels(rig, options.channels);
  if (!channels.empty()) {
    recording.files.push_back(folder / "channels.csv");
    WriteChannelsCsv(recording.files.back(), channels);
  }
  const TruthSeries truth(rig);
  SeriesHeader header = truth.Header(channels);
  header.recipe_toml = options.recipe_toml;
  const fs::path truth_file = folder / "truth.h5";
  PairWriter images(folder, scenario, options.images);
  SeriesWriter series(truth_file, header);
  std::string times = "frame,time_s\n";
  const int total = static_cast<int>(truth.recorded().size());
  for (const int frame : truth.recorded()) {
    images.Add(frame, rig.TakeImage(frame, Side::kLeft), rig.TakeImage(frame, Side::kRight));
    series.Commit(truth.Frame(frame));
    times += fmt::format("{},{:.9f}\n", frame, rig.FrameTime(frame));
    ++recording.frames;
    recording.interrupted = !progress("rendering", recording.frames, total);
    if (recording.interrupted) break;
  }
  images.Close();
  series.Close();
  internal::WriteBytes(folder / "timestamps.csv", times);
  recording.files.insert(recording.files.end(), images.sides().begin(), images.sides().end());
  recording.files.push_back(folder / "timestamps.csv");
  recording.files.push_back(truth_file);
  return recording;
}

}  // namespace plumbline
