#include "match/fft_seeds.h"

#include <gmock/gmock.h>
#include <tbb/global_control.h>

#include <cmath>

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

TEST(FftSeeds, FindHalfTheImage) {
  const Motion motion = Motion::Shift(300.4, -12.3);
  const auto pair = RenderMoved({600, 400}, motion);
  ExpectGood(FindFftSeeds(pair.reference, pair.deformed), motion, 30);
}

TEST(FftSeeds, FindHalfTheImageBothWays) {
  const Motion motion = Motion::Shift(-250.7, 250.2);
  const auto pair = RenderMoved({500, 500}, motion, {SpeckleKind::kSharpDiscs});
  ExpectGood(FindFftSeeds(pair.reference, pair.deformed), motion, 12);
}

TEST(FftSeeds, AreGoodToATenthOfAPixel) {
  const Motion motion = Motion::Shift(7.3, 4.6);
  const auto pair = RenderMoved({300, 300}, motion);
  const auto seeds = FindFftSeeds(pair.reference, pair.deformed);
  ExpectGood(seeds, motion, 25);
  EXPECT_LT(testing::ErrorsOf(seeds, motion).largest_px, 0.1);
}

TEST(FftSeeds, FollowStrainAndSmallTurns) {
  Motion strain{Eigen::Matrix2d{{1.2, 0}, {0, 0.9}}, {8, 3}, {250, 250}};
  const auto strained = RenderMoved({500, 500}, strain);
  ExpectGood(FindFftSeeds(strained.reference, strained.deformed), strain, 40);
  const Motion turn = Motion::Turn(6, {250, 250});
  const auto turned = RenderMoved({500, 500}, turn);
  ExpectGood(FindFftSeeds(turned.reference, turned.deformed), turn, 60);
}

TEST(FftSeeds, DoNotMindExposureAndBits) {
  const Motion motion = Motion::Shift(40, 25);
  RenderedSpeckleOptions dark;
  dark.contrast = 0.4;
  dark.mean_grey = 70;
  dark.bits = 12;
  const auto bright = RenderMoved({300, 300}, motion),
             dim = RenderMoved({300, 300}, motion, dark, 1);
  ExpectGood(FindFftSeeds(bright.reference, dim.deformed), motion, 15);
}

TEST(FftSeeds, FindBothABackgroundAtRestAndAPartThatMoves) {
  const PartOnBackground scene{{200, 250}, 120, Motion::Shift(130, 6.5)};
  const auto pair = scene.Render({500, 500});
  int part = 0, background = 0;
  for (const CorrelationSeed& seed : FindFftSeeds(pair.reference, pair.deformed)) {
    const bool moves = (seed.displacement_px - scene.motion.shift_px).norm() < 1;
    const bool rests = seed.displacement_px.norm() < 1;
    EXPECT_TRUE(moves || rests) << seed.displacement_px.transpose();
    part += moves ? 1 : 0;
    background += rests ? 1 : 0;
  }
  EXPECT_GE(part, 9);
  EXPECT_GE(background, 20);
}

TEST(FftSeeds, KeepToTheMask) {
  // All but the part is masked; 0 and 255 as well as 0 and 1.
  const PartOnBackground scene{{200, 250}, 120, Motion::Shift(130, 6.5)};
  const auto pair = scene.Render({500, 500});
  for (const int valid : {1, 255}) {
    Image<std::uint8_t> mask({500, 500}, 0);
    for (int y = 0; y < 500; ++y) {
      for (int x = 0; x < 500; ++x) {
        mask(y, x) = static_cast<std::uint8_t>(scene.Holds(Eigen::Vector2d(x, y)) ? valid : 0);
      }
    }
    const auto seeds = FindFftSeeds(pair.reference, pair.deformed, &mask);
    ExpectGood(seeds, scene.motion, 15);
    for (const auto& seed : seeds) EXPECT_TRUE(scene.Holds(seed.reference_px));
  }
}

TEST(FftSeeds, FindAStripThatNoLatticePointHits) {
  const Motion motion = Motion::Shift(60, 9);
  const auto pair = RenderMoved({400, 300}, motion);
  Image<std::uint8_t> mask({400, 300}, 0);
  for (int y = 52; y < 80; ++y) {
    for (int x = 0; x < 300; ++x) mask(y, x) = 1;
  }
  ExpectGood(FindFftSeeds(pair.reference, pair.deformed, &mask), motion, 3);
  for (auto& valid : mask.values()) valid = 0;
  EXPECT_THAT(FindFftSeeds(pair.reference, pair.deformed, &mask), IsEmpty());
}

TEST(FftSeeds, AreNoneInAnotherSpeckle) {
  RenderedSpeckleOptions other;
  other.pattern_seed = 2;
  for (const ImageSize size : {ImageSize{500, 500}, ImageSize{120, 90}}) {
    const auto a = RenderMoved(size, {}), b = RenderMoved(size, {}, other);
    EXPECT_THAT(FindFftSeeds(a.reference, b.deformed), IsEmpty());
  }
}

TEST(FftSeeds, AreNoneWithoutTexture) {
  const ImageSize size{300, 200};
  const auto pair = RenderMoved(size, {});
  for (const int grey : {0, 128, 255}) {
    EXPECT_THAT(FindFftSeeds(Uniform(size, grey), Uniform(size, grey)), IsEmpty());
    EXPECT_THAT(FindFftSeeds(pair.reference, Uniform(size, grey)), IsEmpty());
    EXPECT_THAT(FindFftSeeds(Uniform(size, grey), pair.deformed), IsEmpty());
  }
  RenderedSpeckleOptions blank;
  blank.contrast = 0;  // noise only
  const auto noise = RenderMoved(size, {}, blank);
  EXPECT_THAT(FindFftSeeds(noise.reference, noise.deformed), IsEmpty());
  RenderedSpeckleOptions saturated;
  saturated.mean_grey = 420;
  const auto white = RenderMoved(size, {}, saturated);
  EXPECT_THAT(FindFftSeeds(white.reference, white.deformed), IsEmpty());
}

TEST(FftSeeds, StayOffABlankHalf) {
  auto pair = RenderMoved({400, 300}, Motion::Shift(0, 20));
  for (GrayImage* image : {&pair.reference, &pair.deformed}) {
    for (int y = 0; y < 300; ++y) {
      for (int x = 200; x < 400; ++x) image->grey(y, x) = 90;
    }
  }
  const auto seeds = FindFftSeeds(pair.reference, pair.deformed);
  ExpectGood(seeds, Motion::Shift(0, 20), 12);
  for (const auto& seed : seeds) EXPECT_LT(seed.reference_px.x(), 221);
}

GrayImage Wave(ImageSize size, double period_x_px, double period_y_px, double phase) {
  GrayImage image = Uniform(size, 0);
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      double grey = 120 + 40 * std::sin(6.283185307 * (x - phase) / period_x_px);
      if (period_y_px > 0) grey += 40 * std::sin(6.283185307 * y / period_y_px);
      image.grey(y, x) = static_cast<std::uint16_t>(std::lround(grey));
    }
  }
  return image;
}

TEST(FftSeeds, AreNoneOnStripes) {
  FftSeedOptions narrow;
  narrow.search_px = 6;
  for (const double period_px : {20, 60, 900}) {
    const auto a = Wave({300, 300}, period_px, 0, 0), b = Wave({300, 300}, period_px, 0, 3);
    EXPECT_THAT(FindFftSeeds(a, b), IsEmpty());
    EXPECT_THAT(FindFftSeeds(a, b, nullptr, narrow), IsEmpty());
  }
}

TEST(FftSeeds, AreNoneOnAPatternThatRepeatsUnlessTheSearchIsNarrower) {
  const auto a = Wave({300, 300}, 16, 16, 0), b = Wave({300, 300}, 16, 16, 3);
  EXPECT_THAT(FindFftSeeds(a, b), IsEmpty());
  FftSeedOptions narrow;
  narrow.search_px = 6;
  ExpectGood(FindFftSeeds(a, b, nullptr, narrow), Motion::Shift(3, 0), 10);
}

TEST(FftSeeds, KeepToTheSearch) {
  const auto pair = RenderMoved({400, 400}, Motion::Shift(90, 0));
  FftSeedOptions options;
  options.search_px = 60;
  EXPECT_THAT(FindFftSeeds(pair.reference, pair.deformed, nullptr, options), IsEmpty());
  options.search_px = 100;
  ExpectGood(FindFftSeeds(pair.reference, pair.deformed, nullptr, options), Motion::Shift(90, 0),
             25);
}

TEST(FftSeeds, AreTheSameForAnyNumberOfThreads) {
  const auto pair = RenderMoved({500, 400}, Motion::Turn(3, {250, 200}));
  const auto seeds = FindFftSeeds(pair.reference, pair.deformed);
  EXPECT_GT(seeds.size(), 30U);
  for (const std::size_t threads : {1, 3}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    EXPECT_TRUE(testing::SameBits(FindFftSeeds(pair.reference, pair.deformed), seeds));
  }
}

TEST(FftSeeds, RefuseBadInput) {
  const auto image = Uniform({100, 80}, 9), small = Uniform({100, 40}, 9);
  Image<std::uint8_t> mask({100, 40}, 1), no_mask;
  const auto message = [&](const GrayImage& a, const GrayImage& b,
                           const Image<std::uint8_t>* use = nullptr) {
    return MessageOf<InputError>([&] { (void)FindFftSeeds(a, b, use); });
  };
  EXPECT_THAT(message(image, small), HasSubstr("100 x 80 px and the deformed image 100 x 40 px"));
  EXPECT_THAT(message(small, small), HasSubstr("subset of 41 px does not fit"));
  EXPECT_THAT(message(GrayImage{}, GrayImage{}), HasSubstr("does not fit"));
  EXPECT_THAT(message(image, image, &mask), HasSubstr("the mask has 100 x 40 px"));
  EXPECT_THAT(message(image, image, &no_mask), HasSubstr("the mask has 0 x 0 px"));
  EXPECT_EQ(message(image, image), "");
}

TEST(FftSeeds, OptionsNameTheBrokenConstraint) {
  const auto message = [](const auto& change) {
    FftSeedOptions options;
    change(&options);
    return MessageOf<UsageError>([&] { options.Check(); });
  };
  EXPECT_THAT(message([](auto* o) { o->subset_px = 40; }), HasSubstr("subset_px"));
  EXPECT_THAT(message([](auto* o) { o->subset_px = 7; }), HasSubstr("subset_px"));
  EXPECT_THAT(message([](auto* o) { o->spacing_px = 0; }), HasSubstr("spacing_px"));
  EXPECT_THAT(message([](auto* o) { o->search_px = -1; }), HasSubstr("search_px"));
  EXPECT_THAT(message([](auto* o) { o->min_zncc = 1; }), HasSubstr("min_zncc"));
  EXPECT_THAT(message([](auto* o) { o->max_second_share = NAN; }), HasSubstr("max_second_share"));
  EXPECT_THAT(message([](auto* o) { o->min_contrast_grey = -1; }), HasSubstr("min_contrast_grey"));
  EXPECT_EQ(message([](auto*) {}), "");
}

}  // namespace
}  // namespace plumbline
