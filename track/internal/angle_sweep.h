#pragma once

#include <limits>
#include <vector>

namespace plumbline::internal {

// What is known of an angle over time, in any units that fit together; see SmoothAngles(). All are
// of one length, that of the frames; what is between two frames stands with the earlier one.
struct AngleSeries {
  std::vector<double> step;      // from the frame before
  std::vector<double> value;     // of the angle
  std::vector<double> variance;  // infinite: not measured
  std::vector<double> turn;      // to the next frame
  std::vector<double> turn_variance;
  // Of what the error of the angles changes by until the next frame, above 0. Empty: it does not.
  std::vector<double> drift_variance;
  double still_variance = 0;  // above 0, next to nothing: that error in the first frame
  double start_variance = 1;  // of the state in the first frame, more than any data say

  static constexpr double kNotMeasured = std::numeric_limits<double>::infinity();
  std::size_t size() const { return value.size(); }
};

struct AngleState {
  double angle = 0, speed = 0;
  double var_angle = 0, var_speed = 0;
  // The angle with the drift of the measured ones, its variance and its covariance with the angle;
  // and the variance of the turn to the next frame.
  double measured = 0, var_measured = 0, covar_measured = 0, var_turn = 0;
};

struct AngleSweep {
  std::vector<AngleState> state;
  // Of the innovations; as many as there are beyond those that determine the state, which add next
  // to nothing to chi2 and a constant to log_variance.
  double chi2 = 0, log_variance = 0;
  int innovations = 0;

  static constexpr int kOfState = 3;
};

// Least squares over all states at once, frame by frame: by orthogonal transformations of what is
// known of a state (R x = rhs, unit noise), its measurement and its ties to the next one, then back
// (Paige and Saunders, "Least squares estimation of discrete linear dynamic systems using
// orthogonal transformations", SIAM J. Numer. Anal. 14(2), 1977). No covariance is subtracted from
// another, however little or much is known. q: of SmoothAngles().
AngleSweep SweepAngles(const AngleSeries& series, double q);

}  // namespace plumbline::internal
