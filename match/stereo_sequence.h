#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string_view>

#include "calib/stereo_rig.h"
#include "match/correlate_field.h"
#include "match/stereo_seeds.h"

namespace plumbline {

// How the pairs of a sequence are matched. The points are those of a grid in the left image of the
// reference pair, and the material that is seen there.
enum class StereoStrategy : std::uint8_t {
  // The reference subset is found in both images of every later pair: no drift, whatever the number
  // of frames.
  kReference = 0,
  // It is followed through the left images, and each left image is matched with its right one
  // anew: where the views differ too much for a subset to be found across time and cameras at once.
  kFreshStereo,
  // Each image is matched with the one before of its camera: for deformation that makes the
  // reference unrecognisable. Errors add up from update to update.
  kIncremental,
};
inline constexpr std::array<std::string_view, 3> kStereoStrategyNames = {
    "reference", "fresh-stereo", "incremental"};

struct StereoSequenceOptions {
  FieldOptions field;
  // Whether, with order 1, the curvature of the motion from left to right is taken from the
  // reference pair and given to the shape functions of all right matches, where without it they
  // would be biased by a tenth of their sigma or more. It costs no precision, as order 2 does
  // (sigmas 1.9 times as large), but what deformation adds is not in it.
  bool follow_curvature = true;
  std::optional<NoiseModel> right_noise;  // of the right camera, with field.correlator.noise
  StereoSeedOptions seeds;
  StereoStrategy strategy = StereoStrategy::kReference;
  int update_every = 1;  // frames; of kIncremental
  // Whether every point of every frame is looked for again from the new image, and not only those
  // of frames without a start from the one before. The epipolar distance is a check of its own.
  bool verify_all = false;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Where the points are seen in both images of one pair. Displacements of both count from the grid's
// pixels in the reference left image; gradients and covariances likewise (see SubsetMatch).
struct StereoField {
  PlanarField left, right;
  FieldCounts left_counts, right_counts;
  // What the images were correlated with: a frame's number, or -1 for the reference pair.
  std::int64_t reference_frame = -1;
};

// Where the right image of a pair shows, about, what the left one shows at a pixel; NaN: not known.
using RightPlace = std::function<Eigen::Vector2d(const Eigen::Vector2d& left_px)>;

// Follows the points of a reference pair through a sequence of pairs, in the raw images.
//
// The errors of all matches of one point have the noise of the reference subset in common
// (PlanarField::reference_share), also where images between were used: their noise cancels but for
// the rounding to whole pixels.
//
// Not thread-safe; uses all of TBB's threads, and the result does not depend on their number.
class StereoSequence {
 public:
  // Matches the reference pair. mask: of its left image; may be empty. right_place: where that is
  // known beforehand, to a pixel or two; the pair is searched where it leads to too little, and
  // without it. Throws UsageError from the options; InputError as FindStereoSeeds and
  // FieldCorrelator, and where the cameras' images differ in size.
  StereoSequence(const StereoRig& rig, const GrayImage& left, const GrayImage& right,
                 const StereoSequenceOptions& options, const Image<std::uint8_t>& mask = {},
                 const RightPlace& right_place = nullptr);
  ~StereoSequence();

  // Left: at rest, without error.
  const StereoField& reference() const;
  // What the search for seeds said of the reference pair (its seeds are not kept); empty where
  // there was none.
  const StereoSeeds& reference_seeds() const;
  const FieldCorrelator& correlator() const;  // of the left reference image
  bool follows_curvature() const;

  // The next pair. `number`: the caller's, for StereoField::reference_frame. Throws InputError when
  // an image is not of the reference's size; the sequence then goes on without it.
  StereoField Add(const GrayImage& left, const GrayImage& right, std::int64_t number);

  // The same when it is known, about, where both images show the points: displacements and
  // gradients (zero will do) of the points that are kOk in `starts`, of the grid of reference();
  // else they are reached from their neighbours. All points are verified, and none is looked for
  // anywhere else. Throws InputError where starts are of another grid, std::logic_error for
  // kIncremental.
  StereoField AddFrom(const StereoField& starts, const GrayImage& left, const GrayImage& right,
                      std::int64_t number);

  // Forgets the frames after the reference: the next one is matched as the first. Throws
  // std::logic_error for kIncremental.
  void Restart();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
