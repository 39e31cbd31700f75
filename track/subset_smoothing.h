#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/image.h"
#include "match/neighbour_correlation.h"
#include "match/stereo_sequence.h"
#include "track/surface_state.h"

namespace plumbline {

// What the shape functions of the subsets do not follow, as far as the points themselves show it.
//
// What correlation finds of a motion u at the centre of a subset is, but for noise and texture, the
// value there of the polynomial of the shape function's order that fits u best over the subset:
// S u (Schreier and Sutton, Experimental Mechanics 42(3), 2002). Its error (S - 1) u is told by
// doing the same once more to what was found, with the points of the grid that lie in the subset:
//   d = (S' - 1) S u,
// the leading term of which is that of the error, times what the points' fit makes of the first
// power that is left out (x^2 for orders 0 and 1, x^4 for order 2), over what the pixels' makes.
//
// How wrong points are there is the mean of d d' over the points within a subset, less what noise
// makes of it; directions in which it is not 1.5 times that count as nothing.
class SubsetSmoothing {
 public:
  // Of the grid and the subsets of a field. Square subsets are taken for round ones as well.
  explicit SubsetSmoothing(const PlanarField& of);

  // mm^2, xx xy xz yy yz zz, in the frame of `instant`: the rig's, of the same field. reference:
  // the pair at rest, of which order 1 and below takes over the curvature between the cameras
  // (StereoSequenceOptions::follow_curvature). cov_px2: UnitCovariance(). NaN where a point has no
  // position.
  [[nodiscard]] Image<Eigen::Matrix<float, 6, 1>> LeftOut(
      const StereoField& reference, const StereoField& field, const SurfaceState& instant,
      const Image<Eigen::Vector3f>& cov_px2) const;

 private:
  // Points about one, in the grid, and what they add up to d with.
  struct Difference {
    std::vector<Eigen::Vector2i> offsets;
    Eigen::VectorXd weights;
    double noise_gain = 0;  // variance of d over that of a point
  };
  Difference Among(std::vector<Eigen::Vector2i> offsets) const;

  int order_, step_px_;
  double scale_ = 1;  // of what pixels' fits leave out over what whole windows of points do
  NeighbourCorrelation neighbours_;
  Difference whole_;  // no point missing
};

}  // namespace plumbline
