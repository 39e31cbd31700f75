#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "calib/image.h"
#include "calib/rigid3.h"
#include "match/neighbour_correlation.h"

namespace plumbline {

// Points of a surface on a grid, and how their errors came about. All images have the size of the
// grid.
struct SurfacePoints {
  Image<Eigen::Vector3d> point_mm;  // NaN where there is none
  // From independent noise: xx xy xz yy yz zz.
  Image<Eigen::Matrix<float, 6, 1>> cov_random_mm2;
  // What one standard deviation of each random error does that all points have in common, as those
  // of the frame that they are told in. Independent of each other.
  std::vector<Image<Eigen::Vector3f>> along_common_mm;
  // What one standard deviation of each calibration mode does to the points. Empty: unknown.
  std::vector<Image<Eigen::Vector3f>> along_modes_mm;

  ImageSize size() const { return point_mm.size(); }
  // Throws std::invalid_argument where the sizes differ.
  void Check() const;
};

// A number with both of its errors. NaN: not known.
struct MeasuredScalar {
  double value = std::numeric_limits<double>::quiet_NaN();
  double sigma_random = std::numeric_limits<double>::quiet_NaN();
  Eigen::VectorXd along_modes;  // what one sigma of each calibration mode adds; empty: unknown

  double sigma_calibration() const;  // NaN where the modes are unknown
  bool known() const { return value == value; }
};

// The frame that points are told in, and its own errors.
struct UncertainFrame {
  Rigid3 frame_from_rig;
  // Random: of a turn about the frame's x, y, z (rad) and a shift along them (mm); they move a
  // point that the frame tells at p by turn x p + shift.
  Eigen::Matrix<double, 6, 6> cov_random = Eigen::Matrix<double, 6, 6>::Zero();
  // frame_from_rig along each calibration mode. Empty: no mode moves it.
  std::vector<Rigid3> along_modes;

  // How one sigma of each of its six independent errors turns and shifts it: a root of cov_random.
  Eigen::Matrix<double, 6, 6> Root() const;
};

// The points told in another frame: six errors more in common, the frame's.
// Throws std::invalid_argument where the frame knows another number of modes than the points do.
[[nodiscard]] SurfacePoints InFrame(const SurfacePoints& in_rig, const UncertainFrame& frame);

// What the error of one point does to a result of up to three numbers; its columns are the point's
// x, y, z.
struct PointChange {
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::ColMajor, 3, 3>;
  std::size_t place = 0;  // row * columns + column
  Matrix change;
};

// The covariance of such a result from the points' independent noise: sum over pairs of points of
//   J_a L_a rho_ab L_b' J_b',   L L' = C,
// rho the mean correlation of both components of the matches (NeighbourCorrelation).
// Ordered by place, each at most once.
[[nodiscard]] Eigen::MatrixXd IndependentCovariance(std::span<const PointChange> changes,
                                                    const SurfacePoints& points,
                                                    const NeighbourCorrelation& neighbours);

// What errors that move all points at once do to it, one column an error.
[[nodiscard]] Eigen::MatrixXd ChangeAlong(std::span<const PointChange> changes,
                                          const std::vector<Image<Eigen::Vector3f>>& errors_mm);

// The errors of a number, put together from all that it hangs on.
class ErrorSum {
 public:
  // common: number of random errors that several of its parts have in common. modes: likewise of
  // the calibration; 0: unknown.
  ErrorSum(Eigen::Index common, Eigen::Index modes);

  // changes: of one row.
  void AddPoints(std::span<const PointChange> changes, const SurfacePoints& points,
                 const NeighbourCorrelation& neighbours);
  void AddIndependent(double variance) { variance_ += variance; }
  // What one sigma of each does; they add up with what other parts have from the same errors.
  void AddCommon(const Eigen::RowVectorXd& change) { common_ += change.transpose(); }
  void AddModes(const Eigen::RowVectorXd& change) { modes_ += change.transpose(); }
  // Of a number with errors of its own that this one changes by so much. Modes in another number
  // than here are taken as those of another rig, independent.
  void AddScalar(double by, const MeasuredScalar& scalar);

  MeasuredScalar Of(double value) const;

 private:
  double variance_ = 0, foreign_ = 0;
  Eigen::VectorXd common_, modes_;
};

// A number that hangs on points alone, with all of its errors. changes: of one row.
[[nodiscard]] MeasuredScalar MeasuredSum(std::span<const PointChange> changes, double value,
                                         const SurfacePoints& points,
                                         const NeighbourCorrelation& neighbours);

}  // namespace plumbline
