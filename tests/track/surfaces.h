#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

#include "track/surface_strain.h"

namespace plumbline::testing {

inline constexpr int kStepPx = 5, kSubsetPx = 21;
inline constexpr double kMmPerPx = 0.1;
inline constexpr ImageSize kGrid{25, 21};
inline constexpr StrainMeasure kMeasures[] = {StrainMeasure::kGreenLagrange, StrainMeasure::kSmall,
                                              StrainMeasure::kHencky, StrainMeasure::kAlmansi};

// A point in space by its place on the surface (mm along columns and rows, 0 in the middle).
using Surface = std::function<Eigen::Vector3d(double s_mm, double t_mm)>;

inline SurfaceState InstantOf(ImageSize grid, const Surface& at) {
  SurfaceState instant;
  instant.point_mm = Image<Eigen::Vector3d>(grid, Eigen::Vector3d::Zero());
  for (int r = 0; r < grid.height; ++r) {
    for (int c = 0; c < grid.width; ++c)
      instant.point_mm(r, c) =
          at(kMmPerPx * kStepPx * (c - grid.width / 2), kMmPerPx * kStepPx * (r - grid.height / 2));
  }
  instant.d_left = Image<Eigen::Matrix<float, 3, 2>>(grid, Eigen::Matrix<float, 3, 2>::Zero());
  instant.d_right = instant.d_left;
  instant.scale_left = instant.scale_right = Image<float>(grid, 1);
  instant.share_left = instant.share_right = Image<float>(grid, 0.5F);
  return instant;
}

inline Image<Status> AllOk(ImageSize grid) { return Image<Status>(grid, Status::kOk); }

inline SurfaceGauges GaugesOf(const SurfaceState& reference,
                              const SurfaceStrainOptions& options = {}) {
  const ImageSize grid = reference.point_mm.size();
  // Of a texture that is poorer in some columns; those differ where weights do.
  Image<Eigen::Vector3f> cov_px2(grid, Eigen::Vector3f(1e-4F, 0, 2e-4F));
  if (options.weights == GaugeWeights::kInverseVariance) {
    for (int r = 0; r < grid.height; ++r) {
      for (int c = 0; c < grid.width; ++c) cov_px2(r, c) *= 1 + static_cast<float>((c + 2 * r) % 7);
    }
  }
  return {
      reference, std::move(cov_px2), NeighbourCorrelation::OfOverlap(grid, kStepPx, kSubsetPx, 1),
      kStepPx,   kSubsetPx,          options};
}

inline void Remove(SurfaceState& instant, int row, int column) {
  instant.point_mm(row, column).setConstant(std::numeric_limits<double>::quiet_NaN());
}

// A surface that is curved both ways.
inline Eigen::Vector3d OnSaddle(double s, double t) {
  return {s + 0.1 * t, 0.9 * t - 2, 400 + 0.02 * s * s - 0.03 * t * t + 0.01 * s * t + 0.3 * s};
}

// Stretched, sheared and tilted: the axes turn and their errors count.
inline Eigen::Vector3d OnLoadedSaddle(double s, double t) {
  return Eigen::AngleAxisd(0.35, Eigen::Vector3d::UnitX()) *
             (OnSaddle(1.15 * s + 0.04 * t, 0.93 * t) - Eigen::Vector3d(0, 0, 400)) +
         Eigen::Vector3d(0, 0, 395);
}

// A stereo rig's derivatives, roughly, that vary over the grid by some per cent; matches of
// different sigma and share.
inline void AddMatches(SurfaceState& instant, bool at_reference) {
  const ImageSize grid = instant.point_mm.size();
  for (int r = 0; r < grid.height; ++r) {
    for (int c = 0; c < grid.width; ++c) {
      const double along = 0.1 * (c - 0.5 * grid.width) / grid.width;
      const double down = 0.1 * (r - 0.5 * grid.height) / grid.height;
      Eigen::Matrix<double, 3, 2> left, right;
      left << 0.12, 0.01 + along, 0.02, 0.09, 0.30 + down, -0.05;
      right << -0.03, 0.005, 0.01, 0.05 + down, -0.33 + along, 0.04;
      if (!at_reference) {
        instant.d_left(r, c) = left.cast<float>();
        right *= 1.1;
      }
      instant.d_right(r, c) = right.cast<float>();
      instant.scale_left(r, c) = static_cast<float>(1.2 + along);
      instant.scale_right(r, c) = static_cast<float>((at_reference ? 0.9 : 1.1) + down);
      instant.share_left(r, c) = 0.6F;
      instant.share_right(r, c) = at_reference ? 0.5F : 0.4F;
    }
  }
}

// Modes that bend, turn and stretch space, of the size a good calibration has.
inline std::vector<std::function<Eigen::Vector3d(const Eigen::Vector3d&)>> Modes() {
  return {[](const Eigen::Vector3d& p) {
            return Eigen::Vector3d(2e-5 * p.x() * p.y(), 0, 2e-4 * p.x());
          },
          [](const Eigen::Vector3d& p) {
            return Eigen::Vector3d(0, 5e-4 * p.y(), 3e-6 * p.z() * p.z());
          },
          [](const Eigen::Vector3d& p) {
            return Eigen::Vector3d(3e-5 * p.y() * p.y(), 1e-4 * p.z(), 0);
          }};
}

inline void AddModes(SurfaceState& instant) {
  for (const auto& mode : Modes()) {
    Image<Eigen::Vector3f> along(instant.point_mm.size(), Eigen::Vector3f::Zero());
    for (std::size_t i = 0; i < along.pixel_count(); ++i)
      along.data()[i] = mode(instant.point_mm.data()[i]).cast<float>();
    instant.along_modes_mm.push_back(along);
  }
}

}  // namespace plumbline::testing
