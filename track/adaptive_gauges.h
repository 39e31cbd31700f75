#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/image.h"
#include "calib/status.h"
#include "match/neighbour_correlation.h"
#include "track/surface_state.h"
#include "track/surface_strain.h"

namespace plumbline {

struct AdaptiveGaugesOptions {
  // Of the gauges; window_points is the largest window.
  SurfaceStrainOptions gauge;
  // The smallest window, odd; 0: all gauges have the largest.
  int smallest_window_points = 0;
  // How many sigmas of their difference a larger gauge may say otherwise than a smaller one.
  double agreement_sigmas = 1.7;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// SurfaceStrain with a window at each point; the images are empty where all gauges have the same.
struct AdaptiveStrain {
  SurfaceStrain strain;  // window_points, vsg_px and vsg_mm of the largest window
  Image<float> window_points;
  // One standard deviation of what the gauge's polynomial leaves out, by component: neither random
  // nor of the calibration. NaN where there is no other gauge to tell.
  Image<Eigen::Vector3f> sigma_model;
};

// Strain over gauges that are as large as the surface's own strain allows, at each point: where it
// varies fast a large gauge smooths it, where it does not a small one only adds noise.
//
// Windows grow by about a third from the smallest to the largest. At each point the largest one
// is taken of which it and all smaller ones agree, in all three components: the square of their
// difference over its variance, a mean over the 5 x 5 points about it, is at most agreement_sigmas
// squared. The variance is that of the smaller gauge less that of the larger (as of nested
// least-squares fits), at least a tenth of the smaller one's, times the factor by which noise is
// larger than claimed: of each frame and component, by the median differences of the three smallest
// gauges. (Intersection of confidence intervals: Goldenshluger and Nemirovski, 1997; Katkovnik,
// 1999; over a neighbourhood: what a gauge smooths it smooths around it too, noise is not alike.)
// No truth is asked for, nor what the specimen is.
//
// sigma_model is by how much the next larger gauge says otherwise, the first that does not agree;
// of the largest window, the next smaller one. The sigmas of noise and calibration are those of the
// gauge taken; that noise has a say in which one it is, is left out.
class AdaptiveGauges {
 public:
  // As SurfaceGauges.
  AdaptiveGauges(const SurfaceState& reference, const Image<Eigen::Vector3f>& cov_px2,
                 const NeighbourCorrelation& neighbours, int step_px, int subset_px,
                 const AdaptiveGaugesOptions& options = {});

  // As SurfaceGauges. Status: of the smallest gauge where none is there.
  [[nodiscard]] AdaptiveStrain Strain(const SurfaceState& now, const Image<Status>& status) const;

 private:
  AdaptiveGaugesOptions options_;
  std::vector<SurfaceGauges> gauges_;  // by size
};

}  // namespace plumbline
