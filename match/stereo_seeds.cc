#include "match/stereo_seeds.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/triangulate.h"

namespace plumbline {
namespace {

using Cell = std::pair<int, int>;

void CheckSize(const GrayImage& image, const Camera& camera, const char* side) {
  if (image.size() == camera.size()) return;
  throw InputError(
      fmt::format("the {} image has {} x {} px, but that camera was calibrated with {} x {} px",
                  side, image.width(), image.height(), camera.size().width, camera.size().height));
}

bool Inside(const Eigen::Vector2d& pixel, ImageSize size) {
  return pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() <= size.width - 1 &&
         pixel.y() <= size.height - 1;
}

// Leaves out the seeds that the rig contradicts.
void KeepEpipolar(const StereoRig& rig, double max_epipolar_px, StereoSeeds& found) {
  std::vector<StereoObservation> observations;
  for (const CorrelationSeed& seed : found.seeds) {
    observations.push_back({seed.reference_px, seed.reference_px + seed.displacement_px});
  }
  const std::vector<TriangulatedPoint> points = Triangulate(rig, observations);
  std::vector<CorrelationSeed> kept;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const bool off = !(std::abs(points[i].epipolar_px) <= max_epipolar_px);
    const bool behind = points[i].status == Status::kBehindCamera;
    found.off_epipolar += off;
    found.behind_camera += behind;
    if (!off && points[i].status == Status::kOk) kept.push_back(found.seeds[i]);
  }
  found.found = static_cast<std::int64_t>(points.size());
  found.seeds = std::move(kept);
}

class DisparitySeeds {
 public:
  DisparitySeeds(const StereoRig& rig, const GrayImage& left, const GrayImage& right,
                 const Image<std::uint8_t>* mask, const StereoSeedOptions& options)
      : left_size_(left.size()),
        right_size_(right.size()),
        mask_(mask),
        spacing_px_(options.seeds.fft.spacing_px),
        rectification_(rig, options.rectification) {
    Image<std::uint8_t> left_valid, right_valid;
    const GrayImage left_rectified = rectification_.RemapLeft(left, &left_valid);
    const GrayImage right_rectified = rectification_.RemapRight(right, &right_valid);
    disparity_ = ComputeDisparity(left_rectified, right_rectified, options.disparity, &left_valid,
                                  &right_valid);
  }

  // One in each cell that `taken` does not hold.
  std::vector<CorrelationSeed> Seeds(const std::set<Cell>& taken) const {
    std::vector<CorrelationSeed> seeds;
    for (int y = spacing_px_ / 2; y < left_size_.height; y += spacing_px_) {
      for (int x = spacing_px_ / 2; x < left_size_.width; x += spacing_px_) {
        if (taken.contains({y / spacing_px_, x / spacing_px_})) continue;
        if (mask_ != nullptr && (*mask_)(y, x) == 0) continue;
        AddSeed({x, y}, seeds);
      }
    }
    return seeds;
  }

 private:
  static constexpr int kRadius = 4;  // rectified px, of the window that gives value and slope

  void AddSeed(const Eigen::Vector2d& left_px, std::vector<CorrelationSeed>& seeds) const;
  bool FitDisparity(const Eigen::Vector2i& at, double* value, Eigen::RowVector2d* slope) const;

  ImageSize left_size_, right_size_;
  const Image<std::uint8_t>* mask_;
  int spacing_px_;
  Rectification rectification_;
  DisparityMap disparity_;
};

// A plane through the disparities of a window.
bool DisparitySeeds::FitDisparity(const Eigen::Vector2i& at, double* value,
                                  Eigen::RowVector2d* slope) const {
  const ImageSize size = disparity_.status.size();
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
  std::vector<double> values;
  for (int dy = -kRadius; dy <= kRadius; ++dy) {
    for (int dx = -kRadius; dx <= kRadius; ++dx) {
      const int x = at.x() + dx, y = at.y() + dy;
      if (x < 0 || y < 0 || x >= size.width || y >= size.height) continue;
      if (disparity_.status(y, x) != Status::kOk) continue;
      const Eigen::Vector3d row(1, dx, dy);
      const double d = static_cast<double>(disparity_.value_px(y, x));
      normal += row * row.transpose();
      rhs += row * d;
      values.push_back(d);
    }
  }
  constexpr int kWindow = (2 * kRadius + 1) * (2 * kRadius + 1);
  if (static_cast<int>(values.size()) * 3 < kWindow * 2) return false;
  const Eigen::Vector3d plane = normal.ldlt().solve(rhs);
  // A step in the window is no slope.
  if (std::abs(plane[0] - Median(std::move(values))) > 1 || !plane.allFinite()) return false;
  *value = plane[0];
  *slope = plane.tail<2>().transpose();
  return true;
}

void DisparitySeeds::AddSeed(const Eigen::Vector2d& left_px,
                             std::vector<CorrelationSeed>& seeds) const {
  const Eigen::Vector2d there = rectification_.LeftRectifiedPixel(left_px);
  if (!there.allFinite() || !Inside(there, disparity_.status.size())) return;
  const Eigen::Vector2d centre = there.array().round();
  double d = 0;
  Eigen::RowVector2d slope;
  if (!FitDisparity(centre.cast<int>(), &d, &slope)) return;
  Eigen::Matrix2d raw_left, raw_right;  // d raw / d rectified
  const Eigen::Vector2d from = rectification_.LeftRawPixel(centre, &raw_left);
  const Eigen::Vector2d to = rectification_.RightRawPixel({centre.x() - d, centre.y()}, &raw_right);
  if (!from.allFinite() || !to.allFinite() || !Inside(to, right_size_)) return;
  Eigen::Matrix2d rectified = Eigen::Matrix2d::Identity();
  rectified.row(0) -= slope;
  const Eigen::Matrix2d gradient =
      raw_right * rectified * raw_left.inverse() - Eigen::Matrix2d::Identity();
  if (!gradient.allFinite() || (Eigen::Matrix2d::Identity() + gradient).determinant() <= 0) return;
  seeds.push_back({from, to - from, gradient, 0.5});
}

// Cells of the left image that have texture to match, and those among them that have a seed.
struct Coverage {
  std::int64_t cells = 0;
  std::set<Cell> taken;
};

Coverage CoverageOf(const std::vector<CorrelationSeed>& seeds, ImageSize size,
                    const Image<std::uint8_t>* mask, int spacing_px) {
  Coverage coverage;
  for (int y = spacing_px / 2; y < size.height; y += spacing_px) {
    for (int x = spacing_px / 2; x < size.width; x += spacing_px) {
      coverage.cells += mask == nullptr || (*mask)(y, x) != 0;
    }
  }
  for (const CorrelationSeed& seed : seeds) {
    const Eigen::Vector2i cell = (seed.reference_px / spacing_px).array().floor().cast<int>();
    coverage.taken.insert({cell.y(), cell.x()});
  }
  return coverage;
}

}  // namespace

void StereoSeedOptions::Check() const {
  seeds.Check();
  rectification.Check();
  disparity.Check();
  if (!(max_epipolar_px > 0)) {
    throw UsageError("The distance of a seed from its epipolar line has to be above 0 px.");
  }
  if (!(min_cell_share >= 0 && min_cell_share <= 1)) {
    throw UsageError(fmt::format(
        "The share of cells with a seed lies between 0 and 1; {} does not.", min_cell_share));
  }
}

StereoSeeds FindStereoSeeds(const StereoRig& rig, const GrayImage& left, const GrayImage& right,
                            const Image<std::uint8_t>* mask, const StereoSeedOptions& options) {
  options.Check();
  CheckSize(left, rig.left, "left");
  CheckSize(right, rig.right, "right");
  StereoSeeds result;
  if (left.size() == right.size()) {
    result.seeds = FindSeeds(left, right, mask, options.seeds);
    KeepEpipolar(rig, options.max_epipolar_px, result);
    if (result.ContradictRig()) return result;
  }
  const Coverage coverage =
      CoverageOf(result.seeds, left.size(), mask, options.seeds.fft.spacing_px);
  if (static_cast<double>(coverage.taken.size()) >=
      options.min_cell_share * static_cast<double>(coverage.cells)) {
    return result;
  }
  try {
    const DisparitySeeds dense(rig, left, right, mask, options);
    const std::vector<CorrelationSeed> more = dense.Seeds(coverage.taken);
    result.seeds.insert(result.seeds.end(), more.begin(), more.end());
    result.from_disparity = true;
  } catch (const InputError&) {
    // The rectified pair cannot be matched: what features gave has to do, and if that is nothing
    // but contradictions of the rig, they are the better answer.
    if (result.found == 0) throw;
  }
  return result;
}

}  // namespace plumbline
