#include "match/feature_seeds.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "calib/error.h"
#include "match/internal/feature_match.h"
#include "match/internal/seed_consistency.h"
#include "match/internal/seed_images.h"
#include "match/internal/subset_search.h"

namespace plumbline {
namespace {

constexpr int kLongestPx = 800;  // for the search of features
// SIFT's places are good to a fraction of a pixel of their own scale; the affine map of a
// neighbourhood is not exact.
constexpr double kTolerancePx = 1.5;
constexpr double kCoarseTolerancePx = 0.75;  // more for every further pixel averaged into one
constexpr int kNeighbours = 16;
constexpr int kLeastSupport = 5;
constexpr int kDraws = 80;
constexpr int kReachPx = 3;

// Several matches of one place (a feature of two orientations) would bear each other out.
std::vector<CorrelationSeed> DistinctMatches(const internal::Features& reference,
                                             const internal::Features& deformed, double max_ratio) {
  std::vector<CorrelationSeed> out;
  for (const auto& match : internal::MatchFeatures(reference, deformed, max_ratio)) {
    CorrelationSeed seed;
    seed.reference_px = reference.places_px[match.from];
    seed.displacement_px = deformed.places_px[match.to] - seed.reference_px;
    const auto same = [&](const CorrelationSeed& other) {
      return (other.reference_px - seed.reference_px).norm() < 1 &&
             (other.displacement_px - seed.displacement_px).norm() < 1;
    };
    // Sorted by row: what is near came shortly before.
    const auto recent = out.end() - std::min<std::ptrdiff_t>(out.end() - out.begin(), 20);
    if (std::none_of(recent, out.end(), same)) out.push_back(seed);
  }
  return out;
}

// The seed moved to the middle of the nearest pixel, where the grey values confirm it.
std::optional<CorrelationSeed> Verified(const CorrelationSeed& seed,
                                        const internal::SeedLevel& images,
                                        const FeatureSeedOptions& options) {
  const Eigen::Vector2d rounded = seed.reference_px.array().round();
  const Eigen::Vector2i centre_px = rounded.cast<int>();
  if (centre_px.x() < 0 || centre_px.y() < 0 || centre_px.x() >= images.mask.width() ||
      centre_px.y() >= images.mask.height() || images.mask(centre_px.y(), centre_px.x()) == 0) {
    return std::nullopt;
  }
  const auto subset = internal::CutTemplate(images.reference, images.mask, centre_px,
                                            options.subset_px / 2, options.min_contrast_grey);
  if (!subset) return std::nullopt;
  const auto match =
      internal::SearchAround(*subset, images.deformed,
                             seed.displacement_px + seed.gradient * (rounded - seed.reference_px),
                             seed.gradient, kReachPx);
  if (!match || match->zncc < options.min_zncc) return std::nullopt;
  return CorrelationSeed{rounded, match->displacement_px, seed.gradient, match->zncc};
}

// The first of each cell of the lattice, from its middle, that the grey values confirm.
std::vector<CorrelationSeed> OneOfEachCell(const std::vector<CorrelationSeed>& seeds,
                                           const internal::SeedLevel& images,
                                           const FeatureSeedOptions& options) {
  std::map<std::pair<int, int>, std::vector<CorrelationSeed>> cells;
  for (const CorrelationSeed& seed : seeds) {
    const Eigen::Vector2i cell =
        (seed.reference_px / options.spacing_px).array().floor().cast<int>();
    cells[{cell.y(), cell.x()}].push_back(seed);
  }
  std::vector<std::vector<CorrelationSeed>> candidates;
  for (auto& [cell, members] : cells) {
    const Eigen::Vector2d middle_px =
        (Eigen::Vector2d(cell.second, cell.first).array() + 0.5) * options.spacing_px;
    const auto distance = [&](const CorrelationSeed& seed) {
      return (seed.reference_px - middle_px).squaredNorm();
    };
    std::stable_sort(members.begin(), members.end(),
                     [&](const auto& a, const auto& b) { return distance(a) < distance(b); });
    candidates.push_back(std::move(members));
  }
  std::vector<std::optional<CorrelationSeed>> confirmed(candidates.size());
  tbb::parallel_for(std::size_t{0}, candidates.size(), [&](std::size_t i) {
    for (const CorrelationSeed& seed : candidates[i]) {
      if ((confirmed[i] = Verified(seed, images, options))) return;
    }
  });
  std::vector<CorrelationSeed> out;
  for (const auto& seed : confirmed) {
    if (seed) out.push_back(*seed);
  }
  return out;
}

}  // namespace

void FeatureSeedOptions::Check() const {
  const auto require = [](bool holds, const std::string& what) {
    if (!holds) throw UsageError("feature seeds: " + what);
  };
  require(max_features >= 10,
          fmt::format("max_features must be at least 10, not {}", max_features));
  require(max_ratio > 0 && max_ratio <= 1,
          fmt::format("max_ratio must lie between 0 and 1, not {}", max_ratio));
  require(spacing_px >= 1, fmt::format("spacing_px must be at least 1, not {}", spacing_px));
  require(subset_px >= 9 && subset_px % 2 == 1,
          fmt::format("subset_px must be odd and at least 9, not {}", subset_px));
  require(min_zncc > 0 && min_zncc < 1,
          fmt::format("min_zncc must lie between 0 and 1, not {}", min_zncc));
  require(min_contrast_grey >= 0 && min_contrast_grey < 256,
          fmt::format("min_contrast_grey must be 0 to 255, not {}", min_contrast_grey));
}

std::vector<CorrelationSeed> FindFeatureSeeds(const GrayImage& reference, const GrayImage& deformed,
                                              const Image<std::uint8_t>* mask,
                                              const FeatureSeedOptions& options) {
  options.Check();
  internal::CheckSeedInput("feature seeds", reference, deformed, mask, options.subset_px);
  const auto from = internal::FindFeatures(reference, mask, options.max_features, kLongestPx);
  const auto to = internal::FindFeatures(deformed, nullptr, options.max_features, kLongestPx);
  const std::vector<CorrelationSeed> matches = DistinctMatches(from, to, options.max_ratio);
  internal::ConsistencyOptions consistency;
  consistency.neighbours = kNeighbours;
  consistency.least_support = kLeastSupport;
  consistency.draws = kDraws;
  consistency.random_seed = options.random_seed;
  consistency.tolerance_px = kTolerancePx + kCoarseTolerancePx * (from.factor - 1);
  consistency.reach_px = std::max(reference.width(), reference.height()) / 4.0;
  const auto images = internal::BuildSeedLevels(reference, deformed, mask,
                                                std::max(reference.width(), reference.height()), 1);
  return OneOfEachCell(internal::KeepConsistent(matches, consistency), images[0], options);
}

}  // namespace plumbline
