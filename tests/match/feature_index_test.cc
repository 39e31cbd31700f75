#include "match/feature_index.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <vector>

#include "calib/error.h"
#include "tests/match/seed_truth.h"

namespace plumbline {
namespace {

using testing::Motion;
using testing::RenderedSpeckleOptions;
using testing::RenderSpeckle;
using testing::Uniform;

constexpr ImageSize kSize{320, 240};

RenderedSpeckleOptions Pattern(std::uint32_t seed) {
  RenderedSpeckleOptions options;
  options.pattern_seed = seed;
  options.scale = 1.5;
  return options;
}

// What a camera sees of the pattern that lies from x_px on, seen through a motion.
GrayImage Seen(double x_px, std::uint32_t seed = 1, const Motion& motion = {},
               double noise_grey = 2) {
  return RenderSpeckle(
      kSize,
      [&](const Eigen::Vector2d& x) -> Eigen::Vector2d {
        return motion.Undo(x) + Eigen::Vector2d(x_px, 0);
      },
      noise_grey, static_cast<std::uint32_t>(x_px) + 7, Pattern(seed));
}

// A strip of which neighbouring images show two thirds of each other.
class Strip : public ::testing::Test {
 protected:
  Strip() {
    for (int i = 0; i < 10; ++i) images_.push_back(Seen(110.0 * i));
    for (const GrayImage& image : images_) pointers_.push_back(&image);
  }
  std::vector<GrayImage> images_;
  std::vector<const GrayImage*> pointers_;
};

using FeatureIndexOfAStrip = Strip;

TEST_F(FeatureIndexOfAStrip, FindsTheImagesThatShowTheSame) {
  const FeatureIndex index(pointers_);
  EXPECT_EQ(index.image_count(), 10U);
  const Motion motion{Eigen::Matrix2d{{1.08, 0.05}, {-0.04, 0.95}}, {5, -8}, {160, 120}};
  const std::vector<IndexMatch> found = index.Find(Seen(340, 1, motion));
  ASSERT_GE(found.size(), 2U);
  EXPECT_EQ(found[0].image, 3U);
  EXPECT_GT(found[0].agreeing.size(), 40U);
  EXPECT_GE(found[0].agreeing.size(), found[1].agreeing.size());
  std::size_t off = 0;
  for (const CorrelationSeed& seed : found[0].agreeing) {
    // The image begins at 340 px of the strip, image 3 of the index at 330.
    const Eigen::Vector2d there = motion.Apply(seed.reference_px + Eigen::Vector2d(330 - 340, 0));
    off += (seed.reference_px + seed.displacement_px - there).norm() > 2.5 ? 1 : 0;
  }
  EXPECT_LE(off, found[0].agreeing.size() / 20);
}

TEST_F(FeatureIndexOfAStrip, HardlyAnythingAgreesByChance) {
  const FeatureIndex index(pointers_);
  std::size_t most = 0;
  for (std::uint32_t seed = 2; seed < 12; ++seed) {
    for (const IndexMatch& match : index.Find(Seen(340, seed))) {
      most = std::max(most, match.agreeing.size());
    }
  }
  EXPECT_LE(most, 5U);
  EXPECT_TRUE(index.Find(Uniform(kSize, 90)).empty());
}

TEST_F(FeatureIndexOfAStrip, IsTheSameForAnyNumberOfThreads) {
  const auto with = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    std::vector<double> out;
    for (const IndexMatch& match : FeatureIndex(pointers_).Find(Seen(470))) {
      out.push_back(static_cast<double>(match.image));
      for (const CorrelationSeed& seed : match.agreeing) out.push_back(seed.displacement_px.x());
    }
    return out;
  };
  EXPECT_EQ(with(1), with(2));
}

TEST(FeatureIndex, RefusesImagesWithoutFeatures) {
  const GrayImage wall = Uniform(kSize, 90);
  const std::vector<const GrayImage*> walls(3, &wall);
  EXPECT_THROW(FeatureIndex{walls}, InputError);
  FeatureIndexOptions options;
  options.max_ratio = 2;
  EXPECT_THROW(FeatureIndex(walls, options), UsageError);
}

}  // namespace
}  // namespace plumbline
