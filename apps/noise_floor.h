#pragma once

#include <memory>

#include "io/noise_file.h"
#include "io/series_frame.h"
#include "io/series_writer.h"

namespace plumbline {

// Finds the noise floor of a rig from stereo-DIC of static pairs, given one after the other, and
// holds it against what the sigmas of these pairs predict.
//
// All K later pairs are measured against one reference pair, whose noise they have in common. At
// rest the pairs are exchangeable, the reference among them (it has displacement 0). With d_k the
// displacement or strain of a point in pair k = 0..K, and m the point's mean over these pairs,
//   noise^2 = mean over points of (2 / K) sum_k (d_k - m)^2
// is the mean square of the difference between any two pairs, and has the expectation sigma^2, that
// of a displacement since the reference. The mean over the later pairs alone has the reference's
// noise in it: its predicted variance is sigma^2 (1 + 1/K) / 2. This holds as long as errors do not
// add up from pair to pair (StereoStrategy::kIncremental).
//
// Motion:  what all points do together (drift, vibration) is taken off each pair first and told
//          apart (FloorComponent::common): of displacements in space the rigid motion, of those in
//          the images, both counted since the reference pair, an affine one. The share of the noise
//          that goes with it is taken off the prediction, to first order in area / N, area being
//          how many of the N points share one noise. Nothing is taken off the strain, whose common
//          part is the mean over the points.
// Points:  those that are valid in all pairs.
// Sigma:   of a ratio, 1 / sqrt(2 K N / area); area of a strain being the points of its gauge.
//
// Accuracy: tests/apps/noise_floor_test.cc.
class NoiseFloorMeasurement {
 public:
  // header: of the run. correlation_area_points: StereoRun::correlation_area_points().
  NoiseFloorMeasurement(const SeriesHeader& header, double correlation_area_points);
  ~NoiseFloorMeasurement();

  // The frames of a StereoRun, with matches and without removal of rigid motion; the first one is
  // that of the reference pair. Frames with a problem do not count. Throws std::invalid_argument
  // when it is not of the grid's size.
  void Add(const SeriesFrame& frame);

  // Throws InputError when there are fewer than two good frames, or no point is valid in all.
  NoiseFloor Result() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
