#pragma once

#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "track/angle_smoother.h"
#include "track/clock_offset.h"
#include "track/rig_rotation.h"
#include "track/rolling_survey.h"

namespace plumbline {

// The wheel's speed as an encoder or a wheel-force transducer logs it.
struct WheelSpeedChannel {
  SampledSignal speed_rad_s;  // on the logger's clock = ours + clock_offset_s
  double clock_offset_s = 0, sigma_clock_offset_s = 0;
  // Of one sample, independent of the others. Left out: by how much each scatters about the line
  // between those beside it (without outliers), which noise that a filter has smoothed hides.
  std::optional<double> sigma_rad_s;
  double sigma_scale = 0;  // of a factor 1 + s on all of it

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The wheel's turn from frame to frame by the channel: the integral of the lines between samples.
// One less than there are times.
struct ChannelTurns {
  std::vector<double> turn_rad;  // NaN over gaps and where the channel does not reach
  // From the noise of the samples. What a sample at a frame's time does to the turns before and
  // after it is counted in both as if they were one, so that sums of turns have the right sigma.
  std::vector<double> sigma_rad;
  std::vector<double> along_clock_rad;  // what one sigma of the clock's offset does
  double sigma_sample_rad_s = 0;
  int gaps = 0;  // turns that are missing
};

// times_s: of the frames, growing. A gap is where samples lie further apart than the frames do
// (median). Sigmas are 0 where nothing is said of the noise and the samples do not scatter. Throws
// UsageError from the channel; std::invalid_argument for times that do not grow.
[[nodiscard]] ChannelTurns TurnsByChannel(const WheelSpeedChannel& channel,
                                          std::span<const double> times_s);

// What the frames' images say of the wheel's speed, against the rig, or with `rotation` (one entry
// a frame) over the ground; without frames that are not placed or of which the rotation is not
// known.
[[nodiscard]] SampledSignal WheelSpeedsOf(const RollingWheel& rolling,
                                          std::span<const RigRotationFrame> rotation);

struct ChannelLean {
  bool used = false;
  std::string problem;  // not used: why, in a sentence
  // How much of the wheel's turn over the recording follows the channel: its derivative by a factor
  // on the channel. 0: the images tell all of it, 1: the channel does.
  double lean = std::numeric_limits<double>::quiet_NaN();
  double sigma_sample_rad_s = 0;
  int gaps = 0, outliers = 0;  // turns from frame to frame that are missing, that do not count
  // Of the turn from a frame to the next, what obstacles draw the whole surface along by and places
  // do not disagree on: so that images and channel go together (maximum likelihood). 0 where one
  // deformation explains all frames.
  double drawn_along_rad = 0;
};

// Smooths the wheel's angle again, with the turns from frame to frame by a channel.
//
// A channel tells turns and not the angle, images both, but an obstacle that draws the whole
// surface along cannot be told from a turn by images alone. So the errors of the measured angles
// drift (AngleTurns): from frame to frame by how far places disagree (turn_spread_rad), and in a
// recording with obstacles (not RollingAngles::steady) by drawn_along_rad besides. On even ground
// images are a hundred times surer than a channel, and it changes next to nothing; over obstacles
// it tells the turn. The constant stays that of the images in the first frame.
//
// rotation: one entry a frame where the channel tells the speed over the ground: turns against the
// rig are those less the rig's own, with its errors. Empty: it tells that against the rig.
//
// The channel is not used, and nothing changed, where it contradicts the images where they see no
// obstacle: the median turn differs by more than three sigmas of both, the clock's and the
// calibration's; with obstacles, in the half of the turns on which places agree best, by more than
// 2 % of the turn besides.
//
// Sigmas: those of the clock's offset and of the scale are errors common to all turns; what they do
// to the angle and the speed is counted with the random errors.
// Changes of rolling: angle, speed, their sigmas, what the modes do, lean, outlier and channel_lean
// of the frames; jerk_rad_s25 and scatter.
// It is neither used where the frames have no times, nothing tells its noise, or no frame the
// rotation that it needs. Throws as SmoothAngles() and TurnsByChannel(), and std::invalid_argument
// where there are not as many rotations as frames.
// Accuracy: tests/track/wheel_speed_channel_test.cc.
ChannelLean LeanOnChannel(const WheelSpeedChannel& channel,
                          std::span<const RigRotationFrame> rotation,
                          const AngleSmootherOptions& options, RollingWheel* rolling);

}  // namespace plumbline
