#include "match/feature_seeds.h"

#include <gmock/gmock.h>
#include <tbb/global_control.h>

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
using testing::SpeckleKind;
using testing::Uniform;

TEST(FeatureSeeds, FindLargeTurns) {
  for (const double degrees : {30, 90, 180}) {
    SCOPED_TRACE(degrees);
    const Motion motion = Motion::Turn(degrees, {200, 200});
    const auto pair = RenderMoved({400, 400}, motion);
    ExpectGood(FindFeatureSeeds(pair.reference, pair.deformed), motion, 35);
  }
}

TEST(FeatureSeeds, FindTurnsOfSharpDiscs) {
  const Motion motion = Motion::Turn(70, {200, 200});
  const auto pair = RenderMoved({400, 400}, motion, {SpeckleKind::kSharpDiscs});
  ExpectGood(FindFeatureSeeds(pair.reference, pair.deformed), motion, 25);
}

TEST(FeatureSeeds, FindStrain) {
  const Motion motion{Eigen::Matrix2d{{1.2, 0.1}, {-0.1, 0.85}}, {30, 10}, {200, 200}};
  const auto pair = RenderMoved({400, 400}, motion);
  ExpectGood(FindFeatureSeeds(pair.reference, pair.deformed), motion, 30);
}

TEST(FeatureSeeds, FindHalfTheImage) {
  const Motion motion = Motion::Shift(-200.2, 3.7);
  const auto pair = RenderMoved({400, 400}, motion);
  ExpectGood(FindFeatureSeeds(pair.reference, pair.deformed), motion, 20);
}

TEST(FeatureSeeds, FindFeaturesOfImagesThatAreAveragedDown) {
  const Motion motion = Motion::Turn(45, {500, 150});
  RenderedSpeckleOptions coarse;
  coarse.scale = 1.5;
  const auto pair = RenderMoved({1000, 300}, motion, coarse);
  ExpectGood(FindFeatureSeeds(pair.reference, pair.deformed), motion, 20);
}

TEST(FeatureSeeds, FindBothABackgroundAtRestAndAPartThatTurns) {
  const PartOnBackground scene{{200, 200}, 110, Motion::Turn(90, {200, 200})};
  const auto pair = scene.Render({400, 400});
  int part = 0, background = 0;
  for (const CorrelationSeed& seed : FindFeatureSeeds(pair.reference, pair.deformed)) {
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

TEST(FeatureSeeds, KeepToTheMask) {
  const PartOnBackground scene{{200, 200}, 110, Motion::Turn(90, {200, 200})};
  const auto pair = scene.Render({400, 400});
  Image<std::uint8_t> mask({400, 400}, 0);
  for (int y = 0; y < 400; ++y) {
    for (int x = 0; x < 400; ++x) mask(y, x) = scene.Holds(Eigen::Vector2d(x, y)) ? 255 : 0;
  }
  const auto seeds = FindFeatureSeeds(pair.reference, pair.deformed, &mask);
  ExpectGood(seeds, scene.motion, 10);
  for (const auto& seed : seeds) EXPECT_TRUE(scene.Holds(seed.reference_px));
}

TEST(FeatureSeeds, AreNoneInAnotherSpeckle) {
  RenderedSpeckleOptions other;
  other.pattern_seed = 2;
  for (const ImageSize size : {ImageSize{400, 400}, ImageSize{120, 90}}) {
    const auto a = RenderMoved(size, {}), b = RenderMoved(size, {}, other);
    EXPECT_THAT(FindFeatureSeeds(a.reference, b.deformed), IsEmpty());
  }
}

TEST(FeatureSeeds, AreNoneWithoutTexture) {
  const ImageSize size{200, 200};
  const auto pair = RenderMoved(size, {});
  for (const int grey : {0, 255}) {
    EXPECT_THAT(FindFeatureSeeds(Uniform(size, grey), Uniform(size, grey)), IsEmpty());
    EXPECT_THAT(FindFeatureSeeds(pair.reference, Uniform(size, grey)), IsEmpty());
    EXPECT_THAT(FindFeatureSeeds(Uniform(size, grey), pair.deformed), IsEmpty());
  }
  RenderedSpeckleOptions blank;
  blank.contrast = 0;  // noise only
  const auto noise = RenderMoved(size, {}, blank);
  EXPECT_THAT(FindFeatureSeeds(noise.reference, noise.deformed), IsEmpty());
}

TEST(FeatureSeeds, AreTheSameForAnyNumberOfThreadsAndEachTime) {
  const auto pair = RenderMoved({300, 300}, Motion::Turn(30, {150, 150}));
  const auto seeds = FindFeatureSeeds(pair.reference, pair.deformed);
  EXPECT_GT(seeds.size(), 10U);
  for (const std::size_t threads : {1, 3}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    EXPECT_TRUE(testing::SameBits(FindFeatureSeeds(pair.reference, pair.deformed), seeds));
  }
}

TEST(FeatureSeeds, RefuseBadInput) {
  const auto image = Uniform({100, 80}, 9), small = Uniform({100, 40}, 9);
  const Image<std::uint8_t> mask({80, 100}, 1);
  const auto message = [&](const GrayImage& a, const GrayImage& b,
                           const Image<std::uint8_t>* use = nullptr) {
    return MessageOf<InputError>([&] { (void)FindFeatureSeeds(a, b, use); });
  };
  EXPECT_THAT(message(image, small), HasSubstr("must have the same size"));
  EXPECT_THAT(message(small, small), HasSubstr("does not fit"));
  EXPECT_THAT(message(image, image, &mask), HasSubstr("the mask has 80 x 100 px"));
  FeatureSeedOptions options;
  options.max_ratio = 1.5;
  EXPECT_THAT(MessageOf<UsageError>([&] { options.Check(); }), HasSubstr("max_ratio"));
  options = {};
  options.max_features = 3;
  EXPECT_THAT(MessageOf<UsageError>([&] { options.Check(); }), HasSubstr("max_features"));
}

}  // namespace
}  // namespace plumbline
