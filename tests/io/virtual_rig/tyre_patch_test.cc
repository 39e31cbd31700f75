#include "io/virtual_rig/tyre_patch.h"

#include <gtest/gtest.h>

#include <cmath>

#include "io/virtual_rig/scenario.h"

namespace plumbline {
namespace {

TyreSurface Flat() { return TyreSurface{TyreOptions{}}; }

// Counting cells of a fine grid in the ground plane, each with its own share of the area.
double AreaByCounting(const TyreSurface& tyre, double time_s, double step) {
  const auto now = tyre.At(time_s);
  const auto contact = tyre.Contact(time_s);
  const double bottom = tyre.Wheel(time_s).angle_rad * tyre.options().section.crown_radius_mm;
  double area = 0;
  for (double u = bottom - 340 + step / 2; u < bottom + 340; u += step) {
    for (double v = -210 + step / 2; v < 210; v += step) {
      if (contact->Level({u, v}) > 0) continue;
      const auto& J = now->At({u, v}).d_position_d_material;
      area += step * step * std::abs(J(0, 0) * J(1, 1) - J(0, 1) * J(1, 0));
    }
  }
  return area;
}

TEST(TyrePatch, AgreesWithCountingCells) {
  TyreOptions slipping;
  slipping.slip_angle_rad = 0.05;
  for (const TyreOptions& options : {TyreOptions{}, slipping}) {
    const TyreSurface tyre(options);
    const auto patch = FindPatch(tyre, 0);
    ASSERT_TRUE(patch);
    EXPECT_NEAR(patch->area_mm2 / AreaByCounting(tyre, 0, 0.5), 1, 1e-3);
  }
}

TEST(TyrePatch, IsFoundWholeOverEveryObstacle) {
  for (const ScenarioEntry& entry : ListScenarios()) {
    if (entry.name.rfind("cleat", 0) != 0 && entry.name != "nuts") continue;
    const Scenario scenario = MakeScenario(entry.name);
    const TyreSurface tyre(std::get<TyreOptions>(scenario.surface));
    for (const double time_s : {-0.04, 0.0, 0.05, 0.11, 0.2}) {
      const auto patch = FindPatch(tyre, time_s);
      ASSERT_TRUE(patch) << entry.name << " " << time_s;
      const double counted = AreaByCounting(tyre, time_s, 1);
      // Cells are counted whole: along a bar's edge by up to half a cell's width.
      EXPECT_NEAR(patch->area_mm2, counted, 0.005 * counted + 130) << entry.name << " " << time_s;
      EXPECT_LT(patch->contours_mm.size(), 24U) << entry.name << " " << time_s;
    }
  }
}

TEST(TyrePatch, ConvergesWithItsSpacing) {
  const TyreSurface tyre = Flat();
  const auto coarse = FindPatch(tyre, 0, 0, 2), normal = FindPatch(tyre, 0, 0, 1),
             fine = FindPatch(tyre, 0, 0, 0.25);
  ASSERT_TRUE(coarse && normal && fine);
  EXPECT_LT(std::abs(normal->area_mm2 - fine->area_mm2), 3e-5 * fine->area_mm2);
  EXPECT_LT(std::abs(coarse->length_mm - fine->length_mm), 0.02);
  EXPECT_LT(std::abs(coarse->width_mm - fine->width_mm), 0.02);
}

TEST(TyrePatch, IsAnOvalOnFlatGroundAboutTheAxis) {
  const auto patch = FindPatch(Flat(), 0);
  ASSERT_TRUE(patch);
  EXPECT_EQ(patch->contours_mm.size(), 1U);
  EXPECT_LT(patch->centroid_mm.norm(), 0.1);
  // Between an ellipse and a rectangle.
  const double box = patch->length_mm * patch->width_mm;
  EXPECT_GT(patch->area_mm2, 0.75 * box);
  EXPECT_LT(patch->area_mm2, 0.95 * box);
}

TEST(TyrePatch, GrowsWithTheThreshold) {
  const TyreSurface tyre = Flat();
  double last = FindPatch(tyre, 0)->area_mm2;
  for (const double threshold_mm : {0.05, 0.2, 0.5, 1.0}) {
    const double area = FindPatch(tyre, 0, threshold_mm)->area_mm2;
    EXPECT_GT(area, last);
    last = area;
  }
}

TEST(TyrePatch, LeavesOutWhereTheTyreHangsBesideABar) {
  TyreOptions options;
  options.obstacles = {{Obstacle::Section::kSquare, 38, 0, {0, 0}, 0}};
  options.start_travel_mm = -110;
  const TyreSurface tyre(options);
  const auto patch = FindPatch(tyre, 0);
  ASSERT_TRUE(patch);
  EXPECT_EQ(patch->contours_mm.size(), 2U);  // on the flat ground, and on the bar ahead
}

TEST(TyrePatch, IsNotThereWhereTheWheelIsLifted) {
  TyreOptions options;
  options.lifted_mm = 30;
  EXPECT_FALSE(FindPatch(TyreSurface(options), 0));
}

}  // namespace
}  // namespace plumbline
