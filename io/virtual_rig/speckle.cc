#include "io/virtual_rig/speckle.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

// Of memory's sake: some gigabytes.
constexpr double kMaxCells = 5e7;

struct Disc {
  double u, v;
  float outer2;     // squared radius of the edge's outside
  float per_range;  // 1 / (outer^2 - inner^2)
};

// Discs sorted into the cells of a grid that they touch.
class Speckle : public Albedo {
 public:
  Speckle(const MaterialDomain& domain, const SpeckleOptions& options)
      : domain_(domain), options_(options), periodic_(std::isfinite(domain.period_u)) {
    const double reach = Reach();
    // A margin, so that discs reach in from beyond the edge.
    const double margin = periodic_ ? 0 : reach;
    u_begin_ = domain.u_min - margin;
    v_begin_ = domain.v_min - reach;
    width_ = periodic_ ? domain.period_u : domain.u_max - domain.u_min + 2 * margin;
    height_ = domain.v_max - domain.v_min + 2 * reach;
    // Cells of about half a disc: few discs a cell, few cells a disc.
    const double wanted = options.diameter_mm / 2;
    columns_ = std::max(1, static_cast<int>(width_ / wanted));
    rows_ = std::max(1, static_cast<int>(height_ / wanted));
    per_cell_u_ = columns_ / width_;
    per_cell_v_ = rows_ / height_;
    Sort(Scatter());
  }

  void Evaluate(std::span<const Eigen::Vector2d> material, std::span<float> albedo) const override {
    for (std::size_t i = 0; i < material.size(); i += kBatch) {
      const std::size_t count = std::min(kBatch, material.size() - i);
      EvaluateBatch(material.subspan(i, count), albedo.subspan(i, count));
    }
  }

 private:
  double Reach() const {
    return options_.diameter_mm / 2 * (1 + options_.diameter_spread) * (1 + options_.edge / 2);
  }

  // One disc a cell of its own grid, anywhere in it: random, without the holes of independent
  // places.
  std::vector<Disc> Scatter() const {
    const double area = std::numbers::pi / 4 * options_.diameter_mm * options_.diameter_mm *
                        (1 + options_.diameter_spread * options_.diameter_spread / 3);
    const double wanted = std::sqrt(area / options_.coverage);
    const int nu = std::max(1, static_cast<int>(std::lround(width_ / wanted)));
    const int nv = std::max(1, static_cast<int>(std::lround(height_ / wanted)));
    std::mt19937_64 random(options_.seed);
    const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
    std::vector<Disc> discs;
    discs.reserve(static_cast<std::size_t>(nu) * static_cast<std::size_t>(nv));
    for (int j = 0; j < nv; ++j) {
      for (int i = 0; i < nu; ++i) {
        const double u = u_begin_ + (i + uniform()) * width_ / nu;
        const double v = v_begin_ + (j + uniform()) * height_ / nv;
        const double r =
            options_.diameter_mm / 2 * (1 + options_.diameter_spread * (2 * uniform() - 1));
        const double outer = r * (1 + options_.edge / 2), inner = r * (1 - options_.edge / 2);
        discs.push_back({u, v, static_cast<float>(outer * outer),
                         static_cast<float>(1 / (outer * outer - inner * inner))});
      }
    }
    return discs;
  }

  void Sort(const std::vector<Disc>& discs) {
    first_.assign(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_) + 1, 0);
    ForEachTouched(discs, [&](std::size_t cell, const Disc&) { ++first_[cell + 1]; });
    for (std::size_t c = 1; c < first_.size(); ++c) first_[c] += first_[c - 1];
    sorted_.resize(first_.back());
    std::vector<std::uint32_t> next(first_.begin(), first_.end() - 1);
    ForEachTouched(discs,
                   [&](std::size_t cell, const Disc& disc) { sorted_[next[cell]++] = disc; });
  }

  // Discs over the seam of a period are handed out with the centre that is near to the cell.
  template <typename Do>
  void ForEachTouched(const std::vector<Disc>& discs, const Do& handle) const {
    for (const Disc& disc : discs) {
      const double outer = std::sqrt(static_cast<double>(disc.outer2)) * (1 + 1e-6);
      const auto cell = [](double x) { return static_cast<int>(std::floor(x)); };
      const int i0 = cell((disc.u - outer - u_begin_) * per_cell_u_),
                i1 = cell((disc.u + outer - u_begin_) * per_cell_u_);
      const int j0 = std::max(0, cell((disc.v - outer - v_begin_) * per_cell_v_)),
                j1 = std::min(rows_ - 1, cell((disc.v + outer - v_begin_) * per_cell_v_));
      for (int j = j0; j <= j1; ++j) {
        for (int i = i0; i <= i1; ++i) {
          if (!periodic_ && (i < 0 || i >= columns_)) continue;
          const int turns = i < 0 ? -1 : i >= columns_ ? 1 : 0;
          Disc near = disc;
          near.u -= turns * width_;
          handle(static_cast<std::size_t>(j) * static_cast<std::size_t>(columns_) +
                     static_cast<std::size_t>(i - turns * columns_),
                 near);
        }
      }
    }
  }

  static constexpr std::size_t kBatch = 64;
  static constexpr std::size_t kNowhere = std::numeric_limits<std::size_t>::max();

  // The cell of a place, which is moved to the first period; kNowhere where there is no speckle.
  std::size_t CellOf(Eigen::Vector2d& place) const {
    if (periodic_) {
      const double from = place.x() - u_begin_;
      if (!(from >= 0 && from < domain_.period_u)) {
        place.x() -= domain_.period_u * std::floor(from / domain_.period_u);
      }
    } else if (!(place.x() >= domain_.u_min && place.x() <= domain_.u_max)) {
      return kNowhere;
    }
    if (!(place.y() >= domain_.v_min && place.y() <= domain_.v_max)) return kNowhere;
    const int i = std::min(columns_ - 1, static_cast<int>((place.x() - u_begin_) * per_cell_u_));
    const int j = std::min(rows_ - 1, static_cast<int>((place.y() - v_begin_) * per_cell_v_));
    return static_cast<std::size_t>(j) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(i);
  }

  // Neighbours lie in one cell more often than not: each of its discs is held against all of them.
  void EvaluateBatch(std::span<const Eigen::Vector2d> material, std::span<float> albedo) const {
    std::array<double, kBatch> u, v;
    std::array<std::size_t, kBatch> cell;
    std::array<float, kBatch> bare;  // the share of the ground that no disc covers
    for (std::size_t k = 0; k < material.size(); ++k) {
      Eigen::Vector2d place = material[k];
      cell[k] = CellOf(place);
      u[k] = place.x();
      v[k] = place.y();
      bare[k] = 1;
    }
    const auto background = static_cast<float>(options_.background);
    const auto black = static_cast<float>(options_.black);
    const auto range = static_cast<float>(options_.white - options_.black);
    for (std::size_t k = 0; k < material.size();) {
      std::size_t end = k + 1;
      while (end < material.size() && cell[end] == cell[k]) ++end;
      if (cell[k] == kNowhere) {
        std::fill(albedo.begin() + k, albedo.begin() + end, background);
      } else {
        for (std::uint32_t d = first_[cell[k]]; d < first_[cell[k] + 1]; ++d) {
          Cover(sorted_[d], u.data() + k, v.data() + k, end - k, bare.data() + k);
        }
        for (std::size_t n = k; n < end; ++n) albedo[n] = black + range * bare[n];
      }
      k = end;
    }
  }

  static void Cover(const Disc& disc, const double* u, const double* v, std::size_t count,
                    float* bare) {
    for (std::size_t n = 0; n < count; ++n) {
      const auto du = static_cast<float>(u[n] - disc.u), dv = static_cast<float>(v[n] - disc.v);
      const float depth = (disc.outer2 - (du * du + dv * dv)) * disc.per_range;
      const float x = depth < 0 ? 0 : depth > 1 ? 1 : depth;
      bare[n] *= 1 - x * x * (3 - 2 * x);
    }
  }

  MaterialDomain domain_;
  SpeckleOptions options_;
  bool periodic_;
  double u_begin_, v_begin_, width_, height_;
  int columns_, rows_;
  double per_cell_u_, per_cell_v_;
  std::vector<std::uint32_t> first_;
  std::vector<Disc> sorted_;
};

}  // namespace

void SpeckleOptions::Check() const {
  if (!(diameter_mm > 0)) throw UsageError("The speckle's diameter must be positive.");
  if (!(diameter_spread >= 0 && diameter_spread < 1)) {
    throw UsageError("The spread of the speckle's diameters must lie in 0 to 1.");
  }
  if (!(coverage > 0 && coverage < 5))
    throw UsageError("The speckle's coverage must lie in 0 to 5.");
  if (!(edge > 0 && edge <= 2)) throw UsageError("The speckle's soft edge must lie in 0 to 2.");
}

std::unique_ptr<const Albedo> MakeSpeckle(const MaterialDomain& domain,
                                          const SpeckleOptions& options) {
  options.Check();
  const double width = domain.u_max - domain.u_min, height = domain.v_max - domain.v_min;
  if (options.diameter_mm > std::min(width, height) / 8) {
    throw UsageError(fmt::format(
        "Speckles of {:g} mm are too large for a surface of {:.0f} x {:.0f} mm: at most an eighth.",
        options.diameter_mm, width, height));
  }
  const double cells = 4 * width * height / (options.diameter_mm * options.diameter_mm);
  if (cells * std::max(1.0, options.coverage) > kMaxCells) {
    throw UsageError(fmt::format(
        "Speckles of {:g} mm are too many for a surface of {:.0f} x {:.0f} mm: choose larger ones.",
        options.diameter_mm, width, height));
  }
  return std::make_unique<Speckle>(domain, options);
}

}  // namespace plumbline
