#include "calib/internal/ray_table.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace plumbline::internal {
namespace {

using Lanes = ModeVectors::Lanes;

constexpr int kCells[] = {40, 80, 160};  // across the longer side of the image
constexpr double kEnoughServed = 0.98;
constexpr double kRelativeTolerance = 1e-4;
constexpr double kTogetherTolerance = 1e-4;
constexpr double kRayTolerance = 1e-5;
// What the inversion of the lens leaves, so that a state without any change is served.
constexpr double kNoise_rad = 1e-11;

// The cubic through the values at 0, 1, 2, 3, taken at t.
Eigen::Array4f LagrangeWeights(double t) {
  const double a = t, b = t - 1, c = t - 2, d = t - 3;
  return Eigen::Array4d(-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6).cast<float>();
}

std::vector<Eigen::Vector3d> Rays(const TurnedCamera& state,
                                  std::span<const Eigen::Vector2d> pixels) {
  std::vector<Eigen::Vector3d> rays(pixels.size());
  state.camera.Unproject(pixels, rays);
  for (Eigen::Vector3d& ray : rays) ray = state.rig_from_camera * ray;
  return rays;
}

}  // namespace

RayTable::RayTable(const TurnedCamera& nominal, std::span<const TurnedCamera> states)
    : blocks_((static_cast<int>(states.size()) + ModeVectors::kLanes - 1) / ModeVectors::kLanes),
      stride_(4 + 12 * static_cast<std::size_t>(blocks_)) {
  const ImageSize size = nominal.camera.size();
  for (const int cells : kCells) {
    Fill(nominal, states, static_cast<double>(std::max(size.width, size.height)) / cells);
    if (ServedShare() >= kEnoughServed) break;
  }
}

double RayTable::ServedShare() const {
  return std::accumulate(served_.begin(), served_.end(), 0.0) / static_cast<double>(served_.size());
}

void RayTable::Fill(const TurnedCamera& nominal, std::span<const TurnedCamera> states,
                    double step_px) {
  const ImageSize size = nominal.camera.size();
  columns_ = std::max(4, static_cast<int>(std::ceil(size.width / step_px)) + 1);
  rows_ = std::max(4, static_cast<int>(std::ceil(size.height / step_px)) + 1);
  step_ << size.width / (columns_ - 1.0), size.height / (rows_ - 1.0);
  const std::size_t nodes = static_cast<std::size_t>(rows_) * static_cast<std::size_t>(columns_);
  std::vector<Eigen::Vector2d> pixels;  // the nodes, then the middles of the cells
  std::vector<Eigen::Vector2d> middles;
  for (int r = 0; r < rows_; ++r) {
    for (int c = 0; c < columns_; ++c) {
      pixels.emplace_back(c * step_.x() - 0.5, r * step_.y() - 0.5);
      if (r + 1 < rows_ && c + 1 < columns_) middles.emplace_back(c + 0.5, r + 0.5);
    }
  }
  for (const Eigen::Vector2d& m : middles) {
    pixels.push_back(m.cwiseProduct(step_) - Eigen::Vector2d(0.5, 0.5));
  }

  const std::vector<Eigen::Vector3d> rays = Rays(nominal, pixels);
  values_.assign(nodes * stride_, 0.0F);
  for (std::size_t i = 0; i < nodes; ++i) {
    for (int d = 0; d < 3; ++d) {
      values_[i * stride_ + static_cast<std::size_t>(d)] = static_cast<float>(rays[i][d]);
    }
  }
  std::vector<std::vector<Eigen::Vector3d>> changes(states.size());
  std::vector<double> rms(states.size());
  tbb::parallel_for(std::size_t{0}, states.size(), [&](std::size_t k) {
    changes[k] = Rays(states[k], pixels);
    double sum = 0;
    std::size_t count = 0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      changes[k][i] -= rays[i];
      const double square = changes[k][i].squaredNorm();
      if (!std::isfinite(square)) continue;
      sum += square;
      ++count;
    }
    rms[k] = count > 0 ? std::sqrt(sum / static_cast<double>(count)) : 0;
    for (std::size_t i = 0; i < nodes; ++i) {
      float* const at = values_.data() + i * stride_ + 4 + 12 * (k / 4) + k % 4;
      for (int d = 0; d < 3; ++d) at[4 * d] = static_cast<float>(changes[k][i][d]);
    }
  });

  const double together =
      std::sqrt(std::inner_product(rms.begin(), rms.end(), rms.begin(), 0.0));  // of all states
  served_.assign(middles.size(), 1);
  tbb::parallel_for(std::size_t{0}, middles.size(), [&](std::size_t i) {
    std::vector<ModeVectors> found(static_cast<std::size_t>(blocks_));
    Eigen::Vector3d ray;
    Interpolate(middles[i], 0, found, &ray);
    bool good = (ray - rays[nodes + i]).norm() <= kRayTolerance;
    for (std::size_t k = 0; k < states.size() && good; ++k) {
      const ModeVectors& block = found[k / 4];
      const auto lane = static_cast<Eigen::Index>(k % 4);
      const Eigen::Vector3d& exact = changes[k][nodes + i];
      const Eigen::Vector3d error =
          Eigen::Vector3f(block.x[lane], block.y[lane], block.z[lane]).cast<double>() - exact;
      good = error.norm() <=
             kRelativeTolerance * exact.norm() + kTogetherTolerance * together + kNoise_rad;
    }
    served_[i] = good ? 1 : 0;
  });
}

void RayTable::Interpolate(const Eigen::Vector2d& position, int first_block,
                           std::span<ModeVectors> changes, Eigen::Vector3d* ray) const {
  const int column = std::clamp(static_cast<int>(position.x()) - 1, 0, columns_ - 4);
  const int row = std::clamp(static_cast<int>(position.y()) - 1, 0, rows_ - 4);
  const Eigen::Array4f wx = LagrangeWeights(position.x() - column);
  const Eigen::Array4f wy = LagrangeWeights(position.y() - row);
  std::array<const float*, 16> node;
  std::array<float, 16> weight;
  Lanes sum = Lanes::Zero();
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) {
      const std::size_t i = 4 * static_cast<std::size_t>(r) + static_cast<std::size_t>(c);
      node[i] = Node(row + r, column + c);
      weight[i] = wy[r] * wx[c];
      sum += weight[i] * Eigen::Map<const Lanes>(node[i]);
    }
  }
  *ray = sum.head<3>().cast<double>();
  for (std::size_t b = 0; b < changes.size(); ++b) {
    const std::size_t offset = 4 + 12 * (static_cast<std::size_t>(first_block) + b);
    Lanes x = Lanes::Zero(), y = Lanes::Zero(), z = Lanes::Zero();
    for (std::size_t i = 0; i < 16; ++i) {
      const float* const at = node[i] + offset;
      x += weight[i] * Eigen::Map<const Lanes>(at);
      y += weight[i] * Eigen::Map<const Lanes>(at + 4);
      z += weight[i] * Eigen::Map<const Lanes>(at + 8);
    }
    changes[b] = {x, y, z};
  }
}

bool RayTable::Look(const Eigen::Vector2d& pixel, int first_block, std::span<ModeVectors> changes,
                    Eigen::Vector3d* ray) const {
  const Eigen::Vector2d position = (pixel + Eigen::Vector2d(0.5, 0.5)).cwiseQuotient(step_);
  if (!(position.x() >= 0 && position.y() >= 0 && position.x() <= columns_ - 1 &&
        position.y() <= rows_ - 1)) {
    return false;
  }
  const int column = std::min(static_cast<int>(position.x()), columns_ - 2);
  const int row = std::min(static_cast<int>(position.y()), rows_ - 2);
  if (served_[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_ - 1) +
              static_cast<std::size_t>(column)] == 0) {
    return false;
  }
  Interpolate(position, first_block, changes, ray);
  return true;
}

}  // namespace plumbline::internal
