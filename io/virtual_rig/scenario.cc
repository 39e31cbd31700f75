#include "io/virtual_rig/scenario.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <set>

#include "calib/error.h"

namespace plumbline {
namespace {

// Motion within one exposure that can be rendered.
constexpr double kFarthestBlur_mm = 50;
constexpr double kDegree = std::numbers::pi / 180;
// --- the list

using Adapt = std::function<void(Scenario&)>;
struct Listed {
  ScenarioEntry entry;
  RigKind rig;
  Adapt adapt;
};

SpecimenOptions& Specimen(Scenario& s) { return std::get<SpecimenOptions>(s.surface); }
TyreOptions& Tyre(Scenario& s) { return std::get<TyreOptions>(s.surface); }

void AddLaboratory(std::vector<Listed>& list) {
  const auto add = [&](const char* name, const char* summary, const Adapt& adapt) {
    list.push_back({{name, summary}, RigKind::kLaboratory, [adapt](Scenario& s) {
                      s.follow_material = true;
                      s.frames_per_second = 10;
                      adapt(s);
                      Specimen(s).end_time_s = (s.frames - 1) / s.frames_per_second;
                    }});
  };
  add("still", "a flat specimen that stands still: the noise floor", [](Scenario&) {});
  add("shift", "a flat specimen shifted by 0.5, 0.3 and 0.2 mm in ten steps, without strain",
      [](Scenario& s) {
        Specimen(s).translation_mm = {0.5, 0.3, 0.2};
      });
  add("rigid", "a flat specimen turned by 10 degrees and moved by 20 mm, without strain",
      [](Scenario& s) {
        Specimen(s).size_mm = {80, 60};
        Specimen(s).rotation_rad = Eigen::Vector3d(3, 4, 8.66) * kDegree;
        Specimen(s).translation_mm = {8, -6, 17};
      });
  add("cylinder", "a speckled cylinder of 60 mm radius, rolling by 2 degrees", [](Scenario& s) {
    Specimen(s).shape = SpecimenOptions::Shape::kCylinder;
    Specimen(s).rotation_rad = Eigen::Vector3d(0, 2, 0) * kDegree;
  });
  add("stretch", "a sheet stretched by 2 % along x, contracting by 0.6 % along y",
      [](Scenario& s) { Specimen(s).displacement_gradient << 0.02, 0, 0, -0.006; });
  add("shear", "a sheet sheared by 1 %",
      [](Scenario& s) { Specimen(s).displacement_gradient << 0, 0.01, 0, 0; });
  add("star", "a wavy displacement whose period grows from 1 to 20 mm: spatial resolution",
      [](Scenario& s) {
        s.frames = 2;
        Specimen(s).star_amplitude_mm = 0.05;
      });
}

void AddTyre(std::vector<Listed>& list) {
  const auto add = [&](const std::string& name, const std::string& summary, const Adapt& adapt) {
    list.push_back({{name, summary}, RigKind::kWide640, [adapt](Scenario& s) {
                      s.surface = TyreOptions();
                      s.frames = 12;
                      s.exposure_s = 1.5e-4;
                      s.motion.mounting_rad = Eigen::Vector3d(0.8, -1.5, 0.4) * kDegree;
                      adapt(s);
                    }});
  };
  add("tyre-lifted", "5.3.1: the lifted wheel, slowly turning: the undeformed inner surface",
      [](Scenario& s) {
        Tyre(s).lifted_mm = 50;
        Tyre(s).speed_mm_s = 500;
      });
  add("tyre-flat", "5.3.2: the loaded tyre rolls on flat ground", [](Scenario&) {});
  struct Way {
    const char* name;
    const char* section;
    const char* words;
    double angle_rad;
    Eigen::Vector2d centre_mm;
  };
  const Way ways[] = {
      {"lateral", "5.3.3", "across its way", 0, {0, 0}},
      {"longitudinal", "5.3.4", "along its way, in the middle", 90 * kDegree, {0, 0}},
      {"diagonal", "5.3.5", "at 45 degrees", 45 * kDegree, {0, 0}},
      {"offset", "5.3.6", "along its way, 45 mm to the left", 90 * kDegree, {0, 45}}};
  struct Bar {
    const char* name;
    const char* words;
    Obstacle::Section section;
    double size_mm;
  };
  const Bar bars[] = {{"square38", "a 38 mm square bar", Obstacle::Section::kSquare, 38},
                      {"square50", "a 50 mm square bar", Obstacle::Section::kSquare, 50},
                      {"angle40", "a 40 mm angle iron", Obstacle::Section::kAngleIron, 40}};
  for (const Way& way : ways) {
    for (const Bar& bar : bars) {
      add(fmt::format("cleat-{}-{}", way.name, bar.name),
          fmt::format("{}: the tyre rolls over {} {}", way.section, bar.words, way.words),
          [way, bar](Scenario& s) {
            Tyre(s).start_travel_mm = -154;
            Tyre(s).obstacles = {{bar.section, bar.size_mm, 0, way.centre_mm, way.angle_rad}};
          });
    }
  }
  add("nuts", "5.3.7: the tyre rolls over nuts M24, M20, M14 and M10 in a row", [](Scenario& s) {
    s.frames = 24;
    Tyre(s).start_travel_mm = -80;
    const double heights_mm[] = {23.1, 19.6, 13.6, 10.0}, flats_mm[] = {36, 30, 21, 17};
    for (int k = 0; k < 4; ++k) {
      Tyre(s).obstacles.push_back(
          {Obstacle::Section::kNut, flats_mm[k], heights_mm[k], {160.0 * k, 0}, 0.2});
    }
  });
  add("tyre-braking", "the tyre rolls on flat ground with 3 % of braking slip",
      [](Scenario& s) { Tyre(s).slip_ratio = -0.03; });
  add("tyre-cornering", "the tyre rolls on flat ground with 3 degrees of slip angle",
      [](Scenario& s) { Tyre(s).slip_angle_rad = 3 * kDegree; });
  add("tyre-disturbed",
      "over a 38 mm bar with all that disturbs: flexing torque arm, pitching vehicle, vibrating "
      "camera, unsteady speed",
      [](Scenario& s) {
        Tyre(s).start_travel_mm = -154;
        Tyre(s).speed_swing_mm_s = 400;
        Tyre(s).obstacles = {{Obstacle::Section::kSquare, 38, 0, {0, 0}, 0}};
        s.motion.flexure_rad_per_m_s2 = 1.2 * kDegree;
        s.motion.wheelbase_mm = 2794;
        s.motion.vibration_rad = 0.01 * kDegree;
        s.right_delay_s = 2e-5;
        s.dropped = {5};
      });
}

std::vector<Listed> List() {
  std::vector<Listed> list;
  AddLaboratory(list);
  list.push_back({{"incline", "5.1: a wedge of 10 degrees on a flat base, seen by the tyre's rig"},
                  RigKind::kWide640,
                  [](Scenario& s) {
                    s.frames = 5;
                    SpecimenOptions& wedge = Specimen(s);
                    wedge.shape = SpecimenOptions::Shape::kIncline;
                    wedge.size_mm = {320, 260};
                    wedge.incline_rad = 10 * kDegree;
                  }});
  AddTyre(list);
  return list;
}

// A disc is about four and a half pixels wide in the middle of the view: what correlation likes.
constexpr double kSpeckle_px = 4.4;

}  // namespace

std::vector<ScenarioEntry> ListScenarios() {
  std::vector<ScenarioEntry> entries;
  for (const Listed& listed : List()) entries.push_back(listed.entry);
  return entries;
}

namespace {

Scenario Make(const Listed& listed, const StereoRig& rig, double distance_mm) {
  Scenario s{.name = listed.entry.name,
             .summary = listed.entry.summary,
             .rig = rig,
             .distance_mm = distance_mm,
             .ground_from_rig = MakeRigPose(rig, distance_mm),
             .surface = SpecimenOptions(),
             .speckle = {},
             .tags = {},
             .motion = {},
             .lighting = {},
             .sensor = {},
             .render = {},
             .dropped = {}};
  listed.adapt(s);
  if (s.HasTyre()) {
    // From the wheel's centre: the inner surface's crown lies a radius below.
    s.ground_from_rig.translation_mm.z() -= Tyre(s).section.crown_radius_mm;
  }
  // The material ends without a rim.
  s.speckle.background = s.render.background_albedo;
  s.speckle.diameter_mm = kSpeckle_px * distance_mm / rig.left.parameters()[0];
  const double between_mm = rig.right_from_left.Inverse().translation_mm.x();
  s.lighting.leds_in_rig_mm = {{-45, 0, 0}, {between_mm + 45, 0, 0}};
  s.lighting.reference_distance_mm = distance_mm;
  return s;
}

const Listed& Find(const std::vector<Listed>& list, const std::string& name) {
  const auto at =
      std::find_if(list.begin(), list.end(), [&](const Listed& l) { return l.entry.name == name; });
  if (at == list.end()) {
    throw UsageError(fmt::format(
        "There is no scenario '{}'; plumbline simulate list names those there are.", name));
  }
  return *at;
}

}  // namespace

Scenario MakeScenario(const std::string& name) {
  const std::vector<Listed> list = List();
  return MakeScenario(name, Find(list, name).rig);
}

Scenario MakeScenario(const std::string& name, RigKind kind) {
  return MakeScenario(name, MakeRig(DesignOf(kind)), DesignOf(kind).distance_mm);
}

Scenario MakeScenario(const std::string& name, const StereoRig& rig, double distance_mm) {
  const std::vector<Listed> list = List();
  return Make(Find(list, name), rig, distance_mm);
}

RigKind RigOf(const std::string& name) {
  const std::vector<Listed> list = List();
  return Find(list, name).rig;
}

void RigMotionOptions::Check() const {
  if (!mounting_rad.allFinite() || !std::isfinite(flexure_rad_per_m_s2)) {
    throw UsageError("The rig's mounting and its flexure must be finite.");
  }
  if (!(wheelbase_mm >= 0) || !(vibration_hz > 0) || !(std::abs(vibration_rad) < 0.1)) {
    throw UsageError("The wheelbase must be 0 or more and the vibration below 6 degrees.");
  }
}

void Scenario::Check() const {
  if (!(distance_mm > 0)) throw UsageError("The cameras must stand off by more than 0 mm.");
  if (HasTyre() && distance_mm > std::get<TyreOptions>(surface).section.crown_radius_mm - 100) {
    throw UsageError(fmt::format(
        "A rig {:.0f} mm from the inner surface stands beyond the wheel's hub: at most {:.0f} mm.",
        distance_mm, std::get<TyreOptions>(surface).section.crown_radius_mm - 100));
  }
  if (frames < 1) throw UsageError("A recording has at least one frame.");
  if (!(frames_per_second > 0)) throw UsageError("The frame rate must be positive.");
  if (!(exposure_s >= 0) || exposure_s * frames_per_second > 1) {
    throw UsageError("The exposure must be shorter than the time between frames.");
  }
  if (!(std::abs(right_delay_s) * frames_per_second < 1)) {
    throw UsageError("The cameras' time offset must be shorter than the time between frames.");
  }
  if (step_px < 1) throw UsageError("The step of the truth's grid must be at least 1 px.");
  for (const int index : dropped) {
    if (index < 0 || index >= frames) {
      throw UsageError(
          fmt::format("Frame {} cannot be dropped: there are {}, counted from 0.", index, frames));
    }
  }
  if (std::set<int>(dropped.begin(), dropped.end()).size() >= static_cast<std::size_t>(frames)) {
    throw UsageError("All frames are dropped; leave at least one.");
  }
  if (!HasTyre() && std::find(dropped.begin(), dropped.end(), 0) != dropped.end()) {
    throw UsageError("Frame 0 of a specimen cannot be dropped: all displacements count from it.");
  }
  motion.Check();
  speckle.Check();
  lighting.Check();
  sensor.Check();
  render.Check();
  if (HasTyre()) {
    const auto& tyre = std::get<TyreOptions>(surface);
    tyre.Check();
    if ((tyre.speed_mm_s + std::abs(tyre.speed_swing_mm_s)) * exposure_s > kFarthestBlur_mm) {
      throw UsageError(
          fmt::format("The tyre moves by more than {:g} mm in one exposure; expose shorter.",
                      kFarthestBlur_mm));
    }
  } else {
    std::get<SpecimenOptions>(surface).Check();
    if (tags) throw UsageError("Tags are painted on a tyre, not on a specimen.");
  }
}

}  // namespace plumbline
