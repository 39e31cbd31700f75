#include "match/fft_seeds.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "calib/error.h"
#include "match/internal/fft_correlator.h"
#include "match/internal/seed_consistency.h"
#include "match/internal/seed_images.h"
#include "match/internal/subset_search.h"

namespace plumbline {
namespace {

using internal::SeedLevel;

constexpr int kCoarsestPx = 320;      // longer side of the level that is searched as a whole
constexpr int kCoarseRadiusPx = 12;   // smallest template of a level that is not the finest
constexpr int kCoarseSpacingPx = 16;  // smallest lattice there
// A template of the coarser levels only has to beat chance, which gives up to 0.4 on a 25 px
// template; with the uniqueness criterion half of that is seen through.
constexpr double kCoarseZncc = 0.4;
constexpr double kCoarseContrastShare = 0.5;  // of min_contrast_grey: averaging takes contrast away
constexpr int kReachPx = 3;                   // around a prediction
constexpr double kNearSpacings = 2.5;         // of the lattice: how far a seed predicts
constexpr std::size_t kMostWholeSearches = 400;
// Pixels transformed at each finer level for what is unexplained.
constexpr double kFinerSearchPixels = 1e7;
constexpr std::size_t kFewestWholeSearches = 8;  // fewer are not worth the transform of the image

enum class Outcome {
  kUntextured,
  kLeaving,     // as the seeds around it go, it leaves the image
  kFarLeaving,  // as the nearest of them goes, which is far
  kUnexplained,
  kFound
};

struct Place {
  Eigen::Vector2i centre_px{0, 0};  // of the level
  Outcome outcome = Outcome::kUnexplained;
  CorrelationSeed seed;                                    // at full resolution
  Eigen::Matrix2d cut_gradient = Eigen::Matrix2d::Zero();  // with which the seed was searched
};

// Everything that a level's search goes by.
struct LevelSearch {
  const FftSeedOptions& options;
  const SeedLevel& level;
  bool finest = false;
  int radius_px = 0;
  int spacing_px = 0;

  LevelSearch(const FftSeedOptions& given, const SeedLevel& at)
      : options(given), level(at), finest(at.factor == 1) {
    radius_px = finest ? options.subset_px / 2
                       : std::max(kCoarseRadiusPx, options.subset_px / 2 / level.factor);
    spacing_px =
        finest ? options.spacing_px : std::max(kCoarseSpacingPx, options.spacing_px / level.factor);
  }
  double least_zncc() const {
    return finest ? options.min_zncc : std::min(kCoarseZncc, options.min_zncc);
  }
  double least_contrast() const {
    return options.min_contrast_grey * (finest ? 1 : kCoarseContrastShare);
  }
  std::optional<internal::SubsetTemplate> Template(const Place& place) const {
    return internal::CutTemplate(level.reference, level.mask, place.centre_px, radius_px,
                                 least_contrast());
  }
  void Accept(const Eigen::Vector2d& displacement_px, const Eigen::Matrix2d& gradient, double zncc,
              Place* place) const {
    const CorrelationSeed seed{place->centre_px.cast<double>() * level.factor,
                               displacement_px * level.factor, gradient, zncc};
    const bool within = options.search_px == 0 || seed.displacement_px.cwiseAbs().maxCoeff() <=
                                                      options.search_px + level.factor;
    if (zncc < least_zncc() || !within) return;
    if (place->outcome == Outcome::kFound && place->seed.score >= zncc) return;
    place->outcome = Outcome::kFound;
    place->seed = seed;
    place->cut_gradient = gradient;
  }
};

// Whether a subset that moves so keeps wholly within the image.
bool StaysInside(const LevelSearch& search, const Place& place, const Eigen::Vector2d& motion_px) {
  const Eigen::Vector2d to = place.centre_px.cast<double>() + motion_px;
  const ImageSize size = search.level.deformed.size();
  return to.x() >= search.radius_px && to.y() >= search.radius_px &&
         to.x() <= size.width - 1 - search.radius_px &&
         to.y() <= size.height - 1 - search.radius_px;
}

Eigen::Vector2d PredictedMotion(const CorrelationSeed& seed, const Eigen::Vector2d& here_px) {
  return seed.displacement_px + seed.gradient * (here_px - seed.reference_px);
}

// Searches around what the nearest seeds of the coarser level predict.
void SearchAroundPredictions(const LevelSearch& search, const std::vector<CorrelationSeed>& coarser,
                             const internal::NearestSeeds& nearest, double reach_px, Place* place) {
  const auto subset = search.Template(*place);
  if (!subset) {
    place->outcome = Outcome::kUntextured;
    return;
  }
  const double factor = search.level.factor;
  const Eigen::Vector2d here_px = place->centre_px.cast<double>() * factor;
  std::vector<Eigen::Vector2d> tried;
  bool stays = false;
  for (const std::size_t i : nearest.Find(here_px, 4, reach_px)) {
    const CorrelationSeed& seed = coarser[i];
    const Eigen::Vector2d motion_px = PredictedMotion(seed, here_px) / factor;
    const auto same = [&](const Eigen::Vector2d& other) {
      return (other - motion_px).norm() < 1.5;
    };
    if (std::any_of(tried.begin(), tried.end(), same)) continue;
    tried.push_back(motion_px);
    if (!StaysInside(search, *place, motion_px)) continue;
    stays = true;
    const auto match =
        internal::SearchAround(*subset, search.level.deformed, motion_px, seed.gradient, kReachPx);
    if (match) search.Accept(match->displacement_px, seed.gradient, match->zncc, place);
  }
  if (!tried.empty()) {
    if (!stays) place->outcome = Outcome::kLeaving;
    return;
  }
  for (const std::size_t i : nearest.Find(here_px, 1, std::numeric_limits<double>::max())) {
    if (!StaysInside(search, *place, PredictedMotion(coarser[i], here_px) / factor)) {
      place->outcome = Outcome::kFarLeaving;
    }
  }
}

// The whole image, for the places that nothing explains, evenly as many as there is time for.
void SearchWhole(const LevelSearch& search, bool coarsest, std::vector<Place>* places) {
  std::vector<Place*> open;
  for (Place& place : *places) {
    if (place.outcome == Outcome::kUnexplained ||
        (place.outcome == Outcome::kFarLeaving && !search.finest)) {
      open.push_back(&place);
    }
  }
  if (open.empty()) return;
  std::size_t most = kMostWholeSearches;
  if (!coarsest) {
    const auto pixels = static_cast<double>(search.level.deformed.pixel_count());
    most = std::min(most, static_cast<std::size_t>(kFinerSearchPixels / pixels));
    if (most < kFewestWholeSearches) return;
  }
  const std::size_t count = std::min(most, open.size());
  const internal::FftCorrelator correlator(search.level.deformed, search.radius_px);
  const int search_px =
      search.options.search_px == 0 ? 0 : search.options.search_px / search.level.factor + 1;
  tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
    Place& place = *open[(2 * i + 1) * open.size() / (2 * count)];
    const auto subset = search.Template(place);
    const auto peak = subset ? correlator.Find(*subset, search_px) : std::nullopt;
    if (!peak || peak->second_zncc > search.options.max_second_share * peak->zncc) return;
    search.Accept(peak->displacement_px, Eigen::Matrix2d::Zero(), peak->zncc, &place);
  });
}

// A subset that was cut with another gradient than its neighbours turn out to have peaks off its
// place: once more.
void SearchAgain(const LevelSearch& search, Place* place) {
  constexpr double kSameGradient = 0.03;
  const Eigen::Matrix2d gradient = place->seed.gradient;
  if ((gradient - place->cut_gradient).cwiseAbs().maxCoeff() < kSameGradient) return;
  const auto subset = search.Template(*place);
  const auto match =
      internal::SearchAround(*subset, search.level.deformed,
                             place->seed.displacement_px / search.level.factor, gradient, kReachPx);
  if (match) search.Accept(match->displacement_px, gradient, match->zncc, place);
}

// The seeds that their neighbours bear out, with gradients; the places of the others are open
// again.
std::vector<CorrelationSeed> KeepConsistent(const LevelSearch& search, std::vector<Place>* places) {
  std::vector<CorrelationSeed> found;
  for (const Place& place : *places) {
    if (place.outcome == Outcome::kFound) found.push_back(place.seed);
  }
  internal::ConsistencyOptions options;
  options.reach_px = 3.0 * search.spacing_px * search.level.factor;
  options.tolerance_px = search.level.factor;
  const std::vector<CorrelationSeed> kept = internal::KeepConsistent(found, options);
  std::vector<Place*> again;
  for (Place& place : *places) {  // kept is in their order
    if (place.outcome != Outcome::kFound) continue;
    if (again.size() < kept.size() && kept[again.size()].reference_px == place.seed.reference_px) {
      place.seed.gradient = kept[again.size()].gradient;
      again.push_back(&place);
    } else {
      place.outcome = Outcome::kUnexplained;
    }
  }
  tbb::parallel_for(std::size_t{0}, again.size(),
                    [&](std::size_t i) { SearchAgain(search, again[i]); });
  std::vector<CorrelationSeed> seeds;
  for (const Place* place : again) seeds.push_back(place->seed);
  return seeds;
}

// From the seeds of the level to the open places around them, and on from what is found there.
std::vector<CorrelationSeed> Grow(const LevelSearch& search, std::vector<Place>* places) {
  constexpr int kMostRounds = 50;
  const double reach_px = kNearSpacings * search.spacing_px * search.level.factor;
  std::vector<CorrelationSeed> seeds = KeepConsistent(search, places);
  std::vector<CorrelationSeed> fresh = seeds;
  for (int round = 0; round < kMostRounds && !fresh.empty(); ++round) {
    const internal::NearestSeeds nearest(seeds), nearest_fresh(fresh);
    std::vector<int> is_new(places->size(), 0);
    tbb::parallel_for(std::size_t{0}, places->size(), [&](std::size_t i) {
      Place& place = (*places)[i];
      if (place.outcome == Outcome::kFound || place.outcome == Outcome::kUntextured) return;
      const Eigen::Vector2d here_px = place.centre_px.cast<double>() * search.level.factor;
      if (nearest_fresh.Find(here_px, 1, reach_px).empty()) return;
      SearchAroundPredictions(search, seeds, nearest, reach_px, &place);
      is_new[i] = place.outcome == Outcome::kFound ? 1 : 0;
    });
    if (std::count(is_new.begin(), is_new.end(), 1) == 0) break;
    seeds = KeepConsistent(search, places);
    fresh.clear();
    for (std::size_t i = 0; i < places->size(); ++i) {
      const Place& place = (*places)[i];
      if (is_new[i] != 0 && place.outcome == Outcome::kFound) fresh.push_back(place.seed);
    }
  }
  return seeds;
}

}  // namespace

void FftSeedOptions::Check() const {
  const auto require = [](bool holds, const std::string& what) {
    if (!holds) throw UsageError("FFT seeds: " + what);
  };
  require(subset_px >= 9 && subset_px % 2 == 1,
          fmt::format("subset_px must be odd and at least 9, not {}", subset_px));
  require(spacing_px >= 1, fmt::format("spacing_px must be at least 1, not {}", spacing_px));
  require(search_px >= 0,
          fmt::format("search_px must be 0 (whole image) or more, not {}", search_px));
  require(min_zncc > 0 && min_zncc < 1,
          fmt::format("min_zncc must lie between 0 and 1, not {}", min_zncc));
  require(max_second_share > 0 && max_second_share < 1,
          fmt::format("max_second_share must lie between 0 and 1, not {}", max_second_share));
  require(min_contrast_grey >= 0 && min_contrast_grey < 256,
          fmt::format("min_contrast_grey must be 0 to 255, not {}", min_contrast_grey));
}

std::vector<CorrelationSeed> FindFftSeeds(const GrayImage& reference, const GrayImage& deformed,
                                          const Image<std::uint8_t>* mask,
                                          const FftSeedOptions& options) {
  options.Check();
  internal::CheckSeedInput("FFT seeds", reference, deformed, mask, options.subset_px);
  const std::vector<SeedLevel> levels = internal::BuildSeedLevels(
      reference, deformed, mask, kCoarsestPx, 2 * (2 * kCoarseRadiusPx + 1));
  std::vector<CorrelationSeed> seeds;
  double coarser_spacing_px = 0;
  for (auto level = levels.rbegin(); level != levels.rend(); ++level) {
    const LevelSearch search(options, *level);
    std::vector<Place> places;
    for (const Eigen::Vector2i& centre :
         internal::SeedLattice(level->mask, search.spacing_px, search.radius_px)) {
      places.push_back({centre, Outcome::kUnexplained, {}});
    }
    const internal::NearestSeeds nearest(seeds);
    tbb::parallel_for(std::size_t{0}, places.size(), [&](std::size_t i) {
      SearchAroundPredictions(search, seeds, nearest, kNearSpacings * coarser_spacing_px,
                              &places[i]);
    });
    SearchWhole(search, level == levels.rbegin(), &places);
    coarser_spacing_px = search.spacing_px * level->factor;
    seeds = Grow(search, &places);
  }
  return seeds;
}

}  // namespace plumbline
