#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "apps/internal/option_table.h"
#include "io/virtual_rig/recording.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline::internal {

// The settings of a recording of the virtual rig, as the command line and recipes hold them. What
// is left out (`auto`) is the scenario's own.
class SimulateOptions {
 public:
  void Declare(OptionTable& options);

  const std::string& scenario() const { return scenario_; }

  // Throws UsageError.
  VirtualRig Rig(std::uint64_t seed) const;
  // The same for a recording that was written: cameras that came from a file, which may be
  // somewhere else by now, are read from the recording's own rig file.
  VirtualRig RigAgain(const std::filesystem::path& rig_file, std::uint64_t seed);
  RecordingOptions Recording(const Scenario& scenario, std::uint64_t seed) const;

 private:
  void DeclareCameras(OptionTable& options);
  void DeclareTyre(OptionTable& options);
  void DeclareCalibration(OptionTable& options);
  Scenario OnItsCameras() const;
  void ApplyTo(Scenario& scenario) const;
  void ApplyToTyre(Scenario& scenario) const;

  std::string scenario_;
  std::string cameras_ = "auto", images_ = "png", points_ = "auto", dropped_;
  std::string rig_, image_size_;
  std::optional<double> lens_mm_, pixel_um_, baseline_mm_, distance_mm_;
  std::optional<int> frame_count_, samples_, bits_, step_;
  std::optional<double> fps_, exposure_ms_, right_delay_ms_;
  std::optional<double> gain_, read_noise_, psf_, brightness_, flicker_, vignetting_, ambient_;
  std::optional<double> speckle_mm_, speckle_coverage_, speckle_edge_;
  bool noise_free_ = false;

  std::optional<double> speed_m_s_, speed_swing_m_s_, slip_ratio_, slip_angle_deg_, start_mm_;
  std::optional<double> flexure_deg_, vibration_deg_;
  std::string mounting_deg_, vehicle_pitch_ = "auto", tags_;
  double channel_rate_hz_ = 200, channel_offset_s_ = 0.237;

  int calibration_pairs_ = 0;
  std::string board_;
  bool careless_ = false, white_on_black_ = false;
  double bend_mm_ = 0, misprint_mm_ = 0;
  std::optional<double> min_distance_mm_, max_distance_mm_;
};

// The virtual rig of a folder that `plumbline simulate` wrote, made again from its recipe. Throws
// InputError when there is none.
VirtualRig ReopenVirtualRig(const std::string& folder);

}  // namespace plumbline::internal
