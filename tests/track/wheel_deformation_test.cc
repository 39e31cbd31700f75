#include "track/wheel_deformation.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <map>
#include <random>
#include <string>

#include "calib/error.h"
#include "fit/bump.h"
#include "fit/cross_section.h"
#include "fit/height_map.h"
#include "match/planar_field.h"
#include "tests/support/rolling_wheel.h"

namespace plumbline {
namespace {

using testing::RollingWheel;
constexpr double kDepth_mm = 0.08, kAcross_mm = 0.02;
constexpr double kReferenceDepth_mm = 0.03, kReferenceAcross_mm = 0.01;
constexpr double kAngle_rad = 1.5e-4, kTurn_rad = 1e-4, kShift_mm = 0.02, kAxis_rad = 1e-4,
                 kAxis_mm = 0.01;

class Scene {
 public:
  explicit Scene(Scenario scenario, int frame = 5, int step_px = 16, int overlap = 3)
      : wheel_(std::move(scenario), step_px, overlap), frame_(frame), truth_(wheel_.Truth(frame)) {
    MaterialFrame noisy = truth_.frame;
    known_.undeformed = known_.loaded = truth_.frame.points;
    wheel_.SetNoise(noisy, kDepth_mm, kAcross_mm);
    known_.loaded.cov_random_mm2 = noisy.points.cov_random_mm2;
    const Rigid3 rig_from_ground = truth_.frame.ground.frame_from_rig.Inverse();
    for (std::size_t i = 0; i < truth_.undeformed_mm.pixel_count(); ++i) {
      noisy.points.point_mm.data()[i] = known_.undeformed.point_mm.data()[i] =
          rig_from_ground * truth_.undeformed_mm.data()[i];
    }
    wheel_.SetNoise(noisy, kReferenceDepth_mm, kReferenceAcross_mm);
    known_.undeformed.cov_random_mm2 = noisy.points.cov_random_mm2;
    testing::SetModes(known_.loaded);
    testing::SetModes(known_.undeformed);
    known_.sigma_angle_rad = kAngle_rad;
    known_.axis = wheel_.Axis(frame);
    known_.cov_axis_random.diagonal() << kAxis_rad * kAxis_rad, 0, kAxis_rad * kAxis_rad,
        kAxis_mm * kAxis_mm;
    known_.axis_along_modes = testing::ModesOfAxis(known_.axis);
    known_.ground = truth_.frame.ground;
    known_.ground.cov_random.diagonal() << Eigen::Vector3d::Constant(kTurn_rad * kTurn_rad),
        Eigen::Vector3d::Constant(kShift_mm * kShift_mm);
    known_.contact = truth_.frame.contact;
    // The tyre's middle plane, where the wheel frame has it.
    const Eigen::Vector3d centre(0, 0, wheel_.Wheel(frame).centre_height_mm);
    options_.centre_y_mm = known_.axis.direction_in_rig().dot(rig_from_ground * centre);
  }

  const RollingWheel& wheel() const { return wheel_; }
  const RollingWheel::True& truth() const { return truth_; }
  const LoadedWheel& known() const { return known_; }
  const WheelDeformationOptions& options() const { return options_; }
  WheelState state() const { return wheel_.Wheel(frame_); }

  LoadedWheel Along(const Eigen::Vector3d& amount) const {
    LoadedWheel moved = known_;
    testing::MoveAlongModes(moved.loaded, amount);
    testing::MoveAlongModes(moved.undeformed, amount);
    moved.axis = testing::AxisAlongModes(moved.axis, amount);
    return moved;
  }

  LoadedWheel Draw(std::mt19937& random) const {
    std::normal_distribution<double> normal;
    const auto three = [&] {
      const double a = normal(random), b = normal(random), c = normal(random);
      return Eigen::Vector3d(a, b, c);
    };
    LoadedWheel drawn = Along(three());
    wheel_.AddNoise(drawn.loaded, kDepth_mm, kAcross_mm, random);
    wheel_.AddNoise(drawn.undeformed, kReferenceDepth_mm, kReferenceAcross_mm, random);
    const Eigen::Matrix3d turn =
        RotationFromVector(kAngle_rad * normal(random) * known_.axis.direction_in_rig());
    for (Eigen::Vector3d& p : drawn.undeformed.point_mm.values()) {
      p = turn * (p - known_.axis.origin_in_rig_mm()) + known_.axis.origin_in_rig_mm();
    }
    const Eigen::Vector3d axis = kAxis_rad * three();
    drawn.axis.rotation = drawn.axis.rotation * RotationFromVector({axis.x(), 0, axis.z()});
    drawn.axis.distance_mm += kAxis_mm * normal(random);
    const Eigen::Vector3d ground = kTurn_rad * three(), shift = kShift_mm * three();
    drawn.ground.frame_from_rig =
        Rigid3::FromRotationVector(ground, shift) * drawn.ground.frame_from_rig;
    return drawn;
  }

  WheelDeformation Measure(const LoadedWheel& wheel) const {
    return MeasureDeformation(wheel, wheel_.neighbours(), options_);
  }

 private:
  RollingWheel wheel_;
  int frame_;
  RollingWheel::True truth_;
  LoadedWheel known_;
  WheelDeformationOptions options_;
};

const Scene& Known(const std::string& name) {
  static std::map<std::string, Scene> scenes;
  return scenes.try_emplace(name, MakeScenario(name)).first->second;
}

TEST(WheelDeformation, IsThatOfTheTyre) {
  const Scene& scene = Known("tyre-flat");
  const WheelDeformation d = scene.Measure(scene.known());
  EXPECT_TRUE(d.problem.empty()) << d.problem;
  EXPECT_NEAR(d.loaded_radius_mm.value, 386, 1e-6);
  EXPECT_NEAR(d.deflection_mm.value, 18, 0.005);
  EXPECT_NEAR(d.radial_mm.value, 18, 0.02);
  EXPECT_LT(d.radial_at_mm.head<2>().norm(), 12);
  EXPECT_NEAR(d.longitudinal_mm.value, 0, 0.05);
  EXPECT_NEAR(d.lateral_mm.value, 0, 0.02);
  for (std::size_t i = 0; i < d.displacement_mm.point_mm.pixel_count(); ++i) {
    const Eigen::Vector3d truth =
        scene.truth().ground_mm.data()[i] - scene.truth().undeformed_mm.data()[i];
    if (!truth.allFinite()) continue;
    EXPECT_LT((d.displacement_mm.point_mm.data()[i] - truth).norm(), 1e-9);
  }
}

TEST(WheelDeformation, ShiftsSidewaysWithTheSlipAngle) {
  const Scene& scene = Known("tyre-cornering");
  const WheelDeformation d = scene.Measure(scene.known());
  const auto& ground = scene.truth().ground_mm;
  const auto& undeformed = scene.truth().undeformed_mm;
  // In the patch's centre, along the wheel's heading and to its left.
  const Eigen::Vector3d left = scene.state().axis;
  double nearest = 1e9, lateral = 0, longitudinal = 0;
  for (std::size_t i = 0; i < ground.pixel_count(); ++i) {
    const double far = ground.data()[i].head<2>().norm();
    if (!(far < nearest)) continue;
    nearest = far;
    const Eigen::Vector3d moved = ground.data()[i] - undeformed.data()[i];
    lateral = moved.dot(left);
    longitudinal = moved.dot(left.cross(Eigen::Vector3d::UnitZ()));
  }
  EXPECT_LT(lateral, -5);
  EXPECT_NEAR(d.lateral_centre_mm.value, lateral, 0.8);
  EXPECT_NEAR(d.longitudinal_centre_mm.value, longitudinal, 0.8);
  EXPECT_NEAR(d.deflection_mm.value, 18, 0.01);
}

constexpr std::array kResults = {&WheelDeformation::loaded_radius_mm,
                                 &WheelDeformation::deflection_mm,
                                 &WheelDeformation::longitudinal_mm,
                                 &WheelDeformation::lateral_mm,
                                 &WheelDeformation::longitudinal_centre_mm,
                                 &WheelDeformation::lateral_centre_mm,
                                 &WheelDeformation::radial_mm};

TEST(WheelDeformation, SigmasAreThoseOfSampling) {
  const Scene& scene = Known("tyre-flat");
  const WheelDeformation exact = scene.Measure(scene.known());
  std::mt19937 random(4);
  constexpr int kDraws = 200;
  std::array<double, kResults.size()> squares{};
  std::array<int, kResults.size()> covered{};
  double nees = 0, deformation = 0, deflection = 0;
  int points = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    const WheelDeformation d = scene.Measure(scene.Draw(random));
    for (std::size_t k = 0; k < kResults.size(); ++k) {
      const MeasuredScalar& got = d.*kResults[k];
      const double error = got.value - (exact.*kResults[k]).value;
      const double sigma = std::hypot(got.sigma_random, got.sigma_calibration());
      squares[k] += std::pow(error / sigma, 2) / kDraws;
      covered[k] += std::abs(error) < 1.96 * sigma ? 1 : 0;
    }
    deflection += std::pow(d.deflection_mm.value - 18, 2) / kDraws;
    for (std::size_t i = 3; i < d.displacement_mm.point_mm.pixel_count(); i += 37) {
      const Eigen::Vector3d error =
          d.displacement_mm.point_mm.data()[i] - exact.displacement_mm.point_mm.data()[i];
      if (!error.allFinite()) continue;
      Eigen::Matrix3d cov = CovarianceOf(d.displacement_mm.cov_random_mm2.data()[i]);
      for (const auto* along :
           {&d.displacement_mm.along_common_mm, &d.displacement_mm.along_modes_mm}) {
        for (const Image<Eigen::Vector3f>& image : *along) {
          const Eigen::Vector3d e = image.data()[i].cast<double>();
          cov += e * e.transpose();
        }
      }
      nees += error.dot(cov.ldlt().solve(error));
      deformation += error.squaredNorm();
      ++points;
    }
  }
  for (std::size_t k = 0; k < kResults.size(); ++k) {
    EXPECT_NEAR(squares[k], 1, 4 * std::sqrt(2.0 / kDraws)) << k;
    EXPECT_NEAR(covered[k] / static_cast<double>(kDraws), 0.95, 0.045) << k;
  }
  EXPECT_NEAR(nees / points, 3, 0.3);
  // With a point every 16 px; the noise is that of depth.
  EXPECT_LT(std::sqrt(deflection), 0.07);
  EXPECT_LT(std::sqrt(deformation / points), 0.15);
}

TEST(WheelDeformation, MovesAlongTheModesAsItSays) {
  const Scene& scene = Known("tyre-cornering");
  const WheelDeformation exact = scene.Measure(scene.known());
  for (Eigen::Index k = 0; k < static_cast<Eigen::Index>(testing::kFieldModes); ++k) {
    const WheelDeformation moved = scene.Measure(scene.Along(Eigen::Vector3d::Unit(k)));
    for (std::size_t n = 0; n < kResults.size(); ++n) {
      EXPECT_NEAR((moved.*kResults[n]).value - (exact.*kResults[n]).value,
                  (exact.*kResults[n]).along_modes[k], 2e-4)
          << k << ' ' << n;
    }
  }
}

TEST(WheelDeformation, SaysWhatIsOutOfView) {
  const Scene& scene = Known("tyre-flat");
  LoadedWheel hidden = scene.known();
  for (std::size_t i = 0; i < hidden.contact.pixel_count(); ++i) {
    hidden.contact.data()[i] = 0;
    if (std::abs(scene.truth().ground_mm.data()[i].y()) < 15) {
      hidden.loaded.point_mm.data()[i].setConstant(NAN);
    }
  }
  const WheelDeformation d = scene.Measure(hidden);
  EXPECT_TRUE(d.loaded_radius_mm.known());
  EXPECT_FALSE(d.deflection_mm.known());
  EXPECT_FALSE(d.lateral_mm.known());
  EXPECT_NE(d.problem.find("under the wheel's centre"), std::string::npos);
  EXPECT_NE(d.problem.find("no point is in contact"), std::string::npos);
  EXPECT_THROW((void)MeasureDeformation(hidden, scene.wheel().neighbours(), {.radius_mm = 0}),
               UsageError);
  hidden.contact = Image<std::uint8_t>({2, 2});
  EXPECT_THROW((void)MeasureDeformation(hidden, scene.wheel().neighbours()), std::invalid_argument);
}

// Table 5.1 of the thesis: the carcass over the nuts.
TEST(WheelDeformation, FindsTheNutsByThemselves) {
  struct Nut {
    int frame;
    double height_mm, way_mm;
  };
  for (const Nut& nut :
       {Nut{3, 23.1, 0}, Nut{9, 19.6, 160}, Nut{14, 13.6, 320}, Nut{20, 10, 480}}) {
    const Scene scene(MakeScenario("nuts"), nut.frame, 20);
    std::mt19937 random(static_cast<unsigned>(nut.frame));
    const LoadedWheel drawn = scene.Draw(random);
    const std::vector<Bump> bumps =
        FindBumps(InFrame(drawn.loaded, drawn.ground), scene.truth().thickness_mm,
                  scene.wheel().neighbours());
    ASSERT_EQ(bumps.size(), 1U) << nut.height_mm;
    const Bump& bump = bumps[0];
    const auto sigma = [](const MeasuredScalar& scalar) {
      return std::hypot(scalar.sigma_random, scalar.sigma_calibration());
    };
    EXPECT_NEAR(bump.clearance_mm.value, nut.height_mm, 0.02 + 2.5 * sigma(bump.clearance_mm));
    EXPECT_NEAR(bump.height_mm.value, nut.height_mm, 0.15 + 2.5 * sigma(bump.height_mm));
    EXPECT_NEAR(bump.at_mm.x(), nut.way_mm - scene.state().travel_mm, 4) << nut.height_mm;
    EXPECT_NEAR(bump.at_mm.y(), 0, 4);
    EXPECT_GT(bump.significance, 50);
  }
  const Scene& flat = Known("tyre-flat");
  std::mt19937 random(8);
  const LoadedWheel drawn = flat.Draw(random);
  EXPECT_TRUE(FindBumps(InFrame(drawn.loaded, drawn.ground), flat.truth().thickness_mm,
                        flat.wheel().neighbours(), {.least_height_mm = 0.6})
                  .empty());
}

// Two runs with the rig mounted otherwise.
TEST(WheelDeformation, ComparesRunsInTheGroundFrame) {
  Scenario turned = MakeScenario("tyre-flat");
  turned.motion.mounting_rad = {-0.03, 0.02, 0.01};
  const Scene &one = Known("tyre-flat"), other(turned);
  std::mt19937 random(6);
  const NeighbourCorrelation& neighbours = one.wheel().neighbours();
  const LoadedWheel a = one.Draw(random), b = other.Draw(random);
  const SurfacePoints now = InFrame(a.loaded, a.ground), before = InFrame(b.loaded, b.ground);
  const GroundGrid grid = GridAround(now, 7);
  const HeightDifference difference =
      CompareHeights(HeightsOf(now, grid, neighbours), HeightsOf(before, grid, neighbours), false);
  ASSERT_GT(difference.count, 300);
  EXPECT_LT(difference.rms_mm, 0.4);
  double squares = 0;
  int flat = 0;
  for (std::size_t i = 0; i < difference.value_mm.pixel_count(); ++i) {
    const Eigen::Vector2d at =
        grid.At(static_cast<int>(i) / grid.size.width, static_cast<int>(i) % grid.size.width);
    if (!std::isfinite(difference.value_mm.data()[i]) || at.norm() > 60) continue;
    const auto random_mm = static_cast<double>(difference.sigma_random_mm.data()[i]);
    const auto calibration_mm = static_cast<double>(difference.sigma_calibration_mm.data()[i]);
    squares += std::pow(difference.value_mm.data()[i] / std::hypot(random_mm, calibration_mm), 2);
    ++flat;
  }
  EXPECT_NEAR(squares / flat, 1, 0.6);  // errors in common do not average out
  // Cross-sections of both on the same plane.
  for (const CutPlane& plane : {CutPlane::AtX(0), CutPlane::AtY(0)}) {
    const auto line = CutSurface(before, plane, neighbours);
    int near = 0;
    for (const SectionPoint& p : line) {
      if (p.gap() || std::abs(p.along_mm) > 50) continue;
      EXPECT_NEAR(p.up_mm, 20, 4 * std::hypot(p.sigma_random_mm, p.sigma_calibration_mm));
      ++near;
    }
    EXPECT_GT(near, 10);
  }
}

}  // namespace
}  // namespace plumbline
