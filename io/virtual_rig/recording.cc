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

// What an earlier recording left in a folder that is written again.
void RemoveEarlier(const fs::path& folder) {
  if (fs::exists(folder / "truth.h5.parts")) {
    throw InputError(fmt::format(
        "'{}' holds a recording that was not finished; delete the folder, or choose another with "
        "-o.",
        folder.string()));
  }
  std::error_code failed;
  for (const char* name :
       {"left", "right", "left.mkv", "right.mkv", "left.avi", "right.avi", "calibration",
        "channels.csv", "timestamps.csv", "truth.h5", "rig.h5", "recipe.toml"}) {
    fs::remove_all(folder / name, failed);
    if (failed) internal::ThrowSystemError("cannot remove", folder / name, failed.value());
  }
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

  // As the image sources call it.
  std::string NameOf(std::size_t side, int frame, int position) const {
    if (videos_.empty()) return fmt::format("{:05}.png", frame);
    return fmt::format("{}#{}", sides_[side].filename().string(), position);
  }

  void Close() {
    for (const auto& video : videos_) video->Close();
  }

  const std::vector<fs::path>& sides() const { return sides_; }

 private:
  std::vector<fs::path> sides_;
  std::vector<std::unique_ptr<VideoWriter>> videos_;
};

void WriteTimestamps(const fs::path& file, const VirtualRig& rig, const std::vector<int>& frames) {
  std::string times = "frame,time_s\n";
  for (const int frame : frames) times += fmt::format("{},{:.9f}\n", frame, rig.FrameTime(frame));
  internal::WriteBytes(file, times);
}

// Where the points of the board really are, in its own frame: bent and misprinted.
void WriteBoard(const fs::path& file, const CalibrationPhotographs& photographs) {
  const BoardSurface board(photographs.board, photographs.print, photographs.flaws, Rigid3());
  std::string points = "id,x_mm,y_mm,z_mm\n";
  for (int id = 0; id < photographs.board.PointCount(); ++id) {
    const Eigen::Vector3d p = board.PointAsMade(id);
    points += fmt::format("{},{:.6f},{:.6f},{:.6f}\n", id, p.x(), p.y(), p.z());
  }
  internal::WriteBytes(file, points);
}

// False when it was stopped.
bool WritePhotographs(const VirtualRig& rig, const fs::path& folder,
                      const CalibrationPhotographs& photographs, const std::vector<Rigid3>& poses,
                      const RecordingProgress& progress, Recording* recording) {
  const Scenario& scenario = rig.scenario();
  PairWriter writer(folder / "calibration", scenario, RecordingOptions::Images::kPng);
  WriteBoard(folder / "calibration" / "board.csv", photographs);
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
  // What can be refused is refused before anything is written.
  if (options.images != RecordingOptions::Images::kPng && scenario.sensor.bits > 8) {
    throw UsageError("Videos hold 8 bits a pixel; write PNG images to keep more.");
  }
  if (options.images != RecordingOptions::Images::kPng) {
    VideoWriter::CheckRate(scenario.frames_per_second);
  }
  std::vector<Rigid3> poses;
  if (options.calibration) {
    const CalibrationPhotographs& c = *options.calibration;
    poses = DrawBoardPoses(scenario.rig, c.board, c.print, c.poses);
  }
  const std::vector<Channel> channels = LogWheelChannels(rig, options.channels);
  RefuseFullFolder(folder, options.overwrite);
  if (options.overwrite) RemoveEarlier(folder);
  MakeFolder(folder);
  Recording recording;
  recording.files = {folder / "recipe.toml", folder / "rig.h5"};
  internal::WriteBytes(recording.files[0], options.recipe_toml);
  RigFileExtras extras;
  extras.recipe_toml = options.recipe_toml;
  extras.arrays.push_back({"working_distance",
                           "mm",
                           "distance of the surface from the cameras, in the middle of the view",
                           {},
                           {scenario.distance_mm},
                           {}});
  WriteRigFile(recording.files[1], scenario.rig, extras);
  if (options.calibration &&
      !WritePhotographs(rig, folder, *options.calibration, poses, progress, &recording)) {
    recording.interrupted = true;
    return recording;
  }
  if (!channels.empty()) {
    recording.files.push_back(folder / "channels.csv");
    WriteChannelsCsv(recording.files.back(), channels);
  }
  const TruthSeries truth(rig);
  const std::vector<int> recorded = rig.Recorded();
  // The truth's own channels: exact, and on the clock of the frames.
  ChannelOptions exact = options.channels;
  exact.noise = false;
  exact.clock_offset_s = -rig.FrameTime(recorded.front());
  std::vector<Channel> exact_channels = LogWheelChannels(rig, exact);
  for (Channel& channel : exact_channels) channel.clock_offset_s = channel.sigma_clock_offset_s = 0;
  SeriesHeader header = truth.Header(exact_channels);
  header.recipe_toml = options.recipe_toml;
  const fs::path truth_file = folder / "truth.h5";
  PairWriter images(folder, scenario, options.images);
  SeriesWriter series(truth_file, header);
  WriteTimestamps(folder / "timestamps.csv", rig, recorded);
  const int total = static_cast<int>(recorded.size());
  for (const int frame : recorded) {
    images.Add(frame, rig.TakeImage(frame, Side::kLeft), rig.TakeImage(frame, Side::kRight));
    SeriesFrame exposed = truth.Frame(frame);
    exposed.left_id = images.NameOf(0, frame, recording.frames);
    exposed.right_id = images.NameOf(1, frame, recording.frames);
    series.Commit(exposed);
    ++recording.frames;
    recording.interrupted = !progress("rendering", recording.frames, total);
    if (recording.interrupted) break;
  }
  images.Close();
  series.Close();
  if (recording.interrupted) {
    WriteTimestamps(folder / "timestamps.csv", rig,
                    {recorded.begin(), recorded.begin() + recording.frames});
  }
  recording.files.insert(recording.files.end(), images.sides().begin(), images.sides().end());
  recording.files.push_back(folder / "timestamps.csv");
  recording.files.push_back(truth_file);
  return recording;
}

}  // namespace plumbline
