#include "match/internal/dense_match.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace plumbline::internal {
namespace {

// Rows that a band computes beyond those it delivers, so that paths of the semi-global cost have
// run in; and the bytes that one band may take.
constexpr int kOverlapRows = 40;
constexpr int kFewestRows = 64;
constexpr std::int64_t kBandBytes = std::int64_t{320} << 20;
constexpr std::int64_t kTotalBytes = std::int64_t{1300} << 20;

struct Bands {
  bool full_paths = true;  // MODE_HH: eight paths; else MODE_SGBM_3WAY, whose memory is one row's
  int rows = 0;            // delivered by one band
  std::int64_t bytes = 0;  // of one band
};

// MODE_HH keeps matching cost and path cost, 2 bytes each, for all pixels and disparities.
Bands PlanBands(ImageSize size, int disparity_count, DisparityMethod method) {
  const std::int64_t row_bytes = std::int64_t{4} * (size.width + disparity_count) * disparity_count;
  Bands plan;
  if (method == DisparityMethod::kBm) {
    plan.rows = size.height;
    plan.bytes = std::int64_t{8} * (size.width + disparity_count) * size.height;
    return plan;
  }
  const std::int64_t rows = kBandBytes / row_bytes - 2 * kOverlapRows;
  if (rows >= kFewestRows || size.height * row_bytes <= kBandBytes) {
    const auto bands =
        std::max<std::int64_t>(1, (size.height + rows - 1) / std::max<std::int64_t>(1, rows));
    plan.rows = size.height * row_bytes <= kBandBytes
                    ? size.height
                    : static_cast<int>((size.height + bands - 1) / bands);
    plan.bytes = row_bytes * std::min<std::int64_t>(size.height, plan.rows + 2 * kOverlapRows);
  } else {
    plan.full_paths = false;
    plan.rows = size.height;
    plan.bytes = row_bytes * 4;
  }
  return plan;
}

cv::Ptr<cv::StereoMatcher> MakeMatcher(const DisparityOptions& options, int disparity_count,
                                       bool full_paths) {
  const int block = BlockPx(options);
  const int uniqueness = cvRound(options.uniqueness_percent);
  if (options.method == DisparityMethod::kBm) {
    auto bm = cv::StereoBM::create(disparity_count, block);
    bm->setUniquenessRatio(uniqueness);
    bm->setTextureThreshold(0);  // our own test of texture comes after, in sigmas
    return bm;
  }
  // Hirschmueller 2008; penalties as OpenCV's documentation gives them for one channel. The
  // matcher's own left-right check reuses one cost volume: switched off, ours matches twice.
  constexpr int kNoLeftRightCheck = 1 << 20;
  return cv::StereoSGBM::create(
      0, disparity_count, block, 8 * block * block, 32 * block * block, kNoLeftRightCheck, 63,
      uniqueness, 0, 0, full_paths ? cv::StereoSGBM::MODE_HH : cv::StereoSGBM::MODE_SGBM_3WAY);
}

// OpenCV delivers only pixels whose whole range lies inside the right image. So the left image
// gets `count` columns before its first, and the right one is moved by the least disparity: then
// the range starts at 0 and each pixel is searched.
void PadForRange(const cv::Mat1b& left, const cv::Mat1b& right, const DisparityRange& range,
                 cv::Mat1b* padded_left, cv::Mat1b* padded_right) {
  const int width = left.cols;
  cv::copyMakeBorder(left, *padded_left, 0, 0, range.count, 0, cv::BORDER_REPLICATE);
  padded_right->create(right.rows, width + range.count);
  for (int y = 0; y < right.rows; ++y) {
    const uchar* from = right.ptr(y);
    uchar* to = padded_right->ptr(y);
    for (int x = 0; x < width + range.count; ++x) {
      to[x] = from[std::clamp(x - range.count - range.minimum_px, 0, width - 1)];
    }
  }
}

int DisparitySteps(const DisparityRange& range) { return (range.count + 15) / 16 * 16; }

}  // namespace

int BlockPx(const DisparityOptions& options) {
  if (options.block_px > 0) return options.block_px;
  return options.method == DisparityMethod::kBm ? 11 : 5;
}

std::int64_t DenseMatchBytes(ImageSize size, int disparity_count, DisparityMethod method) {
  const Bands plan = PlanBands(size, (disparity_count + 15) / 16 * 16, method);
  const std::int64_t bands = (size.height + plan.rows - 1) / plan.rows;
  return std::max(plan.bytes, std::min(plan.bytes * bands, kTotalBytes));
}

cv::Mat1b StretchTo8Bit(const GrayImage& image, const Image<std::uint8_t>* valid) {
  std::vector<std::int64_t> histogram(1 << 16, 0);
  std::int64_t total = 0;
  for (std::size_t i = 0; i < image.grey.pixel_count(); ++i) {
    if (valid != nullptr && valid->data()[i] == 0) continue;
    ++histogram[image.grey.data()[i]];
    ++total;
  }
  const auto level_below_which = [&](double share) {
    std::int64_t sum = 0;
    int level = 0;
    while (level < (1 << 16) - 1) {
      sum += histogram[static_cast<std::size_t>(level)];
      if (static_cast<double>(sum) > share * static_cast<double>(total)) break;
      ++level;
    }
    return level;
  };
  cv::Mat1b stretched(image.height(), image.width(), uchar{0});
  if (total == 0) return stretched;
  const int low = level_below_which(0.005);
  const int high = level_below_which(0.995);
  if (high <= low) return stretched;
  std::vector<uchar> table(1 << 16);
  for (std::size_t i = 0; i < table.size(); ++i) {
    table[i] = cv::saturate_cast<uchar>(255.0 * (static_cast<double>(i) - low) / (high - low));
  }
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) stretched(y, x) = table[image.grey(y, x)];
  }
  return stretched;
}

cv::Mat1s MatchDense(const cv::Mat1b& left, const cv::Mat1b& right, const DisparityRange& range,
                     const DisparityOptions& options) {
  const DisparityRange padded{range.minimum_px, DisparitySteps(range)};
  cv::Mat1b padded_left, padded_right;
  PadForRange(left, right, padded, &padded_left, &padded_right);
  const int height = left.rows;
  const Bands plan = PlanBands({left.cols, height}, padded.count, options.method);
  const int bands = (height + plan.rows - 1) / plan.rows;
  cv::Mat1s disparity(height, left.cols);
  const auto run_band = [&](int band) {
    const int first = band * plan.rows;
    const int last = std::min(height, first + plan.rows);
    const cv::Range rows(std::max(0, first - kOverlapRows), std::min(height, last + kOverlapRows));
    cv::Mat found;
    MakeMatcher(options, padded.count, plan.full_paths)
        ->compute(padded_left.rowRange(rows), padded_right.rowRange(rows), found);
    found(cv::Range(first - rows.start, last - rows.start),
          cv::Range(padded.count, padded.count + left.cols))
        .copyTo(disparity.rowRange(first, last));
  };
  const auto at_once = static_cast<int>(
      std::max<std::int64_t>(1, kTotalBytes / std::max<std::int64_t>(1, plan.bytes)));
  tbb::task_arena arena(std::min(at_once, tbb::this_task_arena::max_concurrency()));
  arena.execute([&] { tbb::parallel_for(0, bands, run_band); });
  return disparity;
}

cv::Mat1s MatchDenseFromRight(const cv::Mat1b& left, const cv::Mat1b& right,
                              const DisparityRange& range, const DisparityOptions& options) {
  // Mirrored left to right, the right camera is the left one of a pair with the same disparities.
  cv::Mat mirrored_left, mirrored_right, back;
  cv::flip(left, mirrored_left, 1);
  cv::flip(right, mirrored_right, 1);
  cv::flip(MatchDense(mirrored_right, mirrored_left, range, options), back, 1);
  return back;
}

}  // namespace plumbline::internal
