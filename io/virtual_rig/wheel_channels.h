#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "io/series_writer.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline {

// What a wheel-force transducer and the vehicle would log of a tyre scenario, on a clock of their
// own.
struct ChannelOptions {
  double rate_hz = 200;
  double clock_offset_s = 0.237;  // the logger's clock less the cameras'
  double lead_s = 0.5;            // logged before the first and after the last frame
  bool noise = true;
  std::uint64_t seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Wheel speed and vehicle speed of the kinematics; forces on the wheel, ISO 8855 axes, by a linear
// tyre: 300 N a millimetre of compression, 8 of longitudinal and 6 of cornering stiffness a unit of
// load and slip, 1.5 % rolling resistance. Noise: 0.1 % of the speeds, 15 N. Empty in the
// laboratory.
std::vector<Channel> LogWheelChannels(const VirtualRig& rig, const ChannelOptions& options = {});

// time_s and one column a channel, "wheel_speed_rad/s" and so on. Throws EnvironmentError.
void WriteChannelsCsv(const std::filesystem::path& file, const std::vector<Channel>& channels);

}  // namespace plumbline
