#include "apps/internal/wheel_speed_options.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "calib/error.h"
#include "track/clock_offset.h"

namespace plumbline::internal {
namespace {

// Nothing: not a unit of turning.
std::optional<double> RadiansASecond(const std::string& units) {
  constexpr double kTurn = 2 * std::numbers::pi;
  if (units == "rad/s") return 1;
  if (units == "deg/s") return kTurn / 360;
  if (units == "rpm" || units == "1/min" || units == "r/min") return kTurn / 60;
  return std::nullopt;
}

}  // namespace

const Channel& ChannelNamed(const std::vector<Channel>& channels, const std::string& name) {
  const auto found = std::find_if(channels.begin(), channels.end(),
                                  [&](const Channel& channel) { return channel.name == name; });
  if (found != channels.end()) return *found;
  std::string there;
  for (const Channel& channel : channels) {
    there += (there.empty() ? "" : ", ") + channel.name;
  }
  throw UsageError(fmt::format("There is no channel '{}' in the table of --channels{}.", name,
                               there.empty() ? "" : "; there are " + there));
}

void WheelSpeedOptionSet::Declare(OptionTable& options) {
  options.Add({.name = "wheel-speed",
               .help = "channel of --channels with the wheel's speed (rad/s, deg/s, rpm or 1/min): "
                       "tells the offset of the logger's clock, with --channel-offset within 0.3 s "
                       "of that; and the wheel's angle leans on it where images cannot tell it, "
                       "as over obstacles"},
              &name_);
  options.Add({.name = "wheel-speed-sigma",
               .help = "standard deviation of one sample of it, independent of the others; auto: "
                       "from how they scatter",
               .unit = "rad/s",
               .min = 1e-9,
               .max = 1e3},
              &sigma_rad_s_);
  options.Add({.name = "wheel-speed-scale-sigma",
               .help = "standard deviation of a common factor on it, as a share",
               .min = 0,
               .max = 0.5},
              &sigma_scale_);
  options.Add({.name = "wheel-speed-against",
               .help = "what it is the turn against: the ground, or the rig with the cameras, as "
                       "of an encoder on the arm that holds them",
               .choices = {"ground", "rig"}},
              &against_);
}

void WheelSpeedOptionSet::Check(const std::vector<Channel>& channels) const {
  if (given()) {
    (void)ChannelNamed(channels, name_);
  } else if (sigma_rad_s_ || sigma_scale_ > 0) {
    throw UsageError(
        "There is an error of the wheel's speed and no channel of it: give --wheel-speed.");
  }
}

std::string WheelSpeedOptionSet::FindClock(const SampledSignal& by_images,
                                           std::vector<Channel>* channels) const {
  const Channel& theirs = ChannelNamed(*channels, name_);
  // About what is known of it, which tells the periods of a speed that swings apart.
  constexpr double kAbout_s = 0.3;
  const bool known = std::isfinite(theirs.clock_offset_s);
  const double about_s = known ? theirs.clock_offset_s : 0;
  SampledSignal logged{theirs.time_s, theirs.value};
  for (double& time_s : logged.time_s) time_s -= about_s;
  ClockOffsetOptions search;
  if (known) search.most_s = kAbout_s;
  try {
    const ClockOffset clock = FindClockOffset(by_images, logged, search);
    if (known && theirs.sigma_clock_offset_s <= clock.sigma_s) {
      return fmt::format(
          "The offset of the logger's clock is that of --channel-offset, which is surer than "
          "{:.4f} "
          "s, sigma {:.1g} s, by the wheel's speed.",
          about_s + clock.offset_s, clock.sigma_s);
    }
    for (Channel& channel : *channels) {
      channel.clock_offset_s = about_s + clock.offset_s;
      channel.sigma_clock_offset_s = clock.sigma_s;
    }
    return fmt::format(
        "By the wheel's speed the logger's clock reads {:.4f} s when that of the frames is 0, "
        "sigma {:.1g} s.",
        about_s + clock.offset_s, clock.sigma_s);
  } catch (const InputError& error) {
    if (!known) {
      return fmt::format(
          "The logger's clock stays unknown, and nothing leans on its channels; with "
          "--channel-offset the offset is looked for near that: {}",
          error.what());
    }
    return fmt::format("The offset of the logger's clock is that of --channel-offset: {}",
                       error.what());
  }
}

std::optional<WheelSpeedChannel> WheelSpeedOptionSet::Speeds(const std::vector<Channel>& channels,
                                                             std::string* problem) const {
  const Channel& channel = ChannelNamed(channels, name_);
  const std::optional<double> unit = RadiansASecond(channel.units);
  if (!unit) {
    *problem =
        fmt::format("'{}' is not a unit of turning (rad/s, deg/s, rpm or 1/min)", channel.units);
    return std::nullopt;
  }
  if (!std::isfinite(channel.clock_offset_s)) {
    *problem = "the logger's clock is not known";
    return std::nullopt;
  }
  WheelSpeedChannel out;
  out.speed_rad_s = {channel.time_s, channel.value};
  for (double& value : out.speed_rad_s.value) value *= *unit;
  out.clock_offset_s = channel.clock_offset_s;
  if (std::isfinite(channel.sigma_clock_offset_s)) {
    out.sigma_clock_offset_s = channel.sigma_clock_offset_s;
  }
  out.sigma_rad_s = sigma_rad_s_;
  out.sigma_scale = sigma_scale_;
  return out;
}

}  // namespace plumbline::internal
