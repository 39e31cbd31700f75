#include "io/virtual_rig/internal/material_map.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace plumbline::internal {
namespace {

constexpr double kCell_px = 8;
constexpr double kSmallest_px = 1;
constexpr double kTolerance_px = 1e-4;
constexpr double kLightTolerance = 2e-4;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Lagrange's weights of the nodes 0, 1/3, 2/3, 1.
Eigen::Array4d Weights(double t) {
  const double a = 3 * t, b = a - 1, c = a - 2, d = a - 3;
  return {-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6};
}

// Material (mm) a pixel, from the spread of the nodes.
double MaterialPerPixel(const std::array<MaterialMap::Sample, 16>& nodes, double size) {
  return std::max((nodes[3] - nodes[0]).head<2>().matrix().norm(),
                  (nodes[12] - nodes[0]).head<2>().matrix().norm()) /
         size;
}

}  // namespace

MaterialMap::MaterialMap(const SurfaceView& opening, const SurfaceView& closing, const Light& light,
                         int margin_px)
    : opening_(opening), closing_(closing), light_(light), moves_(&opening != &closing) {
  const ImageSize size = opening.camera().size();
  corner_ = Eigen::Vector2d::Constant(-0.5 - margin_px);
  const auto cells = [&](int pixels) {
    return static_cast<int>(std::ceil((pixels + 2 * margin_px) / kCell_px));
  };
  columns_ = cells(size.width);
  rows_ = cells(size.height);
  roots_.resize(static_cast<std::size_t>(rows_));
  branches_.resize(static_cast<std::size_t>(rows_));
  tbb::parallel_for(0, rows_, [&](int r) {
    const auto k = static_cast<std::size_t>(r);
    Nodes nodes;
    for (int c = 0; c < columns_; ++c) {
      const Eigen::Vector2d corner = corner_ + kCell_px * Eigen::Vector2d(c, r);
      for (int n = 0; n < 16; ++n) {
        // The left edge is the right one of the cell before.
        Sample& node = nodes[static_cast<std::size_t>(n)];
        node = c > 0 && n % 4 == 0 ? nodes[static_cast<std::size_t>(n + 3)]
                                   : Look(corner + kCell_px / 3 * Eigen::Vector2d(n % 4, n / 4));
      }
      roots_[k].push_back(Build(corner, kCell_px, nodes, branches_[k]));
    }
  });
}

MaterialMap::Sample MaterialMap::Look(const Eigen::Vector2d& pixel) const {
  Sample sample = Sample::Constant(kNaN);
  const auto seen = opening_.Look(pixel);
  if (!seen) return sample;
  sample.segment<2>(0) = seen->material_mm.array();
  sample[4] = light_(*seen, pixel);
  if (!moves_) {
    sample.segment<2>(2) = sample.segment<2>(0);
    return sample;
  }
  // Where another surface comes in sight during the exposure, the first one is kept.
  const auto later = closing_.Follow(*seen);
  sample.segment<2>(2) = later ? later->material_mm.array() : seen->material_mm.array();
  return sample;
}

MaterialMap::Cell MaterialMap::Build(const Eigen::Vector2d& corner, double size, const Nodes& nodes,
                                     Branch& branch) const {
  const auto hits = std::count_if(nodes.begin(), nodes.end(),
                                  [](const Sample& node) { return !node.isNaN().any(); });
  const Sample centre = Look(corner + Eigen::Vector2d::Constant(size / 2));
  const bool centre_hit = !centre.isNaN().any();
  if (hits == 0 && !centre_hit) return {Kind::kEmpty, 0};
  if (hits == 16 && centre_hit && Interpolates(nodes, corner, size, centre)) {
    branch.nodes.push_back(nodes);
    const double moved = (centre.segment<2>(2) - centre.segment<2>(0)).matrix().norm();
    branch.motion_px = std::max(branch.motion_px, moved / MaterialPerPixel(nodes, size));
    return {Kind::kSmooth, static_cast<int>(branch.nodes.size()) - 1};
  }
  if (size <= kSmallest_px) return {Kind::kExact, 0};
  return Split(corner, size, nodes, centre, branch);
}

bool MaterialMap::Interpolates(const Nodes& nodes, const Eigen::Vector2d& corner, double size,
                               const Sample& centre) const {
  const double tolerance_mm = kTolerance_px * MaterialPerPixel(nodes, size);
  const auto agrees = [&](double tx, double ty, const Sample& exact) {
    const Eigen::Array4d wx = Weights(tx), wy = Weights(ty);
    Sample guess = Sample::Zero();
    for (int k = 0; k < 16; ++k) {
      guess += wx[k % 4] * wy[k / 4] * nodes[static_cast<std::size_t>(k)];
    }
    return (guess - exact).head<4>().abs().maxCoeff() < tolerance_mm &&
           std::abs(guess[4] - exact[4]) < kLightTolerance;
  };
  const auto look = [&](double tx, double ty) {
    return Look(corner + size * Eigen::Vector2d(tx, ty));
  };
  // NaN agrees with nothing.
  return agrees(0.5, 0.5, centre) && agrees(1.0 / 6, 5.0 / 6, look(1.0 / 6, 5.0 / 6)) &&
         agrees(5.0 / 6, 1.0 / 6, look(5.0 / 6, 1.0 / 6));
}

MaterialMap::Cell MaterialMap::Split(const Eigen::Vector2d& corner, double size, const Nodes& nodes,
                                     const Sample& centre, Branch& branch) const {
  // The nodes of all four cells, at sixths of this one: every other one is its own.
  std::array<Sample, 49> lattice;
  for (int k = 0; k < 49; ++k) {
    const int x = k % 7, y = k / 7;
    Sample& node = lattice[static_cast<std::size_t>(k)];
    if (x % 2 == 0 && y % 2 == 0) {
      node = nodes[static_cast<std::size_t>(y / 2 * 4 + x / 2)];
    } else {
      node = x == 3 && y == 3 ? centre : Look(corner + size / 6 * Eigen::Vector2d(x, y));
    }
  }
  std::array<Cell, 4> children;
  for (int k = 0; k < 4; ++k) {
    const int x0 = 3 * (k % 2), y0 = 3 * (k / 2);
    Nodes own;
    for (int n = 0; n < 16; ++n) {
      own[static_cast<std::size_t>(n)] =
          lattice[static_cast<std::size_t>((y0 + n / 4) * 7 + x0 + n % 4)];
    }
    children[static_cast<std::size_t>(k)] =
        Build(corner + size / 6 * Eigen::Vector2d(x0, y0), size / 2, own, branch);
  }
  branch.cells.insert(branch.cells.end(), children.begin(), children.end());
  return {Kind::kSplit, static_cast<int>(branch.cells.size()) - 4};
}

void MaterialMap::EvaluateRun(const Branch& branch, const Cell& cell, const Eigen::Vector2d& corner,
                              double size, double y, double x0, double dx,
                              std::span<Sample> run) const {
  if (run.empty()) return;
  switch (cell.kind) {
    case Kind::kEmpty:
      std::fill(run.begin(), run.end(), Sample::Constant(kNaN));
      return;
    case Kind::kExact:
      for (std::size_t i = 0; i < run.size(); ++i) {
        run[i] = Look({x0 + static_cast<double>(i) * dx, y});
      }
      return;
    case Kind::kSplit: {
      const double half = size / 2;
      const int below = y >= corner.y() + half ? 2 : 0;
      const double middle = corner.x() + half;
      const auto left = static_cast<std::size_t>(
          std::clamp(std::ceil((middle - x0) / dx), 0.0, static_cast<double>(run.size())));
      const double child_y = corner.y() + (below != 0 ? half : 0);
      const auto first = static_cast<std::size_t>(cell.first + below);
      EvaluateRun(branch, branch.cells[first], {corner.x(), child_y}, half, y, x0, dx,
                  run.first(left));
      EvaluateRun(branch, branch.cells[first + 1], {middle, child_y}, half, y,
                  x0 + static_cast<double>(left) * dx, dx, run.subspan(left));
      return;
    }
    case Kind::kSmooth: {
      const Nodes& nodes = branch.nodes[static_cast<std::size_t>(cell.first)];
      const Eigen::Array4d w = Weights((y - corner.y()) / size);
      std::array<Sample, 4> column;
      for (std::size_t c = 0; c < 4; ++c) {
        column[c] =
            w[0] * nodes[c] + w[1] * nodes[4 + c] + w[2] * nodes[8 + c] + w[3] * nodes[12 + c];
      }
      for (std::size_t i = 0; i < run.size(); ++i) {
        const Eigen::Array4d v = Weights((x0 + static_cast<double>(i) * dx - corner.x()) / size);
        run[i] = v[0] * column[0] + v[1] * column[1] + v[2] * column[2] + v[3] * column[3];
      }
      return;
    }
  }
}

void MaterialMap::EvaluateRow(double y, double x0, double dx, std::span<Sample> row) const {
  const int r = std::clamp(static_cast<int>((y - corner_.y()) / kCell_px), 0, rows_ - 1);
  const auto k = static_cast<std::size_t>(r);
  std::size_t done = 0;
  for (int c = 0; c < columns_ && done < row.size(); ++c) {
    const Eigen::Vector2d corner = corner_ + kCell_px * Eigen::Vector2d(c, r);
    const double start = x0 + static_cast<double>(done) * dx;
    const auto count = c + 1 == columns_
                           ? row.size() - done
                           : std::min(row.size() - done,
                                      static_cast<std::size_t>(std::max(
                                          0.0, std::ceil((corner.x() + kCell_px - start) / dx))));
    EvaluateRun(branches_[k], roots_[k][static_cast<std::size_t>(c)], corner, kCell_px, y, start,
                dx, row.subspan(done, count));
    done += count;
  }
}

double MaterialMap::LargestMotion_px() const {
  double largest = 0;
  for (const Branch& branch : branches_) largest = std::max(largest, branch.motion_px);
  return largest;
}

double MaterialMap::InterpolatedShare() const {
  const auto area = [&](auto&& self, const Branch& branch, const Cell& cell) -> double {
    if (cell.kind == Kind::kSmooth) return 1;
    if (cell.kind != Kind::kSplit) return 0;
    double sum = 0;
    for (int k = 0; k < 4; ++k) {
      sum += self(self, branch, branch.cells[static_cast<std::size_t>(cell.first + k)]) / 4;
    }
    return sum;
  };
  double sum = 0;
  for (std::size_t r = 0; r < roots_.size(); ++r) {
    for (const Cell& cell : roots_[r]) sum += area(area, branches_[r], cell);
  }
  return sum / (static_cast<double>(rows_) * columns_);
}

}  // namespace plumbline::internal
