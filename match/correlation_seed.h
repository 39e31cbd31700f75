#pragma once

#include <Eigen/Core>

namespace plumbline {

// A place where the motion is known well enough for the correlator to start: to about a pixel, and
// its gradient to about 0.1 over the subset.
struct CorrelationSeed {
  Eigen::Vector2d reference_px{0, 0};
  Eigen::Vector2d displacement_px{0, 0};               // deformed_px = reference_px + this
  Eigen::Matrix2d gradient = Eigen::Matrix2d::Zero();  // (du/dx, du/dy; dv/dx, dv/dy)
  double score = 0;                                    // how good, 0..1: the best go first
};

}  // namespace plumbline
