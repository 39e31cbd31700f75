#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "calib/image.h"
#include "match/correlation_image.h"
#include "match/correlation_seed.h"
#include "match/find_seeds.h"
#include "match/neighbour_correlation.h"
#include "match/planar_field.h"
#include "match/subset_correlator.h"

namespace plumbline {

struct FieldOptions {
  CorrelatorOptions correlator;
  CorrelationImageOptions image;
  FindSeedsOptions seeds;
  int step_px = 8;  // between points
  // Left out: all points whose subset fits into the image, less its edge
  // (CorrelationImage::edge_px()) and with 2 px to spare. Else the first point and their number.
  Eigen::Vector2i first_px{-1, -1};
  ImageSize grid;

  // What matched is looked for again from the deformed image, and must come back to where it
  // started within this and 5 sigma; so must the inner half of subsets that correlate badly.
  bool verify = true;
  double verify_tolerance_px = 0.15;
  // Parts of the view that stand still, cut off by a jump from others that move, are background.
  bool keep_still_parts = false;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// What became of the points, for people.
struct FieldCounts {
  std::int64_t points = 0;     // of the grid
  std::int64_t attempted = 0;  // inside mask and image
  std::int64_t ok = 0;
  std::int64_t seeds = 0;           // that the correlation started from
  std::int64_t reseeded = 0;        // points that only a second search for seeds reached
  std::int64_t not_found_back = 0;  // failed_verification: matched again, it lies elsewhere
  std::int64_t isolated = 0;        // failed_verification: a few points that contradict all others
  std::int64_t still = 0;           // failed_verification: background that stands still
  std::array<std::int64_t, 16> by_status{};  // by the number of the Status
};

// Finds seeds in a deformed image, in place of FindSeeds().
using SeedFinder = std::function<std::vector<CorrelationSeed>(const GrayImage& deformed)>;

// Where a correlation starts.
struct FieldStart {
  // A field of the same grid, such as that of the frame before; points where it is not kOk are
  // reached from their neighbours. Null, or where it leads nowhere: seeds are looked for; and for
  // the rest where more than a tenth of its points is lost.
  const PlanarField* prior = nullptr;
  SeedFinder seeds = nullptr;  // null: FindSeeds()
  // Whether points that the prior led to are looked for again from the deformed image (as those
  // that seeds led to always are, with FieldOptions::verify). It takes longer than the match
  // itself.
  bool verify_back = true;
  // At each point of the grid, the second order of the motion where that is known, as between views
  // of two cameras; with order 1 it is kept as it is. Null: none is known.
  const Image<SubsetCurvature>* curvature = nullptr;
  // Whether seeds are looked for where a prior leads nowhere; else what it does not lead to is
  // lost.
  bool search = true;
};

struct CorrelatedField {
  PlanarField field;
  FieldCounts counts;
};

// Correlates the points of a grid in one reference image with any number of deformed ones.
//
// Seeds are matched first; from the best correlated points on, neighbours start from what is known
// beside them (reliability-guided: Pan, "Reliability-guided digital image correlation for image
// deformation measurement", Applied Optics 48(8), 2009), a batch at a time, so that the result does
// not depend on the number of threads. Where points are left, seeds are looked for there once more.
// Then every result is verified: by a backward match, by its inner half, by its neighbours.
//
// Statuses: those of SubsetCorrelator; masked; failed_verification as counted in FieldCounts;
// not_converged for points that nothing led to.
// Thread-safe; copies what it needs.
class FieldCorrelator {
 public:
  // mask: of the reference, 0 is left out; empty: all of it. Throws UsageError as
  // FieldOptions::Check(), InputError as SubsetCorrelator and when mask and image leave no point.
  FieldCorrelator(const GrayImage& reference, const FieldOptions& options,
                  const Image<std::uint8_t>& mask = {});
  ~FieldCorrelator();
  FieldCorrelator(FieldCorrelator&&) noexcept;
  FieldCorrelator& operator=(FieldCorrelator&&) noexcept;

  const FieldOptions& options() const;
  SubsetGrid grid() const;

  // Throws InputError when the image is not of the reference's size or the prior of another grid.
  CorrelatedField Correlate(const GrayImage& deformed, const FieldStart& start = {}) const;

  // The same from seeds that the caller knows.
  CorrelatedField CorrelateFrom(const GrayImage& deformed,
                                const std::vector<CorrelationSeed>& seeds) const;

  // How the errors of neighbouring points go together. Worked out at the first call, in about half
  // a second a megapixel.
  const NeighbourCorrelation& neighbours() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
