#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "calib/image.h"
#include "calib/status.h"
#include "match/neighbour_correlation.h"
#include "match/planar_field.h"
#include "track/strain_measure.h"

namespace plumbline {

enum class GaugeWeights : std::uint8_t { kEqual = 0, kInverseVariance };

struct PlanarStrainOptions {
  StrainMeasure measure = StrainMeasure::kGreenLagrange;
  int window_points = 15;  // side of the gauge, odd; 1: the gradient of the subset itself
  int order = 1;           // of the polynomial, 1 to 3
  GaugeWeights weights = GaugeWeights::kEqual;
  // A gauge that is not full, at edges and holes, gives a value only if this share of its points is
  // there, and of each quarter around its centre at least that one: no one-sided extrapolation.
  double min_share = 0.7;
  double min_quarter_share = 0.25;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The strain of a planar field: all images have the size of its grid, NaN where status is not kOk.
// Sigmas are one standard deviation, first order, from the noise of the images alone. Strains have
// no unit.
struct PlanarStrain {
  StrainMeasure measure = StrainMeasure::kGreenLagrange;
  int window_points = 0;
  int order = 1;
  int vsg_px = 0;  // side of the virtual strain gauge: (window_points - 1) step + subset

  Image<Eigen::Vector3f> strain;                  // xx, yy, xy (tensor); x right, y down
  Image<Eigen::Matrix<float, 6, 1>> cov_strain;   // upper triangle of its covariance, row by row
  Image<float> rotation_rad, sigma_rotation_rad;  // of F = R U, from x towards y
  // As StrainInvariants. First order: sigmas of principals, angle and shear hold where e1 and
  // e2 are several of their sigmas apart, that of von Mises where it is several of its own from
  // zero; nearer, the noise itself parts the principals.
  Image<Eigen::Vector2f> principal, sigma_principal;
  Image<float> angle_rad, sigma_angle_rad;
  Image<float> max_shear, sigma_max_shear;
  Image<float> von_mises, sigma_von_mises;
  Image<std::uint16_t> points;  // that went into the gauge
  Image<Status> status;

  PlanarStrain() = default;
  explicit PlanarStrain(ImageSize size);
  ImageSize size() const { return status.size(); }
};

// Strain over a virtual strain gauge (VSG): window_points x window_points POIs about each POI.
//
// The displacements of the gauge's valid points are fitted by a polynomial P of the order,
//   b = M^-1 sum_p w_p P(x_p) d_p,   M = sum_p w_p P(x_p) P(x_p)',
// and its gradient at the centre becomes strain (StrainOf). Weights are 1, or the inverse of the
// mean variance of u and v. The covariance is that of this estimate under the full covariance of
// the points, overlap of the subsets included,
//   cov b = M^-1 (sum_pq w_p w_q P(x_p) P(x_q)' cov(d_p, d_q)) M^-1,
//   cov(d_p, d_q) = S_p R S_q (NeighbourCorrelation), cov(d_p, d_p) the point's own,
// carried through the measure's Jacobian. The sum over pairs is taken offset by offset, each from
// the moments of S_p R S_q over the gauge, so that holes and edges are as exact as full gauges.
//
// window_points = 1: gradient and cov_gradient of the field, of the subset's shape function.
//
// Status:  the field's own where the POI has no displacement; kExtrapolated where the gauge is not
//          full enough (see the options) or its points do not fix the polynomial;
//          kFailedVerification where the gradient folds the material over (det F <= 0) or the POI's
//          displacement or covariance is not finite.
// Throws:  UsageError from options.Check(), or for window_points = 1 with a field of order 0;
//          InputError where the field's images differ in size.
// The result does not depend on the number of threads.
[[nodiscard]] PlanarStrain ComputePlanarStrain(const PlanarField& field,
                                               const NeighbourCorrelation& correlation,
                                               const PlanarStrainOptions& options = {});

}  // namespace plumbline
