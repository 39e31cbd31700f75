#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "apps/region.h"
#include "apps/surface_evaluation.h"
#include "calib/stereo_rig.h"
#include "io/image_source.h"
#include "io/series_writer.h"
#include "match/stereo_sequence.h"

namespace plumbline {

struct StereoRunOptions {
  StereoSequenceOptions sequence;
  std::optional<PixelRegion> roi;  // points whose subset fits into it; none: into the image
  Image<std::uint8_t> mask;        // of the left reference image; empty: all of it
  SurfaceEvaluationOptions evaluation;
  // Pairs that start one from the other. The first of each block is matched as if nothing were
  // known of those before, so that a recording can be cut there, and resumed, with the same result.
  int block_frames = 32;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct StereoRunFrame {
  SeriesFrame frame;
  SurfaceSummary summary;
  FieldCounts left_counts, right_counts;  // empty where there is a problem
  // Seconds that its stages took.
  double match_s = 0, evaluate_s = 0;
};

// From a synchronised pair of image streams to a surface's shape, motion and strain with error
// bars: the only place that wires the libraries together for stereo-DIC.
//
//   reference pair -> points -> [ each pair: matches of both images -> points in space
//                                 -> displacement, velocity, strain, plane, rig watch ]
class StereoRun {
 public:
  // reference: the pair that displacements count from; it must have no problem. Throws UsageError
  // from the options, InputError as StereoSequence and SurfaceEvaluation.
  StereoRun(const StereoRig& rig, const StereoFrame& reference, const StereoRunOptions& options);
  ~StereoRun();

  // All but the recipe, the inputs and the channels.
  SeriesHeader Header() const;
  // What the user should know of how the reference pair was matched, one sentence each.
  std::vector<std::string> Notes() const;
  double correlation_area_points() const;  // of SurfaceEvaluation

  // The next pair; `position`: its place in the whole sequence of pairs, from 0, bad ones counted.
  // Positions only grow, and none of a block is left out once it was begun. A pair with a problem
  // comes back with it. Throws InputError when the images are not of the rig's size.
  StereoRunFrame Measure(const StereoFrame& pair, std::int64_t position);

  // Where to begin so that the pair at this place comes out as in an undisturbed run: those before
  // it, from there on, are measured too.
  std::int64_t FirstToMeasure(std::int64_t first_wanted) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
