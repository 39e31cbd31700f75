#pragma once

#include <cstdint>
#include <optional>

#include "calib/image.h"
#include "calib/status.h"

namespace plumbline {

// Disparity of a rectified pair: the left pixel (x, y) is seen at (x - value(y, x), y) on the
// right. All images have the size of the pair.
struct DisparityMap {
  Image<float> value_px;  // NaN where status is not kOk
  Image<float> sigma_px;  // one standard deviation; NaN where status is not kOk
  Image<Status> status;
  // The disparities that were searched, given or found; no value lies more than 1 px beyond them.
  int min_disparity_px = 0;
  int max_disparity_px = 0;
};

// kBm: OpenCV's block matcher, fast, for well textured surfaces. kSgbm: semi-global matching
// (Hirschmueller 2008), which carries values across weak texture.
enum class DisparityMethod { kBm, kSgbm };

struct DisparityOptions {
  DisparityMethod method = DisparityMethod::kSgbm;
  std::optional<int> min_disparity_px;  // both or neither; neither: found automatically
  std::optional<int> max_disparity_px;
  int block_px = 0;  // odd side of the matcher's block; 0: the method's own, 5 (SGBM) or 11 (BM)
  double uniqueness_percent = 10;      // by which the best cost must win over the second best
  double left_right_tolerance_px = 1;  // between the match from the left and that from the right
  int refinement_radius_px = 4;  // of the window of (2 radius + 1)^2 that gives value and sigma

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Matches a rectified pair densely.
//
// The matcher (OpenCV's SGBM or BM, on contrast-stretched 8-bit copies) is run from the left and
// from the right; where both agree, the disparity and its slopes are refined on the grey values
// themselves by least squares with gain and offset free (ZNSSD), the matcher's disparity being a
// weak prior. The sigma comes from that least-squares problem's normal matrix, its residual (both
// images' noise), the residuals' correlation over the image and the disagreements seen while
// matching, with global factors fitted once on pairs of known truth: docs/disparity.md. It is about
// pixels matched to the right surface; the few per cent that are not, are wrong by more.
//
// left_valid, right_valid: 0 where a pixel is not to be used; may be null.
// Status:  kMasked (this pixel, or the one it matches), kOutsideImage (match beyond the right
//          image), kLowTexture, kLowCorrelation (best match not unique, or windows unlike),
//          kOccluded (left and right disagree), kFailedVerification (an isolated patch).
// Throws:  UsageError from options.Check(); InputError when images or masks differ in size, are
//          smaller than the windows or too narrow for the range, when no range is given and
//          none can be found.
// Memory:  bounded: a 1920x1200 pair with 256 disparities takes under 2 GB, see docs/disparity.md.
// The result does not depend on the number of threads.
[[nodiscard]] DisparityMap ComputeDisparity(const GrayImage& left_rectified,
                                            const GrayImage& right_rectified,
                                            const DisparityOptions& options = {},
                                            const Image<std::uint8_t>* left_valid = nullptr,
                                            const Image<std::uint8_t>* right_valid = nullptr);

}  // namespace plumbline
