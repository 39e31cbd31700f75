// Accuracy and calibration on photographs of known disparity, beside OpenCV's defaults. The figures
// printed here are those of docs/disparity.md.
#include <gtest/gtest.h>

#include <cstdio>
#include <opencv2/calib3d.hpp>

#include "match/disparity.h"
#include "tests/match/disparity_truth.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

using testing::DisparityScore;
using testing::KnownPair;
using testing::Score;

void Print(const char* name, const DisparityScore& s) {
  std::printf(
      "%-34s density %5.1f %%  >1 px %5.2f %%  >2 px %5.2f %%  rms %.3f px  wrong or missing %5.1f "
      "%%\n",
      name, 100 * s.density, 100 * s.bad1, 100 * s.bad2, s.inlier_rms_px, 100 * s.wrong1);
}

// What a user of OpenCV starts from: the samples' settings, left-right check switched on for SGBM.
Image<float> OpenCvDefault(const KnownPair& pair, DisparityMethod method) {
  cv::Mat found;
  if (method == DisparityMethod::kBm) {
    cv::StereoBM::create(64, 21)->compute(pair.left8, pair.right8, found);
  } else {
    cv::StereoSGBM::create(0, 64, 5, 8 * 25, 32 * 25, 1, 63, 10, 100, 2)
        ->compute(pair.left8, pair.right8, found);
  }
  return testing::FromOpenCv(found, 0);
}

void ExpectBetterThanOpenCv(const KnownPair& pair, DisparityMethod method, const char* name) {
  DisparityOptions options;
  options.method = method;
  const DisparityMap map = ComputeDisparity(pair.left, pair.right, options);
  const Image<float> default_value = OpenCvDefault(pair, method);
  const std::string label = std::string(name) + (method == DisparityMethod::kBm ? " BM" : " SGBM");
  for (const auto* counted : {static_cast<const Image<std::uint8_t>*>(nullptr), &pair.visible}) {
    const auto ours =
        Score(map.value_px, &map.sigma_px, pair.truth, pair.truth_variance_px2, counted);
    const auto theirs = Score(default_value, nullptr, pair.truth, 0, counted);
    const std::string which = counted == nullptr ? " all" : " visible";
    Print((label + which + ", plumbline").c_str(), ours);
    Print((label + which + ", OpenCV").c_str(), theirs);
    EXPECT_LT(ours.bad1, theirs.bad1) << label << which;
    EXPECT_LT(ours.bad2, theirs.bad2) << label << which;
    EXPECT_LT(ours.wrong1, theirs.wrong1) << label << which;
  }
}

TEST(DisparityMiddlebury, IsBetterThanOpenCvsDefaults) {
  PLUMBLINE_SHARED_DATA(folder, "middlebury-cones-teddy-2003");
  for (const char* name : {"cones", "teddy"}) {
    const KnownPair pair = testing::ReadMiddlebury2003(folder / name);
    ExpectBetterThanOpenCv(pair, DisparityMethod::kSgbm, name);
    ExpectBetterThanOpenCv(pair, DisparityMethod::kBm, name);
  }
}

TEST(DisparityMiddlebury, SigmaIsCalibrated) {
  PLUMBLINE_SHARED_DATA(folder, "middlebury-cones-teddy-2003");
  PLUMBLINE_SHARED_DATA(motorcycle, "middlebury-2014-motorcycle");
  const std::pair<const char*, KnownPair> pairs[] = {
      {"cones", testing::ReadMiddlebury2003(folder / "cones")},
      {"teddy", testing::ReadMiddlebury2003(folder / "teddy")},
      {"motorcycle", testing::ReadMotorcycle(motorcycle)}};
  for (const auto& named : pairs) {
    const KnownPair& pair = named.second;
    for (const auto method : {DisparityMethod::kSgbm, DisparityMethod::kBm}) {
      DisparityOptions options;
      options.method = method;
      const DisparityMap map = ComputeDisparity(pair.left, pair.right, options);
      const auto score =
          Score(map.value_px, &map.sigma_px, pair.truth, pair.truth_variance_px2, nullptr);
      const bool sgbm = method == DisparityMethod::kSgbm;
      std::printf("%s %s: within 1 sigma %.3f of the inliers, NEES %.2f\n", named.first,
                  sgbm ? "SGBM" : "BM", score.within_one_sigma, score.mean_squared_z);
      EXPECT_NEAR(score.within_one_sigma, 0.683, 0.05) << named.first;
    }
  }
}

TEST(DisparityMiddlebury, FindsTheRangeOfEachPair) {
  PLUMBLINE_SHARED_DATA(folder, "middlebury-cones-teddy-2003");
  PLUMBLINE_SHARED_DATA(motorcycle, "middlebury-2014-motorcycle");
  const KnownPair pairs[] = {testing::ReadMiddlebury2003(folder / "cones"),
                             testing::ReadMiddlebury2003(folder / "teddy"),
                             testing::ReadMotorcycle(motorcycle)};
  for (const KnownPair& pair : pairs) {
    const DisparityMap map = ComputeDisparity(pair.left, pair.right);
    double outside = 0, known = 0;
    for (const float d : pair.truth.values()) {
      if (!std::isfinite(d)) continue;
      ++known;
      outside += d < static_cast<float>(map.min_disparity_px) ||
                 d > static_cast<float>(map.max_disparity_px);
    }
    EXPECT_LT(outside, 0.001 * known);
    EXPECT_LT(map.max_disparity_px - map.min_disparity_px, 90);
  }
}

}  // namespace
}  // namespace plumbline
