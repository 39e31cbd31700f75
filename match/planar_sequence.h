#pragma once

#include <cstdint>
#include <memory>

#include "match/correlate_field.h"

namespace plumbline {

// What the frames of a sequence are correlated with.
enum class ReferenceMode : std::uint8_t {
  kFixed = 0,  // the reference image, always
  kEvery,      // a frame of the sequence, taken anew every update_every frames; put off while a
               // frame has less than half of the points that the reference had
  kAuto,       // a frame of the sequence, taken anew when the correlation gets worse
};

struct SequenceOptions {
  FieldOptions field;
  ReferenceMode reference = ReferenceMode::kFixed;
  int update_every = 1;  // frames; of kEvery
  // Whether points that the frame before leads to are looked for again from the new frame too.
  bool verify_all = true;
  // Of kAuto: the last frame becomes the reference when the number of points that are kOk, or the
  // median of their ZNCC, is below this share of the best with the reference so far; and it stays
  // only where that makes it better.
  double least_ok_share = 0.95;
  double least_zncc_share = 0.9;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct SequenceFrame {
  PlanarField field;  // displacements count from the reference image, whatever the mode
  FieldCounts counts;
  std::int64_t reference_frame = -1;  // that this one was correlated with; -1: the reference image
  std::int64_t lost_at_updates = 0;   // points, so far, that no frame can bring back
};

// Correlates the frames of a sequence, one after the other, with one reference image. Each frame
// starts from the one before, and from seeds where that leads nowhere.
//
// With a fixed reference a point that is lost in one frame may come back in a later one.
//
// With an updated reference (frame k) the points of the grid sit at X = x + d_k, between the pixels
// of image k: the subset around the nearest pixel p is matched and its warp W taken at the offset
// X - p, so that d_m = W(X) - x, F_m = F_km F_k. A point without a value in frame k is lost from
// then on (and keeps its status). The mask is carried along. Noise: with L the covariance of a leg,
// half of it from each of its images, the noise of image k enters the legs that end and begin there
// with opposite signs, through the same subset but for the rounding X - p; so
//   C_m = F C_k F' + L_km - rho (F L_k F' / 2 + L_km / 2),  F = F_km,
// L_k of the leg that ended at k and rho the correlation of the two legs' answers to that noise: 1
// less what the offset of their subsets, a part of a pixel, changes at the edges. To C_m comes what
// is of second order, from the noise of the gradients that weigh the noise; and the mean of what
// noise does to a leg by way of the gain is taken out, since all legs have it alike.
// tests/match/planar_sequence_test.cc holds it against sampling: 30 updates at a noise of 2 grey
// levels. What is systematic, such as interpolation bias, adds up with each update and is not in
// it; at a noise of 4 on a speckle of 25 grey levels the sigma is 15 % too small after 30 updates.
//
// Not thread-safe; uses all of TBB's threads, and the result does not depend on their number.
class PlanarSequence {
 public:
  // Throws UsageError as SequenceOptions::Check(), InputError as FieldCorrelator.
  PlanarSequence(const GrayImage& reference, const SequenceOptions& options,
                 const Image<std::uint8_t>& mask = {});
  ~PlanarSequence();

  // The next frame. `number`: the caller's, for SequenceFrame::reference_frame. `seeds`: where to
  // start the first frame, and frames that the one before leads nowhere in, as long as the
  // reference is the first image; null: FindSeeds(). `starts`: about where the points are, in terms
  // of the reference in force; in place of what the frames before lead to, and of any search: what
  // these do not lead to is lost. Throws InputError when the image is not of the reference's size;
  // the sequence then goes on without it.
  SequenceFrame Add(const GrayImage& deformed, std::int64_t number,
                    const SeedFinder& seeds = nullptr, const PlanarField* starts = nullptr);

  // What FieldStart::curvature is to say of matches with the first image.
  void SetCurvature(Image<SubsetCurvature> curvature);

  // Forgets all frames: the next one is correlated as the first.
  void Restart();

  // Of the reference image.
  const FieldCorrelator& correlator() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
