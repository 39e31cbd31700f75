#include "io/virtual_rig/wheel_channels.h"

#include <fmt/format.h>

#include <cmath>
#include <random>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/virtual_rig/internal/mixed_seed.h"

namespace plumbline {
namespace {

constexpr double kVerticalStiffness_N_mm = 300;
constexpr double kLongitudinalStiffness = 8, kCorneringStiffness = 6, kRollingResistance = 0.015;
constexpr double kSpeedNoise = 1e-3, kForceNoise_N = 15;
constexpr double kMaxSamples = 1e7;
constexpr std::uint64_t kStream = 0x6368616e;  // apart from those of the images

}  // namespace

void ChannelOptions::Check() const {
  if (!(rate_hz > 0 && rate_hz <= 1e5)) {
    throw UsageError("The channels' rate must lie in 0 to 100 kHz.");
  }
  if (!std::isfinite(clock_offset_s) || !(lead_s >= 0)) {
    throw UsageError("The channels' clock offset must be finite and their lead 0 or more seconds.");
  }
}

std::vector<Channel> LogWheelChannels(const VirtualRig& rig, const ChannelOptions& options) {
  options.Check();
  if (rig.tyre() == nullptr) return {};
  std::vector<Channel> channels = {{"wheel_speed", "rad/s", "angular speed of the wheel", {}, {}},
                                   {"vehicle_speed", "m/s", "speed of the vehicle", {}, {}},
                                   {"force_x", "N", "longitudinal force on the wheel", {}, {}},
                                   {"force_y", "N", "lateral force on the wheel", {}, {}},
                                   {"force_z", "N", "vertical force on the wheel", {}, {}}};
  const TyreOptions& tyre = rig.tyre()->options();
  const double begin = -options.lead_s;
  const double end = rig.FrameTime(rig.scenario().frames - 1) + options.lead_s;
  const double samples = std::floor((end - begin) * options.rate_hz) + 1;
  if (samples > kMaxSamples) {
    throw UsageError(fmt::format(
        "The channels would hold {:.3g} samples; log at a lower --channel-rate.", samples));
  }
  const auto count = static_cast<int>(samples);
  std::mt19937_64 random(internal::MixedSeed({options.seed, kStream}));
  std::normal_distribution<double> normal(0, 1);
  const auto noise = [&](double sigma) { return options.noise ? sigma * normal(random) : 0.0; };
  for (int k = 0; k < count; ++k) {
    const double t = begin + k / options.rate_hz;
    const WheelState wheel = rig.tyre()->Wheel(t);
    const double load = kVerticalStiffness_N_mm * wheel.compression_mm;
    const double speed_m_s = wheel.speed_mm_s / 1000;
    const double values[] = {
        wheel.angular_speed_rad_s * (1 + noise(kSpeedNoise)), speed_m_s * (1 + noise(kSpeedNoise)),
        load * (kLongitudinalStiffness * tyre.slip_ratio - kRollingResistance) +
            noise(kForceNoise_N),
        -load * kCorneringStiffness * tyre.slip_angle_rad + noise(kForceNoise_N),
        load + noise(kForceNoise_N)};
    for (std::size_t c = 0; c < channels.size(); ++c) {
      channels[c].time_s.push_back(t + options.clock_offset_s);
      channels[c].value.push_back(values[c]);
    }
  }
  return channels;
}

void WriteChannelsCsv(const std::filesystem::path& file, const std::vector<Channel>& channels) {
  std::string text = "time_s";
  for (const Channel& channel : channels)
    text += fmt::format(",{}_{}", channel.name, channel.units);
  text += '\n';
  for (std::size_t k = 0; !channels.empty() && k < channels.front().time_s.size(); ++k) {
    text += fmt::format("{:.6f}", channels.front().time_s[k]);
    for (const Channel& channel : channels) text += fmt::format(",{:.6g}", channel.value[k]);
    text += '\n';
  }
  internal::WriteBytes(file, text);
}

}  // namespace plumbline
