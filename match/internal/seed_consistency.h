#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "match/correlation_seed.h"

namespace plumbline::internal {

// The seeds nearest a place of the reference: exact, and the same from run to run. May be asked
// from many threads. Does not keep the seeds.
class NearestSeeds {
 public:
  explicit NearestSeeds(const std::vector<CorrelationSeed>& seeds);
  ~NearestSeeds();

  // Indices, nearest first, of at most `count` seeds within reach_px.
  std::vector<std::size_t> Find(const Eigen::Vector2d& place_px, int count, double reach_px) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

struct ConsistencyOptions {
  int neighbours = 8;
  double reach_px = 0;      // further neighbours have no say
  double tolerance_px = 1;  // of a displacement against what the neighbours' affine map says
  int least_support = 2;    // neighbours that must agree; seeds with no more neighbours pass
  // 0: every pair of neighbours makes a map with the seed. Else so many pairs, drawn at random.
  int draws = 0;
  std::uint64_t random_seed = 1;
};

// Local affine RANSAC (Fischler and Bolles 1981): keeps the seeds whose motion agrees with that of
// neighbours under one affine map, and gives them the gradient of the map that those who agree
// give without the seed. The maps tried are through the seed and pairs of its neighbours, or have
// the gradient that the seed has already; maps that mirror, or stretch by more than 2.5, do not
// count. A seed needs its own few, not the majority: parts that move differently keep their
// own motion. Order and displacements are kept.
std::vector<CorrelationSeed> KeepConsistent(const std::vector<CorrelationSeed>& seeds,
                                            const ConsistencyOptions& options);

// Deterministic, well mixed 64 bits (the finaliser of SplitMix64).
std::uint64_t MixBits(std::uint64_t x);

}  // namespace plumbline::internal
