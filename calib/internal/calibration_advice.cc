#include "calib/internal/calibration_advice.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/calibration_report.h"

namespace plumbline::internal {
namespace {

constexpr double kDegrees = 180 / M_PI;
constexpr int kFewPairs = 15;
constexpr double kSmallTilt_rad = 20 / kDegrees;
constexpr double kThinCoverage = 0.5;
constexpr double kDisagreement = 3;  // sigmas

double CoveredShare(const Calibration& c, int camera) {
  const Image<int> map = CoverageMap(c, camera);
  const auto covered =
      std::count_if(map.values().begin(), map.values().end(), [](int n) { return n > 0; });
  return static_cast<double>(covered) / static_cast<double>(map.pixel_count());
}

int UsedPairs(const Calibration& c) {
  return static_cast<int>(
      std::count_if(c.pairs.begin(), c.pairs.end(), [](const PairResult& p) { return p.used; }));
}

double LargestTilt(const Calibration& c) {
  double tilt = 0;
  for (const PairResult& p : c.pairs) {
    if (p.used) tilt = std::max(tilt, p.tilt_rad);
  }
  return tilt;
}

// Horizontally apart and the wrong way round: the right camera should stand on the +x side of the
// left one.
bool LooksSwapped(const StereoRig& rig) {
  const Eigen::Vector3d right_centre = rig.right_from_left.Inverse().translation_mm;
  return right_centre.x() < 0 && std::abs(right_centre.x()) > 2 * std::abs(right_centre.y());
}

void WarnOfDisagreement(const HalvesComparison& h, std::vector<std::string>& out) {
  if (std::abs(h.baseline_difference_mm) > kDisagreement * h.baseline_expected_mm) {
    out.push_back(fmt::format(
        "even and odd pairs disagree on the baseline by {:.3f} mm, {:.1f} times what the error bar "
        "lets expect: something changed between the photographs; look at the worst ones",
        h.baseline_difference_mm, std::abs(h.baseline_difference_mm) / h.baseline_expected_mm));
  }
  if (std::abs(h.angle_difference_rad) > kDisagreement * h.angle_expected_rad) {
    out.push_back(fmt::format(
        "even and odd pairs disagree on the angle between the cameras by {:.4f} deg, {:.1f} times "
        "what the error bar lets expect: did a camera move between the photographs?",
        h.angle_difference_rad * kDegrees,
        std::abs(h.angle_difference_rad) / h.angle_expected_rad));
  }
}

}  // namespace

std::vector<std::string> Warnings(const Calibration& c) {
  std::vector<std::string> out;
  for (int camera : {0, 1}) {
    const Camera& lens = camera == 0 ? c.rig.left : c.rig.right;
    const char* side = camera == 0 ? "left" : "right";
    if (const double share = lens.NonInvertibleShare(); share > 0) {
      out.push_back(
          fmt::format("the {} lens model folds over in {:.1f} % of the image, where nothing can be "
                      "measured; add photographs there, or use a smaller --model",
                      side, 100 * share));
    }
  }
  if (c.halves) WarnOfDisagreement(*c.halves, out);
  if (LooksSwapped(c.rig)) {
    out.push_back(
        "the camera called right stands to the left of the other one; if your rig does not, left "
        "and right are swapped: exchange --left and --right, and do the same in measure");
  }
  if (!c.options.known_distance && c.options.scale_sigma > 0) {
    out.push_back(fmt::format(
        "the board's overall scale is taken on trust within {:.3g} %, and no photograph can show "
        "it; measure one long distance on the board and give it as --known-distance ID:ID:MM:SIGMA",
        100 * c.scale_sigma));
  }
  if (const int pairs = UsedPairs(c); pairs < kFewPairs) {
    out.push_back(fmt::format(
        "only {} pairs are used; the error bars of so few are rough, 20 to 40 are better", pairs));
  }
  if (const double tilt = LargestTilt(c); tilt < kSmallTilt_rad) {
    out.push_back(
        fmt::format("the board was tilted by at most {:.0f} deg, which leaves focal length and "
                    "distance tied together; tilt it by 20 to 40 deg in both directions",
                    tilt * kDegrees));
  }
  for (int camera : {0, 1}) {
    if (const double share = CoveredShare(c, camera); share < kThinCoverage) {
      out.push_back(fmt::format(
          "the boards cover {:.0f} % of the {} image; outside of it the lens is extrapolated",
          100 * share, camera == 0 ? "left" : "right"));
    }
  }
  if (c.options.rigid_target && c.fixed_to_board_share > 0.3) {
    out.push_back(
        fmt::format("{:.0f} % of the residual's variance is fixed to the board: it is bent or "
                    "misprinted, and --rigid-target puts its error into the cameras",
                    100 * c.fixed_to_board_share));
  }
  return out;
}

std::string BestImprovement(const Calibration& c) {
  const WorkingUncertainty u = UncertaintyAtWorkingDistance(c);
  if (u.sigma_length_scale_mm > std::max(u.sigma_length_calibration_mm, u.sigma_length_random_mm)) {
    return "measure one long distance on the board and give it as --known-distance: the scale is "
           "the largest part of a length's error";
  }
  if (u.sigma_length_calibration_mm < 0.5 * u.sigma_length_random_mm) {
    return "nothing in the calibration: matching noise is the larger part; sharper images or "
           "larger windows help more";
  }
  if (LargestTilt(c) < kSmallTilt_rad) return "photographs with the board tilted by 20 to 40 deg";
  if (std::min(CoveredShare(c, 0), CoveredShare(c, 1)) < kThinCoverage)
    return "photographs with the board near the image edges and corners";
  return fmt::format("more pairs: the error bars shrink with their square root (now {})",
                     UsedPairs(c));
}

}  // namespace plumbline::internal
