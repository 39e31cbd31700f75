#include "io/virtual_rig/sensor.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/error.h"

namespace plumbline {
namespace {

struct Moments {
  double mean = 0, variance = 0;
};

Moments MomentsOf(const GrayImage& image) {
  Moments m;
  const auto n = static_cast<double>(image.grey.pixel_count());
  for (const std::uint16_t grey : image.grey.values()) m.mean += grey / n;
  for (const std::uint16_t grey : image.grey.values()) {
    m.variance += (grey - m.mean) * (grey - m.mean) / (n - 1);
  }
  return m;
}

// Photon transfer: variance = gain * mean + read^2, plus 1/12 for the rounding.
TEST(Sensor, NoiseHasTheStatedGainAndVariance) {
  for (const int bits : {8, 10, 12}) {
    for (const double level : {5.0, 40.0, 120.0, 200.0}) {
      SensorOptions sensor;
      sensor.bits = bits;
      sensor.gain_grey = 0.03;
      sensor.read_noise_grey = 0.8;
      const GrayImage image =
          Expose(Image<float>({400, 300}, static_cast<float>(level)), sensor, 7, 1);
      const double scale = std::ldexp(1, bits - 8);
      const Moments m = MomentsOf(image);
      const double variance = scale * scale * (0.03 * level + 0.64) + 1.0 / 12;
      EXPECT_NEAR(m.mean, scale * (level + sensor.black_level_grey),
                  5 * std::sqrt(variance / 120000));
      // A sample variance of n values scatters by sqrt(2 / n).
      EXPECT_NEAR(m.variance / variance, 1, 5 * std::sqrt(2.0 / 120000)) << bits << " " << level;
    }
  }
}

TEST(Sensor, NoiseIsIndependentBetweenPixelsRowsAndExposures) {
  const Image<float> mean({300, 300}, 100);
  const GrayImage a = Expose(mean, {}, 1, 1), b = Expose(mean, {}, 1, 2);
  const Moments ma = MomentsOf(a), mb = MomentsOf(b);
  double next = 0, below = 0, other = 0;
  int n = 0;
  for (int r = 0; r + 1 < 300; ++r) {
    for (int c = 0; c + 1 < 300; ++c, ++n) {
      const double d = a.grey(r, c) - ma.mean;
      next += d * (a.grey(r, c + 1) - ma.mean);
      below += d * (a.grey(r + 1, c) - ma.mean);
      other += d * (b.grey(r, c) - mb.mean);
    }
  }
  for (const double sum : {next, below, other}) {
    EXPECT_LT(std::abs(sum / n / ma.variance), 5 / std::sqrt(n));
  }
}

TEST(Sensor, SaturatesAndClips) {
  SensorOptions sensor;
  sensor.bits = 10;
  sensor.noise = false;
  EXPECT_EQ(Expose(Image<float>({2, 2}, 400), sensor, 1, 1).grey(0, 0), 1023);
  EXPECT_EQ(Expose(Image<float>({2, 2}, -400), sensor, 1, 1).grey(0, 0), 0);
  EXPECT_EQ(Expose(Image<float>({2, 2}, 100), sensor, 1, 1).grey(0, 0), 4 * 104);
}

TEST(Sensor, RefusesWhatItCannotBe) {
  SensorOptions sensor;
  sensor.bits = 7;
  EXPECT_THROW(Expose(Image<float>({2, 2}), sensor, 1, 1), UsageError);
  sensor = {};
  sensor.gain_grey = 0;
  EXPECT_THROW(Expose(Image<float>({2, 2}), sensor, 1, 1), UsageError);
}

}  // namespace
}  // namespace plumbline
