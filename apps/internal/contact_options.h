#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/internal/option_table.h"
#include "io/series_writer.h"
#include "track/rolling_contact.h"

namespace plumbline::internal {

// What is said of the ground under a rolling tyre, of its carcass and of its slip.
class ContactOptionSet {
 public:
  void Declare(OptionTable& options);

  // crown_y_mm: where the middle of the tread lies on the wheel's axis (wheel frame). Throws
  // UsageError.
  RollingContactOptions Options(double crown_y_mm) const;

  // The vehicle's speed out of the channels, on our clock as far as that is said or follows from
  // the wheel's speed; nothing where none was named. Throws UsageError for a channel that is not
  // there or has no unit of a speed, InputError as FindClockOffset.
  void AddChannels(const std::vector<Channel>& channels, const RollingWheel& rolling,
                   RollingContactOptions* options) const;

 private:
  std::string carcass_ = "0", ground_turns_, vehicle_speed_, wheel_speed_, convention_ = "iso8855";
  double vehicle_speed_sigma_m_s_ = 0, radius_sigma_mm_ = 0, threshold_mm_ = 0.5;
  std::optional<double> radius_mm_;
};

}  // namespace plumbline::internal
