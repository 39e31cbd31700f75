#include "match/stereo_sequence.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "calib/error.h"
#include "tests/support/rendered_surface.h"

namespace plumbline {
namespace {

using testing::ConvergentRig;
using testing::SpeckledSheet;

constexpr ImageSize kSize{360, 280};
constexpr double kNoiseGrey = 1.5;

StereoRig Rig() { return ConvergentRig(kSize, 1500, 400, 110); }

// The sheet at an instant: it moves, turns and stretches.
SpeckledSheet SheetAt(int frame, double radius_mm = 0) {
  SpeckledSheet sheet;
  const double t = frame;
  sheet.rig_from_sheet =
      Rigid3::FromRotationVector({0.05, -0.1, 0.1 + 0.01 * t}, {0.3 * t, -0.2 * t, 400 + 0.5 * t});
  sheet.stretch << 1 + 0.01 * t, 0.002 * t, 0, 1 - 0.004 * t;
  sheet.radius_mm = radius_mm;
  return sheet;
}

StereoSequenceOptions Options(StereoStrategy strategy) {
  StereoSequenceOptions options;
  options.strategy = strategy;
  options.field.correlator.subset_px = 29;
  options.field.step_px = 12;
  options.field.correlator.noise = NoiseModel{kNoiseGrey * kNoiseGrey, 0};
  return options;
}

struct Errors {
  int points = 0, ok = 0, outside = 0;  // outside: off by more than 5 sigma and 0.03 px
  double left = 0, right = 0;           // squares of errors in sigmas
  double PerDimension() const { return (left + right) / (4.0 * ok); }
  double Right() const { return right / (2.0 * ok); }
};

Errors Compare(const StereoRig& rig, const SpeckledSheet& first, const SpeckledSheet& now,
               const StereoField& field) {
  Errors errors;
  for (int r = 0; r < field.left.size().height; ++r) {
    for (int c = 0; c < field.left.size().width; ++c) {
      ++errors.points;
      if (field.left.status(r, c) != Status::kOk || field.right.status(r, c) != Status::kOk) {
        continue;
      }
      ++errors.ok;
      const Eigen::Vector2d pixel = field.left.PixelOf(r, c);
      const Eigen::Vector3d point = now.PointInRig(first.MaterialAt(rig, pixel));
      const auto check = [&](const PlanarField& match, const Eigen::Vector2d& truth,
                             double& squares) {
        const Eigen::Vector2d off = pixel + match.displacement_px(r, c) - truth;
        const Eigen::Matrix2d cov = CovarianceOf(match.cov_displacement_px2(r, c));
        if (cov.trace() > 0) squares += off.dot(cov.ldlt().solve(off));
        const double sigma = std::sqrt(cov.trace());
        if (off.norm() > 5 * sigma && off.norm() > 0.03) ++errors.outside;
      };
      check(field.left, rig.left.Project(point), errors.left);
      check(field.right, rig.right.Project(rig.right_from_left * point), errors.right);
    }
  }
  return errors;
}

class StereoSequenceOf : public ::testing::TestWithParam<StereoStrategy> {};

TEST_P(StereoSequenceOf, FollowsMaterialPointsInBothImages) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = SheetAt(0);
  StereoSequence sequence(rig, first.Left(rig, kNoiseGrey, 1), first.Right(rig, kNoiseGrey, 2),
                          Options(GetParam()));
  for (int frame = 1; frame <= 3; ++frame) {
    const SpeckledSheet now = SheetAt(frame);
    const auto seed = static_cast<std::uint32_t>(10 * frame);
    const StereoField field =
        sequence.Add(now.Left(rig, kNoiseGrey, seed), now.Right(rig, kNoiseGrey, seed + 1), frame);
    const Errors errors = Compare(rig, first, now, field);
    EXPECT_GT(errors.ok, errors.points * 85 / 100) << frame;
    EXPECT_EQ(errors.outside, 0) << frame;
    EXPECT_NEAR(errors.PerDimension(), 1, 0.2) << frame;
  }
}

INSTANTIATE_TEST_SUITE_P(Strategies, StereoSequenceOf,
                         ::testing::Values(StereoStrategy::kReference, StereoStrategy::kFreshStereo,
                                           StereoStrategy::kIncremental),
                         [](const auto& info) {
                           std::string name(
                               kStereoStrategyNames[static_cast<std::size_t>(info.param)]);
                           std::erase(name, '-');
                           return name;
                         });

// Both cameras see every point somewhere else by 19 px and 2.5 degrees a frame, so that the last
// frame leads neighbouring subsets astray.
TEST(StereoSequence, KeepsThePointsThroughLargeSteps) {
  const StereoRig rig = Rig();
  const auto at = [](int frame) {
    SpeckledSheet sheet;
    sheet.rig_from_sheet = Rigid3::FromRotationVector({0.05, -0.1 + 0.03 * frame, 0.044 * frame},
                                                      {5.0 * frame, -1.0 * frame, 400});
    return sheet;
  };
  const SpeckledSheet first = at(0);
  StereoSequence sequence(rig, first.Left(rig, kNoiseGrey, 1), first.Right(rig, kNoiseGrey, 2),
                          Options(StereoStrategy::kReference));
  for (int frame = 1; frame <= 3; ++frame) {
    const SpeckledSheet now = at(frame);
    const auto seed = static_cast<std::uint32_t>(10 * frame);
    const StereoField field =
        sequence.Add(now.Left(rig, kNoiseGrey, seed), now.Right(rig, kNoiseGrey, seed + 1), frame);
    int within = 0;
    for (int r = 0; r < field.left.size().height; ++r) {
      for (int c = 0; c < field.left.size().width; ++c) {
        const Eigen::Vector3d point =
            now.PointInRig(first.MaterialAt(rig, field.left.PixelOf(r, c)));
        bool inside = sequence.reference().right.status(r, c) == Status::kOk;
        for (const Eigen::Vector2d& pixel :
             {rig.left.Project(point), rig.right.Project(rig.right_from_left * point)}) {
          inside = inside && pixel.minCoeff() > 24 && pixel.x() < kSize.width - 24 &&
                   pixel.y() < kSize.height - 24;
        }
        within += inside ? 1 : 0;
      }
    }
    const Errors errors = Compare(rig, first, now, field);
    EXPECT_GT(within, 150) << frame;
    EXPECT_GE(errors.ok, within * 98 / 100) << frame << ", of " << within;
    EXPECT_EQ(errors.outside, 0) << frame;
  }
}

TEST(StereoSequence, StartsAnywhereAfterARestart) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = SheetAt(0), later = SheetAt(6);
  StereoSequence sequence(rig, first.Left(rig, kNoiseGrey, 1), first.Right(rig, kNoiseGrey, 2),
                          Options(StereoStrategy::kReference));
  sequence.Restart();
  const StereoField field =
      sequence.Add(later.Left(rig, kNoiseGrey, 3), later.Right(rig, kNoiseGrey, 4), 6);
  const Errors errors = Compare(rig, first, later, field);
  EXPECT_GT(errors.ok, errors.points * 80 / 100);
  EXPECT_EQ(errors.outside, 0);

  // The same once more is the same to the last bit.
  sequence.Restart();
  const StereoField again =
      sequence.Add(later.Left(rig, kNoiseGrey, 3), later.Right(rig, kNoiseGrey, 4), 6);
  EXPECT_EQ(again.right.status.values(), field.right.status.values());
  for (std::size_t i = 0; i < field.right.status.pixel_count(); ++i) {
    if (field.right.status.data()[i] != Status::kOk) continue;
    EXPECT_EQ(again.right.displacement_px.data()[i], field.right.displacement_px.data()[i]);
  }
}

// Where both images show the points of the first sheet, off by as much.
StereoField StartsAt(const StereoRig& rig, const SpeckledSheet& first, const SpeckledSheet& now,
                     const PlanarField& grid, const Eigen::Vector2d& off_px) {
  StereoField starts;
  starts.left = starts.right = PlanarField(grid.size(), grid.first_px, grid.step_px);
  for (int r = 0; r < grid.size().height; ++r) {
    for (int c = 0; c < grid.size().width; ++c) {
      const Eigen::Vector2d pixel = grid.PixelOf(r, c);
      const Eigen::Vector3d point = now.PointInRig(first.MaterialAt(rig, pixel));
      const auto set = [&](PlanarField& field, const Eigen::Vector2d& there) {
        field.status(r, c) = Status::kOk;
        field.displacement_px(r, c) = there - pixel + off_px;
        field.gradient(r, c).setZero();
      };
      set(starts.left, rig.left.Project(point));
      set(starts.right, rig.right.Project(rig.right_from_left * point));
    }
  }
  return starts;
}

TEST(StereoSequence, StartsFromWhereThePointsAreKnownToBe) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = SheetAt(0), later = SheetAt(6);
  const GrayImage left = later.Left(rig, kNoiseGrey, 3), right = later.Right(rig, kNoiseGrey, 4);
  for (const StereoStrategy strategy : {StereoStrategy::kReference, StereoStrategy::kFreshStereo}) {
    StereoSequence sequence(rig, first.Left(rig, kNoiseGrey, 1), first.Right(rig, kNoiseGrey, 2),
                            Options(strategy));
    const PlanarField& grid = sequence.reference().left;
    const StereoField searched = sequence.Add(left, right, 6);
    sequence.Restart();
    const StereoField field =
        sequence.AddFrom(StartsAt(rig, first, later, grid, {1, -0.7}), left, right, 6);
    const Errors errors = Compare(rig, first, later, field);
    EXPECT_GT(errors.ok, errors.points * 80 / 100);
    EXPECT_EQ(errors.outside, 0);
    int both = 0;
    for (std::size_t i = 0; i < grid.status.pixel_count(); ++i) {
      if (field.right.status.data()[i] != Status::kOk ||
          searched.right.status.data()[i] != Status::kOk) {
        continue;
      }
      ++both;
      EXPECT_LT(
          (field.right.displacement_px.data()[i] - searched.right.displacement_px.data()[i]).norm(),
          0.01);
    }
    EXPECT_GE(both, searched.right_counts.ok * 98 / 100);
    // Starts that lead nowhere are not made up for by a search.
    const StereoField astray =
        sequence.AddFrom(StartsAt(rig, first, later, grid, {40, 25}), left, right, 6);
    EXPECT_LT(astray.left_counts.ok, 10);
    EXPECT_LT(astray.right_counts.ok, 10);
    EXPECT_THROW(sequence.AddFrom({PlanarField({2, 2}, {30, 30}, 12), {}, {}, {}}, left, right, 6),
                 InputError);
  }
}

TEST(StereoSequence, TakesThePairAsItIsKnownAndSearchesItWhereThatIsWrong) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = SheetAt(0);
  const GrayImage left = first.Left(rig, kNoiseGrey, 1), right = first.Right(rig, kNoiseGrey, 2);
  const StereoSequenceOptions options = Options(StereoStrategy::kReference);
  const StereoSequence searched(rig, left, right, options);
  for (const double off_px : {1.0, 50.0}) {
    const StereoSequence known(rig, left, right, options, {}, [&](const Eigen::Vector2d& px) {
      const Eigen::Vector3d point = first.PointInRig(first.MaterialAt(rig, px));
      return Eigen::Vector2d(rig.right.Project(rig.right_from_left * point) +
                             Eigen::Vector2d(off_px, 0));
    });
    EXPECT_EQ(known.reference_seeds().found > 0, off_px > 10);
    const Errors errors = Compare(rig, first, first, known.reference());
    EXPECT_GE(errors.ok, searched.reference().right_counts.ok * 98 / 100);
    EXPECT_EQ(errors.outside, 0);
  }
}

TEST(StereoSequence, GoesOnAfterABlankPair) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = SheetAt(0), now = SheetAt(1);
  StereoSequence sequence(rig, first.Left(rig, kNoiseGrey, 1), first.Right(rig, kNoiseGrey, 2),
                          Options(StereoStrategy::kReference));
  const GrayImage blank{Image<std::uint16_t>(kSize, 90), 8};
  const StereoField nothing = sequence.Add(blank, blank, 1);
  EXPECT_EQ(nothing.left_counts.ok, 0);
  EXPECT_EQ(nothing.right_counts.ok, 0);
  const StereoField field =
      sequence.Add(now.Left(rig, kNoiseGrey, 3), now.Right(rig, kNoiseGrey, 4), 2);
  EXPECT_GT(Compare(rig, first, now, field).ok, 300);
}

// Between converging cameras even a plane is seen with second derivatives (of a homography, 2 tan
// 15 deg / f), and a cylinder with more.
TEST(StereoSequence, GivesTheCurvatureOfTheViewsToItsSubsets) {
  const StereoRig rig = Rig();
  const SpeckledSheet bent = SheetAt(0, 150);
  const GrayImage left = bent.Left(rig, 0.5, 1), right = bent.Right(rig, 0.5, 2);
  StereoSequenceOptions options = Options(StereoStrategy::kReference);
  options.field.correlator.noise = NoiseModel{0.25, 0};
  const StereoSequence with(rig, left, right, options);
  EXPECT_TRUE(with.follows_curvature());
  options.follow_curvature = false;
  const StereoSequence without(rig, left, right, options);
  EXPECT_FALSE(without.follows_curvature());
  const double biased = Compare(rig, bent, bent, without.reference()).Right();
  const double followed = Compare(rig, bent, bent, with.reference()).Right();
  EXPECT_GT(biased, 3);
  EXPECT_LT(followed, 1.25);
}

TEST(StereoSequence, RefusesWhatIsNoSequenceOfOneRig) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = SheetAt(0);
  StereoSequence sequence(rig, first.Left(rig, 1, 1), first.Right(rig, 1, 2),
                          Options(StereoStrategy::kIncremental));
  const GrayImage small{Image<std::uint16_t>({100, 80}, 7), 8};
  EXPECT_THROW(sequence.Add(small, small, 1), InputError);
  EXPECT_THROW(sequence.Restart(), std::logic_error);
  EXPECT_THROW(sequence.AddFrom(sequence.reference(), small, small, 1), std::logic_error);
  StereoSequenceOptions options = Options(StereoStrategy::kIncremental);
  options.update_every = 0;
  EXPECT_THROW(options.Check(), UsageError);
}

}  // namespace
}  // namespace plumbline
