#include "apps/internal/wheel_lean.h"

#include <fmt/format.h>

#include <numbers>
#include <utility>

namespace plumbline::internal {

std::string TextOf(const ChannelLean& lean) {
  if (!lean.used) {
    return fmt::format("The wheel's angle does not lean on the channel of its speed: {}.",
                       lean.problem);
  }
  constexpr double kDegree = std::numbers::pi / 180;
  std::string text = fmt::format(
      "The wheel's angle leans on the channel of its speed: {:.3g} % of its turn follows that, "
      "whose samples scatter by {:.2g} rad/s",
      100 * lean.lean, lean.sigma_sample_rad_s);
  if (lean.drawn_along_rad > 0) {
    text += fmt::format(
        "; by it obstacles draw the surface along by {:.2g} degrees from frame to "
        "frame",
        lean.drawn_along_rad / kDegree);
  }
  if (lean.gaps > 0) {
    text += fmt::format("; {} turns from frame to frame are not in it, as it has gaps", lean.gaps);
  }
  if (lean.outliers > 0) {
    text += fmt::format("; {} contradict the others and do not count", lean.outliers);
  }
  return text + ".";
}

std::string FindContact(const ContactOptionSet& said, RollingContactOptions contact,
                        RollingRun& run, std::vector<Channel>* channels) {
  const WheelSpeedOptionSet& wheel_speed = said.wheel_speed();
  std::string clock;
  if (wheel_speed.given()) {
    const bool over_ground = wheel_speed.over_ground();
    // How the rig turns, and the right camera's delay, by the images alone.
    run.FindContact(contact);
    clock = wheel_speed.FindClock(run.WheelSpeeds(over_ground), channels);
    std::string problem;
    const auto speeds = wheel_speed.Speeds(*channels, &problem);
    run.LeanOn(speeds, over_ground, problem);
  }
  said.AddVehicleSpeed(*channels, &contact);
  run.FindContact(std::move(contact));
  return clock;
}

}  // namespace plumbline::internal
