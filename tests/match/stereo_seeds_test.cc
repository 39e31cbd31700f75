#include "match/stereo_seeds.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

#include "calib/error.h"
#include "tests/support/rendered_surface.h"

namespace plumbline {
namespace {

using testing::ConvergentRig;
using testing::SpeckledSheet;

constexpr ImageSize kSize{480, 360};

StereoRig Rig() { return ConvergentRig(kSize, 1800, 400, 130); }

SpeckledSheet Tilted() {
  SpeckledSheet sheet;
  sheet.rig_from_sheet = Rigid3::FromRotationVector({0.1, -0.2, 0.3}, {1, -2, 400});
  return sheet;
}

// Where the material at a left pixel is seen on the right.
Eigen::Vector2d SeenRight(const StereoRig& rig, const SpeckledSheet& sheet,
                          const Eigen::Vector2d& left_px) {
  return rig.right.Project(rig.right_from_left * sheet.PointInRig(sheet.MaterialAt(rig, left_px)));
}

void ExpectTrue(const StereoRig& rig, const SpeckledSheet& sheet, const StereoSeeds& found,
                double tolerance_px) {
  int wrong = 0;
  for (const CorrelationSeed& seed : found.seeds) {
    const Eigen::Vector2d there = SeenRight(rig, sheet, seed.reference_px);
    if ((seed.reference_px + seed.displacement_px - there).norm() > tolerance_px) ++wrong;
    const Eigen::Vector2d step(2, 0);
    const Eigen::Vector2d along = (SeenRight(rig, sheet, seed.reference_px + step) -
                                   SeenRight(rig, sheet, seed.reference_px - step)) /
                                  4;
    EXPECT_LT((seed.gradient.col(0) + Eigen::Vector2d::UnitX() - along).norm(), 0.1);
  }
  EXPECT_LE(wrong, static_cast<int>(found.seeds.size()) / 50);
}

TEST(StereoSeeds, AreFoundBetweenConvergingCameras) {
  const StereoRig rig = Rig();
  const SpeckledSheet sheet = Tilted();
  const StereoSeeds found = FindStereoSeeds(rig, sheet.Left(rig, 2, 1), sheet.Right(rig, 2, 2));
  EXPECT_GT(found.seeds.size(), 20U);
  EXPECT_FALSE(found.from_disparity);
  EXPECT_LE(found.off_epipolar, found.found / 20);
  ExpectTrue(rig, sheet, found, 1);
}

TEST(StereoSeeds, ComeFromTheRectifiedPairWhereNothingElseFindsThem) {
  const StereoRig rig = Rig();
  SpeckledSheet sheet = Tilted();
  sheet.px_per_mm = 2;  // speckle that half the resolution still shows
  StereoSeedOptions options;
  options.seeds.use_features = false;
  options.seeds.fft.min_contrast_grey = 255;  // finds no place to look at
  const StereoSeeds found =
      FindStereoSeeds(rig, sheet.Left(rig, 2, 1), sheet.Right(rig, 2, 2), nullptr, options);
  EXPECT_TRUE(found.from_disparity);
  EXPECT_GT(found.seeds.size(), 20U);
  ExpectTrue(rig, sheet, found, 1);
}

TEST(StereoSeeds, LieInTheMask) {
  const StereoRig rig = Rig();
  const SpeckledSheet sheet = Tilted();
  Image<std::uint8_t> mask(kSize, 0);
  for (int y = 100; y < 260; ++y) {
    for (int x = 100; x < 300; ++x) mask(y, x) = 1;
  }
  const StereoSeeds found =
      FindStereoSeeds(rig, sheet.Left(rig, 2, 1), sheet.Right(rig, 2, 2), &mask);
  EXPECT_GT(found.seeds.size(), 3U);
  for (const CorrelationSeed& seed : found.seeds) {
    EXPECT_GT(seed.reference_px.x(), 90);
    EXPECT_LT(seed.reference_px.x(), 310);
  }
}

TEST(StereoSeeds, ShowThatTheCamerasAreSwapped) {
  const StereoRig rig = Rig();
  const SpeckledSheet sheet = Tilted();
  const StereoSeeds found = FindStereoSeeds(rig, sheet.Right(rig, 2, 2), sheet.Left(rig, 2, 1));
  EXPECT_GT(found.found, 12);
  EXPECT_GT(2 * std::max(found.behind_camera, found.off_epipolar), found.found);
}

TEST(StereoSeeds, RefuseImagesOfAnotherSize) {
  const StereoRig rig = Rig();
  const GrayImage small{Image<std::uint16_t>({100, 80}, 7), 8};
  try {
    static_cast<void>(FindStereoSeeds(rig, small, small));
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("100 x 80"));
  }
}

}  // namespace
}  // namespace plumbline
