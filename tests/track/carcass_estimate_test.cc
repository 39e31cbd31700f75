#include "track/carcass_estimate.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <utility>

#include "calib/error.h"
#include "io/virtual_rig/tyre_patch.h"
#include "tests/support/consistency.h"
#include "tests/support/true_wheel.h"
#include "tests/support/tyre_frames.h"
#include "track/ground_observation.h"

namespace plumbline {
namespace {

using testing::Consistency;
using testing::TrueTyreFrame;
using testing::TyreFrame;
using testing::TyreScenario;
using testing::WithNoise;

constexpr double kDegrees = std::numbers::pi / 180;

// A run over flat ground from its points on: ground by the map, the map by the contact, patches.
class MappedRun {
 public:
  MappedRun(const char* scenario, int frames, int step_px, double noise_mm, int shared)
      : rig_(TyreScenario(scenario, {0.8, -1.5, 0.4})), noise_mm_(noise_mm), shared_(shared) {
    for (int f = 0; f < frames; ++f) truth_.push_back(TrueTyreFrame(rig_, f, step_px));
    options_.sigma_mm = noise_mm;
    options_.correlation_area_points = shared * shared;
  }

  const WheelAxis& axis() const { return truth_.front().axis; }
  const std::vector<TyreFrame>& truth() const { return truth_; }
  const PatchSeriesOptions& options() const { return options_; }
  TyrePatch Patch() const { return FindPatch(*rig_.tyre(), 0).value(); }
  NeighbourCorrelation Neighbours() const {
    return NeighbourCorrelation::OfOverlap(truth_.front().point_mm.size(), 100, 100 * shared_ + 1,
                                           1);
  }

  CarcassThickness TrueMap(double step_mm) const {
    return testing::TrueCarcass(rig_, axis(), step_mm);
  }
  CarcassThickness WrongMap(double step_mm, double error_mm, std::mt19937& random) const {
    CarcassThickness map = TrueMap(step_mm);
    std::normal_distribution<double> normal(0, error_mm);
    for (double& t : map.thickness_mm) t += normal(random);
    map.sigma_mm = error_mm;
    return map;
  }

  // Makes the carcass of the tyre that of a map: what touches lies higher or lower.
  void GiveCarcass(const CarcassThickness& map) {
    for (TyreFrame& frame : truth_) {
      const Eigen::Vector3d up = frame.ground_from_rig.rotation.row(2);
      for (std::size_t i = 0; i < frame.point_mm.pixel_count(); ++i) {
        const double y_mm = axis().direction_in_rig().dot(frame.undeformed_mm.data()[i]);
        const double lift = map.At(y_mm) - frame.thickness_mm.data()[i];
        frame.point_mm.data()[i] += lift * up;
        frame.undeformed_mm.data()[i] += lift * up;
      }
    }
  }

  void Draw(std::mt19937& random) {
    frames_.clear();
    for (const TyreFrame& frame : truth_) {
      frames_.push_back(WithNoise(frame, noise_mm_, shared_, random));
    }
  }

  // The frames in their ground as the map has it.
  std::vector<PatchFrame> Frames(const CarcassThickness& map) const {
    const std::vector<WheelAxis> axes(static_cast<std::size_t>(map.mode_count()), axis());
    GroundObservationOptions options;
    options.flat.correlation_area_points = options_.correlation_area_points;
    options.levels.correlation_area_points = options_.correlation_area_points;
    std::vector<PoseObservation> observed;
    std::vector<PatchFrame> result;
    for (const TyreFrame& frame : frames_) {
      PatchFrame& out = result.emplace_back();
      out.point_mm = frame.point_mm;
      out.undeformed_mm = frame.undeformed_mm;
      out.cov_mm2 = frame.cov_mm2;
      out.thickness_mm = ThicknessOver(map, frame.undeformed_mm, axis());
      for (int k = 0; k < map.mode_count(); ++k) {
        out.along_modes_mm.emplace_back(frame.point_mm.size(), Eigen::Vector3f::Zero());
        out.thickness_along_modes.push_back(
            ThicknessOver(map.AlongMode(k), frame.undeformed_mm, axis()));
      }
      observed.push_back(
          ObserveGround({.time_s = frame.time_s,
                         .point_mm = out.point_mm,
                         .cov_mm2 = out.cov_mm2,
                         .thickness_mm = out.thickness_mm,
                         .left_out_mm = ThicknessLeftOutOver(map, frame.undeformed_mm, axis()),
                         .sigma_mm = noise_mm_,
                         .along_modes_mm = out.along_modes_mm,
                         .thickness_along_modes = out.thickness_along_modes},
                        axis(), axes, Neighbours(), options)
              .pose);
    }
    const RigRotation rotation = SmoothRigRotation(observed, axis(), axes);
    for (std::size_t f = 0; f < result.size(); ++f) result[f].rotation = rotation.frames[f];
    return result;
  }

  PatchSeries Patches(const CarcassThickness& map) const {
    PatchSeriesOptions options = options_;
    options.carcass = map;
    return FindPatches(Frames(map), axis(), Neighbours(), options);
  }

 private:
  VirtualRig rig_;
  double noise_mm_;
  int shared_;
  std::vector<TyreFrame> truth_, frames_;
  PatchSeriesOptions options_;
};

FramePatch::Results SigmaOf(const FramePatch& record) {
  return (record.sigma_random.cwiseAbs2() + record.sigma_calibration.cwiseAbs2()).cwiseSqrt();
}

// Errors of area (a share), length and width.
Eigen::Vector3d Off(const FramePatch& record, const TyrePatch& truth) {
  return {record.patch.area_mm2 / truth.area_mm2 - 1, record.patch.length_mm - truth.length_mm,
          record.patch.width_mm - truth.width_mm};
}

TEST(CarcassEstimate, MakesThePatchRightUnderAMapThatIsOff) {
  MappedRun run("tyre-flat", 2, 12, 0.02, 2);
  const TyrePatch truth = run.Patch();
  std::mt19937 random(7);
  for (int draw = 0; draw < 2; ++draw) {
    run.Draw(random);
    const CarcassThickness said = run.WrongMap(10, 0.1, random);
    std::string why;
    const CarcassThickness found =
        EstimateCarcass(run.Frames(said), run.axis(), said, run.options(), &why);
    ASSERT_EQ(found.modes_mm.cols(), said.mode_count()) << why;
    EXPECT_EQ(found.said_mm, said.thickness_mm);
    for (const FramePatch& record : run.Patches(found).frames) {
      ASSERT_EQ(record.by, FramePatch::By::kLiftOff) << record.problem;
      const Eigen::Vector3d off = Off(record, truth);
      const FramePatch::Results sigma = SigmaOf(record);
      EXPECT_LT(std::abs(off[0]), 0.025);
      EXPECT_LT(sigma[0], 0.03 * truth.area_mm2);
      EXPECT_LT(std::abs(off[0]) * truth.area_mm2, 2 * sigma[0]);
      EXPECT_LT(std::abs(off[1]), 2 * sigma[1]);
      EXPECT_LT(std::abs(off[2]), 2 * sigma[2]);
    }
  }
}

// Of a tyre whose carcass is the curve of a map exactly; the prior's draws and the noise's.
TEST(CarcassEstimate, SigmasAreThoseOfSampling) {
  constexpr int kDraws = 12;
  MappedRun run("tyre-flat", 2, 12, 0.02, 2);
  const CarcassThickness truth = run.TrueMap(10);
  run.GiveCarcass(truth);
  const auto entries = static_cast<Eigen::Index>(truth.y_mm.size());
  const Eigen::Map<const Eigen::VectorXd> exact(truth.thickness_mm.data(), entries);
  std::mt19937 random(5);
  double nees = 0, before = 0;
  Consistency tilt;
  for (int draw = 0; draw < kDraws; ++draw) {
    run.Draw(random);
    const CarcassThickness said = run.WrongMap(10, 0.1, random);
    const auto frames = run.Frames(said);
    const CarcassThickness found = EstimateCarcass(frames, run.axis(), said, run.options());
    const Eigen::VectorXd off =
        Eigen::Map<const Eigen::VectorXd>(found.thickness_mm.data(), entries) - exact;
    nees += found.modes_mm.triangularView<Eigen::Lower>().solve(off).squaredNorm() /
            static_cast<double>(entries * kDraws);
    before += (exact - Eigen::Map<const Eigen::VectorXd>(said.thickness_mm.data(), entries))
                  .squaredNorm() /
              static_cast<double>(entries * kDraws);
    // The ground by the corrected map: its tilt is off as its slope is, which nothing tells.
    const PatchFrame frame = run.Frames(found).front();
    const double roll = PoseOf(run.truth().front().Ground(), run.axis())[1];
    tilt.Add(frame.rotation.pose[1] - roll,
             std::hypot(frame.rotation.sigma_random[1], frame.rotation.sigma_calibration[1]));
  }
  std::printf("NEES %.2f; the prior's %.2f\n", nees, before / 0.01);
  tilt.Print("tilt about x, rad");
  EXPECT_NEAR(nees, 1, 0.4);
  EXPECT_GT(tilt.sigma(), 0.01 * kDegrees);
  EXPECT_NEAR(tilt.nees(), 1, 4 * std::sqrt(2.0 / kDraws));
}

TEST(CarcassEstimate, SaysWhenTheContactContradictsTheMap) {
  MappedRun run("tyre-flat", 2, 12, 0.02, 2);
  std::mt19937 random(9);
  run.Draw(random);
  const auto check = [&](const CarcassThickness& map) {
    return CheckCarcass(run.Frames(map), run.axis(), map, run.options());
  };
  const CarcassCheck right = check(run.TrueMap(5));
  EXPECT_FALSE(right.contradicts) << right.chi_square << " of " << right.freedom;
  EXPECT_GT(right.freedom, 8);
  // One entry, off by 0.15 mm.
  CarcassThickness wrong = run.TrueMap(10);
  const std::size_t at = wrong.y_mm.size() / 2 + 2;
  wrong.thickness_mm[at] -= 0.15;
  CarcassCheck found = check(wrong);
  EXPECT_TRUE(found.contradicts);
  EXPECT_NEAR(found.at_y_mm, wrong.y_mm[at], 10);
  EXPECT_NEAR(found.most_mm, 0.12, 0.05);
  wrong.sigma_mm = 0.1;
  EXPECT_FALSE(check(wrong).contradicts);
  wrong.sigma_mm = 0.01;
  EXPECT_TRUE(check(wrong).contradicts);
  // 20 mm all over, where it is 0.3 mm more 60 mm from the middle.
  CarcassThickness bowed = run.TrueMap(5);
  for (std::size_t k = 0; k < bowed.y_mm.size(); ++k) {
    bowed.thickness_mm[k] = 20 + 0.3 * std::pow((bowed.y_mm[k] - bowed.y_mm[22]) / 60, 2);
  }
  run.GiveCarcass(bowed);
  run.Draw(random);
  found = check(CarcassThickness{{}, {20}});
  EXPECT_TRUE(found.contradicts);
  EXPECT_GT(std::abs(found.most_mm), 0.05);
  EXPECT_EQ(CheckCarcass({}, run.axis(), wrong, run.options()).freedom, -2);
}

TEST(CarcassEstimate, LeavesWhatItCannotTell) {
  MappedRun run("tyre-flat", 1, 16, 0.02, 1);
  std::mt19937 random(9);
  run.Draw(random);
  CarcassThickness map = run.TrueMap(10);
  auto frames = run.Frames(map);
  EXPECT_EQ(EstimateCarcass(frames, run.axis(), map, run.options()).modes_mm.size(), 0);
  map.sigma_mm = 0.1;
  frames[0].rotation.from = RigRotationFrame::From::kObstacle;
  std::string why;
  const CarcassThickness same = EstimateCarcass(frames, run.axis(), map, run.options(), &why);
  EXPECT_EQ(same.thickness_mm, map.thickness_mm);
  EXPECT_EQ(same.modes_mm.size(), 0);
  EXPECT_FALSE(why.empty());
  const CarcassThickness one{{}, {20}, 0.1};
  EXPECT_EQ(EstimateCarcass(frames, run.axis(), one, run.options()).thickness_mm[0], 20);
}

// What docs/rolling_tyre.md says of a map that is off by 0.1 mm.
TEST(CarcassEstimate, ProveThePatchUnderMapsThatAreOff) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  for (const char* name : {"tyre-flat", "tyre-braking"}) {
    MappedRun run(name, 4, 8, 0.02, 3);
    const TyrePatch truth = run.Patch();
    std::mt19937 random(7);
    std::array<Consistency, 3> parts;
    Consistency tilt;
    Eigen::Vector3d worst = Eigen::Vector3d::Zero();
    for (int draw = 0; draw < 24; ++draw) {
      run.Draw(random);
      const CarcassThickness said = run.WrongMap(10, 0.1, random);
      const CarcassThickness found =
          EstimateCarcass(run.Frames(said), run.axis(), said, run.options());
      const auto frames = run.Frames(found);
      const PatchSeries series = run.Patches(found);
      for (std::size_t f = 0; f < frames.size(); ++f) {
        const FramePatch& record = series.frames[f];
        ASSERT_EQ(record.by, FramePatch::By::kLiftOff) << record.problem;
        Eigen::Vector3d off = Off(record, truth);
        worst = worst.cwiseMax(off.cwiseAbs());
        off[0] *= truth.area_mm2;
        for (int k = 0; k < 3; ++k) {
          parts[static_cast<std::size_t>(k)].Add(off[k], SigmaOf(record)[k]);
        }
        const RigRotationFrame& r = frames[f].rotation;
        tilt.Add(r.pose[1] - PoseOf(run.truth()[f].Ground(), run.axis())[1],
                 std::hypot(r.sigma_random[1], r.sigma_calibration[1]));
      }
    }
    std::printf("%s: at most %.2f %%, %.2f mm, %.2f mm off\n", name, 100 * worst[0], worst[1],
                worst[2]);
    parts[0].Print("area, mm2");
    parts[1].Print("length, mm");
    parts[2].Print("width, mm");
    tilt.Print("tilt about x, rad");
    EXPECT_LT(worst[0], 0.02);
    for (const Consistency& part : parts) EXPECT_GT(part.coverage(), 0.9);
  }
}

}  // namespace
}  // namespace plumbline
