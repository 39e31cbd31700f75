#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/internal/option_table.h"
#include "io/series_writer.h"
#include "track/wheel_speed_channel.h"

namespace plumbline::internal {

// The one of that name. Throws UsageError where there is none.
const Channel& ChannelNamed(const std::vector<Channel>& channels, const std::string& name);

// What is said of a channel with the wheel's speed: it tells the offset of the logger's clock, and
// the wheel's angle leans on it.
class WheelSpeedOptionSet {
 public:
  void Declare(OptionTable& options);

  bool given() const { return !name_.empty(); }
  // Else against the rig.
  bool over_ground() const { return against_ == "ground"; }

  // Before anything is measured. Throws UsageError for a channel that is not there.
  void Check(const std::vector<Channel>& channels) const;

  // The offset of the logger's clock, from the speeds that the images tell (WheelSpeedsOf()), near
  // the one that is said; written into the channels, which are of one logger. Says in a sentence
  // what was found, or why it was not.
  std::string FindClock(const SampledSignal& by_images, std::vector<Channel>* channels) const;

  // The channel, in rad/s; nothing, and in `problem` why, where its unit is not of a turn or the
  // logger's clock is not known.
  std::optional<WheelSpeedChannel> Speeds(const std::vector<Channel>& channels,
                                          std::string* problem) const;

 private:
  std::string name_, against_ = "ground";
  std::optional<double> sigma_rad_s_;
  double sigma_scale_ = 0;
};

}  // namespace plumbline::internal
