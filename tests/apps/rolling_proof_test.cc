// Whether the sigmas of a rolling tyre hold at the end of the whole chain: draws of the images'
// noise and of the calibration, from the lifted wheel to patch and slip.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <memory>
#include <numbers>
#include <span>
#include <utility>
#include <vector>

#include "apps/rolling_run.h"
#include "apps/wheel_reference_run.h"
#include "io/virtual_rig/tyre_patch.h"
#include "io/virtual_rig/virtual_rig.h"
#include "tests/support/consistency.h"
#include "tests/support/held_pairs.h"
#include "tests/support/subset_noise.h"
#include "tests/support/true_wheel.h"

namespace plumbline {
namespace {

using testing::Consistency;

constexpr double kDegrees = std::numbers::pi / 180;
constexpr int kLifted = 8;
constexpr double kLiftedStep_rad = 6 * kDegrees;

// A recording without noise, to be exposed anew for each draw.
struct Scene {
  explicit Scene(Scenario scenario) : rig(std::move(scenario)) {
    for (int f = 0; f < rig.scenario().frames; ++f) {
      means.push_back({rig.MeanImage(f, Side::kLeft), rig.MeanImage(f, Side::kRight)});
    }
  }

  std::vector<StereoFrame> Expose(std::uint64_t seed) const {
    std::vector<StereoFrame> pairs;
    const std::vector<int>& dropped = rig.scenario().dropped;
    for (std::size_t f = 0; f < means.size(); ++f) {
      if (std::count(dropped.begin(), dropped.end(), static_cast<int>(f)) > 0) continue;
      StereoFrame& pair = pairs.emplace_back();
      pair.index = static_cast<std::int64_t>(f);
      pair.time_s = rig.FrameTime(static_cast<int>(f));
      const SensorOptions& sensor = rig.scenario().sensor;
      pair.left = plumbline::Expose(means[f][0], sensor, seed, 2 * f);
      pair.right = plumbline::Expose(means[f][1], sensor, seed, 2 * f + 1);
    }
    return pairs;
  }

  VirtualRig rig;
  std::vector<std::array<Image<float>, 2>> means;
};

// How the rig may be wrong, as a calibration from 30 photographs leaves it: the sizes are those of
// the rig of docs/rolling_tyre.md, one standard deviation a mode, the last one the scale.
StereoRig WithModes(StereoRig rig) {
  const std::vector<std::vector<std::pair<int, double>>> modes = {
      {{0, 0.015}, {1, 0.015}, {9, 0.015}, {10, 0.015}},    // focal lengths, px
      {{0, 0.003}, {1, 0.003}, {9, -0.003}, {10, -0.003}},  //
      {{2, 0.015}, {11, 0.015}},                            // principal points, px
      {{3, 0.013}, {12, 0.013}},                            //
      {{2, 0.003}, {11, -0.003}},                           //
      {{4, 3e-5}, {5, -4e-5}, {8, 1e-5}},                   // distortion
      {{13, 3e-5}, {14, -4e-5}, {17, 1e-5}},                //
      {{18, 1.6e-5}},                                       // pose, rad
      {{19, 2.4e-5}},                                       //
      {{20, 4e-6}},                                         //
      {{22, 7e-4}},                                         // mm
      {{23, 2.5e-3}},                                       //
  };
  const int count = static_cast<int>(modes.size());
  rig.modes.modes = Eigen::MatrixXd::Zero(count + 1, rig.ParameterCount());
  for (int k = 0; k < count; ++k) {
    for (const auto& [parameter, sigma] : modes[static_cast<std::size_t>(k)]) {
      rig.modes.modes(k, parameter) = sigma;
    }
  }
  rig.modes.modes.row(count).tail<3>() = 1e-3 * rig.right_from_left.translation_mm.transpose();
  rig.modes.has_scale_mode = true;
  return rig;
}

Scenario FramesOf(const char* name, int frames) {
  Scenario scenario = MakeScenario(name, RigKind::kWide640);
  scenario.frames = frames;
  return scenario;
}

// The scatter of errors over the draws at each place by itself, in sigmas: what of them is noise.
// The rest is what all draws have alike.
class ScatterAtPlaces {
 public:
  void Add(std::int64_t place, double error, double sigma) {
    Place& at = places_[place];
    ++at.count;
    at.sum += error;
    at.squares += error * error;
    at.variances += sigma * sigma;
  }
  double nees() const {
    double sum = 0, count = 0;
    for (const auto& [place, at] : places_) {
      if (at.count < 5) continue;
      sum += (at.squares - at.sum * at.sum / at.count) / (at.count - 1) * at.count / at.variances;
      ++count;
    }
    return sum / count;
  }

 private:
  struct Place {
    double count = 0, sum = 0, squares = 0, variances = 0;
  };
  std::map<std::int64_t, Place> places_;
};

// A number's errors, of all draws and at each place (or frame) by itself.
struct Errors {
  Consistency all;
  ScatterAtPlaces at_places;

  void Add(std::int64_t place, double error, double sigma) {
    all.Add(error, sigma);
    at_places.Add(place, error, sigma);
  }
};

struct Proof {
  Errors tilt_x, tilt_y, height, deflection, turn, wheel_speed, speed, radius, slip_angle, area,
      length, width, radial, across;
  int frames = 0, with_ground = 0;
};

struct Part {
  const char* name;
  Errors Proof::*part;
  // Of the mean squared error in sigmas, by noise alone: sigmas may be neither too small nor too
  // large.
  double least_nees = 0.6, most_nees = 1.6, least_coverage = 0.85;
};
// What the law of lift-off may leave out, which is not drawn, is in the patch. The height has the
// error that an arc leaves in the axis' distance, and displacements what subsets at the rim of the
// patch do not follow, in all draws alike. Why the tilt about x is claimed too large is not known.
constexpr std::array kParts = {Part{"tilt about x, rad", &Proof::tilt_x, 0.3},
                               Part{"tilt about y, rad", &Proof::tilt_y},
                               Part{"height of the axis, mm", &Proof::height, 0.6, 1.8},
                               Part{"deflection, mm", &Proof::deflection, 0.5},
                               Part{"turn since the first frame, rad", &Proof::turn, 0.5},
                               Part{"speed of the wheel, rad/s", &Proof::wheel_speed, 0.5},
                               Part{"speed over the ground, mm/s", &Proof::speed},
                               Part{"effective radius, mm", &Proof::radius},
                               Part{"slip angle, rad", &Proof::slip_angle},
                               Part{"patch area, mm2", &Proof::area, 0, 2.5, 0.8},
                               Part{"patch length, mm", &Proof::length, 0},
                               Part{"patch width, mm", &Proof::width, 0, 2.5},
                               Part{"displacement towards the axis, mm", &Proof::radial},
                               Part{"displacement along the axis, mm", &Proof::across}};

// How a deformation turns with the ground, and how the speed changes between frames, is counted in
// full and is the same in all draws.
constexpr std::array kPartsDisturbed = {Part{"tilt about x, rad", &Proof::tilt_x},
                                        Part{"tilt about y, rad", &Proof::tilt_y},
                                        Part{"height of the axis, mm", &Proof::height, 0.6, 1.8},
                                        Part{"deflection, mm", &Proof::deflection, 0.5},
                                        Part{"turn since the first frame, rad", &Proof::turn, 0.2},
                                        Part{"speed of the wheel, rad/s", &Proof::wheel_speed, 0.4},
                                        Part{"speed over the ground, mm/s", &Proof::speed, 0.6, 2},
                                        Part{"effective radius, mm", &Proof::radius, 0.1},
                                        Part{"slip angle, rad", &Proof::slip_angle},
                                        Part{"patch area, mm2", &Proof::area, 0, 2.5, 0.8},
                                        Part{"patch length, mm", &Proof::length, 0},
                                        Part{"patch width, mm", &Proof::width, 0, 2.5},
                                        Part{"displacement towards the axis, mm", &Proof::radial},
                                        Part{"displacement along the axis, mm", &Proof::across}};

// Over a bar the speed of the wheel, and the radius with it, may be off by all that places disagree
// by on how far it has turned; the tilt about the axis hangs on how the surface stands still.
constexpr std::array kPartsOverABar = {
    Part{"tilt about x, rad", &Proof::tilt_x, 0.3},
    Part{"tilt about y, rad", &Proof::tilt_y, 0.6, 2.2, 0.7},
    Part{"height of the axis, mm", &Proof::height, 0.6, 2.4},
    Part{"turn since the first frame, rad", &Proof::turn, 0.6, 2.4, 0.75},
    Part{"speed of the wheel, rad/s", &Proof::wheel_speed, 0},
    Part{"speed over the ground, mm/s", &Proof::speed, 0.6, 2},
    Part{"effective radius, mm", &Proof::radius, 0},
    Part{"slip angle, rad", &Proof::slip_angle, 0.4},
    Part{"displacement towards the axis, mm", &Proof::radial, 0.4, 1.4, 0.9},
    Part{"displacement along the axis, mm", &Proof::across, 0.6, 1.6, 0.88}};

// Points of a frame: displacement from the undeformed wheel. calibration: whether it was drawn too.
void ComparePoints(const VirtualRig& rig, bool calibration, int number, const SeriesHeader& header,
                   const SeriesFrame& frame, Proof& proof) {
  const auto truth = rig.Truth(number);
  const Eigen::Vector3d axis = frame.wheel.axis;
  for (std::size_t i = 0; i < frame.surface.status.pixel_count(); ++i) {
    const Eigen::Vector3d moved = frame.displacement.value_mm.data()[i].cast<double>();
    if (!moved.allFinite()) continue;
    const auto there = truth->UnderLeftPixel(
        (header.grid_px.data()[i] + frame.match.left_displacement_px.data()[i]).cast<double>());
    if (!there) continue;
    const Eigen::Vector3d at = frame.surface.position_mm.data()[i].cast<double>();
    const auto from_axis = [&](const Eigen::Vector3d& place) -> Eigen::Vector3d {
      const Eigen::Vector3d from = place - frame.wheel.centre_mm;
      return from - axis * axis.dot(from);
    };
    const Eigen::Vector3d outwards = from_axis(at - moved).normalized();
    // By how much nearer the point has come, which does not hang on the constant of all angles.
    const double off_outwards =
        from_axis(at - there->displacement_mm).norm() - from_axis(at - moved).norm();
    const double off_along = axis.dot(moved - there->displacement_mm);
    const Eigen::Vector3d sigma =
        (frame.displacement.sigma_random_mm.data()[i].cast<double>().cwiseAbs2() +
         (calibration ? 1 : 0) *
             frame.displacement.sigma_calibration_mm.data()[i].cast<double>().cwiseAbs2())
            .cwiseSqrt();
    const auto place = static_cast<std::int64_t>(i) * rig.scenario().frames + number;
    proof.radial.Add(place, off_outwards, sigma.cwiseProduct(outwards).norm());
    proof.across.Add(place, off_along, sigma.cwiseProduct(axis).norm());
  }
}

// By how much the ground has turned about the wheel's axis, as the rig sees it.
double PitchSince(const VirtualRig& rig, double then_s, double now_s) {
  const Rigid3 turned = rig.GroundFromRig(now_s) * rig.GroundFromRig(then_s).Inverse();
  return -turned.RotationVector().y();
}

// flat: the patch on flat ground; over an obstacle neither that nor the deflection is of one
// number.
void Compare(const VirtualRig& rig, bool calibration, int number, const TyrePatch* flat,
             const RollingFrame& first, const RollingFrame& placed, const SeriesFrame& frame,
             Proof& proof) {
  const double time_s = rig.FrameTime(number);
  const auto& tyre = std::get<TyreOptions>(rig.scenario().surface);
  const WheelState wheel = rig.tyre()->Wheel(time_s);
  GroundRecord truth;
  truth.normal_in_rig = rig.GroundFromRig(time_s).rotation.row(2);
  const GroundAngles angles = AnglesOf(frame.ground);
  const Eigen::Vector3d tilt = angles.angle_rad - AnglesOf(truth).angle_rad;
  const auto both = [&](double random, double of_calibration) {
    return calibration ? std::hypot(random, of_calibration) : random;
  };
  proof.tilt_x.Add(number, tilt[0],
                   both(angles.sigma_random_rad[0], angles.sigma_calibration_rad[0]));
  proof.tilt_y.Add(number, tilt[1],
                   both(angles.sigma_random_rad[1], angles.sigma_calibration_rad[1]));
  const DeformationRecord& d = frame.deformation;
  proof.height.Add(number, d.loaded_radius_mm - wheel.centre_height_mm,
                   both(d.sigma_random_loaded_radius_mm, d.sigma_calibration_loaded_radius_mm));
  if (flat != nullptr) {
    proof.deflection.Add(number, d.deflection_mm - tyre.deflection_mm,
                         both(d.sigma_random_deflection_mm, d.sigma_calibration_deflection_mm));
  }
  const WheelRecord& w = frame.wheel;
  if (number > 0) {
    const double turned = wheel.angle_rad - rig.tyre()->Wheel(rig.FrameTime(0)).angle_rad +
                          PitchSince(rig, rig.FrameTime(0), time_s);
    proof.turn.Add(number, placed.angle_rad - first.angle_rad - turned,
                   both(placed.sigma_random_turn_rad, placed.sigma_calibration_turn_rad));
  }
  constexpr double kShort_s = 1e-4;
  const double pitching_rad_s =
      PitchSince(rig, time_s - kShort_s, time_s + kShort_s) / (2 * kShort_s);
  proof.wheel_speed.Add(number, w.speed_rad_s - wheel.angular_speed_rad_s - pitching_rad_s,
                        both(w.sigma_random_speed_rad_s, w.sigma_calibration_speed_rad_s));
  const SlipRecord& s = frame.slip;
  if (!s.found) return;
  proof.speed.Add(number, s.speed_mm_s - wheel.speed_mm_s,
                  both(s.sigma_random_speed_mm_s, s.sigma_calibration_speed_mm_s));
  proof.radius.Add(
      number, s.effective_radius_mm - tyre.free_rolling_radius_mm,
      both(s.sigma_random_effective_radius_mm, s.sigma_calibration_effective_radius_mm));
  proof.slip_angle.Add(number, s.angle_rad,
                       both(s.sigma_random_angle_rad, s.sigma_calibration_angle_rad));
  const PatchRecord& p = frame.patch;
  if (flat == nullptr || !p.found || !std::isfinite(p.sigma_random_area_mm2)) return;
  proof.area.Add(number, p.area_mm2 - flat->area_mm2,
                 both(p.sigma_random_area_mm2, p.sigma_calibration_area_mm2));
  proof.length.Add(number, p.length_mm - flat->length_mm,
                   both(p.sigma_random_length_mm, p.sigma_calibration_length_mm));
  proof.width.Add(number, p.width_mm - flat->width_mm,
                  both(p.sigma_random_width_mm, p.sigma_calibration_width_mm));
}

// One draw: the wheel's reference and a run, by a rig that is off along its modes.
void AddDraw(const Scene& lifted, const Scene& rolling, const TyrePatch* flat, const StereoRig& rig,
             bool calibration, std::uint64_t seed, Proof& proof) {
  const std::vector<StereoFrame> arc = lifted.Expose(seed);
  const auto open = [&] { return std::make_unique<testing::HeldPairs>(arc); };
  const auto go_on = [](const std::string&, std::int64_t, std::int64_t) { return true; };
  const WheelReferenceRun reference = MeasureWheelReference(rig, open, {}, go_on);
  ASSERT_TRUE(reference.wheel);
  RollingRunOptions options;
  options.sequence.field.step_px = 8;
  options.sequence.field.correlator.subset_px = 33;
  options.sequence.field.correlator.order = 2;
  const SensorOptions& sensor = rolling.rig.scenario().sensor;
  options.sequence.field.correlator.noise =
      NoiseModel{std::pow(sensor.read_noise_grey, 2) - sensor.gain_grey * sensor.black_level_grey,
                 sensor.gain_grey};
  options.survey.matching = options.sequence;
  // What shakes the cameras is told as it is; how they were triggered is known.
  const Scenario& scenario = rolling.rig.scenario();
  if (scenario.motion.vibration_rad > 0) {
    options.survey.refinement = options.evaluation.refinement = PoseRefinement::kAlways;
  }
  options.right_delay = RightDelay{scenario.right_delay_s, 0};
  RollingRun run(*reference.wheel, options);
  const std::vector<StereoFrame> pairs = rolling.Expose(seed + 1000);
  testing::HeldPairs recording(pairs);
  ASSERT_TRUE(run.Survey(recording, [](std::int64_t, std::int64_t) { return true; }));
  RollingContactOptions contact;
  contact.carcass = testing::TrueCarcass(lifted.rig, reference.wheel->axis, 2);
  run.FindContact(contact);
  const SeriesHeader header = run.Header();
  for (std::size_t at = 0; at < pairs.size(); ++at) {
    const SeriesFrame frame = run.Measure(pairs[at], static_cast<std::int64_t>(at)).frame;
    const int f = static_cast<int>(pairs[at].index);
    ASSERT_EQ(frame.problem, "");
    ++proof.frames;
    if (!frame.rig_rotation.found) continue;
    ++proof.with_ground;
    const std::vector<RollingFrame>& placed = run.wheel().frames;
    Compare(rolling.rig, calibration, f, flat, placed[0], placed[at], frame, proof);
    ComparePoints(rolling.rig, calibration, f, header, frame, proof);
  }
}

void Prove(const Scenario& scenario, bool flat, std::span<const Part> parts, int draws) {
  const Scene lifted(
      testing::TurningBy(kLiftedStep_rad, kLifted, MakeScenario("tyre-lifted", RigKind::kWide640)));
  const Scene rolling(scenario);
  const auto patch = FindPatch(*rolling.rig.tyre(), 0);
  ASSERT_TRUE(patch || !flat);
  const StereoRig rig = WithModes(rolling.rig.scenario().rig);
  for (const bool calibration : {false, true}) {
    Proof all;
    testing::NormalDeviates normal(11);
    for (int draw = 0; draw < draws; ++draw) {
      StereoRig off = rig;
      if (calibration) {
        Eigen::VectorXd along(rig.modes.count());
        for (double& g : along) g = normal();
        off = rig.WithParameters(rig.Parameters() + rig.modes.modes.transpose() * along);
      }
      AddDraw(lifted, rolling, flat ? &*patch : nullptr, off, calibration,
              static_cast<std::uint64_t>(draw + 1), all);
      if (::testing::Test::HasFatalFailure()) return;
    }
    EXPECT_EQ(all.with_ground, all.frames);
    for (const Part& p : parts) {
      const Consistency& c = (all.*p.part).all;
      c.Print(fmt::format("{} | {}", calibration ? "both" : "noise", p.name).c_str());
      std::printf("  of it scatter over the draws: %.2f\n", (all.*p.part).at_places.nees());
      EXPECT_GT(c.coverage(), p.least_coverage) << p.name;
      EXPECT_LT(c.nees(), p.most_nees) << p.name;
      if (!calibration) {
        EXPECT_GT(c.nees(), p.least_nees) << p.name;
      }
    }
    if (calibration) continue;
    EXPECT_NEAR(all.radial.at_places.nees(), flat ? 0.7 : 0.4, 0.2);
    EXPECT_NEAR(all.across.at_places.nees(), flat ? 0.7 : 0.6, 0.2);
  }
}

TEST(RollingProof, ProveSigmasOver20Draws) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  Prove(FramesOf("tyre-flat", 7), true, kParts, 20);
}

// The arm swings while the vehicle speeds up, the right camera vibrates and exposes later, the
// light flickers, and a frame is lost.
Scenario Disturbed() {
  Scenario scenario = FramesOf("tyre-flat", 8);
  std::get<TyreOptions>(scenario.surface).speed_swing_mm_s = 400;
  scenario.motion.flexure_rad_per_m_s2 = 1.2 * kDegrees;
  scenario.motion.vibration_rad = 0.01 * kDegrees;
  scenario.lighting.flicker = 0.02;
  scenario.right_delay_s = 2e-5;
  scenario.dropped = {5};
  return scenario;
}

TEST(RollingProof, ProveSigmasWithAllThatDisturbsOver20Draws) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  Prove(Disturbed(), true, kPartsDisturbed, 20);
}

// A bar comes under the wheel, stands under it, and begins to leave it.
TEST(RollingProof, ProveSigmasOverABarOver10Draws) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  Prove(FramesOf("cleat-lateral-square38", 6), false, kPartsOverABar, 10);
}

}  // namespace
}  // namespace plumbline
