#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "calib/image.h"
#include "calib/status.h"
#include "match/correlation_image.h"
#include "match/internal/normal_equations.h"
#include "match/internal/subset_sums.h"
#include "match/subset_correlator.h"

namespace plumbline::internal {

// The subsets of one reference image: their pixels, and what of their equations does not depend on
// the deformed image. Thread-safe but for Remember(); the image and the mask must outlive it.
class ReferenceSubsets {
 public:
  // mask may be null.
  ReferenceSubsets(const CorrelationImage& reference, const CorrelatorOptions& options,
                   const Image<std::uint8_t>* mask);

  // Works out what Take() has to know of the subsets around these pixels, in parallel, and keeps
  // it: about 2 KB each.
  void Remember(const std::vector<Eigen::Vector2i>& pixels);

  struct Facts {
    Status status = Status::kOk;  // else why there is nothing to look for
    int count = 0;                // of the pixels that are used
    NormalEquations equations;    // where the status is kOk
    // NormalEquations::CovariancePerVariance(), where those are solvable.
    NormalEquations::Covariance covariance_per_variance;
  };

  // One subset, taken out of the image. To be used for one after the other: its memory is kept.
  struct Subset {
    PackedSubset pixels;  // noise gradients only where the facts were not remembered
    float offset = 0;     // that the grey levels are less by
    // Offsets from the centre that it reaches, what the image's border cuts off left out.
    Eigen::Vector2d low, high;
    const Facts* facts = nullptr;  // remembered, or own
    Facts own;
  };
  // Where the facts' status is not kOk, they are all that is taken.
  void Take(const Eigen::Vector2i& pixel, Subset& subset) const;

 private:
  int CountInside(const Eigen::Vector2i& pixel) const;
  Status Examine(const Eigen::Vector2i& pixel, int count) const;
  void WorkOut(const PackedSubset& pixels, Facts& facts) const;

  const CorrelationImage& reference_;
  const CorrelatorOptions options_;
  const Image<std::uint8_t>* mask_;
  Image<std::uint8_t> pixels_used_;  // the mask less its edge; empty without one
  SubsetOutline outline_;
  ReferencePlanes planes_;
  bool filtered_;
  int full_count_ = 0;
  std::vector<Facts> facts_;
  std::unordered_map<std::int64_t, std::size_t> place_;  // of a pixel's facts
};

}  // namespace plumbline::internal
