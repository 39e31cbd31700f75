#include "io/virtual_rig/tyre_surface.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>

#include "calib/error.h"
#include "io/virtual_rig/scenario.h"
#include "tests/io/virtual_rig/surface_checks.h"

namespace plumbline {
namespace {

constexpr double kPi = std::numbers::pi;

// All tyre scenarios of the list.
std::vector<Scenario> TyreScenarios() {
  std::vector<Scenario> scenarios;
  for (const ScenarioEntry& entry : ListScenarios()) {
    Scenario scenario = MakeScenario(entry.name);
    if (scenario.HasTyre()) scenarios.push_back(std::move(scenario));
  }
  return scenarios;
}

TyreOptions Slipping() {
  TyreOptions options;
  options.slip_ratio = -0.03;
  options.slip_angle_rad = 0.05;
  options.speed_swing_mm_s = 300;
  return options;
}

// A random material point within 0.6 rad of the bottom.
Eigen::Vector2d NearTheBottom(const TyreSurface& tyre, double time_s, std::mt19937& random) {
  std::uniform_real_distribution<double> angle(-0.6, 0.6), along(-200, 200);
  const double radius = tyre.options().section.crown_radius_mm;
  return {radius * (tyre.Wheel(time_s).angle_rad + angle(random)), along(random)};
}

TEST(TyreSurface, TangentsAndVelocityAreDerivativesOfPosition) {
  std::mt19937 random(1);
  for (const Scenario& scenario : TyreScenarios()) {
    const TyreSurface tyre(std::get<TyreOptions>(scenario.surface));
    for (int k = 0; k < 60; ++k) {
      const double time_s = 0.004 * k;
      const Eigen::Vector2d m = NearTheBottom(tyre, time_s, random);
      EXPECT_LT(testing::LargestDerivativeError(tyre, m, time_s), 2e-6)
          << scenario.name << " " << m.transpose();
    }
  }
}

TEST(TyreSurface, StrainOfPositionsConvergesToTheStatedStrainAtSecondOrder) {
  std::mt19937 random(2);
  for (const Scenario& scenario : TyreScenarios()) {
    if (scenario.name == "tyre-lifted") continue;  // no strain at all
    const TyreSurface tyre(std::get<TyreOptions>(scenario.surface));
    const double time_s = 0.11;
    const auto now = tyre.At(time_s), reference = tyre.Reference(time_s);
    double coarse = 0, fine = 0;
    for (int k = 0; k < 200; ++k) {
      const Eigen::Vector2d m = NearTheBottom(tyre, time_s, random);
      const Eigen::Vector3d exact = GreenLagrangeStrain(reference->At(m), now->At(m));
      const auto error = [&](double h) {
        return (testing::StrainByDifferences(*reference, *now, m, h) - exact).squaredNorm();
      };
      coarse += error(0.2);
      fine += error(0.1);
    }
    // Half the step, a quarter of the error.
    std::printf("%s: error %.2g at 0.1 mm, %.3f times that at 0.2 mm\n", scenario.name.c_str(),
                std::sqrt(fine / 200), std::sqrt(coarse / fine));
    EXPECT_NEAR(std::sqrt(coarse / fine), 4, 0.25) << scenario.name;
    EXPECT_LT(std::sqrt(fine / 200), 1e-4) << scenario.name;
  }
}

TEST(TyreSurface, NeverPassesThroughTheGround) {
  for (const Scenario& scenario : TyreScenarios()) {
    const TyreSurface tyre(std::get<TyreOptions>(scenario.surface));
    for (double time_s = 0; time_s < 0.3; time_s += 0.02) {
      const auto now = tyre.At(time_s);
      const auto contact = tyre.Contact(time_s);
      const MaterialDomain window = now->Window();
      double lowest = 1e9;
      for (double u = window.u_min; u <= window.u_max; u += 4) {
        for (double v = window.v_min; v <= window.v_max; v += 4) {
          // The carcass lies between the inner surface and the ground.
          lowest = std::min(lowest,
                            contact ? contact->Gap({u, v})
                                    : now->At({u, v}).position_mm.z() - tyre.CarcassThickness(v));
        }
      }
      EXPECT_GE(lowest, -1e-9) << scenario.name << " at " << time_s << " s";
      EXPECT_EQ(lowest < 1e-9, contact != nullptr) << scenario.name;  // it does touch it
    }
  }
}

TEST(TyreSurface, GapIsTheHeightAboveTheGround) {
  TyreOptions options;
  options.obstacles = {{Obstacle::Section::kNut, 30, 19.6, {40, 5}, 0.2}};
  const TyreSurface tyre(options);
  const auto contact = tyre.Contact(0.01);
  for (double u = -90; u < 120; u += 7) {
    const Eigen::Vector2d m(u, 0.3 * u);
    const Eigen::Vector3d p = tyre.At(0.01)->At(m).position_mm;
    EXPECT_NEAR(contact->Gap(m),
                p.z() - tyre.GroundHeight(p.head<2>(), 0.01) - tyre.CarcassThickness(m.y()), 1e-9);
  }
}

TEST(TyreSurface, DeflectsByEighteenMillimetresOnFlatGround) {
  const TyreSurface tyre{TyreOptions{}};
  const SurfacePoint loaded = tyre.At(0)->At({0, 0}), unloaded = tyre.Reference(0)->At({0, 0});
  EXPECT_NEAR(loaded.position_mm.z() - unloaded.position_mm.z(), 18, 1e-9);
  EXPECT_NEAR(loaded.position_mm.z(), tyre.CarcassThickness(0), 1e-9);
  EXPECT_NEAR(tyre.Wheel(0).centre_height_mm, 404 - 18, 1e-9);
  // The patch is flat: the carcass's thickness above the ground.
  for (const double u : {-60.0, -20.0, 30.0, 70.0}) {
    for (const double v : {-40.0, 0.0, 40.0}) {
      EXPECT_NEAR(tyre.At(0)->At({u, v}).position_mm.z(), tyre.CarcassThickness(v), 1e-9);
    }
  }
}

TEST(TyreSurface, TheLiftedWheelIsTheUndeformedSurface) {
  TyreOptions options;
  options.lifted_mm = 50;
  const TyreSurface tyre(options);
  for (const double u : {-200.0, 0.0, 150.0}) {
    for (const double v : {-180.0, 0.0, 90.0}) {
      const SurfacePoint a = tyre.At(0.2)->At({u, v}), b = tyre.Reference(0.2)->At({u, v});
      EXPECT_EQ(a.position_mm, b.position_mm);
      EXPECT_EQ(GreenLagrangeStrain(b, a).norm(), GreenLagrangeStrain(b, b).norm());
    }
  }
  EXPECT_EQ(tyre.Contact(0.2), nullptr);
}

TEST(TyreSurface, OneTurnBringsTheMaterialBack) {
  for (TyreOptions options : {TyreOptions{}, Slipping()}) {
    options.speed_swing_mm_s = 0;
    const TyreSurface tyre(options);
    const double turn_s = 2 * kPi / tyre.Wheel(0).angular_speed_rad_s;
    for (int k = 0; k < 200; ++k) {
      const Eigen::Vector2d m(2412.0 * k / 200, -200 + 2.0 * k);
      const Eigen::Vector3d before = tyre.At(0.1)->At(m).position_mm;
      EXPECT_LT((tyre.At(0.1 + turn_s)->At(m).position_mm - before).norm(), 1e-9);
      // u and u + period are the same material.
      const Eigen::Vector2d period(tyre.Domain().period_u, 0);
      EXPECT_LT((tyre.At(0.1)->At(m + period).position_mm - before).norm(), 1e-9);
    }
  }
}

// Material points of the stick zone stand still on the ground, so that their distances are kept as
// they travel through it; along the way they are the travel a radian apart.
TEST(TyreSurface, KeepsArcLengthInTheStickZone) {
  for (const TyreOptions& options : {TyreOptions{}, Slipping()}) {
    const TyreSurface tyre(options);
    const double radius = options.section.crown_radius_mm;
    const double per_rad = tyre.Wheel(0).speed_mm_s / tyre.Wheel(0).angular_speed_rad_s;
    for (const double v : {-60.0, 0.0, 40.0}) {
      const Eigen::Vector2d a(20, v), b(50, v);
      double first = 0;
      for (double time_s = -0.005; time_s <= 0.02; time_s += 0.0025) {
        const auto now = tyre.At(time_s);
        const auto contact = tyre.Contact(time_s);
        ASSERT_LE(contact->Level(a), 0) << time_s;
        ASSERT_LE(contact->Level(b), 0) << time_s;
        for (const Eigen::Vector2d& m : {a, b}) {
          const Eigen::Vector3d speed =
              now->Velocity(m) + tyre.Wheel(time_s).speed_mm_s * Eigen::Vector3d::UnitX();
          EXPECT_LT(speed.norm(), 1e-7) << time_s;
        }
        const double apart = (now->At(a).position_mm - now->At(b).position_mm).norm();
        if (first == 0) first = apart;
        EXPECT_NEAR(apart, first, 1e-9);
      }
      EXPECT_NEAR(first, per_rad * 30 / radius, 1e-9);
    }
  }
}

TEST(TyreSurface, SlidesAtTheTrailingEdgeOnly) {
  const TyreSurface tyre(Slipping());
  const auto now = tyre.At(0);
  const auto contact = tyre.Contact(0);
  const auto slide = [&](double u) {
    EXPECT_LE(contact->Level({u, 0}), 0) << u;
    return (now->Velocity({u, 0}) + tyre.Wheel(0).speed_mm_s * Eigen::Vector3d::UnitX()).norm();
  };
  EXPECT_LT(slide(40), 1e-7);
  EXPECT_LT(slide(0), 1e-7);
  EXPECT_GT(slide(-75), 20);  // mm/s
}

// Displacement of a material point against the unloaded wheel, in the axes of the wheel.
Eigen::Vector3d InWheelAxes(const TyreSurface& tyre, const Eigen::Vector2d& m) {
  const Eigen::Vector3d moved =
      tyre.At(0)->At(m).position_mm - tyre.Reference(0)->At(m).position_mm;
  const Eigen::Vector3d axis = tyre.Wheel(0).axis;
  const Eigen::Vector3d ahead = axis.cross(Eigen::Vector3d::UnitZ());
  return {moved.dot(ahead), moved.dot(axis), moved.z()};
}

// Sliding to its left, the tread is dragged to the right of the wheel: more and more from the
// leading edge on, as far as it sticks. The beads stay on the rim.
TEST(TyreSurface, DeformsSidewaysUnderASlipAngle) {
  TyreOptions options;
  options.slip_angle_rad = 0.05;
  const TyreSurface tyre(options);
  options.slip_angle_rad = -0.05;
  const TyreSurface mirrored(options);
  const auto contact = tyre.Contact(0);
  double last = 0;
  for (double u = 70; u >= -20; u -= 10) {
    ASSERT_LE(contact->Level({u, 0}), 0);
    const double shift = InWheelAxes(tyre, {u, 0}).y();
    EXPECT_LT(shift, last) << u;
    last = shift;
  }
  EXPECT_LT(last, -5);
  EXPECT_GT(last, -20);
  for (const double u : {-150.0, 0.0, 60.0, 170.0}) {
    EXPECT_NEAR(InWheelAxes(tyre, {u, 215}).norm(), 0, 1e-9) << u;
    for (const double v : {-120.0, -30.0, 0.0, 80.0}) {
      const Eigen::Vector3d one = InWheelAxes(tyre, {u, v}), other = InWheelAxes(mirrored, {u, -v});
      EXPECT_LT((one - Eigen::Vector3d(other.x(), -other.y(), other.z())).norm(), 1e-9) << u;
    }
  }
}

TEST(TyreSurface, SidewallsBulgeBesideThePatchOnly) {
  const TyreSurface tyre{TyreOptions{}};
  for (const double side : {-1.0, 1.0}) {
    EXPECT_NEAR(side * InWheelAxes(tyre, {0, side * 150}).y(), 3.6, 1e-9);
    EXPECT_NEAR(InWheelAxes(tyre, {0, side * 215}).norm(), 0, 1e-9);
    EXPECT_NEAR(InWheelAxes(tyre, {1.3 * 384, side * 150}).norm(), 0, 1e-9);
  }
}

// A bar shorter than the patch: the tyre stands on it, and comes down beside it over the length
// that its carcass asks for, hanging free.
TEST(TyreSurface, EnvelopsAShortObstacle) {
  for (const double bending_length_mm : {15.0, 30.0, 45.0}) {
    TyreOptions options;
    options.bending_length_mm = bending_length_mm;
    options.obstacles = {{Obstacle::Section::kSquare, 38, 0, {0, 0}, 0}};
    const TyreSurface tyre(options);
    const auto now = tyre.At(0);
    const auto contact = tyre.Contact(0);
    EXPECT_NEAR(now->At({0, 0}).position_mm.z(), 38 + tyre.CarcassThickness(0), 1e-9);
    // The material half way down, as far from the bar's edge as half of 2 sqrt(height * length).
    const double half_way_mm = 19 + std::sqrt(38 * bending_length_mm);
    double near = 0, far = 150;
    while (far - near > 1e-9) {
      const double u = (near + far) / 2;
      (now->At({u, 0}).position_mm.x() < half_way_mm ? near : far) = u;
    }
    EXPECT_NEAR(now->At({near, 0}).position_mm.z() - tyre.CarcassThickness(0), 19, 0.01)
        << bending_length_mm;
    EXPECT_NEAR(contact->Gap({near, 0}), 19, 0.01) << bending_length_mm;
    EXPECT_GT(contact->Level({near, 0}), 0) << bending_length_mm;
  }
}

TEST(TyreSurface, TravelAndAngleAreTiedBySlip) {
  TyreOptions options = Slipping();
  const TyreSurface tyre(options);
  for (const double time_s : {0.0, 0.3, 1.7}) {
    const WheelState wheel = tyre.Wheel(time_s);
    // ISO 8855: (omega - omega_0) / omega_0, omega_0 that of free rolling at the same speed along
    // the wheel's heading.
    const double free_rad_s =
        wheel.speed_mm_s * std::cos(options.slip_angle_rad) / options.free_rolling_radius_mm;
    EXPECT_NEAR(wheel.angular_speed_rad_s / free_rad_s - 1, options.slip_ratio, 1e-12);
    EXPECT_NEAR(wheel.axis.dot(Eigen::Vector3d(std::cos(options.slip_angle_rad),
                                               -std::sin(options.slip_angle_rad), 0)),
                0, 1e-12);
  }
}

// Beyond what a carcass could bear, the pictures would look like nothing that rolls.
TEST(TyreSurface, StrainsStayPlausible) {
  for (const Scenario& scenario : TyreScenarios()) {
    const TyreSurface tyre(std::get<TyreOptions>(scenario.surface));
    double largest = 0;
    for (double time_s = 0; time_s < 0.25; time_s += 0.02) {
      const auto now = tyre.At(time_s), reference = tyre.Reference(time_s);
      const double bottom = tyre.Wheel(time_s).angle_rad * tyre.options().section.crown_radius_mm;
      for (double u = bottom - 180; u <= bottom + 180; u += 6) {
        for (double v = -100; v <= 100; v += 6) {
          largest = std::max(
              largest,
              GreenLagrangeStrain(reference->At({u, v}), now->At({u, v})).cwiseAbs().maxCoeff());
        }
      }
    }
    std::printf("%s: largest strain %.3f\n", scenario.name.c_str(), largest);
    EXPECT_LT(largest, 0.33) << scenario.name;
    EXPECT_TRUE(scenario.name == "tyre-lifted" || largest > 0.01) << scenario.name;
  }
}

TEST(TyreSurface, RefusesWhatItCannotBe) {
  const auto refused = [](auto change) {
    TyreOptions options;
    change(options);
    EXPECT_THROW(TyreSurface{options}, UsageError);
  };
  refused([](TyreOptions& o) { o.deflection_mm = 0; });
  refused([](TyreOptions& o) { o.slip_angle_rad = 1; });
  refused([](TyreOptions& o) { o.free_rolling_radius_mm = 100; });
  refused([](TyreOptions& o) {
    o.obstacles = {{Obstacle::Section::kSquare, 38, 0, {0, 0}, 0},
                   {Obstacle::Section::kSquare, 38, 0, {60, 0}, 0}};
  });
  refused([](TyreOptions& o) { o.obstacles = {{Obstacle::Section::kNut, 30, 0, {0, 0}, 0}}; });
}

}  // namespace
}  // namespace plumbline
