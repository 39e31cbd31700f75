#include "io/virtual_rig/recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>

#include "calib/error.h"
#include "calib/triangulate.h"
#include "io/image_source.h"
#include "io/inspect.h"
#include "io/rig_file.h"
#include "io/series_reader.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const RecordingProgress kGoOn = [](const std::string&, int, int) { return true; };

// By cameras of a quarter of the pixels.
Scenario ShortCleat() {
  RigDesign design = DesignOf(RigKind::kWide640);
  design.image_size = {320, 240};
  design.pixel_um *= 2;
  Scenario scenario = MakeScenario("tyre-disturbed", MakeRig(design), design.distance_mm);
  scenario.frames = 4;
  scenario.dropped = {1};
  scenario.step_px = 8;
  return scenario;
}

std::string TextOf(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

TEST(Recording, IsReadBackAsItWasRendered) {
  const fs::path folder = testing::TestFolder();
  for (const int bits : {8, 12}) {
    Scenario scenario = ShortCleat();
    scenario.sensor.bits = bits;
    const VirtualRig rig(scenario);
    const fs::path out = folder / std::to_string(bits);
    const Recording recording = WriteRecording(rig, out, {}, kGoOn);
    EXPECT_EQ(recording.frames, 3);
    ImageSourceOptions options;
    options.timestamps_csv = out / "timestamps.csv";
    const auto source = OpenImageSource((out / "left").string(), (out / "right").string(), options);
    for (const int exposed : {0, 2, 3}) {
      const auto frame = source->Next();
      ASSERT_TRUE(frame);
      EXPECT_EQ(frame->left.bits, bits);
      EXPECT_EQ(frame->left.grey.values(), rig.TakeImage(exposed, Side::kLeft).grey.values());
      EXPECT_EQ(frame->right.grey.values(), rig.TakeImage(exposed, Side::kRight).grey.values());
      EXPECT_NEAR(frame->time_s, rig.FrameTime(exposed), 1e-9);
    }
    EXPECT_FALSE(source->Next());
    const StereoRig read = ReadRigFile(out / "rig.h5");
    EXPECT_EQ(read.left.parameters(), scenario.rig.left.parameters());
  }
}

TEST(Recording, VideosAreLossless) {
  const fs::path folder = testing::TestFolder();
  const VirtualRig rig(ShortCleat());
  RecordingOptions options;
  options.images = RecordingOptions::Images::kMkv;
  WriteRecording(rig, folder / "sim", options, kGoOn);
  const auto source = OpenImageSource((folder / "sim" / "left.mkv").string(),
                                      (folder / "sim" / "right.mkv").string());
  for (const int exposed : {0, 2, 3}) {
    const auto frame = source->Next();
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->left.grey.values(), rig.TakeImage(exposed, Side::kLeft).grey.values());
  }
  EXPECT_FALSE(source->Next());
  Scenario deep = ShortCleat();
  deep.sensor.bits = 10;
  EXPECT_THROW(WriteRecording(VirtualRig(deep), folder / "deep", options, kGoOn), UsageError);
}

TEST(Recording, TruthIsAWholeSeriesWithAllGroups) {
  const fs::path folder = testing::TestFolder();
  const VirtualRig rig(ShortCleat());
  RecordingOptions options;
  options.recipe_toml = "[simulate]\n";
  WriteRecording(rig, folder / "sim", options, kGoOn);
  EXPECT_THAT(Validate(folder / "sim" / "truth.h5"), IsEmpty());
  const SeriesReader truth(folder / "sim" / "truth.h5");
  EXPECT_EQ(truth.facts().recipe_toml, options.recipe_toml);
  EXPECT_EQ(truth.frame_count(), 3);
  EXPECT_EQ(truth.displacement_reference(), "wheel");
  EXPECT_EQ(truth.channels().size(), 5U);
  const SeriesFrame frame = truth.Frame(1);
  // As the image source counts, names and times the frames of this recording.
  const auto source =
      OpenImageSource((folder / "sim" / "left").string(), (folder / "sim" / "right").string());
  source->Next();
  const auto recorded = source->Next();
  EXPECT_EQ(frame.index, recorded->index);
  EXPECT_EQ(frame.left_id, recorded->left_id);
  EXPECT_EQ(frame.right_id, recorded->right_id);
  EXPECT_NEAR(frame.time_s, rig.FrameTime(2), 1e-12);
  EXPECT_EQ(frame.dropped_before, 1);
  EXPECT_TRUE(frame.wheel.found && frame.patch.found && frame.slip.found && frame.ground.found);
  EXPECT_NEAR(frame.wheel.centre_mm.z(), rig.tyre()->Wheel(rig.FrameTime(2)).centre_height_mm,
              1e-9);
  const auto exact = rig.Truth(2);
  int compared = 0;
  const Image<Eigen::Vector2f> grid = truth.grid_px();
  for (int r = 0; r < grid.height(); ++r) {
    for (int c = 0; c < grid.width(); ++c) {
      if (frame.surface.status(r, c) != Status::kOk) continue;
      ++compared;
      const auto point = exact->UnderLeftPixel(grid(r, c).cast<double>());
      ASSERT_TRUE(point);
      EXPECT_TRUE(point->in_right && !point->hidden_in_right);
      const auto near = [](const Eigen::Vector3f& a, const Eigen::Vector3d& b) {
        return (a.cast<double>() - b).norm() < 1e-6 * (1 + b.norm());
      };
      EXPECT_TRUE(near(frame.surface.position_mm(r, c), point->position_mm));
      EXPECT_TRUE(near(frame.displacement.value_mm(r, c), point->displacement_mm));
      EXPECT_TRUE(near(frame.strain.value(r, c), point->green_lagrange));
      EXPECT_TRUE(near(frame.slip.velocity_mm_s(r, c), point->velocity_mm_s));
      EXPECT_EQ(frame.surface.sigma_random_mm(r, c), Eigen::Vector3f::Zero());
    }
  }
  EXPECT_GT(compared, 800);
}

// Another program looks at the file: the true positions lie on the viewing rays of their pixels.
TEST(Recording, TruePositionsAreSeenWhereTheFileSaysByMrcal) {
  const fs::path folder = testing::TestFolder();
  const VirtualRig rig(ShortCleat());
  WriteRecording(rig, folder / "sim", {}, kGoOn);
  const auto read = testing::RunPython(R"py(
import sys, io, h5py, mrcal, numpy as np
f = h5py.File(sys.argv[1])
worst = 0
for i in range(f['surface/position'].shape[0]):
    p = f['surface/position'][i].reshape(-1, 3).astype(float)
    ok = f['surface/status'][i].reshape(-1) == 0
    q = np.broadcast_to(f['grid/pixel'][:], f['surface/position'].shape[1:3] + (2,)).reshape(-1, 2)
    T = np.linalg.inv(f['ground/ground_from_rig'][i])
    p = (p[ok] @ T[:3, :3].T + T[:3, 3]) / 1000
    model = mrcal.cameramodel(io.StringIO(f['rig/left/cameramodel'].asstr()[()]))
    worst = max(worst, np.abs(mrcal.project(p, *model.intrinsics()) - q[ok]).max())
assert worst < 2e-4, worst    # positions are stored as 32-bit floats
print('seen')
)py",
                                       (folder / "sim" / "truth.h5").string());
  EXPECT_THAT(read.output, HasSubstr("seen"));
}

TEST(Recording, TruthFollowsTheMaterialWhereAsked) {
  Scenario scenario = MakeScenario("stretch", RigKind::kWide640);
  scenario.frames = 3;
  scenario.step_px = 40;
  std::get<SpecimenOptions>(scenario.surface).end_time_s = 0.2;
  const fs::path folder = testing::TestFolder();
  const VirtualRig rig(scenario);
  WriteRecording(rig, folder / "sim", {}, kGoOn);
  const SeriesReader truth(folder / "sim" / "truth.h5");
  EXPECT_EQ(truth.grid_points(), "material");
  EXPECT_EQ(truth.displacement_reference(), "frame 0");
  const SeriesFrame first = truth.Frame(0), last = truth.Frame(2);
  int compared = 0;
  for (std::size_t i = 0; i < first.surface.status.pixel_count(); ++i) {
    if (last.surface.status.data()[i] != Status::kOk) continue;
    ++compared;
    const Eigen::Vector3f moved =
        last.surface.position_mm.data()[i] - first.surface.position_mm.data()[i];
    EXPECT_LT((moved - last.displacement.value_mm.data()[i]).norm(), 1e-5);
    EXPECT_NEAR(last.strain.value.data()[i][0], 0.02 + 0.0002, 1e-7);
  }
  EXPECT_GT(compared, 20);
}

TEST(Recording, TheSameRecipeMakesTheSameFilesForAnyNumberOfThreads) {
  const fs::path folder = testing::TestFolder();
  RecordingOptions options;
  options.calibration = CalibrationPhotographs{};
  options.calibration->board = BoardSpec::Parse("chessboard:9x6:10mm");
  options.calibration->poses.count = 2;
  options.calibration->poses.min_distance_mm = 80;
  options.calibration->poses.max_distance_mm = 130;
  WriteRecording(VirtualRig(ShortCleat()), folder / "a", options, kGoOn);
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  WriteRecording(VirtualRig(ShortCleat()), folder / "b", options, kGoOn);
  for (const char* file : {"left/00002.png", "right/00003.png", "calibration/left/00001.png",
                           "channels.csv", "timestamps.csv"}) {
    EXPECT_EQ(TextOf(folder / "a" / file), TextOf(folder / "b" / file)) << file;
    EXPECT_GT(TextOf(folder / "a" / file).size(), 20U) << file;
  }
}

// Photographs of dots at zero noise: the centroids that the detector finds are those of the discs'
// outlines, projected.
TEST(BoardPhotographs, DiscCentroidsAreWhereProjectionPutsThem) {
  Scenario scenario = MakeScenario("tyre-flat");
  scenario.sensor.noise = false;
  scenario.sensor.bits = 12;
  CalibrationPhotographs photographs;
  photographs.board = BoardSpec::Parse("circles:9x7:10mm");
  photographs.flaws = {.bend_mm = 1, .misprint_mm = 0.05, .scale_error = 0, .seed = 3};
  photographs.poses.count = 3;
  photographs.poses.min_distance_mm = 120;
  photographs.poses.max_distance_mm = 180;
  const auto poses =
      DrawBoardPoses(scenario.rig, photographs.board, photographs.print, photographs.poses);
  double squares = 0;
  int count = 0;
  for (int k = 0; k < 3; ++k) {
    const Rigid3& pose = poses[static_cast<std::size_t>(k)];
    const StereoFrame pair = TakeBoardPhotographs(scenario, photographs, pose, k);
    const BoardSurface board(photographs.board, photographs.print, photographs.flaws, pose);
    const auto now = board.At(0);
    const auto detection = DetectBoard(photographs.board, pair.left);
    ASSERT_EQ(detection.ids.size(), 63U) << detection.problem;
    for (std::size_t i = 0; i < detection.ids.size(); ++i) {
      const Eigen::Vector2d centre = photographs.board.NominalPoint(detection.ids[i]).head<2>();
      const double radius =
          PrintedDiscRadius(photographs.board, photographs.print, detection.ids[i]);
      Eigen::Vector2d moment(0, 0), last(0, 0), origin(0, 0);
      double area = 0;
      constexpr int kSides = 720;
      for (int s = 0; s <= kSides; ++s) {
        const double a = 2 * std::numbers::pi * s / kSides;
        const Eigen::Vector2d rim = centre + radius * Eigen::Vector2d(std::cos(a), std::sin(a));
        const Eigen::Vector2d q = scenario.rig.left.Project(now->At(rim).position_mm);
        if (s == 0) origin = q;
        const Eigen::Vector2d p = q - origin;
        const double cross = last.x() * p.y() - last.y() * p.x();
        area += cross / 2;
        moment += cross / 6 * (last + p);
        last = p;
      }
      const Eigen::Vector2d error = detection.pixels[i] - (origin + moment / area);
      EXPECT_LT(error.norm(), 0.06) << detection.ids[i];
      squares += error.squaredNorm() / 2;
      ++count;
    }
  }
  std::printf("%d discs: rms %.4f px a component\n", count, std::sqrt(squares / count));
  EXPECT_LT(std::sqrt(squares / count), 0.012);
}

TEST(Recording, RefusesAFullFolderAndKeepsIt) {
  const fs::path folder = testing::TestFolder();
  std::ofstream(folder / "mine.txt") << "mine";
  const VirtualRig rig(ShortCleat());
  try {
    WriteRecording(rig, folder, {}, kGoOn);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("not empty"));
    EXPECT_THAT(error.what(), HasSubstr("--overwrite"));
  }
  EXPECT_EQ(TextOf(folder / "mine.txt"), "mine");
  EXPECT_THROW(WriteRecording(rig, folder / "mine.txt" / "below", {}, kGoOn), EnvironmentError);
}

TEST(Recording, OverwritesAllOfAnEarlierRecording) {
  const fs::path folder = testing::TestFolder();
  WriteRecording(VirtualRig(ShortCleat()), folder, {}, kGoOn);
  std::ofstream(folder / "mine.txt") << "mine";
  Scenario still = MakeScenario("still", RigKind::kWide640);
  still.frames = 2;
  RecordingOptions options;
  options.overwrite = true;
  WriteRecording(VirtualRig(still), folder, options, kGoOn);
  EXPECT_EQ(ListImages((folder / "left").string()).size(), 2U);
  EXPECT_FALSE(fs::exists(folder / "channels.csv"));
  EXPECT_EQ(TextOf(folder / "mine.txt"), "mine");
}

// The truth's channels are exact and on the clock of its frames; those of the logger are neither.
TEST(Recording, TruthHoldsTheChannelsOnTheClockOfTheFrames) {
  const fs::path folder = testing::TestFolder();
  const VirtualRig rig(ShortCleat());
  WriteRecording(rig, folder / "sim", {}, kGoOn);
  for (const Channel& channel : SeriesReader(folder / "sim" / "truth.h5").channels()) {
    if (channel.name != "wheel_speed") continue;
    for (const std::size_t k : {0U, 100U, 111U}) {
      EXPECT_NEAR(channel.value[k], rig.tyre()->Wheel(channel.time_s[k]).angular_speed_rad_s,
                  1e-12);
    }
    EXPECT_NEAR(channel.time_s[0], -0.5, 1e-12);
  }
}

TEST(Recording, StopsWhenToldAndLeavesWholeFiles) {
  const fs::path folder = testing::TestFolder();
  const VirtualRig rig(ShortCleat());
  const Recording recording = WriteRecording(
      rig, folder / "sim", {}, [](const std::string&, int done, int) { return done < 2; });
  EXPECT_TRUE(recording.interrupted);
  EXPECT_EQ(recording.frames, 2);
  EXPECT_EQ(SeriesReader(folder / "sim" / "truth.h5").frame_count(), 2);
  EXPECT_THAT(Validate(folder / "sim" / "truth.h5"), IsEmpty());
}

TEST(WheelChannels, LogTheWheelOnTheirOwnClock) {
  const VirtualRig rig(MakeScenario("tyre-braking"));
  ChannelOptions options;
  options.noise = false;
  const std::vector<Channel> channels = LogWheelChannels(rig, options);
  ASSERT_EQ(channels.size(), 5U);
  EXPECT_EQ(channels[0].name, "wheel_speed");
  EXPECT_NEAR(channels[0].time_s.front(), -options.lead_s + options.clock_offset_s, 1e-12);
  EXPECT_GE(channels[0].time_s.back() - options.clock_offset_s, rig.FrameTime(11));
  const WheelState wheel = rig.tyre()->Wheel(0);
  EXPECT_NEAR(channels[0].value[100], wheel.angular_speed_rad_s, 1e-12);
  EXPECT_NEAR(channels[1].value[100], 1.4, 1e-12);
  EXPECT_LT(channels[2].value[100], -1000);         // braking
  EXPECT_NEAR(channels[4].value[100], 5400, 1e-6);  // 18 mm
  EXPECT_TRUE(LogWheelChannels(VirtualRig(MakeScenario("still"))).empty());
}

// The table that a user opens: a head with units, numbers as logged, a clock of its own, and the
// spread that a transducer has.
TEST(WheelChannels, AreWrittenAsATableWithUnits) {
  const fs::path folder = testing::TestFolder();
  Scenario scenario = MakeScenario("tyre-cornering");
  scenario.frames = 50;
  const VirtualRig rig(scenario);
  const std::vector<Channel> channels = LogWheelChannels(rig);
  WriteChannelsCsv(folder / "channels.csv", channels);
  std::ifstream in(folder / "channels.csv");
  std::string line;
  std::getline(in, line);
  EXPECT_EQ(line, "time_s,wheel_speed_rad/s,vehicle_speed_m/s,force_x_N,force_y_N,force_z_N");
  std::vector<std::vector<double>> rows;
  while (std::getline(in, line)) {
    std::istringstream cells(line);
    rows.emplace_back();
    for (std::string cell; std::getline(cells, cell, ',');) rows.back().push_back(std::stod(cell));
    ASSERT_EQ(rows.back().size(), 6U);
  }
  ASSERT_EQ(rows.size(), channels[0].value.size());
  EXPECT_NEAR(rows[0][0], -0.5 + 0.237, 1e-6);
  EXPECT_NEAR(rows[1][0] - rows[0][0], 1.0 / 200, 1e-6);
  // Means and spreads: rolling resistance drags, the ground pushes the sliding wheel to its right.
  const double load = 300 * 18, slip = 3 * std::numbers::pi / 180;
  const double expected[] = {rig.tyre()->Wheel(0).angular_speed_rad_s, 1.4, -0.015 * load,
                             -6 * load * slip, load};
  for (std::size_t c = 0; c < 5; ++c) {
    double sum = 0, squares = 0;
    const auto n = static_cast<double>(rows.size());
    for (const auto& row : rows) {
      sum += row[c + 1];
      squares += row[c + 1] * row[c + 1];
    }
    const double spread = c < 2 ? 1e-3 * expected[c] : 15;
    EXPECT_NEAR(sum / n, expected[c], 5 * spread / std::sqrt(n)) << c;
    EXPECT_NEAR(std::sqrt(squares / n - sum * sum / n / n) / spread, 1, 5 / std::sqrt(2 * n)) << c;
  }
}

}  // namespace
}  // namespace plumbline
