#include "match/disparity.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <cstring>

#include "calib/error.h"
#include "match/internal/dense_match.h"
#include "tests/match/disparity_truth.h"
#include "tests/match/speckle_pair.h"

namespace plumbline {
namespace {

using testing::DisparityPlane;
using testing::RenderSpecklePair;

Image<float> TruthOf(ImageSize size, const DisparityPlane& plane) {
  Image<float> truth(size);
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) truth(y, x) = static_cast<float>(plane.At(x, y));
  }
  return truth;
}

std::size_t Count(const DisparityMap& map, Status status) {
  return static_cast<std::size_t>(
      std::count(map.status.values().begin(), map.status.values().end(), status));
}

template <typename Error, typename Call>
std::string MessageOf(const Call& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

TEST(Disparity, HasNoPhaseBias) {
  // SGBM alone is off by up to 0.2 px between whole pixels (its sub-pixel step is locked to them).
  for (const double phase : {0.0, 0.2, 0.35, 0.5, 0.7, 0.9}) {
    const DisparityPlane plane{6 + phase, 0, 0};
    const auto pair = RenderSpecklePair({200, 120}, plane, 0.5, 3);
    const DisparityMap map = ComputeDisparity(pair.left, pair.right);
    double sum = 0, n = 0;
    for (const float d : map.value_px.values()) {
      if (!std::isfinite(d)) continue;
      sum += static_cast<double>(d) - plane.d;
      ++n;
    }
    EXPECT_GT(n, 0.85 * 200 * 120) << phase;
    EXPECT_NEAR(sum / n, 0, 0.005) << phase;
  }
}

TEST(Disparity, SigmaHoldsOnSpeckle) {
  const ImageSize size{320, 240};
  const struct {
    DisparityPlane plane;
    double noise;
    int bits;
    DisparityMethod method;
  } cases[] = {{{12.3, 0.02, -0.01}, 2, 8, DisparityMethod::kSgbm},
               {{-7.4, 0, 0.03}, 4, 8, DisparityMethod::kSgbm},
               {{-7.4, 0, 0.03}, 4, 12, DisparityMethod::kSgbm},
               {{3.5, -0.03, 0.02}, 1, 12, DisparityMethod::kSgbm},
               {{12.3, 0.02, -0.01}, 2, 8, DisparityMethod::kBm}};
  std::uint32_t seed = 11;
  for (const auto& c : cases) {
    const auto pair = RenderSpecklePair(size, c.plane, c.noise, seed++, c.bits);
    DisparityOptions options;
    options.method = c.method;
    const DisparityMap map = ComputeDisparity(pair.left, pair.right, options);
    const auto score =
        testing::Score(map.value_px, &map.sigma_px, TruthOf(size, c.plane), 0, nullptr);
    std::printf("noise %.0f, %d bits: density %.3f rms %.4f px, within 1 sigma %.3f, NEES %.3f\n",
                c.noise, c.bits, score.density, score.inlier_rms_px, score.within_one_sigma,
                score.mean_squared_z);
    EXPECT_GT(score.density, 0.85);
    EXPECT_LT(score.bad1, 0.003);
    EXPECT_NEAR(score.within_one_sigma, 0.683, 0.06);
    EXPECT_NEAR(score.mean_squared_z, 1, 0.25);
  }
}

TEST(Disparity, FollowsSteepSlopes) {
  const DisparityPlane plane{5, 0.12, -0.15};
  const auto pair = RenderSpecklePair({240, 160}, plane, 1, 21);
  const DisparityMap map = ComputeDisparity(pair.left, pair.right);
  const auto score =
      testing::Score(map.value_px, &map.sigma_px, TruthOf({240, 160}, plane), 0, nullptr);
  EXPECT_GT(score.density, 0.75);
  EXPECT_LT(score.inlier_rms_px, 0.1);
}

TEST(Disparity, FindsNegativeRanges) {
  const DisparityPlane plane{-37.3, 0, 0.05};
  const auto pair = RenderSpecklePair({260, 160}, plane, 1, 5);
  const DisparityMap map = ComputeDisparity(pair.left, pair.right);
  EXPECT_LE(map.min_disparity_px, -38);
  EXPECT_GE(map.max_disparity_px, -29);
  EXPECT_LT(map.max_disparity_px - map.min_disparity_px, 60);
  const auto score =
      testing::Score(map.value_px, &map.sigma_px, TruthOf({260, 160}, plane), 0, nullptr);
  EXPECT_GT(score.density, 0.7);  // 37 of 260 columns have their match outside
  EXPECT_LT(score.bad1, 0.001);
}

TEST(Disparity, SearchesTheGivenRangeOnly) {
  const auto pair = RenderSpecklePair({200, 100}, {8.4, 0, 0}, 1, 6);
  DisparityOptions options;
  options.min_disparity_px = 0;
  options.max_disparity_px = 20;
  const DisparityMap map = ComputeDisparity(pair.left, pair.right, options);
  EXPECT_EQ(map.min_disparity_px, 0);
  EXPECT_EQ(map.max_disparity_px, 20);
  EXPECT_NEAR(map.value_px(50, 100), 8.4, 0.1);
  // A range that does not hold the truth gives statuses, not numbers.
  options.min_disparity_px = 30;
  options.max_disparity_px = 60;
  const DisparityMap none = ComputeDisparity(pair.left, pair.right, options);
  EXPECT_LT(static_cast<double>(Count(none, Status::kOk)), 0.01 * 200 * 100);
}

TEST(Disparity, EveryPixelHasAValueOrAReason) {
  const auto pair = RenderSpecklePair({200, 120}, {17.2, 0, 0}, 2, 8);
  Image<std::uint8_t> left_valid(pair.left.size(), 1), right_valid(pair.left.size(), 1);
  for (int y = 40; y < 60; ++y) {
    for (int x = 80; x < 100; ++x) left_valid(y, x) = 0;
    for (int x = 120; x < 130; ++x) right_valid(y, x) = 0;
  }
  const DisparityMap map = ComputeDisparity(pair.left, pair.right, {}, &left_valid, &right_valid);
  for (std::size_t i = 0; i < map.status.pixel_count(); ++i) {
    const bool ok = map.status.data()[i] == Status::kOk;
    ASSERT_EQ(ok, std::isfinite(map.value_px.data()[i]));
    ASSERT_EQ(ok, std::isfinite(map.sigma_px.data()[i]));
    if (ok) {
      ASSERT_GT(map.sigma_px.data()[i], 0);
    }
  }
  EXPECT_EQ(map.status(50, 90), Status::kMasked);
  EXPECT_EQ(map.status(50, 142), Status::kMasked);  // matches column 125 of the right image
  for (int y = 10; y < 110; ++y) EXPECT_NE(map.status(y, 8), Status::kOk);
  EXPECT_GT(Count(map, Status::kOutsideImage) + Count(map, Status::kOccluded), 15U * 100U);
}

TEST(Disparity, MarksWhatTheRightCameraCannotSee) {
  // A square in front of a wall: left of it, 12 px of the wall are hidden from the right camera.
  const ImageSize size{240, 140};
  auto pair = RenderSpecklePair(size, {6, 0, 0}, 1, 31);
  const auto near_pair = RenderSpecklePair(size, {18, 0, 0}, 1, 32);
  for (int y = 40; y < 100; ++y) {
    for (int x = 100; x < 160; ++x) {
      pair.left.grey(y, x) = near_pair.left.grey(y, x);
      pair.right.grey(y, x - 18) = near_pair.right.grey(y, x - 18);
    }
  }
  const DisparityMap map = ComputeDisparity(pair.left, pair.right);
  EXPECT_NEAR(map.value_px(70, 130), 18, 0.2);
  EXPECT_NEAR(map.value_px(70, 60), 6, 0.2);
  int occluded = 0;
  for (int y = 50; y < 90; ++y) {
    for (int x = 90; x < 98; ++x) occluded += map.status(y, x) == Status::kOccluded;
  }
  EXPECT_GT(occluded, 0.6 * 40 * 8);
}

TEST(Disparity, GivesNoNumbersForWhatShowsNothing) {
  const GrayImage blank{Image<std::uint16_t>({160, 120}, 90), 8};
  DisparityOptions options;
  EXPECT_NE(MessageOf<InputError>([&] {
              (void)ComputeDisparity(blank, blank, options);
            }).find("no disparity range could be found"),
            std::string::npos);
  options.min_disparity_px = -10;
  options.max_disparity_px = 30;
  for (const auto method : {DisparityMethod::kSgbm, DisparityMethod::kBm}) {
    options.method = method;
    EXPECT_EQ(Count(ComputeDisparity(blank, blank, options), Status::kOk), 0U);
    // Two unrelated surfaces, and a grey wall with noise only.
    const auto one = RenderSpecklePair({160, 120}, {}, 2, 41);
    const auto other = RenderSpecklePair({160, 120}, {}, 2, 42);
    EXPECT_LT(
        static_cast<double>(Count(ComputeDisparity(one.left, other.right, options), Status::kOk)),
        0.01 * 160 * 120);
    auto wall = RenderSpecklePair({160, 120}, {}, 3, 43);
    for (GrayImage* image : {&wall.left, &wall.right}) {
      std::uint32_t state = image == &wall.left ? 1 : 2;
      for (auto& grey : image->grey.values()) {
        state = state * 1664525U + 1013904223U;
        grey = static_cast<std::uint16_t>(100 + (state >> 29));
      }
    }
    EXPECT_LT(
        static_cast<double>(Count(ComputeDisparity(wall.left, wall.right, options), Status::kOk)),
        0.01 * 160 * 120);
  }
}

TEST(Disparity, RefusesBadInput) {
  const GrayImage a{Image<std::uint16_t>({160, 120}, 90), 8};
  const GrayImage b{Image<std::uint16_t>({160, 121}, 90), 8};
  const GrayImage tiny{Image<std::uint16_t>({9, 9}, 90), 8};
  const Image<std::uint8_t> mask({160, 121}, 1);
  EXPECT_NE(MessageOf<InputError>([&] { (void)ComputeDisparity(a, b); }).find("160x121"),
            std::string::npos);
  EXPECT_NE(MessageOf<InputError>([&] { (void)ComputeDisparity(tiny, tiny); }).find("9x9"),
            std::string::npos);
  EXPECT_NE(MessageOf<InputError>([&] { (void)ComputeDisparity({}, {}); }).find("0x0"),
            std::string::npos);
  EXPECT_NE(MessageOf<InputError>([&] { (void)ComputeDisparity(a, a, {}, &mask); }).find("mask"),
            std::string::npos);
  DisparityOptions far;
  far.min_disparity_px = 500;
  far.max_disparity_px = 600;
  EXPECT_NE(MessageOf<InputError>([&] { (void)ComputeDisparity(a, a, far); }).find("500 to 600"),
            std::string::npos);
}

TEST(Disparity, OptionsNameTheBrokenConstraint) {
  const auto message = [](const auto& change) {
    DisparityOptions options;
    change(options);
    return MessageOf<UsageError>([&] { options.Check(); });
  };
  EXPECT_EQ(message([](auto&) {}), "");
  EXPECT_NE(message([](auto& o) { o.min_disparity_px = 3; }).find("both"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.min_disparity_px = 3, o.max_disparity_px = 1; }).find("3 to 1"),
            std::string::npos);
  EXPECT_NE(
      message([](auto& o) { o.min_disparity_px = 0, o.max_disparity_px = 5000; }).find("too wide"),
      std::string::npos);
  EXPECT_NE(message([](auto& o) { o.block_px = 4; }).find("block_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.uniqueness_percent = -1; }).find("uniqueness_percent"),
            std::string::npos);
  EXPECT_NE(message([](auto& o) { o.uniqueness_percent = NAN; }).find("uniqueness_percent"),
            std::string::npos);
  EXPECT_NE(message([](auto& o) { o.left_right_tolerance_px = 0; }).find("left_right_tolerance_px"),
            std::string::npos);
  EXPECT_NE(message([](auto& o) { o.refinement_radius_px = 1; }).find("refinement_radius_px"),
            std::string::npos);
}

TEST(Disparity, IsTheSameForAnyNumberOfThreads) {
  const auto pair = RenderSpecklePair({200, 150}, {9.6, 0.03, 0}, 2, 51);
  const auto run = [&](std::size_t threads) {
    tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    return ComputeDisparity(pair.left, pair.right);
  };
  const DisparityMap one = run(1), four = run(4);
  EXPECT_EQ(one.status.values(), four.status.values());
  EXPECT_EQ(std::memcmp(one.value_px.data(), four.value_px.data(), 4 * 200 * 150), 0);
  EXPECT_EQ(std::memcmp(one.sigma_px.data(), four.sigma_px.data(), 4 * 200 * 150), 0);
}

TEST(DenseMatch, StaysWithinItsMemory) {
  // Matching alone; images and maps of 1920x1200 add some 150 MB.
  EXPECT_LT(internal::DenseMatchBytes({1920, 1200}, 256, DisparityMethod::kSgbm),
            std::int64_t{1400} << 20);
  EXPECT_LT(internal::DenseMatchBytes({4096, 3000}, 1024, DisparityMethod::kSgbm),
            std::int64_t{1400} << 20);
}

TEST(DenseMatch, BandsDoNotShow) {
  // 150 px wide with 500 disparities passes the memory of one band: the rows are cut, and the
  // surface must run on over the cuts.
  const DisparityPlane plane{20.3, 0, 0.02};
  const auto pair = RenderSpecklePair({150, 700}, plane, 1, 61);
  DisparityOptions options;
  options.min_disparity_px = 0;
  options.max_disparity_px = 495;
  const DisparityMap map = ComputeDisparity(pair.left, pair.right, options);
  for (int y = 1; y < 700; ++y) {
    int ok = 0;
    for (int x = 50; x < 140; ++x) ok += map.status(y, x) == Status::kOk;
    ASSERT_GT(ok, 45) << "row " << y;
  }
}

}  // namespace
}  // namespace plumbline
