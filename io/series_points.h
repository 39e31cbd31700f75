#pragma once

#include <Eigen/Core>
#include <vector>

#include "fit/surface_points.h"
#include "io/series_reader.h"
#include "match/neighbour_correlation.h"

namespace plumbline {

// What one standard deviation of each of three independent errors of a ground plane does to heights
// over it: a column (a, b, c) moves the height at (x, y) of the ground frame by a x + b y + c.
// cov: GroundRecord::cov_random or cov_calibration. Zeros where the plane was not found, NaN where
// the covariance is unknown.
[[nodiscard]] Eigen::Matrix3d HeightErrorsOf(const GroundRecord& ground,
                                             const Eigen::Matrix3d& cov);

// The points of a frame of a file, in the frame of its positions, for what is fitted to them.
//
// A file holds sigmas of single components. The random ones are taken as independent of each other
// and of other points', but for what the ground plane of a rolling tyre's frame does to heights,
// which is known and common to all points; those of the calibration as one error that moves all
// points at once.
[[nodiscard]] SurfacePoints PointsOf(const SeriesFrame& frame);

// What neighbouring points of a run have in common, as far as the file tells.
[[nodiscard]] NeighbourCorrelation NeighboursOf(const SeriesReader& series);

// How far the wheel has gone over the ground at each frame of a run since the first one that tells
// its speed, mm: the speeds by the trapezoidal rule over the times. NaN where a frame tells none
// (a run that is not of a rolling tyre: everywhere).
[[nodiscard]] std::vector<double> TravelOf(const SeriesReader& series);

}  // namespace plumbline
