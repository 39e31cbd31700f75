#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "calib/stereo_rig.h"
#include "io/virtual_rig/lighting.h"
#include "io/virtual_rig/render.h"
#include "io/virtual_rig/rig_design.h"
#include "io/virtual_rig/sensor.h"
#include "io/virtual_rig/specimen_surfaces.h"
#include "io/virtual_rig/speckle.h"
#include "io/virtual_rig/tag_albedo.h"
#include "io/virtual_rig/tyre_surface.h"

namespace plumbline {

// What moves the rig and should not. Rotations are about the wheel's centre (in the laboratory:
// about the world's origin) and the axes of the ground frame.
struct RigMotionOptions {
  // How the rig is mounted: rotation vector from the nominal pose, for good.
  Eigen::Vector3d mounting_rad = Eigen::Vector3d::Zero();
  // The torque arm bends with the vehicle's acceleration: pitch (about y) an acceleration.
  double flexure_rad_per_m_s2 = 0;
  // The vehicle pitches as its axle rises on an obstacle: rise over wheelbase. 0: it does not.
  double wheelbase_mm = 0;
  // The right camera vibrates against the left one: amplitude of its rotation about each axis.
  double vibration_rad = 0;
  double vibration_hz = 35;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Everything that a recording depends on, and the truth of it.
struct Scenario {
  std::string name;
  std::string summary;  // one line
  StereoRig rig;        // the true cameras
  double distance_mm;   // from them to the surface in the middle of the view
  // Nominal pose of the rig (the left camera): in the laboratory ground_from_rig; in a tyre
  // relative to the wheel's centre, with the ground's axes.
  Rigid3 ground_from_rig;
  std::variant<SpecimenOptions, TyreOptions> surface;
  SpeckleOptions speckle;
  std::optional<WheelTagOptions> tags;  // on a tyre, over the speckle
  RigMotionOptions motion;
  LightingOptions lighting;
  SensorOptions sensor;
  RenderOptions render;

  int frames = 10;  // exposed; dropped ones are missing from the recording
  double frames_per_second = 50;
  double exposure_s = 0;
  double right_delay_s = 0;  // the right camera exposes so much later
  std::vector<int> dropped;  // by index

  // The truth's grid.
  int step_px = 8;
  bool follow_material = false;  // the points seen in the first frame, or the same pixels for good
  std::uint64_t seed = 1;

  bool HasTyre() const { return std::holds_alternative<TyreOptions>(surface); }

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct ScenarioEntry {
  std::string name;
  std::string summary;
};
// All scenarios in the order of the list, the thesis' tests among them.
std::vector<ScenarioEntry> ListScenarios();

// A scenario by name, on its own cameras or on others: pose, light and the size of the speckle
// follow them. Throws UsageError when there is none of that name.
Scenario MakeScenario(const std::string& name);
Scenario MakeScenario(const std::string& name, RigKind kind);
Scenario MakeScenario(const std::string& name, const StereoRig& rig, double distance_mm);

// The cameras that a scenario comes with. Throws UsageError.
RigKind RigOf(const std::string& name);

}  // namespace plumbline
