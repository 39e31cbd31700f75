#pragma once

#include <cstdint>
#include <queue>
#include <utility>
#include <vector>

#include "match/planar_field.h"
#include "match/subset_correlator.h"

namespace plumbline::internal {

// The correlation of a field's points, one from the other: keeps what is found in the field, and
// the warps that neighbours start from.
class Propagation {
 public:
  using Warp = Eigen::Matrix<float, 2, 6>;  // SubsetWarp::c; only ever a start

  // All must outlive it. The field's points that are not to be tried are kMasked. pixels: where
  // each point's subset is in the correlator's reference; null: on the field's grid. curvature: the
  // second order that matches of each point start with; null: that of their neighbours.
  Propagation(const SubsetCorrelator& correlator, const CorrelationImage& deformed,
              PlanarField& field, const Image<Eigen::Vector2i>* pixels = nullptr,
              const Image<SubsetCurvature>* curvature = nullptr);

  // A point of the field (row * columns + column) and the warp to start from.
  using Start = std::pair<std::int64_t, SubsetWarp>;

  // Matches these points, in parallel. Points that are kOk already are passed over; of several
  // starts of a point the first counts.
  void Try(const std::vector<Start>& starts);

  // Goes on from all points that matched to their neighbours, the best correlated first, until
  // nothing is left that could be reached.
  void Spread();

  // Forgets from where the points that did not match were tried.
  void TryAgain();

  const Warp& WarpOf(std::int64_t point) const { return warps_.data()[point]; }
  Eigen::Vector2i PixelOf(std::int64_t point) const;

 private:
  struct Found {
    float zncc;
    std::int64_t point;
    // Best correlation first, then by place: an order that threads cannot change.
    friend bool operator<(const Found& a, const Found& b) {
      return a.zncc != b.zncc ? a.zncc < b.zncc : a.point > b.point;
    }
  };
  void Store(std::int64_t point, const SubsetMatch& match);

  const SubsetCorrelator& correlator_;
  const CorrelationImage& deformed_;
  PlanarField& field_;
  const Image<Eigen::Vector2i>* pixels_;
  const Image<SubsetCurvature>* curvature_;
  Image<Warp> warps_;
  Image<std::uint8_t> tries_;
  std::priority_queue<Found> found_;
};

}  // namespace plumbline::internal
