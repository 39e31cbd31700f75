#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/internal/option_table.h"
#include "apps/internal/wheel_speed_options.h"
#include "io/series_writer.h"
#include "track/rolling_contact.h"

namespace plumbline::internal {

// "20", or "-100:22,0:20,100:22": millimetres of thickness, one for all or by place along the axis
// from the middle of the tread, which lies at crown_y_mm. Throws UsageError.
CarcassThickness ParseCarcass(const std::string& text, double crown_y_mm);

// What is said of the ground under a rolling tyre, of its carcass and of its slip.
class ContactOptionSet {
 public:
  void Declare(OptionTable& options);

  // crown_y_mm: where the middle of the tread lies on the wheel's axis (wheel frame). Throws
  // UsageError.
  RollingContactOptions Options(double crown_y_mm) const;
  // WithCarcassModes(), of the carcass that is said.
  WheelReference WithCarcass(WheelReference wheel) const;

  // Before anything is measured. Throws UsageError for a channel that is not there or has no unit
  // of a speed, and where nothing would tell the logger's clock.
  void CheckChannels(const std::vector<Channel>& channels) const;

  const WheelSpeedOptionSet& wheel_speed() const { return wheel_speed_; }

  // The vehicle's speed out of the channels, on our clock; without its offset there is no slip by
  // the channel.
  void AddVehicleSpeed(const std::vector<Channel>& channels, RollingContactOptions* options) const;

 private:
  CarcassThickness Carcass(double crown_y_mm) const;

  std::string carcass_ = "0", ground_turns_, obstacle_height_, camber_, vehicle_speed_,
              convention_ = "iso8855";
  WheelSpeedOptionSet wheel_speed_;
  double vehicle_speed_sigma_m_s_ = 0, radius_sigma_mm_ = 0, threshold_mm_ = 0.5;
  double carcass_sigma_mm_ = 0;
  std::optional<double> radius_mm_;
};

}  // namespace plumbline::internal
