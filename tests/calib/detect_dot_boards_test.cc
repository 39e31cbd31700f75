#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "calib/board.h"
#include "tests/support/real_photos.h"
#include "tests/support/synthetic_board.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;
using testing::SyntheticPhoto;

constexpr double kRadiusMm = 1.4;

Eigen::Vector2d Middle(const BoardSpec& spec) {
  return (spec.NominalPoint(0) + spec.NominalPoint(spec.PointCount() - 1)).head<2>() / 2;
}

SyntheticPhoto Photo(const BoardSpec& spec, double roll_deg, double tilt_deg,
                     const Eigen::Vector2d& shift_px = {0, 0}, double px_per_mm = 5) {
  SyntheticPhoto photo;
  photo.albedo = testing::DiscAlbedo(spec, kRadiusMm);
  photo.shading = {0.0005, 0.0003};
  photo.image_from_board =
      testing::BoardHomography(Middle(spec), px_per_mm, roll_deg, tilt_deg, -0.5 * tilt_deg,
                               Eigen::Vector2d(320.3, 239.6) + shift_px);
  return photo;
}

double Worst(const BoardSpec& spec, const SyntheticPhoto& photo, const BoardDetection& detection) {
  double worst = 0;
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    const Eigen::Vector2d truth =
        testing::DiscCentroid(photo, spec.NominalPoint(detection.ids[k]).head<2>(), kRadiusMm);
    worst = std::max(worst, (detection.pixels[k] - truth).norm());
  }
  return worst;
}

TEST(DetectDonutDots, WholeBoardWhicheverWayRound) {
  const BoardSpec spec = BoardSpec::Parse("donut-dots:14x10:7mm");
  for (const double roll : {0.0, 100.0, 190.0, 275.0}) {
    const SyntheticPhoto photo = Photo(spec, roll, 20, {0, 0}, 4.2);
    const BoardDetection detection = DetectBoard(spec, photo.Render());
    ASSERT_TRUE(detection.found()) << roll << detection.problem;
    EXPECT_GE(detection.ids.size(), 110U);
    EXPECT_LT(Worst(spec, photo, detection), 0.03) << roll;
    EXPECT_NEAR(detection.disc_radius_mm, kRadiusMm, 0.02);
  }
}

TEST(DetectDonutDots, PartOfTheBoardIsEnoughWithItsThreeRings) {
  const BoardSpec spec = BoardSpec::Parse("donut-dots:14x10:7mm");
  const SyntheticPhoto photo = Photo(spec, 10, 10, {12, 8}, 6.6);
  const BoardDetection detection = DetectBoard(spec, photo.Render());
  ASSERT_TRUE(detection.found()) << detection.problem;
  EXPECT_LT(detection.ids.size(), 130U);
  EXPECT_LT(Worst(spec, photo, detection), 0.03);
}

TEST(DetectDonutDots, WhiteDotsOnBlack) {
  const BoardSpec spec = BoardSpec::Parse("donut-dots:14x10:7mm");
  SyntheticPhoto photo = Photo(spec, -12, 15, {0, 0}, 4.5);
  photo.albedo = testing::DiscAlbedo(spec, kRadiusMm, true);
  const BoardDetection detection = DetectBoard(spec, photo.Render());
  ASSERT_TRUE(detection.found()) << detection.problem;
  EXPECT_LT(Worst(spec, photo, detection), 0.03);
}

TEST(DetectDonutDots, SaysWhichBoardTheRingsFit) {
  const BoardSpec shown = BoardSpec::Parse("donut-dots:14x10:7mm");
  const BoardDetection detection = DetectBoard(BoardSpec::Parse("donut-dots:12x9:7mm"),
                                               Photo(shown, 5, 10, {0, 0}, 4.5).Render());
  EXPECT_FALSE(detection.found());
  EXPECT_THAT(detection.problem, HasSubstr("14x10"));
  EXPECT_THAT(detection.problem, HasSubstr("check the board word"));
}

TEST(DetectDonutDots, CountsTheMissingRings) {
  const BoardSpec spec = BoardSpec::Parse("donut-dots:14x10:7mm");
  const BoardDetection detection = DetectBoard(spec, Photo(spec, 0, 5, {-260, 0}, 6).Render());
  EXPECT_FALSE(detection.found());
  EXPECT_THAT(detection.problem, HasSubstr("of 3 ring markers found"));
  EXPECT_THAT(detection.problem, HasSubstr("image's edge"));
}

TEST(DetectCircles, SymmetricGridFollowsTheImagesRowsOrIsRefused) {
  const BoardSpec spec = BoardSpec::Parse("circles:7x5:7mm");
  const SyntheticPhoto photo = Photo(spec, -35, 20);
  const BoardDetection detection = DetectBoard(spec, photo.Render());
  ASSERT_EQ(detection.ids.size(), 35U) << detection.problem;
  EXPECT_LT(Worst(spec, photo, detection), 0.03);
  EXPECT_THAT(DetectBoard(spec, Photo(spec, 92, 10).Render()).problem,
              HasSubstr("looks the same when turned"));
  const BoardSpec square = BoardSpec::Parse("circles:6x6:7mm");
  EXPECT_THAT(DetectBoard(square, Photo(square, 44, 0).Render()).problem,
              HasSubstr("looks the same when turned"));
}

TEST(DetectCircles, BigCornerDiscTellsWhichWayRound) {
  const BoardSpec spec = BoardSpec::Parse("circles:6x6:7mm");
  for (const double roll : {5.0, 44.0, 140.0, 265.0}) {
    SyntheticPhoto photo = Photo(spec, roll, 12);
    const auto discs = photo.albedo;
    const Eigen::Vector2d corner = spec.NominalPoint(30).head<2>();
    photo.albedo = [=](const Eigen::Vector2d& p) {
      return (p - corner).norm() < 1.8 * kRadiusMm ? 0.0 : discs(p);
    };
    const BoardDetection detection = DetectBoard(spec, photo.Render());
    ASSERT_EQ(detection.ids.size(), 36U) << roll << detection.problem;
    EXPECT_LT(Worst(spec, photo, detection), 0.06) << roll;
  }
}

TEST(DetectCircles, SaysClippedAndSaysWrongWord) {
  const BoardSpec shown = BoardSpec::Parse("circles:7x5:7mm");
  EXPECT_THAT(
      DetectBoard(BoardSpec::Parse("circles:9x8:7mm"), Photo(shown, 3, 5).Render()).problem,
      HasSubstr("found a grid of 7x5 discs (35 seen) where 9x8 was asked; check the board"));
  EXPECT_THAT(DetectBoard(BoardSpec::Parse("circles:5x4:7mm"), Photo(shown, 3, 5).Render()).problem,
              HasSubstr("more discs in a grid"));
  EXPECT_THAT(DetectBoard(shown, Photo(shown, 3, 5, {230, 0}).Render()).problem,
              HasSubstr("cut off by the image's edge"));
}

TEST(DetectCircles, AsymmetricGridIsKnownWhicheverWayRound) {
  const BoardSpec spec = BoardSpec::Parse("acircles:4x11:6mm");
  for (const double roll : {0.0, 75.0, 180.0}) {
    SyntheticPhoto photo = Photo(spec, roll, 20);
    std::vector<Eigen::Vector2d> points;
    for (int id = 0; id < 44; ++id) points.push_back(spec.NominalPoint(id).head<2>());
    photo.albedo = [points](const Eigen::Vector2d& p) {
      for (const auto& q : points) {
        if ((p - q).squaredNorm() < kRadiusMm * kRadiusMm) return 0.0;
      }
      return 1.0;
    };
    const BoardDetection detection = DetectBoard(spec, photo.Render());
    ASSERT_EQ(detection.ids.size(), 44U) << roll << detection.problem;
    EXPECT_LT(Worst(spec, photo, detection), 0.03) << roll;
  }
}

TEST(DetectCircles, FindsAllRealAsymmetricGrids) {
  PLUMBLINE_SHARED_DATA(folder, "cal-circlegrid-asym-4x11-mono");
  const auto files = testing::PhotosIn(folder / "asymmetric_4x11", ".png");
  EXPECT_EQ(files.size(), 10U);
  for (const auto& file : files) {
    const auto detection =
        DetectBoard(BoardSpec::Parse("acircles:4x11:20mm"), testing::ReadPhoto(file));
    EXPECT_EQ(detection.ids.size(), 44U) << file << detection.problem;
  }
}

TEST(DetectCircles, RealSymmetricGridsAreFoundOrRefusedAsAmbiguous) {
  PLUMBLINE_SHARED_DATA(folder, "cal-circlegrid-asym-4x11-mono");
  int found = 0;
  for (const auto& file : testing::PhotosIn(folder / "symmetric_5x6", ".png")) {
    const auto detection =
        DetectBoard(BoardSpec::Parse("circles:5x6:20mm"), testing::ReadPhoto(file));
    if (!detection.found()) {
      // Held with its rows upright in these.
      EXPECT_THAT(detection.problem, HasSubstr("looks the same when turned")) << file;
      continue;
    }
    ++found;
    EXPECT_EQ(detection.ids.size(), 30U);
    // Rows run to the right.
    EXPECT_GT(detection.pixels[4].x(), detection.pixels[0].x()) << file;
  }
  EXPECT_EQ(found, 9);
}

TEST(DetectCircles, FindsAllRealGridsWithABigOriginDisc) {
  PLUMBLINE_SHARED_DATA(folder, "cal-circlegrid-and-charuco-robot-poses");
  const auto files = testing::PhotosIn(folder / "circlegrid_10x10" / "images", ".png");
  EXPECT_EQ(files.size(), 12U);
  for (const auto& file : files) {
    const auto detection =
        DetectBoard(BoardSpec::Parse("circles:10x10:20mm"), testing::ReadPhoto(file));
    EXPECT_EQ(detection.ids.size(), 100U) << file << detection.problem;
  }
}

// Every third photograph, so that the default tests stay quick; Prove takes all.
void ExpectDspecimen(std::size_t every) {
  PLUMBLINE_SHARED_DATA(folder, "stereodic-challenge-S3-Dspecimen-cal");
  const auto files = testing::PhotosIn(folder, ".jpeg");
  EXPECT_EQ(files.size(), 88U);
  for (std::size_t i = 0; i < files.size(); i += every) {
    const auto detection =
        DetectBoard(BoardSpec::Parse("donut-dots:14x10:7mm"), testing::ReadPhoto(files[i]));
    EXPECT_GE(detection.ids.size(), 100U) << files[i] << detection.problem;
    EXPECT_NEAR(detection.disc_radius_mm, 1.062, 0.02);
  }
}

TEST(DetectDonutDots, FindsRealPhotographs) { ExpectDspecimen(11); }

TEST(DetectDonutDots, ProveFindsAllRealPhotographs) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE";
  ExpectDspecimen(1);
}

TEST(DetectDonutDots, FindsSimulatedBoards) {
  PLUMBLINE_SHARED_DATA(folder, "cal-sim-known-truth");
  const BoardSpec spec = BoardSpec::Parse("donut-dots:14x10:7mm");
  for (const char* set : {"donutdots_7mm_14x10", "whitedots_7mm_14x10_mono"}) {
    const auto files = testing::PhotosIn(folder / set, ".jpeg");
    for (std::size_t i = 0; i < files.size(); i += 2) {
      const auto detection = DetectBoard(spec, testing::ReadPhoto(files[i]));
      EXPECT_GE(detection.ids.size(), 120U) << files[i] << detection.problem;
    }
  }
}

}  // namespace
}  // namespace plumbline
