#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "calib/stereo_rig.h"

namespace plumbline::internal {

// One board point seen by one camera.
struct BoardObservation {
  int pair = 0;
  int camera = 0;  // 0 left, 1 right
  int id = 0;      // of the board point
  Eigen::Vector2d pixel;
  double sigma_px = 1;  // what the detector claims
  Eigen::Vector2d disc_offset_px =
      Eigen::Vector2d::Zero();  // centroid of the disc's image less the image of its centre
  bool outlier = false;
};

// Everything the joint adjustment moves, and what it sees.
//
// A point of the target is projected by q = project(camera_from_left * left_from_board[pair] *
// target[id]) + disc_offset.
struct BoardProblem {
  StereoRig rig;                            // its modes are not used here
  std::vector<Rigid3> left_from_board;      // a pair
  std::vector<Eigen::Vector3d> target_mm;   // by id
  std::vector<Eigen::Vector3d> nominal_mm;  // by id
  std::vector<BoardObservation> observations;
  double disc_radius_mm = 0;  // 0: points, no discs
  double floor_px = 0;  // model error added in quadrature to the claimed sigmas, so that chi^2 per
                        // degree of freedom is 1

  // Splined lenses: the control points as libmrcal's solve left them (all intrinsics, left and
  // right). Control points that no photograph reaches, and the turn of the camera frame that a
  // shift of all of them imitates, are known to kSplineSigma about these values and no better; the
  // core (focal lengths and centre), which they can replace, is held. Empty for other lenses.
  std::array<Eigen::VectorXd, 2> spline_anchor = {};

  double Sigma(const BoardObservation& o) const;
};

// Prior standard deviation of a spline's control point, in its own unit (tangent of half the angle,
// times two): about 0.6 degrees, far wider than what photographs say where there are any.
inline constexpr double kSplineSigma = 0.01;
inline constexpr int kSplineCore = 4;  // parameters before the control points

struct AdjustmentOptions {
  bool fix_cameras = false;  // intrinsics and right_from_left stay
  bool fix_target = false;
  double target_sigma_mm = 0.1;
  bool robust = false;  // Cauchy loss at 3 sigma: for a first solve with outliers still in
  int max_iterations = 50;
};

// The residual (observed less predicted, px) and its derivatives with respect to all that may move.
struct ObservationJacobians {
  Eigen::Vector2d residual_px;
  Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> intrinsics;
  Eigen::Matrix<double, 2, 6, Eigen::RowMajor>
      right_from_left;  // rotation vector, translation; 0 for the left camera
  Eigen::Matrix<double, 2, 6, Eigen::RowMajor> left_from_board;
  Eigen::Matrix<double, 2, 3, Eigen::RowMajor> target;
};
ObservationJacobians Linearise(const BoardProblem& problem, const BoardObservation& observation);

// Minimises the weighted squared residuals with Ceres. Single-threaded, so that results do not
// depend on the machine. Throws InputError when the solver does not reach a usable minimum.
void Adjust(BoardProblem& problem, const AdjustmentOptions& options);

// Recomputes every disc_offset_px from the present cameras, poses and target.
void PredictDiscOffsets(BoardProblem& problem);

// Residuals in the order of the observations, outliers included.
std::vector<Eigen::Vector2d> Residuals(const BoardProblem& problem);

// Marks as outliers what lies beyond `sigmas` robust standard deviations, and takes back what no
// longer does. Returns how many marks changed.
int MarkOutliers(BoardProblem& problem, double sigmas);

// Number of inlier scalars less the number of free parameters.
double DegreesOfFreedom(const BoardProblem& problem, bool target_free);

// Sets floor_px so that chi^2 equals its degrees of freedom (0 if the claimed sigmas alone explain
// the residuals).
void EstimateFloor(BoardProblem& problem, bool target_free);

// RMS of the inlier residuals, per component; camera -1: both; pair -1: all.
double ResidualRms(const BoardProblem& problem, int camera = -1, int pair = -1);

}  // namespace plumbline::internal
