#pragma once

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "calib/stereo_rig.h"
#include "calib/triangulate.h"

namespace plumbline::testing {

// Matches of a curved surface 400 mm away, all over a view of 640 x 512 px, that claim a noise of
// claimed_px and have noise_px.
inline std::vector<StereoObservation> SeeCurvedSurface(const StereoRig& rig, double claimed_px,
                                                       double noise_px, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, noise_px);
  std::vector<StereoObservation> seen;
  for (int row = 20; row < 500; row += 24) {
    for (int column = 20; column < 630; column += 24) {
      const Eigen::Vector3d ray = rig.left.Unproject(Eigen::Vector2d(column, row));
      const Eigen::Vector3d point = ray / ray.z() * (400 + 0.0003 * std::pow(column - 320, 2));
      StereoObservation match;
      match.left = Eigen::Vector2d(column + noise(random), row + noise(random));
      match.right = rig.right.Project(rig.right_from_left * point) +
                    Eigen::Vector2d(noise(random), noise(random));
      match.cov_px2 = Eigen::Matrix4d::Identity() * claimed_px * claimed_px;
      seen.push_back(match);
    }
  }
  return seen;
}

}  // namespace plumbline::testing
