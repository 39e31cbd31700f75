// Whether the patch's sigmas by the law of lift-off hold over tyres that differ.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <utility>
#include <vector>

#include "calib/median.h"
#include "io/virtual_rig/tyre_patch.h"
#include "tests/support/consistency.h"
#include "tests/support/tyre_frames.h"
#include "track/patch_series.h"

namespace plumbline {
namespace {

using testing::Consistency;
using testing::TyreFrame;

constexpr int kFrames = 4, kShared = 3;
constexpr double kNoise_mm = 0.02;

// Load, section, belt and the edge of the contact differ; a third is braked or driven, a third
// runs at a slip angle.
Scenario OneOf(std::mt19937& random) {
  const auto between = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  Scenario scenario = testing::TyreScenario("tyre-flat", {0.8, -1.5, 0.4});
  auto& tyre = std::get<TyreOptions>(scenario.surface);
  tyre.deflection_mm = between(12, 24);
  tyre.tread_lift = between(0.1, 0.3);
  tyre.contact_edge_mm = between(2.5, 5.5);
  TyreSection& section = tyre.section;
  section.crown_curvature = 1 / between(200, 450);
  section.shoulder_begin_mm = between(54, 72);
  section.shoulder_curvature = 1 / between(35, 70);
  section.blend_mm = between(16, 32);
  section.shoulder_thickness_mm = between(20, 23);
  const double slips = between(0, 3);
  if (slips < 1) tyre.slip_ratio = between(-0.05, 0.05);
  if (slips > 2) tyre.slip_angle_rad = between(-0.03, 0.03);
  return scenario;
}

PatchFrame FrameOf(TyreFrame frame) {
  PatchFrame result;
  result.rotation.found = true;
  result.rotation.from = RigRotationFrame::From::kPlane;
  result.rotation.pose = PoseOf(frame.Ground(), frame.axis);
  result.rotation.ground.frame_from_rig = frame.ground_from_rig;
  result.point_mm = std::move(frame.point_mm);
  result.undeformed_mm = std::move(frame.undeformed_mm);
  result.thickness_mm = std::move(frame.thickness_mm);
  result.cov_mm2 = std::move(frame.cov_mm2);
  return result;
}

// As a run has it: of its points, about along the ground's normal.
double SigmaOf(const PatchFrame& frame) {
  std::vector<double> sigmas;
  for (const Eigen::Matrix3d& cov : frame.cov_mm2.values()) {
    if (cov.allFinite()) sigmas.push_back(std::sqrt(cov(2, 2)));
  }
  return Median(std::move(sigmas));
}

struct Population {
  Consistency area, length, width;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), square = mean, most = mean;  // a share, mm, mm
  int tyres = 0, not_whole = 0;

  void Add(const FramePatch& record, const TyrePatch& truth) {
    const Eigen::Vector3d off(record.patch.area_mm2 - truth.area_mm2,
                              record.patch.length_mm - truth.length_mm,
                              record.patch.width_mm - truth.width_mm);
    area.Add(off[0], record.sigma_random[0]);
    length.Add(off[1], record.sigma_random[1]);
    width.Add(off[2], record.sigma_random[2]);
    const Eigen::Vector3d shown(off[0] / truth.area_mm2, off[1], off[2]);
    mean += shown;
    square += shown.cwiseAbs2();
    most = most.cwiseMax(shown.cwiseAbs());
  }
  void Print() const {
    const double n = area.count();
    const Eigen::Vector3d rms = (square / n).cwiseSqrt();
    std::printf(
        "%d tyres (%d more are not seen whole); mean, rms, most: area %.2f, %.2f, %.2f %%; length "
        "%.2f, %.2f, %.2f mm; width %.2f, %.2f, %.2f mm\n",
        tyres, not_whole, 100 * mean[0] / n, 100 * rms[0], 100 * most[0], mean[1] / n, rms[1],
        most[1], mean[2] / n, rms[2], most[2]);
    area.Print("area, mm2");
    length.Print("length, mm");
    width.Print("width, mm");
  }
};

Population Draw(int tyres, int step_px) {
  Population population;
  std::mt19937 random(11);
  PatchSeriesOptions options;
  options.correlation_area_points = kShared * kShared;
  while (population.tyres < tyres && population.not_whole < 2 * tyres) {
    const VirtualRig rig(OneOf(random));
    const TyreFrame frame = testing::TrueTyreFrame(rig, 0, step_px);
    const auto truth = FindPatch(*rig.tyre(), 0);
    std::vector<PatchFrame> frames;
    for (int f = 0; f < kFrames; ++f) {
      frames.push_back(FrameOf(testing::WithNoise(frame, kNoise_mm, kShared, random)));
    }
    options.sigma_mm = SigmaOf(frames.front());
    const auto neighbours =
        NeighbourCorrelation::OfOverlap(frame.point_mm.size(), 100, 100 * kShared + 1, 1);
    const PatchSeries series = FindPatches(frames, frame.axis, neighbours, options);
    bool whole = truth.has_value();
    for (const FramePatch& record : series.frames) {
      whole = whole && record.by == FramePatch::By::kLiftOff && record.patch.complete();
    }
    if (!whole) {
      ++population.not_whole;
      continue;
    }
    ++population.tyres;
    for (const FramePatch& record : series.frames) population.Add(record, *truth);
  }
  return population;
}

// Sigmas too small are a fault, and so are ones that are far too large; but what subsets make of
// the gap is in them, and these are true points.
constexpr double kLeastNees = 0.04;

TEST(PatchPopulation, SigmasHoldForTyresThatDiffer) {
  const Population population = Draw(12, 12);
  population.Print();
  EXPECT_EQ(population.tyres, 12);
  EXPECT_LT(population.most[0], 0.02);
  for (const Consistency* part : {&population.area, &population.length, &population.width}) {
    EXPECT_GT(part->coverage(), 0.85);
    EXPECT_LT(part->nees(), 2);
    EXPECT_GT(part->nees(), kLeastNees);
  }
}

TEST(PatchPopulation, ProveSigmasOver150Tyres) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  const Population population = Draw(150, 8);
  population.Print();
  EXPECT_EQ(population.tyres, 150);
  for (const Consistency* part : {&population.area, &population.length, &population.width}) {
    EXPECT_GT(part->coverage(), 0.93);
    EXPECT_GT(part->nees(), kLeastNees);
  }
}

}  // namespace
}  // namespace plumbline
