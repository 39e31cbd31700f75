#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "calib/stereo_rig.h"
#include "io/virtual_rig/lighting.h"
#include "io/virtual_rig/render.h"
#include "io/virtual_rig/sensor.h"
#include "io/virtual_rig/specimen_surfaces.h"
#include "io/virtual_rig/speckle.h"
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
};

// Everything that a recording depends on, and the truth of it.
struct Scenario {
  std::string name;
  std::string summary;  // one line
  StereoRig rig;        // the true cameras
  // Nominal pose of the rig (the left camera): in the laboratory ground_from_rig; in a tyre
  // relative to the wheel's centre, with the ground's axes.
  Rigid3 ground_from_rig;
  std::variant<SpecimenOptions, TyreOptions> surface;
  SpeckleOptions speckle;
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

// The cameras that scenarios come with.
enum class RigKind {
  kWide640,    // 640x480, 3.5 mm lens on a 1/2 inch sensor, 85 degrees of view, 40 mm apart
  kWide1280,   // 1280x1024, the same lens
  kLaboratory  // 1280x1024, 25 mm lens, 130 mm apart, converging on a point 500 mm away
};
StereoRig MakeRig(RigKind kind);
// Nominal ground_from_rig of Scenario: looking straight down on the world's origin from
// distance_mm; in a tyre, on its inner surface below the wheel's centre.
Rigid3 MakeRigPose(const StereoRig& rig, double distance_mm);

struct ScenarioEntry {
  std::string name;
  std::string summary;
};
// All scenarios in the order of the list, the thesis' tests among them.
std::vector<ScenarioEntry> ListScenarios();

// A scenario by name, on other cameras than its own if asked for: the size of the speckle follows.
// Throws UsageError, naming near ones, when there is none.
Scenario MakeScenario(const std::string& name);
Scenario MakeScenario(const std::string& name, RigKind kind);

// Distance from the cameras to the surface in the middle of the view (mm), for calibration.
double WorkingDistance_mm(const Scenario& scenario);

}  // namespace plumbline
