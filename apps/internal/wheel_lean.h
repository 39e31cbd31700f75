#pragma once

#include <string>
#include <vector>

#include "apps/internal/contact_options.h"
#include "apps/rolling_run.h"
#include "io/series_writer.h"
#include "track/wheel_speed_channel.h"

namespace plumbline::internal {

// A sentence on whether, and by how much, the wheel's angle leans on a channel.
std::string TextOf(const ChannelLean& lean);

// After the survey: the offset of the logger's clock, which is written into the channels, the
// wheel's angle by the channel of its speed (RollingRun::LeanOn()), and then the contact, with the
// vehicle's speed. Says in a sentence what was found of the clock; empty: there is no channel of
// the wheel's speed. Throws as RollingRun::FindContact() and LeanOn().
std::string FindContact(const ContactOptionSet& said, RollingContactOptions contact,
                        RollingRun& run, std::vector<Channel>* channels);

}  // namespace plumbline::internal
