#include "match/find_seeds.h"

#include <gmock/gmock.h>
#include <tbb/global_control.h>

#include <cmath>
#include <cstdlib>
#include <limits>

#include "calib/error.h"
#include "tests/match/seed_truth.h"

namespace plumbline {
namespace {

using testing::ExpectGood;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::MessageOf;
using testing::Motion;
using testing::PartOnBackground;
using testing::RenderedSpeckleOptions;
using testing::RenderMoved;
using ::testing::SizeIs;
using testing::SpeckleKind;
using testing::Uniform;

TEST(FindSeeds, FindsWhatTheFftFindsAndWhatOnlyFeaturesDo) {
  for (const Motion& motion : {Motion::Shift(200.5, 3), Motion::Turn(30, {200, 200})}) {
    const auto pair = RenderMoved({400, 400}, motion);
    const auto seeds = FindSeeds(pair.reference, pair.deformed);
    ExpectGood(seeds, motion, 18);
    for (std::size_t i = 1; i < seeds.size(); ++i) EXPECT_LE(seeds[i].score, seeds[i - 1].score);
  }
}

TEST(FindSeeds, FindsATurningPartThatTheFftLeavesOpen) {
  // The background alone would look like a success.
  const PartOnBackground scene{{200, 200}, 110, Motion::Turn(120, {200, 200})};
  const auto pair = scene.Render({400, 400});
  int part = 0, background = 0;
  for (const CorrelationSeed& seed : FindSeeds(pair.reference, pair.deformed)) {
    const Eigen::Vector2d there = seed.reference_px + seed.displacement_px;
    const bool turns = (there - scene.motion.Apply(seed.reference_px)).norm() < 1;
    const bool rests = seed.displacement_px.norm() < 1;
    EXPECT_TRUE(turns || rests) << seed.reference_px.transpose();
    part += turns ? 1 : 0;
    background += rests ? 1 : 0;
  }
  EXPECT_GE(part, 8);
  EXPECT_GE(background, 15);
}

TEST(FindSeeds, AreNoneWhereThereIsNothingToFind) {
  RenderedSpeckleOptions other;
  other.pattern_seed = 2;
  const auto a = RenderMoved({300, 300}, {}), b = RenderMoved({300, 300}, {}, other);
  EXPECT_THAT(FindSeeds(a.reference, b.deformed), IsEmpty());
  EXPECT_THAT(FindSeeds(Uniform({300, 300}, 255), Uniform({300, 300}, 255)), IsEmpty());
  const Image<std::uint8_t> nothing({300, 300}, 0);
  EXPECT_THAT(FindSeeds(a.reference, a.deformed, &nothing), IsEmpty());
  EXPECT_THAT(MessageOf<InputError>([&] {
                (void)FindSeeds(a.reference, Uniform({300, 299}, 255));
              }),
              HasSubstr("must have the same size"));
  FindSeedsOptions options;
  options.max_unexplained = 2;
  EXPECT_THAT(MessageOf<UsageError>([&] { options.Check(); }), HasSubstr("max_unexplained"));
}

TEST(FindSeeds, IsTheSameForAnyNumberOfThreads) {
  const PartOnBackground scene{{150, 150}, 90, Motion::Turn(60, {150, 150})};
  const auto pair = scene.Render({300, 300});
  const auto seeds = FindSeeds(pair.reference, pair.deformed);
  EXPECT_GT(seeds.size(), 10U);
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
  EXPECT_TRUE(testing::SameBits(FindSeeds(pair.reference, pair.deformed), seeds));
}

// Any motion of the list, drawn at random: none may be missed, no seed may be wrong.
TEST(FindSeeds, ProveAnyMotion) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE to run";
  int seeds = 0, wrong = 0, missed = 0;
  constexpr int kPairs = 120;
  for (int i = 0; i < kPairs; ++i) {
    std::uint64_t h = testing::SpecklePattern::Hash(static_cast<std::uint64_t>(i));
    const auto uniform = [&](double low, double high) {
      h = testing::SpecklePattern::Hash(h);
      return low + (high - low) * testing::SpecklePattern::Uniform(h);
    };
    Motion motion = Motion::Turn(i % 3 == 0 ? 0 : uniform(-180, 180), {250, 250});
    motion.map *= Eigen::Matrix2d{{1 + uniform(-0.2, 0.2), uniform(-0.1, 0.1)},
                                  {uniform(-0.1, 0.1), 1 + uniform(-0.2, 0.2)}};
    const double reach = i % 3 == 0 ? 250 : 100;
    motion.shift_px = {uniform(-reach, reach), uniform(-reach, reach)};
    RenderedSpeckleOptions options;
    options.kind = i % 2 == 0 ? SpeckleKind::kSoftBlobs : SpeckleKind::kSharpDiscs;
    options.pattern_seed = static_cast<std::uint32_t>(i + 1);
    options.scale = uniform(0.8, 1.6);
    const auto pair = RenderMoved({500, 500}, motion, options, uniform(0, 6));
    const auto found = FindSeeds(pair.reference, pair.deformed);
    int good = 0;
    for (const CorrelationSeed& seed : found) {
      const auto errors = testing::ErrorsOf({seed}, motion);
      good += errors.largest_px < 1 && errors.largest_gradient < 0.1 ? 1 : 0;
    }
    seeds += static_cast<int>(found.size());
    wrong += static_cast<int>(found.size()) - good;
    missed += good == 0 ? 1 : 0;
  }
  RecordProperty("pairs", kPairs);
  RecordProperty("missed_pairs", missed);
  RecordProperty("seeds", seeds);
  RecordProperty("wrong_seeds", wrong);
  std::printf("%d pairs, %d missed; %d seeds, %d wrong\n", kPairs, missed, seeds, wrong);
  EXPECT_LE(missed, kPairs / 50);
  EXPECT_LE(wrong, seeds / 500);
}

PlanarField FieldOf(ImageSize grid) {
  PlanarField field;  // by hand: what is asked here are the seeds
  field.first_px = {20, 30};
  field.step_px = 10;
  field.displacement_px = Image<Eigen::Vector2d>(grid, {1.5, -2});
  field.gradient = Image<Eigen::Matrix2f>(grid, Eigen::Matrix2f::Constant(0.01F));
  field.zncc = Image<float>(grid, 0.9F);
  field.status = Image<Status>(grid, Status::kOk);
  return field;
}

TEST(SeedsFromField, TakesTheBestOfEachCellAndNoneThatFailed) {
  PlanarField field = FieldOf({30, 20});
  for (int row = 0; row < 20; ++row) {
    for (int column = 15; column < 30; ++column) {
      field.status(row, column) = Status::kLowCorrelation;
      if (row < 10) field.displacement_px(row, column).x() = NAN;  // a status alone is enough
    }
  }
  field.zncc(4, 5) = 0.99F;
  field.displacement_px(4, 5) = {1.25, -2.5};
  field.displacement_px(7, 7) = {std::numeric_limits<double>::quiet_NaN(), 0};  // yet "ok"
  field.gradient(8, 8)(0, 1) = std::numeric_limits<float>::infinity();
  field.zncc(7, 7) = field.zncc(8, 8) = 1;
  const auto seeds = SeedsFromField(field, 50);
  // Columns 20 to 160 px and rows 30 to 220 px touch 4 by 5 cells of 50 px.
  EXPECT_THAT(seeds, SizeIs(20));
  EXPECT_EQ(seeds[0].reference_px, Eigen::Vector2d(70, 70));
  EXPECT_EQ(seeds[0].displacement_px, Eigen::Vector2d(1.25, -2.5));
  EXPECT_NEAR(seeds[0].score, 0.99, 1e-6);
  for (const auto& seed : seeds) {
    EXPECT_TRUE(seed.displacement_px.allFinite() && seed.gradient.allFinite());
    EXPECT_LT(seed.reference_px.x(), 170);
    EXPECT_NEAR(seed.gradient(1, 0), 0.01, 1e-6);
  }
}

TEST(SeedsFromField, TakesFieldsWithoutGradients) {
  PlanarField field = FieldOf({4, 4});
  field.gradient = {};
  field.zncc = {};
  const auto seeds = SeedsFromField(field, 1);
  EXPECT_THAT(seeds, SizeIs(16));
  EXPECT_EQ(seeds[3].gradient, Eigen::Matrix2d::Zero());
  EXPECT_EQ(seeds[3].score, 1);
  EXPECT_THAT(SeedsFromField(PlanarField{}), IsEmpty());
}

TEST(SeedsFromField, RefusesAFieldOfMixedSizes) {
  PlanarField field = FieldOf({4, 4});
  field.zncc = Image<float>({3, 4}, 1);
  EXPECT_THAT(MessageOf<InputError>([&] { (void)SeedsFromField(field); }), HasSubstr("one grid"));
  EXPECT_THAT(MessageOf<UsageError>([&] { (void)SeedsFromField(field, 0); }),
              HasSubstr("spacing_px"));
}

TEST(SeedsFromAffine, TellsARigidMotionAsTheImagesShowIt) {
  const Motion truth = Motion::Turn(40, {200, 150});
  const auto motion =
      AffineMotion::Rigid(truth.about_px, 40 * 3.14159265358979 / 180, truth.shift_px);
  const auto seeds = SeedsFromAffine(motion, {400, 300});
  const auto errors = testing::ErrorsOf(seeds, truth);
  EXPECT_GT(errors.count, 20);
  EXPECT_LT(errors.count, 48);  // 8 by 6 cells, some of which leave the image
  EXPECT_LT(errors.largest_px, 1e-9);
  EXPECT_LT(errors.largest_gradient, 1e-9);
}

TEST(SeedsFromAffine, KeepsToMaskAndImage) {
  Image<std::uint8_t> mask({400, 300}, 0);
  for (int y = 0; y < 300; ++y) {
    for (int x = 0; x < 90; ++x) mask(y, x) = 255;
  }
  AffineMotion motion;
  motion.displacement_px = {0, 200};
  const auto seeds = SeedsFromAffine(motion, {400, 300}, &mask);
  EXPECT_GT(seeds.size(), 1U);
  for (const auto& seed : seeds) {
    EXPECT_LT(seed.reference_px.x(), 90);
    EXPECT_LT(seed.reference_px.y(), 100);
  }
  motion.gradient(0, 0) = NAN;
  EXPECT_THAT(MessageOf<InputError>([&] {
                (void)SeedsFromAffine(motion, {400, 300});
              }),
              HasSubstr("finite"));
  EXPECT_THAT(MessageOf<InputError>([&] {
                (void)SeedsFromAffine({}, {40, 30}, &mask);
              }),
              HasSubstr("mask"));
}

}  // namespace
}  // namespace plumbline
