#include "match/find_seeds.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>
#include <utility>

#include "calib/error.h"
#include "match/internal/seed_consistency.h"
#include "match/internal/seed_images.h"
#include "match/internal/subset_search.h"

namespace plumbline {
namespace {

constexpr double kTolerancePx = 1.5;
// Below this a subset may have been cut with a gradient that is off by 0.2.
constexpr double kSureScore = 0.75;

void SortBestFirst(std::vector<CorrelationSeed>* seeds) {
  const auto key = [](const CorrelationSeed& seed) {
    return std::tuple(-seed.score, seed.reference_px.y(), seed.reference_px.x(),
                      seed.displacement_px.y(), seed.displacement_px.x());
  };
  std::sort(seeds->begin(), seeds->end(),
            [&](const CorrelationSeed& a, const CorrelationSeed& b) { return key(a) < key(b); });
}

Eigen::Vector2d PredictedPlace(const CorrelationSeed& seed, const Eigen::Vector2d& here_px) {
  return here_px + seed.displacement_px + seed.gradient * (here_px - seed.reference_px);
}

// Share of the textured places that have no seed near them, and that the nearest one does not
// take out of the image.
double UnexplainedShare(const internal::SeedLevel& images,
                        const std::vector<CorrelationSeed>& seeds, const FftSeedOptions& options) {
  const int radius_px = options.subset_px / 2;
  const auto places = internal::SeedLattice(images.mask, options.spacing_px, radius_px);
  const internal::NearestSeeds nearest(seeds);
  std::vector<int> textured(places.size(), 0), unexplained(places.size(), 0);
  tbb::parallel_for(std::size_t{0}, places.size(), [&](std::size_t i) {
    if (!internal::CutTemplate(images.reference, images.mask, places[i], radius_px,
                               options.min_contrast_grey)) {
      return;
    }
    textured[i] = 1;
    unexplained[i] = 1;
    const Eigen::Vector2d here_px = places[i].cast<double>();
    for (const std::size_t k : nearest.Find(here_px, 1, std::numeric_limits<double>::max())) {
      const Eigen::Vector2d there_px = PredictedPlace(seeds[k], here_px);
      const bool near = (seeds[k].reference_px - here_px).norm() <= 1.1 * options.spacing_px &&
                        seeds[k].score >= kSureScore;
      // Subsets that are cut by the border, or would be by a little more, have no seed.
      const int margin_px = radius_px + 3;
      const bool leaves = there_px.x() < margin_px || there_px.y() < margin_px ||
                          there_px.x() > images.mask.width() - 1 - margin_px ||
                          there_px.y() > images.mask.height() - 1 - margin_px;
      if (near || leaves) unexplained[i] = 0;
    }
  });
  const auto total = std::count(textured.begin(), textured.end(), 1);
  const auto open = std::count(unexplained.begin(), unexplained.end(), 1);
  return total == 0 ? 0 : static_cast<double>(open) / static_cast<double>(total);
}

// Those of `more` that say something new: no seed near them, or one that moves otherwise.
void AddNew(const std::vector<CorrelationSeed>& more, double reach_px,
            std::vector<CorrelationSeed>* seeds) {
  const internal::NearestSeeds nearest(*seeds);
  std::vector<CorrelationSeed> fresh;
  for (const CorrelationSeed& seed : more) {
    const auto near = nearest.Find(seed.reference_px, 4, reach_px);
    const bool told = std::any_of(near.begin(), near.end(), [&](std::size_t k) {
      const Eigen::Vector2d there_px = PredictedPlace((*seeds)[k], seed.reference_px);
      return (there_px - seed.reference_px - seed.displacement_px).norm() <= kTolerancePx;
    });
    if (!told) fresh.push_back(seed);
  }
  seeds->insert(seeds->end(), fresh.begin(), fresh.end());
}

void CheckSpacing(int spacing_px) {
  if (spacing_px < 1) {
    throw UsageError(fmt::format("seeds: spacing_px must be at least 1, not {}", spacing_px));
  }
}

}  // namespace

void FindSeedsOptions::Check() const {
  fft.Check();
  features.Check();
  if (!(max_unexplained >= 0 && max_unexplained <= 1)) {
    throw UsageError(
        fmt::format("seeds: max_unexplained must lie between 0 and 1, not {}", max_unexplained));
  }
}

std::vector<CorrelationSeed> FindSeeds(const GrayImage& reference, const GrayImage& deformed,
                                       const Image<std::uint8_t>* mask,
                                       const FindSeedsOptions& options) {
  options.Check();
  std::vector<CorrelationSeed> seeds = FindFftSeeds(reference, deformed, mask, options.fft);
  if (!options.use_features) {
    SortBestFirst(&seeds);
    return seeds;
  }
  const auto images = internal::BuildSeedLevels(reference, deformed, mask,
                                                std::max(reference.width(), reference.height()), 1);
  if (UnexplainedShare(images[0], seeds, options.fft) > options.max_unexplained) {
    AddNew(FindFeatureSeeds(reference, deformed, mask, options.features), options.fft.spacing_px,
           &seeds);
  }
  internal::ConsistencyOptions consistency;
  consistency.reach_px = 3.0 * std::max(options.fft.spacing_px, options.features.spacing_px);
  consistency.tolerance_px = kTolerancePx;
  seeds = internal::KeepConsistent(seeds, consistency);
  SortBestFirst(&seeds);
  return seeds;
}

std::vector<CorrelationSeed> SeedsFromField(const PlanarField& prior, int spacing_px) {
  CheckSpacing(spacing_px);
  const ImageSize size = prior.size();
  const bool has_gradient = !prior.gradient.empty(), has_zncc = !prior.zncc.empty();
  if (prior.displacement_px.size() != size || (has_gradient && prior.gradient.size() != size) ||
      (has_zncc && prior.zncc.size() != size)) {
    throw InputError(
        "seeds from a prior field: its displacements, gradients, ZNCC and statuses differ in size; "
        "give a field of one grid");
  }
  std::map<std::pair<int, int>, CorrelationSeed> best;
  for (int row = 0; row < size.height; ++row) {
    for (int column = 0; column < size.width; ++column) {
      if (prior.status(row, column) != Status::kOk) continue;
      CorrelationSeed seed;
      seed.reference_px = prior.PixelOf(row, column);
      seed.displacement_px = prior.displacement_px(row, column);
      if (has_gradient) seed.gradient = prior.gradient(row, column).cast<double>();
      seed.score = has_zncc ? static_cast<double>(prior.zncc(row, column)) : 1;
      if (!seed.displacement_px.allFinite() || !seed.gradient.allFinite() ||
          !std::isfinite(seed.score)) {
        continue;
      }
      seed.score = std::clamp(seed.score, 0.0, 1.0);
      const Eigen::Vector2i cell = (seed.reference_px / spacing_px).array().floor().cast<int>();
      const auto [at, fresh] = best.try_emplace({cell.y(), cell.x()}, seed);
      if (!fresh && seed.score > at->second.score) at->second = seed;
    }
  }
  std::vector<CorrelationSeed> out;
  for (const auto& [cell, seed] : best) out.push_back(seed);
  SortBestFirst(&out);
  return out;
}

AffineMotion AffineMotion::Rigid(const Eigen::Vector2d& about_px, double angle_rad,
                                 const Eigen::Vector2d& displacement_px) {
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  AffineMotion motion{about_px, displacement_px, {}};
  motion.gradient << c - 1, -s, s, c - 1;
  return motion;
}

std::vector<CorrelationSeed> SeedsFromAffine(const AffineMotion& motion, ImageSize size,
                                             const Image<std::uint8_t>* mask, int spacing_px) {
  CheckSpacing(spacing_px);
  if (mask != nullptr && mask->size() != size) {
    throw InputError(
        fmt::format("seeds from a given motion: the mask has {} x {} px and the image "
                    "{} x {} px; draw it on the reference image",
                    mask->width(), mask->height(), size.width, size.height));
  }
  if (!motion.about_px.allFinite() || !motion.displacement_px.allFinite() ||
      !motion.gradient.allFinite()) {
    throw InputError(
        "seeds from a given motion: its centre, displacement and gradient must be finite numbers");
  }
  std::vector<CorrelationSeed> out;
  for (const Eigen::Vector2i& place : internal::SeedLattice(
           mask != nullptr ? *mask : Image<std::uint8_t>(size, 1), spacing_px, 0)) {
    const Eigen::Vector2d here_px = place.cast<double>();
    const Eigen::Vector2d moved_px =
        motion.displacement_px + motion.gradient * (here_px - motion.about_px);
    const Eigen::Vector2d there_px = here_px + moved_px;
    if (there_px.x() < 0 || there_px.y() < 0 || there_px.x() > size.width - 1 ||
        there_px.y() > size.height - 1) {
      continue;
    }
    out.push_back({here_px, moved_px, motion.gradient, 1});
  }
  return out;
}

}  // namespace plumbline
