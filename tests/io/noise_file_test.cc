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
  WriteNoiseFile(path, {{"camera", noise}});
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
  WriteNoiseFile(path, {{"left", SomeNoise()}, {"right", right}});
  EXPECT_EQ(ReadCameraNoise(path, "right").model.slope_grey, 7);
  EXPECT_EQ(ReadCameraNoise(path, "left").model.slope_grey, SomeNoise().model.slope_grey);
  EXPECT_THAT(Refusal(path), HasSubstr("(left, right)"));
}

TEST(NoiseFile, ScalesToOtherBits) {
  const CameraNoise noise = SomeNoise();
  EXPECT_DOUBLE_EQ(noise.ForBits(12).Variance(1600), noise.model.Variance(1600));
  EXPECT_DOUBLE_EQ(noise.ForBits(8).Variance(100), noise.model.Variance(1600) / 256);
}

TEST(NoiseFile, SaysWhatIsWrong) {
  const fs::path path = TestFolder() / "noise.toml";
  EXPECT_THAT(Refusal(path), HasSubstr("There is no noise file"));
  WriteNoiseFile(path, {{"camera", SomeNoise()}});
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
