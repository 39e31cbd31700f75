#include "track/rolling_starts.h"

#include <gtest/gtest.h>

#include <memory>

#include "calib/median.h"
#include "tests/track/lifted_wheel.h"
#include "track/internal/surface_memory.h"
#include "track/internal/view_material.h"

namespace plumbline {
namespace {

using testing::kDegrees;
using testing::LiftedWheel;

// A part of the wheel, and the loaded tyre surveyed in three frames.
class RollingStarts : public ::testing::Test {
 protected:
  static constexpr int kFrames = 3;
  static constexpr double kFrame_s = 0.1;

  static void SetUpTestSuite() {
    LiftedWheel lifted(5, 6 * kDegrees);
    reference_ = new WheelReference(testing::ReferenceOf(lifted));
    Scenario loaded = LiftedWheel::ScenarioOf(kFrames, 5 * kDegrees);
    std::get<TyreOptions>(loaded.surface).lifted_mm = 0;
    rolling_ = new LiftedWheel(loaded);
    RollingSurveyOptions options;
    options.matching = Matching();
    RollingSurvey survey(*reference_, options);
    for (int f = 0; f < kFrames; ++f) {
      survey.Add(f, f * kFrame_s, rolling_->Pair(f).left, rolling_->Pair(f).right);
    }
    wheel_ = new RollingWheel(survey.Finish());
    ASSERT_EQ(wheel_->placed(), kFrames);
  }
  static void TearDownTestSuite() {
    delete reference_;
    delete rolling_;
    delete wheel_;
  }
  static StereoSequenceOptions Matching() {
    StereoSequenceOptions options;
    options.field.correlator.subset_px = 17;
    return options;
  }
  static std::unique_ptr<StereoSequence> Sequence(std::size_t view) {
    const WheelReferenceView& v = reference_->views[view];
    return std::make_unique<StereoSequence>(reference_->rig, v.left, v.right, Matching());
  }
  // How far starts are off what was found, in the median, and how much of it they cover.
  static void ExpectNear(const PlanarField& starts, const PlanarField& found, double most_px,
                         double least_share) {
    std::vector<double> off, strained;
    int all = 0;
    for (std::size_t i = 0; i < found.status.pixel_count(); ++i) {
      if (found.status.data()[i] != Status::kOk) continue;
      ++all;
      if (starts.status.data()[i] != Status::kOk) continue;
      off.push_back((starts.displacement_px.data()[i] - found.displacement_px.data()[i]).norm());
      strained.push_back(
          static_cast<double>((starts.gradient.data()[i] - found.gradient.data()[i]).norm()));
    }
    EXPECT_GE(static_cast<double>(off.size()), least_share * all);
    EXPECT_LT(Median(std::move(off)), most_px);
    EXPECT_LT(Median(std::move(strained)), 0.1);
  }

  static WheelReference* reference_;
  static LiftedWheel* rolling_;
  static RollingWheel* wheel_;
};

WheelReference* RollingStarts::reference_ = nullptr;
LiftedWheel* RollingStarts::rolling_ = nullptr;
RollingWheel* RollingStarts::wheel_ = nullptr;

TEST_F(RollingStarts, KnowTheRightImageOfAView) {
  const WheelReferenceView& view = reference_->views[1];
  const auto sequence = Sequence(1);
  const PlanarField& found = sequence->reference().right;
  const RightPlace place = RightPlaceOf(*reference_, view);
  PlanarField starts = found;
  for (int r = 0; r < found.size().height; ++r) {
    for (int c = 0; c < found.size().width; ++c) {
      const Eigen::Vector2d there = place(found.PixelOf(r, c));
      starts.status(r, c) = there.allFinite() ? Status::kOk : Status::kNotConverged;
      starts.displacement_px(r, c) = there - found.PixelOf(r, c);
      starts.gradient(r, c) = found.gradient(r, c);  // not told
    }
  }
  ExpectNear(starts, found, 0.2, 0.5);
  EXPECT_FALSE(place({-200, 100}).allFinite());
}

TEST_F(RollingStarts, LieWhereTheSurveyFoundItsPoints) {
  const RollingFrame& frame = wheel_->frames.back();
  const auto sequence = Sequence(frame.view);
  const StereoFrame& pair = rolling_->Pair(kFrames - 1);
  const StereoField found = sequence->Add(pair.left, pair.right, 0);
  const StereoField starts = StartsOf(*wheel_, kFrames - 1, sequence->reference().left);
  ExpectNear(starts.left, found.left, 0.01, 0.5);
  ExpectNear(starts.right, found.right, 0.01, 0.5);
  // Between the points of a coarser grid too.
  RollingWheel coarser = *wheel_;
  std::erase_if(coarser.frames.back().points,
                [](const RollingPoint& p) { return p.at.x() % 2 != 0 || p.at.y() % 2 != 0; });
  for (RollingPoint& p : coarser.frames.back().points) p.at /= 2;
  coarser.grid = {(coarser.grid.width + 1) / 2, (coarser.grid.height + 1) / 2};
  coarser.spacing_px *= 2;
  const StereoField between = StartsOf(coarser, kFrames - 1, sequence->reference().left);
  ExpectNear(between.left, found.left, 0.1, 0.5);
}

TEST_F(RollingStarts, AreForeseenFromTheFramesBefore) {
  internal::SurfaceMemory memory(*reference_);
  EXPECT_TRUE(memory.empty());
  memory.Take(wheel_->frames[0], 0);
  EXPECT_FALSE(memory.AngleAt(kFrame_s).has_value());
  memory.Take(wheel_->frames[1], kFrame_s);
  const RollingFrame& frame = wheel_->frames[2];
  const std::optional<double> angle = memory.AngleAt(2 * kFrame_s);
  ASSERT_TRUE(angle.has_value());
  EXPECT_NEAR(std::remainder(*angle - memory.angle_rad(), 2 * std::numbers::pi), 5 * kDegrees,
              0.02 * kDegrees);

  const auto sequence = Sequence(frame.view);
  const StereoFrame& pair = rolling_->Pair(2);
  const StereoField found = sequence->Add(pair.left, pair.right, 0);
  const StereoField& reference = sequence->reference();
  const Image<Eigen::Vector3d> material =
      internal::MaterialOf(*reference_, reference_->views[frame.view], reference).point_mm;
  const StereoField expected = memory.Expect(*angle, reference.left, material, 8);
  ExpectNear(expected.left, found.left, 0.3, 0.7);
  ExpectNear(expected.right, found.right, 0.3, 0.7);
  EXPECT_GT(internal::ShareFound(expected, found), 0.8);
  const StereoField left_alone{found.left, PlanarField(found.left.size(), {0, 0}, 8), {}, {}};
  EXPECT_EQ(internal::ShareFound(expected, left_alone), 0);
}

}  // namespace
}  // namespace plumbline
