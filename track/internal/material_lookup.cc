#include "track/internal/material_lookup.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "calib/median.h"
#include "track/internal/local_fit.h"

namespace plumbline::internal {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
constexpr double kReachOfSpacing = 1.7;
constexpr std::size_t kFewest = 4;

// On the surface, along the circumference and along the axis, from one to the other.
Eigen::Vector2d Apart(const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  const double angle = std::remainder(to.x() - from.x(), kTurn);
  return {from.z() * angle, to.y() - from.y()};
}

double MedianSpacing(const Image<Eigen::Vector3d>& material) {
  std::vector<double> spacings;
  for (int r = 0; r < material.height(); ++r) {
    for (int c = 0; c < material.width(); ++c) {
      const auto add = [&](int row, int column) {
        if (row >= material.height() || column >= material.width()) return;
        const double d = Apart(material(r, c), material(row, column)).norm();
        if (std::isfinite(d)) spacings.push_back(d);
      };
      add(r + 1, c);
      add(r, c + 1);
    }
  }
  return spacings.empty() ? 0 : Median(std::move(spacings));
}

}  // namespace

MaterialLookup::MaterialLookup(const Image<Eigen::Vector3d>& material,
                               const Image<Eigen::Vector3d>& point_mm, double reach_mm)
    : material_(material),
      reach_mm_(reach_mm > 0 ? reach_mm : kReachOfSpacing * MedianSpacing(material)) {
  double high_y = -std::numeric_limits<double>::infinity(), low_y = -high_y;
  double smallest = low_y;
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < material.pixel_count(); ++i) {
    const Eigen::Vector3d& m = material.data()[i];
    if (!m.allFinite() || !point_mm.data()[i].allFinite() || !(m.z() > 0)) continue;
    places.push_back(i);
    low_y = std::min(low_y, m.y());
    high_y = std::max(high_y, m.y());
    smallest = std::min(smallest, m.z());
  }
  if (places.empty() || !(reach_mm_ > 0)) return;
  // Cells at least as large as the reach, all round the wheel.
  low_y_mm_ = low_y;
  columns_ = std::max(1, static_cast<int>(kTurn * smallest / reach_mm_));
  cell_rad_ = kTurn / columns_;
  rows_ = static_cast<int>((high_y - low_y) / reach_mm_) + 1;
  cells_.resize(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_));
  for (const std::size_t i : places) {
    const Eigen::Vector3d& m = material.data()[i];
    cells_[static_cast<std::size_t>(Row(m.y()) * columns_ + Column(m.x()))].push_back(i);
  }
}

int MaterialLookup::Column(double angle_rad) const {
  const double turned = angle_rad - kTurn * std::floor(angle_rad / kTurn);
  return std::clamp(static_cast<int>(turned / cell_rad_), 0, columns_ - 1);
}

int MaterialLookup::Row(double y_mm) const {
  return static_cast<int>(std::floor((y_mm - low_y_mm_) / reach_mm_));
}

std::vector<std::pair<std::size_t, double>> MaterialLookup::SharesAt(
    const Eigen::Vector3d& material) const {
  if (cells_.empty() || !material.allFinite()) return {};
  const int row = Row(material.y()), column = Column(material.x());
  std::vector<std::size_t> near;
  for (int r = std::max(0, row - 1); r <= std::min(rows_ - 1, row + 1); ++r) {
    // Smaller radii than the target's make cells narrower on the surface than the reach by little:
    // one cell more on either side holds all.
    for (int dc = -2; dc <= 2 && dc < columns_ - 2; ++dc) {
      const int c = (column + dc + columns_) % columns_;
      const auto& cell = cells_[static_cast<std::size_t>(r * columns_ + c)];
      near.insert(near.end(), cell.begin(), cell.end());
    }
  }
  std::sort(near.begin(), near.end());
  std::vector<std::size_t> places;
  std::vector<Eigen::Vector2d> apart;
  for (const std::size_t i : near) {
    const Eigen::Vector2d d = Apart(material, material_.data()[i]);
    if (!(d.norm() < reach_mm_)) continue;
    places.push_back(i);
    apart.push_back(d);
  }
  if (places.size() < kFewest || !SurroundOrigin(apart)) return {};
  // Value at the origin of the weighted least-squares plane: e1' (sum w P P')^-1 w P.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  std::vector<Eigen::Vector3d> weighted;
  weighted.reserve(apart.size());
  for (const Eigen::Vector2d& d : apart) {
    const Eigen::Vector3d p(1, d.x() / reach_mm_, d.y() / reach_mm_);
    const double w = std::pow(1 - d.squaredNorm() / (reach_mm_ * reach_mm_), 2);
    normal += w * p * p.transpose();
    weighted.emplace_back(w * p);
  }
  const Eigen::Vector3d row_of_inverse = normal.ldlt().solve(Eigen::Vector3d::UnitX());
  if (!row_of_inverse.allFinite()) return {};
  std::vector<std::pair<std::size_t, double>> shares;
  shares.reserve(places.size());
  for (std::size_t k = 0; k < places.size(); ++k) {
    shares.emplace_back(places[k], row_of_inverse.dot(weighted[k]));
  }
  return shares;
}

}  // namespace plumbline::internal
