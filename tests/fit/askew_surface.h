#pragma once

#include <Eigen/Core>
#include <functional>
#include <random>

#include "fit/surface_points.h"

namespace plumbline::testing {

inline const ImageSize kAskewSize{41, 35};
inline constexpr double kAskewPitch_mm = 5, kAskewSigma_mm = 0.05;
inline const NeighbourCorrelation kAskewNeighbours =
    NeighbourCorrelation::OfOverlap(kAskewSize, 5, 5, 1);

// A grid that stands askew to the axes. Noise along z alone.
inline SurfacePoints AskewSurface(const std::function<double(double, double)>& height_mm,
                                  std::mt19937* random = nullptr) {
  std::normal_distribution<double> normal(0, kAskewSigma_mm);
  SurfacePoints surface;
  surface.point_mm = Image<Eigen::Vector3d>(kAskewSize, Eigen::Vector3d::Zero());
  Eigen::Matrix<float, 6, 1> cov = Eigen::Matrix<float, 6, 1>::Zero();
  cov[5] = static_cast<float>(kAskewSigma_mm * kAskewSigma_mm);
  surface.cov_random_mm2 = Image<Eigen::Matrix<float, 6, 1>>(kAskewSize, cov);
  for (int r = 0; r < kAskewSize.height; ++r) {
    for (int c = 0; c < kAskewSize.width; ++c) {
      const double x = kAskewPitch_mm * (c - 20 + 0.1 * (r - 17)), y = kAskewPitch_mm * (17 - r);
      surface.point_mm(r, c) = {x, y, height_mm(x, y) + (random != nullptr ? normal(*random) : 0)};
    }
  }
  return surface;
}

}  // namespace plumbline::testing
