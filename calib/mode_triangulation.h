#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>

#include "calib/stereo_rig.h"

namespace plumbline {

// What each calibration mode does to triangulated points, fast: to re-evaluate a result along the
// modes (see CalibrationModes) takes every point once a mode, and an inversion of both lenses for
// each is the most expensive way to get it.
//
// The change of the viewing rays along each mode is smooth over the image, so it is tabulated once
// a rig and interpolated (bicubic, on a lattice as fine as the lenses need). The point
// then moves by the exact difference of two midpoints, from rays f and depths s: with df, dc the
// changes of rays and right centre, f' = f + df, w = s0 f0 - s1 f1 - c,
//   dW = s0 df0 - s1 df1 - dc,   u_i = -(df_i . w + f_i' . dW),
//   ds from  [f0'.f0', -f0'.f1'; f0'.f1', -f1'.f1'] ds = u,
//   d point = (s0 df0 + ds0 f0' + dc + s1 df1 + ds1 f1') / 2,
// in which nothing large cancels, so that single precision serves.
//
// Frames:   rig (the left camera), raw pixels; mm.
// Accuracy: tests/calib/mode_triangulation_test.cc: TriangulatePoints(rig.AlongMode(k), ..) less
//           TriangulatePoints(rig, ..) to 1e-3 of its size plus 2e-4 of the rms of all modes
//           together, for OPENCV and splined lenses; the sigma of a length between two points to
//           1 %. Where the lattice cannot follow a lens (next to a fold, some of the knots of a
//           dense spline, pixels outside the image), the points are triangulated outright.
// Speed:    12 modes of 18 400 points in 4 ms on one core (outright 74 ms), for OPENCV lenses.
class ModeTriangulation {
 public:
  // Makes the tables: on one core some 0.05 s with 12 modes, up to 1 s where lenses are splined.
  explicit ModeTriangulation(const StereoRig& rig);

  int count() const;  // modes

  // The point along mode k less the point itself, for each k: out[i * count() + k]. NaN where
  // TriangulatePoints() would give either as NaN. Parallel, the same bits for any number of
  // threads. Throws std::invalid_argument when the spans do not fit.
  void Differences(std::span<const Eigen::Vector2d> left, std::span<const Eigen::Vector2d> right,
                   std::span<Eigen::Vector3f> out) const;

  // The same for the `modes` modes from `first` on alone, to bound the memory of many points:
  // out[i * modes + (k - first)]. Throws std::invalid_argument when there are no such modes.
  void Differences(std::span<const Eigen::Vector2d> left, std::span<const Eigen::Vector2d> right,
                   int first, int modes, std::span<Eigen::Vector3f> out) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace plumbline
