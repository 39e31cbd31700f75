#include "io/virtual_rig/sensor.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "calib/error.h"
#include "io/virtual_rig/internal/mixed_seed.h"

namespace plumbline {

void SensorOptions::Check() const {
  if (bits < 8 || bits > 16) throw UsageError("A sensor has 8 to 16 bits.");
  if (!(gain_grey > 0 && gain_grey <= 10)) {
    throw UsageError("The sensor's gain must lie in 0 to 10 grey levels an electron.");
  }
  if (!(read_noise_grey >= 0)) throw UsageError("The read noise must be 0 or more grey levels.");
  if (!(black_level_grey >= 0 && black_level_grey < 128)) {
    throw UsageError("The black level must lie in 0 to 128 grey levels.");
  }
}

GrayImage Expose(const Image<float>& mean, const SensorOptions& sensor, std::uint64_t seed,
                 std::uint64_t stream) {
  sensor.Check();
  GrayImage image{Image<std::uint16_t>(mean.size()), sensor.bits};
  const double scale = std::ldexp(1.0, sensor.bits - 8);
  const double highest = image.max_level();
  tbb::parallel_for(0, mean.height(), [&](int r) {
    std::mt19937_64 random(internal::MixedSeed({seed, stream, static_cast<std::uint64_t>(r)}));
    std::normal_distribution<double> read(0, 1);
    for (int c = 0; c < mean.width(); ++c) {
      double grey = static_cast<double>(mean(r, c));
      if (sensor.noise) {
        if (grey > 0) {
          std::poisson_distribution<std::int64_t> electrons(grey / sensor.gain_grey);
          grey = static_cast<double>(electrons(random)) * sensor.gain_grey;
        }
        grey += sensor.read_noise_grey * read(random);
      }
      const double level = std::round(scale * (grey + sensor.black_level_grey));
      image.grey(r, c) = static_cast<std::uint16_t>(std::clamp(level, 0.0, highest));
    }
  });
  return image;
}

}  // namespace plumbline
