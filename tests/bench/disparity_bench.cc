#include <benchmark/benchmark.h>

#include <cmath>
#include <opencv2/calib3d.hpp>

#include "match/disparity.h"
#include "tests/match/speckle_pair.h"

namespace plumbline {
namespace {

constexpr ImageSize kSize{960, 600};
constexpr int kDisparities = 64;
constexpr testing::DisparityPlane kPlane{24.3, 0.01, -0.01};

const testing::SpecklePair& Pair() {
  static const testing::SpecklePair pair = testing::RenderSpecklePair(kSize, kPlane, 2, 1);
  return pair;
}

// Share of the pixels delivered and within 0.5 px of the truth.
double ShareRight(const Image<float>& value) {
  double right = 0;
  for (int y = 0; y < value.height(); ++y) {
    for (int x = 0; x < value.width(); ++x) {
      right += std::abs(static_cast<double>(value(y, x)) - kPlane.At(x, y)) < 0.5;
    }
  }
  return right / static_cast<double>(value.pixel_count());
}

// Items: pixels times disparities.
void CountItems(benchmark::State& state) {
  state.SetItemsProcessed(state.iterations() * kSize.width * kSize.height * kDisparities);
}

void Disparity(benchmark::State& state) {
  DisparityOptions options;
  options.method = state.range(0) == 0 ? DisparityMethod::kBm : DisparityMethod::kSgbm;
  options.min_disparity_px = 0;
  options.max_disparity_px = kDisparities - 1;
  const auto& pair = Pair();
  DisparityMap map;
  for (auto _ : state) map = ComputeDisparity(pair.left, pair.right, options);
  if (!(ShareRight(map.value_px) > 0.8)) state.SkipWithError("wrong disparities");
  CountItems(state);
}
BENCHMARK(Disparity)->ArgName("sgbm")->Arg(0)->Arg(1)->Unit(benchmark::kMillisecond)->UseRealTime();

// The baseline: OpenCV alone, once from the left, without refinement, verification or sigma.
void OpenCvDisparity(benchmark::State& state) {
  const auto& pair = Pair();
  cv::Mat1b left(kSize.height, kSize.width), right(kSize.height, kSize.width);
  for (int y = 0; y < kSize.height; ++y) {
    for (int x = 0; x < kSize.width; ++x) {
      left(y, x) = static_cast<uchar>(pair.left.grey(y, x));
      right(y, x) = static_cast<uchar>(pair.right.grey(y, x));
    }
  }
  cv::Ptr<cv::StereoMatcher> matcher;
  if (state.range(0) == 0) {
    matcher = cv::StereoBM::create(kDisparities, 11);
  } else {
    matcher = cv::StereoSGBM::create(0, kDisparities, 5, 8 * 25, 32 * 25, 1, 63, 10, 0, 0,
                                     cv::StereoSGBM::MODE_HH);
  }
  cv::Mat found;
  for (auto _ : state) matcher->compute(left, right, found);
  Image<float> value(kSize, -1000);
  for (int y = 0; y < kSize.height; ++y) {
    for (int x = 0; x < kSize.width; ++x) {
      value(y, x) = static_cast<float>(found.at<short>(y, x)) / 16;
    }
  }
  if (!(ShareRight(value) > 0.7)) state.SkipWithError("wrong disparities");
  CountItems(state);
}
BENCHMARK(OpenCvDisparity)
    ->ArgName("sgbm")
    ->Arg(0)
    ->Arg(1)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

}  // namespace
}  // namespace plumbline
