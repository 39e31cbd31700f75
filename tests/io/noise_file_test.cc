#include "io/noise_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "calib/error.h"
#include "io/virtual_rig/sensor.h"
#include "match/photon_transfer.h"
#include "tests/support/rendered_speckle.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::TestFolder;

CameraNoise SomeNoise() {
  CameraNoise noise;
  noise.model = {0.1 + 0.2, 1.0 / 30};
  noise.cov << 4e-4, -3e-6, -3e-6, 9e-8;
  noise.bits = 12;
  noise.frames = 10;
  noise.size = {1280, 800};
  noise.lowest_grey = 12;
  noise.highest_grey = 3900.5;
  noise.created = "2026-01-02T03:04:05Z";
  return noise;
}

std::string Refusal(const fs::path& path, const std::string& camera = "camera") {
  try {
    ReadCameraNoise(path, camera);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(NoiseFile, ReadsBackWhatItWrote) {
  const fs::path path = TestFolder() / "noise.toml";
  const CameraNoise noise = SomeNoise();
  WriteNoiseFile(path, {{{"camera", noise}}, {}});
  const CameraNoise read = ReadCameraNoise(path, "left");  // one camera answers to any name
  EXPECT_EQ(read.model.offset_grey2, noise.model.offset_grey2);
  EXPECT_EQ(read.model.slope_grey, noise.model.slope_grey);
  EXPECT_TRUE(read.cov.isApprox(noise.cov, 1e-12)) << read.cov;
  EXPECT_EQ(read.bits, 12);
  EXPECT_EQ(read.frames, 10);
  EXPECT_EQ(read.size, noise.size);
  EXPECT_EQ(read.highest_grey, 3900.5);
  EXPECT_EQ(read.created, noise.created);
}

TEST(NoiseFile, KeepsTheCamerasOfARigApart) {
  const fs::path path = TestFolder() / "noise.toml";
  CameraNoise right = SomeNoise();
  right.model.slope_grey = 7;
  WriteNoiseFile(path, {{{"left", SomeNoise()}, {"right", right}}, {}});
  EXPECT_EQ(ReadCameraNoise(path, "right").model.slope_grey, 7);
  EXPECT_EQ(ReadCameraNoise(path, "left").model.slope_grey, SomeNoise().model.slope_grey);
  EXPECT_THAT(Refusal(path), HasSubstr("(left, right)"));
}

NoiseFloor SomeFloor() {
  NoiseFloor floor;
  floor.frames = 4;
  floor.points = 3078;
  floor.strain_points = 2518;
  floor.step_px = 8;
  floor.subset_px = 29;
  floor.vsg_px = 93;
  floor.frame = "ground";
  floor.strain_measure = "hencky";
  double number = 1.0 / 3;
  const auto fill = [&](auto& components) {
    for (FloorComponent& c : components) {
      c = {number, 1.1 * number, 0.02, 3 * number, 0.7 * number, 0.8 * number};
      number /= 2;
    }
  };
  fill(floor.left_px);
  fill(floor.right_px);
  fill(floor.displacement_mm);
  fill(floor.strain.emplace());
  return floor;
}

TEST(NoiseFile, KeepsTheFloor) {
  const fs::path path = TestFolder() / "noise.toml";
  NoiseFloor floor = SomeFloor();
  const auto expect_same = [](const auto& read, const auto& written) {
    for (std::size_t i = 0; i < written.size(); ++i) {
      EXPECT_EQ(read[i].noise, written[i].noise);
      EXPECT_EQ(read[i].predicted, written[i].predicted);
      EXPECT_EQ(read[i].sigma_ratio, written[i].sigma_ratio);
      EXPECT_EQ(read[i].common, written[i].common);
      EXPECT_EQ(read[i].bias, written[i].bias);
      EXPECT_EQ(read[i].predicted_bias, written[i].predicted_bias);
    }
  };
  WriteNoiseFile(path, {{{"left", SomeNoise()}, {"right", SomeNoise()}}, floor});
  // Written again as it was read: nothing is lost on the way.
  WriteNoiseFile(path, ReadNoiseFile(path));
  const NoiseFile file = ReadNoiseFile(path);
  EXPECT_EQ(file.cameras.size(), 2u);
  ASSERT_TRUE(file.floor && file.floor->strain);
  EXPECT_EQ(file.floor->frames, 4);
  EXPECT_EQ(file.floor->points, 3078);
  EXPECT_EQ(file.floor->strain_points, 2518);
  EXPECT_EQ(file.floor->step_px, 8);
  EXPECT_EQ(file.floor->subset_px, 29);
  EXPECT_EQ(file.floor->vsg_px, 93);
  EXPECT_EQ(file.floor->frame, "ground");
  EXPECT_EQ(file.floor->strain_measure, "hencky");
  expect_same(file.floor->left_px, floor.left_px);
  expect_same(file.floor->right_px, floor.right_px);
  expect_same(file.floor->displacement_mm, floor.displacement_mm);
  expect_same(*file.floor->strain, *floor.strain);

  floor.strain.reset();
  WriteNoiseFile(path, {{{"left", SomeNoise()}, {"right", SomeNoise()}}, floor});
  EXPECT_FALSE(ReadNoiseFile(path).floor->strain);
  EXPECT_EQ(ReadCameraNoise(path, "right").frames, 10);

  std::ostringstream good;
  good << std::ifstream(path).rdbuf();
  std::string text = good.str();
  std::ofstream(path) << text.replace(text.find("predicted = ["), 13, "predicted = [nan, ");
  EXPECT_THAT(Refusal(path), HasSubstr("[floor.left_px] needs predicted"));
}

TEST(NoiseFile, ScalesToOtherBits) {
  const CameraNoise noise = SomeNoise();
  EXPECT_DOUBLE_EQ(noise.ForBits(12).Variance(1600), noise.model.Variance(1600));
  EXPECT_DOUBLE_EQ(noise.ForBits(8).Variance(100), noise.model.Variance(1600) / 256);
}

TEST(NoiseFile, SaysWhatIsWrong) {
  const fs::path path = TestFolder() / "noise.toml";
  EXPECT_THAT(Refusal(path), HasSubstr("There is no noise file"));
  WriteNoiseFile(path, {{{"camera", SomeNoise()}}, {}});
  std::ostringstream good;
  good << std::ifstream(path).rdbuf();
  const auto changed = [&](const std::string& from, const std::string& to) {
    std::string text = good.str();
    std::ofstream(path) << text.replace(text.find(from), from.size(), to);
    return Refusal(path);
  };
  EXPECT_EQ(changed("frames = 10", "frames = 10"), "");
  EXPECT_THAT(changed("bits = 12", "bits = 7"), HasSubstr("[camera] needs bits"));
  EXPECT_THAT(changed("slope_grey = 0", "slope_grey = -1"), HasSubstr("needs slope_grey"));
  EXPECT_THAT(changed("slope_grey = 0", "slope_grey = nan # "), HasSubstr("needs slope_grey"));
  EXPECT_THAT(changed("\noffset_grey2", "\noffset"), HasSubstr("needs offset_grey2"));
  EXPECT_THAT(changed("plumbline-noise", "other"), HasSubstr("is no noise file"));
  EXPECT_THAT(changed("[camera]", "[camera"), HasSubstr("line"));
  std::ofstream(path) << "format = \"plumbline-noise\"\n";
  EXPECT_THAT(Refusal(path), HasSubstr("holds no camera"));
}

// The virtual rig's sensor counts photons; the line that it was given is found again.
TEST(NoiseFile, HoldsWhatTheVirtualSensorWasGiven) {
  for (const int bits : {8, 12}) {
    SensorOptions sensor;
    sensor.bits = bits;
    testing::SpecklePattern pattern({.contrast = 0.9});
    Image<float> mean({240, 200});
    for (int y = 0; y < mean.height(); ++y) {
      for (int x = 0; x < mean.width(); ++x) {
        mean(y, x) = static_cast<float>(pattern.GreyAt(Eigen::Vector2d(x, y)));
      }
    }
    PhotonTransferFit fit;
    for (std::uint64_t i = 0; i < 5; ++i) fit.Add(Expose(mean, sensor, 3, i));
    const PhotonTransfer found = fit.Fit();
    const double scale = std::ldexp(1.0, bits - 8);
    const double slope = scale * sensor.gain_grey;
    const double offset = scale * scale *
                          (sensor.read_noise_grey * sensor.read_noise_grey -
                           sensor.gain_grey * sensor.black_level_grey);
    EXPECT_NEAR(found.model.slope_grey, slope, 4 * found.sigma_slope_grey());
    EXPECT_NEAR(found.model.offset_grey2, offset, 4 * found.sigma_offset_grey2());
    EXPECT_LT(found.sigma_slope_grey(), 0.05 * slope);
  }
}

}  // namespace
}  // namespace plumbline
