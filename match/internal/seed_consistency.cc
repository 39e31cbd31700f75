#include "match/internal/seed_consistency.h"

#include <tbb/parallel_for.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <flann/flann.hpp>
#include <optional>
#include <utility>

namespace plumbline::internal {
namespace {

// A neighbour as the seed sees it.
struct Neighbour {
  Eigen::Vector2d offset_px{0, 0};        // in the reference
  Eigen::Vector2d displacement_px{0, 0};  // less that of the seed
};

struct Support {
  int count = 0;
  double misfit_px = 0;  // summed over those that agree
  Eigen::Matrix2d gradient = Eigen::Matrix2d::Zero();
  bool operator<(const Support& other) const {
    return count != other.count ? count < other.count : misfit_px > other.misfit_px;
  }
};

// A gradient that stands for no more than a motion to the pixel lets neighbours differ by this
// share of their distance.
constexpr double kLooseSlope = 0.1;
constexpr double kFittedSlope = 0.03;

bool Agrees(const Neighbour& n, const Eigen::Matrix2d& gradient, double tolerance_px, double slope,
            double* misfit_px) {
  *misfit_px = (n.displacement_px - gradient * n.offset_px).norm();
  return *misfit_px <= tolerance_px + slope * n.offset_px.norm();
}

Support CountSupport(const std::vector<Neighbour>& neighbours, const Eigen::Matrix2d& gradient,
                     double tolerance_px, double slope) {
  Support support;
  support.gradient = gradient;
  for (const Neighbour& n : neighbours) {
    double misfit_px = 0;
    if (!Agrees(n, gradient, tolerance_px, slope, &misfit_px)) continue;
    ++support.count;
    support.misfit_px += misfit_px;
  }
  return support;
}

bool IsPlausible(const Eigen::Matrix2d& gradient) {
  const Eigen::Matrix2d map = Eigen::Matrix2d::Identity() + gradient;
  // The singular values are the sum and, where the map does not mirror, the difference of these.
  const double turning = std::hypot(map(0, 0) + map(1, 1), map(1, 0) - map(0, 1)) / 2;
  const double shearing = std::hypot(map(0, 0) - map(1, 1), map(1, 0) + map(0, 1)) / 2;
  return turning + shearing < 2.5 && turning - shearing > 0.4;
}

// The gradient of the map that takes two neighbours where they went.
std::optional<Eigen::Matrix2d> GradientThrough(const Neighbour& a, const Neighbour& b) {
  Eigen::Matrix2d offsets, displacements;
  offsets << a.offset_px, b.offset_px;
  displacements << a.displacement_px, b.displacement_px;
  constexpr double kLeastSine = 0.3;
  if (std::abs(offsets.determinant()) < kLeastSine * a.offset_px.norm() * b.offset_px.norm() ||
      offsets.determinant() == 0) {
    return std::nullopt;
  }
  const Eigen::Matrix2d gradient = displacements * offsets.inverse();
  if (!IsPlausible(gradient)) return std::nullopt;
  return gradient;
}

struct Around {
  std::optional<Eigen::Matrix2d> gradient;
  bool contradicts = false;  // the map takes the seed elsewhere
};

// The map that the agreeing neighbours give by least squares without the seed, if it takes the seed
// where it went. A line of neighbours gives none: some affine map takes a line and any further
// point anywhere.
Around FitAround(const std::vector<Neighbour>& neighbours, const Eigen::Matrix2d& agreed,
                 double tolerance_px, double slope) {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
  double distance_px = 0;
  for (const Neighbour& n : neighbours) {
    double misfit_px = 0;
    if (!Agrees(n, agreed, tolerance_px, slope, &misfit_px)) continue;
    const Eigen::Vector3d row(1, n.offset_px.x(), n.offset_px.y());
    normal += row * row.transpose();
    right += row * n.displacement_px.transpose();
    distance_px += n.offset_px.norm();
  }
  if (normal(0, 0) < 3) return {};
  const Eigen::Matrix2d scatter =
      normal.bottomRightCorner<2, 2>() -
      normal.bottomLeftCorner<2, 1>() * normal.topRightCorner<1, 2>() / normal(0, 0);
  const Eigen::Vector2d spread =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(scatter).eigenvalues();
  constexpr double kLeastSpread = 0.02;
  if (!(spread(0) > kLeastSpread * spread(1))) return {};
  const Eigen::Matrix<double, 3, 2> fit = normal.ldlt().solve(right);
  const Eigen::Matrix2d gradient = fit.bottomRows<2>().transpose();
  const double off_px = fit.row(0).norm();
  if (off_px > tolerance_px + kFittedSlope * distance_px / normal(0, 0)) return {{}, true};
  if (!IsPlausible(gradient)) return {};
  return {gradient, false};
}

// Support of the seed with its gradient, and the fitted one where there are neighbours enough.
Support BestSupport(const std::vector<Neighbour>& neighbours, const Eigen::Matrix2d& own,
                    const ConsistencyOptions& options, std::uint64_t random_seed) {
  const double tolerance_px = options.tolerance_px;
  Support best;
  for (const double slope : {kFittedSlope, kLooseSlope}) {
    Support support = CountSupport(neighbours, own, tolerance_px, slope);
    const Around around = FitAround(neighbours, own, tolerance_px, slope);
    if (around.contradicts || support.count <= best.count) continue;
    support.gradient = around.gradient.value_or(own);
    best = support;
  }
  bool fitted = false;
  const std::size_t n = neighbours.size();
  const auto try_pair = [&](std::size_t j, std::size_t k) {
    const auto through = GradientThrough(neighbours[j], neighbours[k]);
    if (!through) return;
    Support support = CountSupport(neighbours, *through, tolerance_px, kFittedSlope);
    // The pair itself agrees anyhow: it takes two more to bear it out, among many pairs.
    if (support.count < (n > 4 ? 4 : 3) ||
        (fitted ? !(best < support) : support.count < best.count))
      return;
    const Around around = FitAround(neighbours, *through, tolerance_px, kFittedSlope);
    if (!around.gradient) return;
    support.gradient = *around.gradient;
    best = support;
    fitted = true;
  };
  if (options.draws == 0) {
    for (std::size_t j = 0; j < n; ++j) {
      for (std::size_t k = j + 1; k < n; ++k) try_pair(j, k);
    }
    return best;
  }
  for (int draw = 0; draw < options.draws; ++draw) {
    random_seed = MixBits(random_seed);
    const std::size_t j = (random_seed >> 32) % n, k = (random_seed & 0xFFFFFFFFU) % n;
    if (j != k) try_pair(j, k);
  }
  return best;
}

}  // namespace

std::uint64_t MixBits(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15ULL;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31);
}

struct NearestSeeds::State {
  std::vector<double> places;
  std::optional<flann::KDTreeSingleIndex<flann::L2_Simple<double>>> index;
};

NearestSeeds::NearestSeeds(const std::vector<CorrelationSeed>& seeds)
    : state_(std::make_unique<State>()) {
  for (const CorrelationSeed& seed : seeds) {
    state_->places.push_back(seed.reference_px.x());
    state_->places.push_back(seed.reference_px.y());
  }
  if (seeds.empty()) return;
  state_->index.emplace(flann::Matrix<double>(state_->places.data(), seeds.size(), 2),
                        flann::KDTreeSingleIndexParams());
  state_->index->buildIndex();
}
NearestSeeds::~NearestSeeds() = default;

std::vector<std::size_t> NearestSeeds::Find(const Eigen::Vector2d& place_px, int count,
                                            double reach_px) const {
  if (!state_->index || count <= 0) return {};
  Eigen::Vector2d query = place_px;
  std::vector<std::vector<std::size_t>> indices;
  std::vector<std::vector<double>> squared_px2;
  state_->index->knnSearch(flann::Matrix<double>(query.data(), 1, 2), indices, squared_px2,
                           static_cast<std::size_t>(count),
                           flann::SearchParams(flann::FLANN_CHECKS_UNLIMITED));
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < indices[0].size(); ++i) {
    if (squared_px2[0][i] <= reach_px * reach_px) out.push_back(indices[0][i]);
  }
  return out;
}

std::vector<CorrelationSeed> KeepConsistent(const std::vector<CorrelationSeed>& seeds,
                                            const ConsistencyOptions& options) {
  const NearestSeeds nearest(seeds);
  std::vector<std::optional<CorrelationSeed>> kept(seeds.size());
  tbb::parallel_for(std::size_t{0}, seeds.size(), [&](std::size_t i) {
    const CorrelationSeed& seed = seeds[i];
    std::vector<Neighbour> neighbours;
    for (const std::size_t j :
         nearest.Find(seed.reference_px, options.neighbours + 1, options.reach_px)) {
      if (j == i) continue;
      neighbours.push_back({seeds[j].reference_px - seed.reference_px,
                            seeds[j].displacement_px - seed.displacement_px});
    }
    kept[i] = seed;
    if (neighbours.size() <= static_cast<std::size_t>(options.least_support)) return;
    const Support best =
        BestSupport(neighbours, seed.gradient, options, MixBits(options.random_seed ^ i));
    if (best.count >= options.least_support) {
      kept[i]->gradient = best.gradient;
    } else {
      kept[i].reset();
    }
  });
  std::vector<CorrelationSeed> out;
  for (const auto& seed : kept) {
    if (seed) out.push_back(*seed);
  }
  return out;
}

}  // namespace plumbline::internal
