#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "fit/cross_section.h"
#include "fit/height_map.h"
#include "io/series_frame.h"

namespace plumbline {

// Two runs held against each other in the frame that they have in common, that of the ground: each
// frame of a run has its own, however the rig was turned.

// Frames of two runs, by their places in the files.
struct FramePair {
  std::int64_t run = 0, other = 0;
  // Way over the ground that the other wheel is ahead; NaN: the pair is not by the way.
  double ahead_mm = 0;
};

// Frames that have the same number in their recordings. indices: SeriesFrame::index of each frame.
[[nodiscard]] std::vector<FramePair> PairByIndex(std::span<const std::int64_t> run_indices,
                                                 std::span<const std::int64_t> other_indices);

// Of each frame of a run the one of the other in which the wheel stands nearest to the same place
// of the ground. travel: TravelOf() each; shift_mm: way that the other wheel has to go from its
// first frame to where the run's first frame is. A frame whose way is not known, or that has none
// within most_apart_mm, has no partner: nothing is interpolated between frames.
[[nodiscard]] std::vector<FramePair> PairByTravel(std::span<const double> run_travel_mm,
                                                  std::span<const double> other_travel_mm,
                                                  double shift_mm, double most_apart_mm);

struct RunComparisonOptions {
  double step_mm = 2;  // between the places of the ground at which both are told
  // Only along the line in which a plane x = a or y = b cuts the ground.
  std::optional<CutPlane> section;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Heights of a frame less those of another at the same places of the ground, where both are
// measured.
struct HeightComparison {
  HeightMap run, other;
  HeightDifference difference;       // of calibrations as if of two rigs: files do not tell more
  double median_mm = kNone;          // of its size
  double rms_from_plane_mm = kNone;  // about the plane (the line of a section) below
  double median_sigma_random_mm = kNone, median_sigma_calibration_mm = kNone;
  double within_two_sigma = kNone;  // share of the places, both parts
  double area_mm2 = kNone;          // of the places; a section's: length_mm
  double length_mm = kNone;
  // The plane through the differences, those left out that lie further from their median than six
  // medians: how the runs' ground planes are turned against each other about x and y of the ground,
  // and how far apart below the axis. Of a section only the turn that shows in it.
  Eigen::Vector2d tilt_rad = Eigen::Vector2d::Constant(kNone);
  double offset_mm = kNone;
  // Those of both ground planes; what is left of the surface's own errors is small beside them.
  Eigen::Vector2d sigma_random_tilt_rad = Eigen::Vector2d::Constant(kNone);
  Eigen::Vector2d sigma_calibration_tilt_rad = Eigen::Vector2d::Constant(kNone);
  double sigma_random_offset_mm = kNone, sigma_calibration_offset_mm = kNone;

  static constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
};

// Both frames hold surfaces in a ground frame; where both know their wheel the other one's is laid
// so that the wheels' middles (WheelRecord::centre_mm) are above the same place. Places are told in
// the frame of `run`. Without common places all but the maps is NaN.
// Throws UsageError from the options.
// Accuracy: tests/apps/run_comparison_test.cc.
[[nodiscard]] HeightComparison CompareFrames(const SeriesFrame& run,
                                             const NeighbourCorrelation& run_neighbours,
                                             const SeriesFrame& other,
                                             const NeighbourCorrelation& other_neighbours,
                                             const RunComparisonOptions& options);

}  // namespace plumbline
