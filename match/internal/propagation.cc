#include "match/internal/propagation.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <unordered_set>

namespace plumbline::internal {
namespace {

constexpr std::uint8_t kMostTries = 3;  // from different neighbours
constexpr std::size_t kBatch = 128;     // points whose neighbours are matched together

}  // namespace

Propagation::Propagation(const SubsetCorrelator& correlator, const CorrelationImage& deformed,
                         PlanarField& field, const Image<Eigen::Vector2i>* pixels,
                         const Image<SubsetCurvature>* curvature)
    : correlator_(correlator),
      deformed_(deformed),
      field_(field),
      pixels_(pixels),
      curvature_(curvature),
      warps_(field.size(), Warp::Zero()),
      tries_(field.size(), 0) {}

Eigen::Vector2i Propagation::PixelOf(std::int64_t point) const {
  if (pixels_ != nullptr) return pixels_->data()[point];
  const auto columns = static_cast<std::int64_t>(field_.size().width);
  return field_.first_px + field_.step_px * Eigen::Vector2i(static_cast<int>(point % columns),
                                                            static_cast<int>(point / columns));
}

void Propagation::Store(std::int64_t point, const SubsetMatch& match) {
  const auto i = static_cast<std::size_t>(point);
  field_.status.data()[i] = match.status;
  field_.zncc.data()[i] = static_cast<float>(match.zncc);
  field_.iterations.data()[i] =
      static_cast<std::uint8_t>(std::min(255, field_.iterations.data()[i] + match.iterations));
  if (match.status == Status::kOutsideImage && match.iterations > 0) {
    // What lies beyond is led to from here, so that it is called outside too; last of all.
    warps_.data()[i] = match.warp.c.cast<float>();
    found_.push({-2, point});
  }
  if (match.status != Status::kOk) return;
  field_.displacement_px.data()[i] = match.warp.displacement_px();
  field_.gradient.data()[i] = match.warp.gradient().cast<float>();
  field_.cov_displacement_px2.data()[i] = TriangleOf(match.cov_displacement_px2);
  field_.cov_gradient.data()[i] = TriangleOf(match.cov_gradient);
  field_.reference_share.data()[i] = static_cast<float>(match.reference_share);
  warps_.data()[i] = match.warp.c.cast<float>();
  found_.push({static_cast<float>(match.zncc), point});
}

void Propagation::Try(const std::vector<Start>& starts) {
  std::vector<Start> wanted;
  std::unordered_set<std::int64_t> taken;
  for (const Start& start : starts) {
    const Status status = field_.status.data()[start.first];
    if (status != Status::kOk && status != Status::kMasked && taken.insert(start.first).second) {
      wanted.push_back(start);
    }
  }
  std::vector<SubsetMatch> matches(wanted.size());
  tbb::parallel_for(std::size_t{0}, wanted.size(), [&](std::size_t i) {
    SubsetWarp& start = wanted[i].second;
    if (curvature_ != nullptr) {
      start.c.rightCols<3>() = curvature_->data()[wanted[i].first].cast<double>();
    }
    matches[i] = correlator_.Match(deformed_, PixelOf(wanted[i].first), start);
  });
  for (std::size_t i = 0; i < wanted.size(); ++i) Store(wanted[i].first, matches[i]);
}

void Propagation::Spread() {
  const ImageSize size = field_.size();
  const std::array<Eigen::Vector2i, 4> neighbours = {Eigen::Vector2i(1, 0), Eigen::Vector2i(-1, 0),
                                                     Eigen::Vector2i(0, 1), Eigen::Vector2i(0, -1)};
  std::vector<Start> starts;
  while (!found_.empty()) {
    starts.clear();
    for (std::size_t n = 0; n < kBatch && !found_.empty(); ++n) {
      const std::int64_t from = found_.top().point;
      found_.pop();
      const int column = static_cast<int>(from % size.width);
      const int row = static_cast<int>(from / size.width);
      SubsetWarp warp;
      warp.c = WarpOf(from).cast<double>();
      for (const Eigen::Vector2i& by : neighbours) {
        const int c = column + by.x();
        const int r = row + by.y();
        if (c < 0 || r < 0 || c >= size.width || r >= size.height) continue;
        const Status status = field_.status(r, c);
        if (status == Status::kOk || status == Status::kMasked || tries_(r, c) >= kMostTries) {
          continue;
        }
        ++tries_(r, c);
        const std::int64_t to = static_cast<std::int64_t>(r) * size.width + c;
        starts.emplace_back(to, warp.MovedTo((PixelOf(to) - PixelOf(from)).cast<double>()));
      }
    }
    Try(starts);
  }
}

void Propagation::TryAgain() { std::fill(tries_.values().begin(), tries_.values().end(), 0); }

}  // namespace plumbline::internal
