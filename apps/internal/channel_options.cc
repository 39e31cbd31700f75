#include "apps/internal/channel_options.h"

#include <limits>

#include "calib/error.h"
#include "io/channel_table.h"

namespace plumbline::internal {

void ChannelOptionSet::Declare(OptionTable& options) {
  options.Add({.name = "channels",
               .help = "a text table of signals that were logged beside the cameras, kept on the "
                       "logger's clock; its first line names the columns, as \"time [s],speed "
                       "[m/s]\"",
               .unit = "FILE"},
              &file_);
  options.Add({.name = "channel-offset",
               .help = "what the logger's clock reads when that of the frames is 0; not given: not "
                       "known",
               .unit = "s"},
              &clock_offset_s_);
  options.Add({.name = "channel-offset-sigma",
               .help = "standard deviation of --channel-offset, where that is surely known: a "
                       "channel of the wheel's speed then corrects it only where it is surer",
               .unit = "s",
               .min = 0,
               .max = 10},
              &sigma_clock_offset_s_);
}

std::vector<Channel> ChannelOptionSet::Read() const {
  if (sigma_clock_offset_s_ && !clock_offset_s_) {
    throw UsageError("--channel-offset-sigma is of --channel-offset, which is not given.");
  }
  if (file_.empty()) {
    if (clock_offset_s_) throw UsageError("--channel-offset is of --channels, which is not given.");
    return {};
  }
  std::vector<Channel> channels = ReadChannelTable(file_);
  SetClock(&channels);
  return channels;
}

std::vector<Channel> ChannelOptionSet::ReadOr(std::vector<Channel> of_run) const {
  if (!file_.empty() || of_run.empty()) return Read();
  SetClock(&of_run);
  return of_run;
}

void ChannelOptionSet::SetClock(std::vector<Channel>* channels) const {
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  for (Channel& channel : *channels) {
    channel.clock_offset_s = clock_offset_s_.value_or(kUnknown);
    channel.sigma_clock_offset_s = sigma_clock_offset_s_.value_or(kUnknown);
  }
}

}  // namespace plumbline::internal
