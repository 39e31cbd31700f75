#include "apps/internal/contact_options.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "apps/internal/parse_numbers.h"
#include "calib/error.h"
#include "track/carcass_modes.h"

namespace plumbline::internal {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// Of a height that is said without a standard deviation.
constexpr double kExactly_mm = 1e-3;

double MillimetresASecond(const Channel& channel) {
  if (channel.units == "m/s") return 1e3;
  if (channel.units == "km/h") return 1e3 / 3.6;
  if (channel.units == "mm/s") return 1;
  throw UsageError(
      fmt::format("The channel '{}' of the vehicle's speed is in '{}': m/s, km/h or "
                  "mm/s are understood.",
                  channel.name, channel.units));
}

}  // namespace

CarcassThickness ParseCarcass(const std::string& text, double crown_y_mm) {
  CarcassThickness carcass;
  const auto refuse = [&] {
    return UsageError(fmt::format(
        "The carcass is one thickness in mm, as 20, or thicknesses by place along the axis from "
        "the middle of the tread, as -100:22,0:20,100:22, not '{}'.",
        text));
  };
  if (text.find(':') == std::string::npos) {
    const auto one = ParseNumbers(text, ',');
    if (!one || one->size() != 1) throw refuse();
    carcass.thickness_mm = *one;
  } else {
    std::size_t begin = 0;
    while (begin <= text.size()) {
      const std::size_t comma = std::min(text.find(',', begin), text.size());
      const auto pair = ParseNumbers(text.substr(begin, comma - begin), ':');
      if (!pair || pair->size() != 2) throw refuse();
      carcass.y_mm.push_back(crown_y_mm + (*pair)[0]);
      carcass.thickness_mm.push_back((*pair)[1]);
      begin = comma + 1;
    }
  }
  carcass.Check();
  return carcass;
}

void ContactOptionSet::Declare(OptionTable& options) {
  options.Add({.name = "carcass",
               .help = "thickness of a tyre's carcass with its tread, under the inner surface that "
                       "is seen: one for all, or by place along the axis from the middle of the "
                       "tread, as -100:22,0:20,100:22. With 0 the ground is where the inner "
                       "surface lies flat",
               .unit = "mm"},
              &carcass_);
  options.Add({.name = "carcass-sigma",
               .help = "standard deviation of each thickness of --carcass, independent of the "
                       "others; its errors count with those of the calibration",
               .unit = "mm",
               .min = 0,
               .max = 10},
              &carcass_sigma_mm_);
  options.Add({.name = "ground-turns",
               .help = "how the rig is turned over the ground, by hand: degrees about its x, y, z "
                       "axes as 157,0,0; the undeformed minimum is then at z = 0. Empty: from the "
                       "contact with the ground in every frame, smoothed",
               .unit = "deg"},
              &ground_turns_);
  options.Add({.name = "obstacle-height",
               .help = "how high the flat top of an obstacle is above the ground, where no ground "
                       "is touched beside it, as 38, or with the standard deviation of that as "
                       "38,0.2; of all flat tops in the recording. Empty: not known, but for what "
                       "frames tell that touch both",
               .unit = "mm"},
              &obstacle_height_);
  options.Add({.name = "camber",
               .help = "how the wheel's axis leans against the ground, positive with its left end "
                       "up, and the standard deviation of that, as 0,0.1: of the first frame, for "
                       "recordings in which nothing flat tells it",
               .unit = "deg"},
              &camber_);
  options.Add({.name = "contact-threshold",
               .help = "gap that still counts as contact where the law of lift-off does not hold, "
                       "as over an obstacle",
               .unit = "mm",
               .min = 0,
               .max = 50},
              &threshold_mm_);
  options.Add({.name = "free-rolling-radius",
               .help = "travel a radian of the wheel without slip, as a run without drive or brake "
                       "tells it (effective_radius_mm); without it there is no slip ratio",
               .unit = "mm",
               .min = 1,
               .max = 1e5},
              &radius_mm_);
  options.Add({.name = "free-rolling-radius-sigma",
               .help = "standard deviation of it",
               .unit = "mm",
               .min = 0,
               .max = 1e4},
              &radius_sigma_mm_);
  options.Add({.name = "vehicle-speed",
               .help = "channel of --channels with the vehicle's speed, for a slip ratio by it"},
              &vehicle_speed_);
  options.Add({.name = "vehicle-speed-sigma",
               .help = "standard deviation of one sample of it",
               .unit = "m/s",
               .min = 0,
               .max = 1e3},
              &vehicle_speed_sigma_m_s_);
  wheel_speed_.Declare(options);
  options.Add({.name = "slip-convention",
               .help = "signs and definitions of slip (docs/theory.md)",
               .choices = {"iso8855", "sae-j670"}},
              &convention_);
}

CarcassThickness ContactOptionSet::Carcass(double crown_y_mm) const {
  CarcassThickness carcass = ParseCarcass(carcass_, std::isfinite(crown_y_mm) ? crown_y_mm : 0);
  carcass.sigma_mm = carcass_sigma_mm_;
  carcass.Check();
  return carcass;
}

WheelReference ContactOptionSet::WithCarcass(WheelReference wheel) const {
  const CarcassThickness carcass = Carcass(wheel.profile.crown_y_mm);
  return WithCarcassModes(std::move(wheel), carcass);
}

RollingContactOptions ContactOptionSet::Options(double crown_y_mm) const {
  RollingContactOptions options;
  options.carcass = Carcass(crown_y_mm);
  options.patch.threshold.threshold_mm = threshold_mm_;
  options.slip.convention =
      convention_ == "iso8855" ? SlipConvention::kIso8855 : SlipConvention::kSaeJ670;
  if (!ground_turns_.empty()) {
    const auto turns = ParseNumbers(ground_turns_, ',');
    if (!turns || turns->size() != 3) {
      throw UsageError(
          fmt::format("The turns of the rig are three angles in degrees, as 157,0,0, not '{}'.",
                      ground_turns_));
    }
    options.manual_turns_deg = Eigen::Vector3d((*turns)[0], (*turns)[1], (*turns)[2]);
  }
  if (!obstacle_height_.empty()) {
    const auto height = ParseNumbers(obstacle_height_, ',');
    if (!height || height->empty() || height->size() > 2 || !((*height)[0] > 0) ||
        (height->size() == 2 && !((*height)[1] > 0))) {
      throw UsageError(
          fmt::format("An obstacle's height is a number of mm above 0, as 38, or that and its "
                      "standard deviation above 0, as 38,0.2, not '{}'.",
                      obstacle_height_));
    }
    options.rotation.obstacle_height_mm = (*height)[0];
    options.rotation.sigma_obstacle_height_mm = height->size() == 2 ? (*height)[1] : kExactly_mm;
  }
  if (!camber_.empty()) {
    const auto camber = ParseNumbers(camber_, ',');
    if (!camber || camber->size() != 2 || !(std::abs((*camber)[0]) < 90) || !((*camber)[1] > 0)) {
      throw UsageError(
          fmt::format("The camber is an angle in degrees and its standard deviation above 0, as "
                      "0,0.1, not '{}'.",
                      camber_));
    }
    // The normal is (..., -sin roll, ...) along the axis.
    options.rotation.prior[1] = -(*camber)[0] * kDegree;
    options.rotation.prior_sigma[1] = (*camber)[1] * kDegree;
  }
  if (radius_mm_) {
    MeasuredScalar radius;
    radius.value = *radius_mm_;
    radius.sigma_random = radius_sigma_mm_;
    options.free_rolling_radius_mm = radius;
  }
  options.Check();
  return options;
}

void ContactOptionSet::CheckChannels(const std::vector<Channel>& channels) const {
  wheel_speed_.Check(channels);
  if (vehicle_speed_.empty()) return;
  const Channel& vehicle = ChannelNamed(channels, vehicle_speed_);
  (void)MillimetresASecond(vehicle);
  if (std::isfinite(vehicle.clock_offset_s) || wheel_speed_.given()) return;
  throw UsageError(
      "How the logger's clock goes against the cameras' is not known: give --channel-offset, or "
      "with --wheel-speed the channel of the wheel's speed.");
}

void ContactOptionSet::AddVehicleSpeed(const std::vector<Channel>& channels,
                                       RollingContactOptions* options) const {
  if (vehicle_speed_.empty()) return;
  const Channel& vehicle = ChannelNamed(channels, vehicle_speed_);
  if (!std::isfinite(vehicle.clock_offset_s)) return;
  SampledSignal speed{vehicle.time_s, vehicle.value};
  for (double& value : speed.value) value *= MillimetresASecond(vehicle);
  options->channel_clock.offset_s = vehicle.clock_offset_s;
  if (std::isfinite(vehicle.sigma_clock_offset_s)) {
    options->channel_clock.sigma_s = vehicle.sigma_clock_offset_s;
  }
  options->vehicle_speed_mm_s = std::move(speed);
  options->sigma_vehicle_speed_mm_s = 1e3 * vehicle_speed_sigma_m_s_;
}

}  // namespace plumbline::internal
