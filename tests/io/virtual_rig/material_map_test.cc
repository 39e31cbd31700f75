#include "io/virtual_rig/internal/material_map.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "io/virtual_rig/virtual_rig.h"

namespace plumbline {
namespace {

using internal::MaterialMap;

// Interpolated places against exact looks: in pixels, and the light in shares of it.
void ExpectExactEverywhere(const std::string& name, int frame) {
  const VirtualRig rig(MakeScenario(name));
  const Scenario& s = rig.scenario();
  const double time_s = rig.FrameTime(frame);
  const auto opening = rig.surface().At(time_s), closing = rig.surface().At(time_s + 1e-4);
  const SurfaceView first(s.rig.left, rig.GroundFromRig(time_s).Inverse(), *opening);
  const SurfaceView second =
      SurfaceView::WithoutDepth(s.rig.left, rig.GroundFromRig(time_s + 1e-4).Inverse(), *closing);
  const Light lamps = MakeLight(s.lighting, s.rig.left, rig.GroundFromRig(time_s), 1);
  const MaterialMap::Light light = [&](const SeenPoint& seen, const Eigen::Vector2d& pixel) {
    return lamps(seen.surface.position_mm, seen.surface.Normal(), pixel);
  };
  const MaterialMap map(first, second, light, 2);
  // Nearly everywhere; beside the specimen there is nothing to interpolate.
  EXPECT_GT(map.InterpolatedShare(), rig.tyre() != nullptr ? 0.97 : 0.6) << name;
  std::mt19937 random(3);
  std::uniform_real_distribution<double> x(0, s.rig.left.size().width - 1),
      y(0, s.rig.left.size().height - 1);
  double squares = 0, largest_light = 0;
  int count = 0, off = 0;
  for (int k = 0; k < 6000; ++k) {
    const Eigen::Vector2d pixel(x(random), y(random));
    MaterialMap::Sample sample;
    map.EvaluateRow(pixel.y(), pixel.x(), 1, {&sample, 1});
    const auto seen = first.Look(pixel);
    ASSERT_EQ(seen.has_value(), !std::isnan(sample[0])) << name << " " << pixel.transpose();
    if (!seen) continue;
    // What the interpolated material point would look like, in pixels off.
    const Eigen::Vector2d error_px =
        first.Project(opening->At(sample.head<2>().matrix()).position_mm) - pixel;
    squares += error_px.squaredNorm();
    off += error_px.norm() > 1e-3;
    ++count;
    largest_light = std::max(largest_light, std::abs(sample[4] - light(*seen, pixel)));
    if (const auto later = second.Follow(*seen)) {
      const Eigen::Vector2d there =
          second.Project(closing->At(sample.segment<2>(2).matrix()).position_mm);
      off += (there - pixel).norm() > 1e-3;
    }
  }
  EXPECT_GT(count, 2000) << name;
  EXPECT_LT(std::sqrt(squares / count), 1e-4) << name;
  EXPECT_LT(off, count / 500) << name;
  EXPECT_LT(largest_light, 2e-3) << name;
}

TEST(MaterialMap, AgreesWithExactLooksBetweenItsNodes) {
  for (const char* name : {"tyre-flat", "cleat-lateral-square38", "cleat-diagonal-square50", "nuts",
                           "incline", "cylinder", "star"}) {
    ExpectExactEverywhere(name, 1);
  }
}

}  // namespace
}  // namespace plumbline
