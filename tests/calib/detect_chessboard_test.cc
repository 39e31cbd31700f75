#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "calib/board.h"
#include "calib/internal/saddle_fit.h"
#include "tests/support/real_photos.h"
#include "tests/support/synthetic_board.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;
using testing::SyntheticPhoto;

SyntheticPhoto Photo(const BoardSpec& spec, double roll_deg, double tilt_deg) {
  SyntheticPhoto photo;
  photo.albedo = testing::ChessboardAlbedo(spec);
  const Eigen::Vector2d middle =
      (spec.NominalPoint(0) + spec.NominalPoint(spec.PointCount() - 1)).head<2>() / 2;
  photo.image_from_board =
      testing::BoardHomography(middle, 5, roll_deg, tilt_deg, -0.5 * tilt_deg, {320.3, 239.6});
  return photo;
}

// Largest distance of a detection from the truth, px.
double Worst(const BoardSpec& spec, const SyntheticPhoto& photo, const BoardDetection& detection) {
  double worst = 0;
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    const Eigen::Vector2d truth = photo.Map(spec.NominalPoint(detection.ids[k]).head<2>());
    worst = std::max(worst, (detection.pixels[k] - truth).norm());
  }
  return worst;
}

TEST(DetectChessboard, FindsCornersToAHundredthOfAPixel) {
  const BoardSpec spec = BoardSpec::Parse("chessboard:9x6:8mm");
  SyntheticPhoto photo = Photo(spec, 8, 25);
  photo.shading = {0.0004, -0.0003};
  const BoardDetection detection = DetectBoard(spec, photo.Render());
  ASSERT_EQ(detection.ids.size(), 54U) << detection.problem;
  EXPECT_LT(Worst(spec, photo, detection), 0.01);
}

TEST(DetectChessboard, SquareColoursTellWhichWayRound) {
  const BoardSpec spec = BoardSpec::Parse("chessboard:9x6:8mm");
  for (const double roll : {0.0, 60.0, 120.0, 180.0, 250.0}) {
    const SyntheticPhoto photo = Photo(spec, roll, 15);
    const BoardDetection detection = DetectBoard(spec, photo.Render());
    ASSERT_TRUE(detection.found()) << roll << detection.problem;
    EXPECT_LT(Worst(spec, photo, detection), 0.05) << roll;
  }
}

TEST(DetectChessboard, SymmetricBoardFollowsTheImagesRowsOrIsRefused) {
  const BoardSpec spec = BoardSpec::Parse("chessboard:8x6:8mm");
  const SyntheticPhoto upright = Photo(spec, 40, 10), across = Photo(spec, 88, 10);
  const BoardDetection detection = DetectBoard(spec, upright.Render());
  ASSERT_TRUE(detection.found()) << detection.problem;
  EXPECT_LT(Worst(spec, upright, detection), 0.05);
  EXPECT_THAT(DetectBoard(spec, across.Render()).problem, HasSubstr("looks the same when turned"));
}

TEST(DetectChessboard, SaysWhichBoardItSawInstead) {
  const BoardSpec shown = BoardSpec::Parse("chessboard:9x6:8mm");
  const BoardDetection detection =
      DetectBoard(BoardSpec::Parse("chessboard:11x8:8mm"), Photo(shown, 5, 10).Render());
  EXPECT_FALSE(detection.found());
  EXPECT_THAT(detection.problem, HasSubstr("9x6 inner corners where 11x8 was asked"));
}

TEST(DetectChessboard, SaysThatNothingIsThere) {
  const GrayImage grey{Image<std::uint16_t>({320, 240}, 128), 8};
  EXPECT_THAT(DetectBoard(BoardSpec::Parse("chessboard:9x6:8mm"), grey).problem,
              HasSubstr("no chessboard found"));
}

TEST(SaddleFit, SigmaAgreesWithSampling) {
  const BoardSpec spec = BoardSpec::Parse("chessboard:9x6:8mm");
  SyntheticPhoto photo;
  photo.albedo = testing::ChessboardAlbedo(spec);
  photo.size = {48, 48};
  photo.noise = 4;
  photo.image_from_board = testing::BoardHomography({24, 16}, 3, 20, 30, 10, {23.6, 24.2}, 80);
  const Eigen::Vector2d truth = photo.Map({24, 16});
  const Eigen::Vector2d along = photo.Map({32, 16}) - truth, down = photo.Map({24, 24}) - truth;
  double nees = 0;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  constexpr int kDraws = 300;
  for (int draw = 0; draw < kDraws; ++draw) {
    photo.seed = static_cast<std::uint64_t>(7 + draw);
    const auto fit =
        internal::FitSaddle(photo.Render(), truth + Eigen::Vector2d(0.5, -0.4), along, down, 9);
    ASSERT_TRUE(fit);
    const Eigen::Vector2d error = fit->pixel - truth;
    mean += error / kDraws;
    nees += error.dot(fit->cov_px2.inverse() * error) / kDraws;
  }
  EXPECT_LT(mean.norm(), 0.006);
  EXPECT_NEAR(nees, 2, 4 * std::sqrt(4.0 / kDraws));
}

TEST(DetectChessboard, FindsAllRealPairs) {
  PLUMBLINE_SHARED_DATA(folder, "cal-chessboard-opencv-stereo");
  const BoardSpec spec = BoardSpec::Parse("chessboard:9x6:10mm");
  int found = 0;
  for (const auto& file : testing::PhotosIn(folder, ".jpg")) {
    const BoardDetection detection = DetectBoard(spec, testing::ReadPhoto(file));
    EXPECT_EQ(detection.ids.size(), 54U) << file << detection.problem;
    ++found;
  }
  EXPECT_EQ(found, 26);
}

}  // namespace
}  // namespace plumbline
