#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/image.h"
#include "fit/carcass_thickness.h"
#include "fit/contact_patch.h"

namespace plumbline {

// Where a tyre's carcass leaves the ground: the boundary of contact without a threshold.
//
// The gap g of ContactPatch begins so slowly that the outline at any threshold above the noise
// encloses a tenth more than what touches. But it begins by a law. A carcass is a belt that bends;
// its tread, being soft, passes distributed forces only, so that height, slope, moment and shear
// force are continuous where it leaves the ground, and the gap begins with the fourth power. Of
// what? Of the depth d by which the undeformed tyre, in the same place and at the same angle, lies
// above the ground (negative: would reach into it): that tells how hard the ground presses, and is
// known without noise from the wheel's reference. So, with q = d - d0(x, y),
//   g = 0 where q <= 0,   g = k q^power (1 + m q + n m^2 q^2) where q > 0,
//   d0 = a0 + a1 x + a2 y + a3 (x^2 - y^2) + a4 x y,   x, y from the patch's middle, in 100 mm,
// by least squares over the points near the boundary of all frames together. k and m belong to
// the tyre and are common to the frames; a0..a4, d at the boundary and how it changes round the
// patch, are the frame's own. n is held: it says how a gap that begins so goes over into a slope,
// 0.28 for the ramp x^4 (2.5 - 3 x + x^2), and points cannot tell it, because what subsets smooth
// of the gap's first hundredths of a millimetre looks like another n. Its sigma counts with the
// law's. Contact is where q <= 0.
//
// Not for patches over obstacles, where a carcass leaves the ground before the obstacle by another
// law: the scatter of the gap about the law tells.
struct LiftOffOptions {
  // 4: no line forces, as above. 3: a bending belt on rigid ground (a line force at the boundary);
  // 2: a membrane. The result depends on it.
  int power = 4;
  // Up to which the law is fitted: more, and subsets matter less, the law's further terms more.
  double largest_gap_mm = 2;
  double next_term = 0.28, sigma_next_term = 0.01;  // n
  double inside_mm = 3;         // depth (along d) of the rim of the contact that is fitted too
  double least_d_mm = -40;      // deeper undeformed tyre is not looked at
  int least_points = 60;        // a frame
  double max_scatter_mm = 0.3;  // rms of the gap about the law: more, and it does not hold

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// What one frame contributes. All images of one grid, ground frame (mm), NaN where there is none.
struct LiftOffFrame {
  const Image<Eigen::Vector3d>* position_mm = nullptr;
  const Image<Eigen::Vector3d>* undeformed_mm = nullptr;  // of the same material points
  const Image<double>* thickness_mm = nullptr;
  const Image<ThicknessShares>* shares = nullptr;  // where the thickness is to be fitted too
};

struct LiftOffLaw {
  static constexpr int kParameters = 3;
  using Parameters = Eigen::Matrix<double, kParameters, 1>;
  using Covariance = Eigen::Matrix<double, kParameters, kParameters>;
  double log_k = 0, m = 0, n = 0.28;    // k in mm^(1 - power), m in 1 / mm
  Covariance cov = Covariance::Zero();  // random, in this order
};

// The boundary in one frame.
struct LiftOffLine {
  static constexpr int kTerms = 5;
  static constexpr double kLength_mm = 100;  // that x and y are counted in
  using Terms = Eigen::Matrix<double, kTerms, 1>;
  Eigen::Vector2d middle_mm{0, 0};
  Terms a = Terms::Zero();
  Eigen::Matrix<double, kTerms, kTerms> cov = Eigen::Matrix<double, kTerms, kTerms>::Zero();
  using ByLaw = Eigen::Matrix<double, kTerms, LiftOffLaw::kParameters>;
  ByLaw d_a_d_law = ByLaw::Zero();
  double scatter_mm = 0;  // of the gap about the law
  int points = 0;
};

// sigma_mm of the gaps, from noise; correlation_area_points as in GroundPlaneOptions. The law of
// several frames of one tyre, whose noise is independent. Throws UsageError from the options,
// InputError with the reason where no frame holds it.
[[nodiscard]] LiftOffLaw FitLiftOffLaw(std::span<const LiftOffFrame> frames, double sigma_mm,
                                       double correlation_area_points,
                                       const LiftOffOptions& options = {});

// The depth of the undeformed tyre below which it surely touches, by the points within 0.3 mm of
// the ground: no law is needed. Nothing where there are none.
[[nodiscard]] std::optional<double> DepthInContact(const LiftOffFrame& frame,
                                                   const LiftOffOptions& options = {});

// What is known, before anything is measured, of the errors of the entries of a map of the
// carcass: what is to be added to them, each with this sigma, independent of the others.
struct ThicknessPrior {
  Eigen::VectorXd expected_mm;
  double sigma_mm = 0;
};

struct LawAndThickness {
  LiftOffLaw law;                     // its cov: with this thickness exactly
  Eigen::VectorXd added_mm;           // to each entry
  Eigen::MatrixXd cov_mm2;            // of that, the law being free
  Eigen::MatrixXd d_law_d_thickness;  // log k, m, n by entry: of the law that fits best
};

// The law together with the carcass's thickness, which what touches the ground tells: the gap is 0
// there, whatever the map says. Least squares as above over all points that touch (frames in which
// one in fifty of them does not, as over an obstacle, have no say) and the prior; each frame's
// ground may be off by a plane, so that a constant and a slope of the map across the tread, which
// are the ground's height and tilt as well, stay as the prior has them, and so do entries beside
// what touches, but for what the law's own points tell there.
// prior: nullptr holds the thickness; added_mm and what follows are empty then.
[[nodiscard]] LawAndThickness FitLawAndThickness(std::span<const LiftOffFrame> frames,
                                                 double sigma_mm, double correlation_area_points,
                                                 const ThicknessPrior* prior,
                                                 const LiftOffOptions& options = {});

// The boundary of one frame under a law. cov: from noise, the law being exact; d_a_d_law carries
// the law's own error. Nothing where too few points are near the boundary or the law does not hold;
// the reason is then in *why, if given.
[[nodiscard]] std::optional<LiftOffLine> FindLiftOffLine(const LiftOffFrame& frame,
                                                         const LiftOffLaw& law, double sigma_mm,
                                                         double correlation_area_points,
                                                         const LiftOffOptions& options = {},
                                                         std::string* why = nullptr);

// Area, length and the rest of q <= 0, outlined as by FindContactPatch(); its
// d_area_d_threshold_mm is that by a0 (mm^2 a mm of d). Nothing where no point is in contact.
[[nodiscard]] std::optional<ContactPatch> PatchWithin(const LiftOffFrame& frame,
                                                      const LiftOffLine& line);

}  // namespace plumbline
