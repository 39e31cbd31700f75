#include "fit/bump.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"

namespace plumbline {
namespace {

constexpr double kSigmas = 1.5;
constexpr double kTopShare = 0.75;  // of the height: what rises above it tells where the top is
constexpr double kLeastSpread_mm = 0.02;
constexpr double kMostHoles = 0.1;  // of an area: points that are missing in it

// Of each missing point how many hang together with it; 0 where they reach the end of the grid, and
// for points that are there.
Image<int> HolesOf(const Image<double>& values) {
  const int columns = values.width(), rows = values.height();
  Image<int> holes(values.size(), 0);
  Image<std::uint8_t> seen(values.size(), 0);
  for (std::size_t first = 0; first < values.pixel_count(); ++first) {
    if (seen.data()[first] != 0 || !std::isnan(values.data()[first])) continue;
    std::vector<std::size_t> hole = {first};
    seen.data()[first] = 1;
    bool open = false;
    for (std::size_t k = 0; k < hole.size(); ++k) {
      const int r = static_cast<int>(hole[k]) / columns, c = static_cast<int>(hole[k]) % columns;
      open = open || r == 0 || c == 0 || r + 1 == rows || c + 1 == columns;
      for (int row = std::max(0, r - 1); row <= std::min(rows - 1, r + 1); ++row) {
        for (int column = std::max(0, c - 1); column <= std::min(columns - 1, c + 1); ++column) {
          if (seen(row, column) != 0 || !std::isnan(values(row, column))) continue;
          seen(row, column) = 1;
          hole.push_back(static_cast<std::size_t>(row * columns + column));
        }
      }
    }
    for (const std::size_t k : hole) holes.data()[k] = open ? 0 : static_cast<int>(hole.size());
  }
  return holes;
}

class Finder {
 public:
  Finder(const SurfacePoints& surface, const Image<double>& thickness_mm,
         const NeighbourCorrelation& neighbours, const BumpOptions& options)
      : surface_(surface),
        neighbours_(neighbours),
        options_(options),
        clearance_(surface.size(), std::numeric_limits<double>::quiet_NaN()),
        seen_(surface.size(), 0) {
    for (std::size_t i = 0; i < clearance_.pixel_count(); ++i) {
      clearance_.data()[i] = surface.point_mm.data()[i].z() - thickness_mm.data()[i];
    }
    holes_ = HolesOf(clearance_);
  }

  std::vector<Bump> Find() {
    Image<double> smooth(clearance_.size(), std::numeric_limits<double>::quiet_NaN());
    std::vector<std::size_t> high;
    for (std::size_t i = 0; i < smooth.pixel_count(); ++i) {
      if (!(clearance_.data()[i] > options_.least_height_mm / 2)) continue;
      smooth.data()[i] = MeanClearance(Near(i, options_.top_radius_mm));
      if (smooth.data()[i] > options_.least_height_mm) high.push_back(i);
    }
    // Ties by place.
    std::stable_sort(high.begin(), high.end(), [&](std::size_t a, std::size_t b) {
      return smooth.data()[a] > smooth.data()[b];
    });
    std::vector<Bump> bumps;
    for (const std::size_t i : high) {
      if (seen_.data()[i] != 0) continue;
      const std::optional<std::vector<std::size_t>> area = Area(i, smooth.data()[i] / 2);
      if (!area) continue;
      const std::optional<Bump> bump = Measure(smooth.data()[i], *area);
      if (bump && bump->height_mm.value >= options_.least_height_mm &&
          bump->significance >= options_.least_significance) {
        bumps.push_back(*bump);
      }
    }
    std::stable_sort(bumps.begin(), bumps.end(), [](const Bump& a, const Bump& b) {
      return a.height_mm.value > b.height_mm.value;
    });
    return bumps;
  }

 private:
  Eigen::Vector2d At(std::size_t i) const { return surface_.point_mm.data()[i].head<2>(); }

  // Points within a distance in the ground plane, in order, those without a clearance left out.
  std::vector<std::size_t> Near(std::size_t i, double distance_mm) const {
    std::vector<std::size_t> near;
    for (std::size_t k = 0; k < clearance_.pixel_count(); ++k) {
      if (std::isfinite(clearance_.data()[k]) && (At(k) - At(i)).norm() <= distance_mm) {
        near.push_back(k);
      }
    }
    return near;
  }

  double MeanClearance(const std::vector<std::size_t>& places) const {
    double sum = 0;
    for (const std::size_t k : places) sum += clearance_.data()[k];
    return sum / static_cast<double>(places.size());
  }

  // The points above a level that hang together with a maximum, marked as seen; nothing where they
  // hang together with what was seen before or with the end of what is seen, or where too many of
  // them are missing.
  std::optional<std::vector<std::size_t>> Area(std::size_t top, double level) {
    const int columns = clearance_.width(), rows = clearance_.height();
    std::vector<std::size_t> area = {top};
    Image<std::uint8_t> own(clearance_.size(), 0);
    own.data()[top] = 1;
    bool surrounded = true;
    int missing = 0, largest_hole = 0;
    for (std::size_t k = 0; k < area.size(); ++k) {
      const int r = static_cast<int>(area[k]) / columns, c = static_cast<int>(area[k]) % columns;
      if (seen_(r, c) != 0) surrounded = false;
      seen_(r, c) = 1;
      for (int dr = -1; dr <= 1; ++dr) {
        for (int dc = -1; dc <= 1; ++dc) {
          const int row = r + dr, column = c + dc;
          if (row < 0 || column < 0 || row >= rows || column >= columns ||
              (std::isnan(clearance_(row, column)) && holes_(row, column) == 0)) {
            surrounded = false;
            continue;
          }
          if (own(row, column) != 0) continue;
          if (std::isnan(clearance_(row, column))) {
            own(row, column) = 1;
            missing += 1;
            largest_hole = std::max(largest_hole, holes_(row, column));
          }
          if (!(clearance_(row, column) > level)) continue;
          own(row, column) = 1;
          area.push_back(static_cast<std::size_t>(row * columns + column));
        }
      }
    }
    const double most = kMostHoles * static_cast<double>(area.size());
    if (!surrounded || std::max(missing, largest_hole) > most) return std::nullopt;
    return area;
  }

  // The area of the cells around its points.
  double AreaOf(const std::vector<std::size_t>& area) const {
    double sum = 0;
    int cells = 0;  // that are whole
    for (const std::size_t k : area) {
      const auto columns = static_cast<std::size_t>(clearance_.width());
      const Eigen::Vector2d along = (At(k + 1) - At(k - 1)) / 2;
      const Eigen::Vector2d across = (At(k + columns) - At(k - columns)) / 2;
      const double cell = std::abs(along.x() * across.y() - along.y() * across.x());
      if (!std::isfinite(cell)) continue;
      sum += cell;
      ++cells;
    }
    return sum * static_cast<double>(area.size()) / cells;
  }

  // Of what rises above a level.
  Eigen::Vector2d CentreOf(const std::vector<std::size_t>& area, double level) const {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    double weights = 0;
    for (const std::size_t k : area) {
      const double w = std::max(0.0, clearance_.data()[k] - level);
      sum += w * At(k);
      weights += w;
    }
    return sum / weights;
  }

  // One sigma of what moves the heights of all points at once.
  double SigmaOfGround(std::size_t place) const {
    double variance = 0;
    for (const Image<Eigen::Vector3f>& error : surface_.along_common_mm) {
      variance += std::pow(error.data()[place].z(), 2);
    }
    return std::sqrt(variance);
  }

  // The points around an area that touch the ground, those left out that begin to lift off.
  std::vector<std::size_t> Surroundings(const std::vector<std::size_t>& area) const {
    Image<std::uint8_t> inside(clearance_.size(), 0);
    for (const std::size_t k : area) inside.data()[k] = 1;
    const double flat_mm = std::max(options_.flat_mm, 2 * SigmaOfGround(area.front()));
    std::vector<std::size_t> ring;
    for (std::size_t k = 0; k < clearance_.pixel_count(); ++k) {
      if (inside.data()[k] != 0 || !(std::abs(clearance_.data()[k]) <= flat_mm)) continue;
      const bool near = std::any_of(area.begin(), area.end(), [&](std::size_t a) {
        return (At(k) - At(a)).norm() <= options_.ring_mm;
      });
      if (near) ring.push_back(k);
    }
    if (ring.empty()) return ring;
    std::vector<double> sigmas, values;
    sigmas.reserve(ring.size());
    values.reserve(ring.size());
    for (const std::size_t k : ring) {
      sigmas.push_back(std::sqrt(static_cast<double>(surface_.cov_random_mm2.data()[k][5])));
      values.push_back(clearance_.data()[k]);
    }
    // Where they lie densest: many of them may hang free already.
    const double half = std::max(kLeastSpread_mm, kSigmas * Median(std::move(sigmas)));
    std::sort(values.begin(), values.end());
    std::ptrdiff_t most = 0;
    double middle = 0;
    for (auto low = values.begin(); low != values.end(); ++low) {
      const auto high = std::upper_bound(low, values.end(), *low + 2 * half);
      if (high - low > most) {
        most = high - low;
        middle = *(low + most / 2);
      }
    }
    std::erase_if(ring,
                  [&](std::size_t k) { return std::abs(clearance_.data()[k] - middle) > half; });
    return ring;
  }

  std::optional<Bump> Measure(double height_mm, const std::vector<std::size_t>& area) const {
    const Eigen::Vector2d centre = CentreOf(area, kTopShare * height_mm);
    const std::size_t top =
        *std::min_element(area.begin(), area.end(), [&](std::size_t a, std::size_t b) {
          return (At(a) - centre).norm() < (At(b) - centre).norm();
        });
    const std::vector<std::size_t> peak = Near(top, options_.top_radius_mm);
    const std::vector<std::size_t> ring = Surroundings(area);
    if (ring.empty()) return std::nullopt;
    std::vector<PointChange> changes;
    const auto add = [&](const std::vector<std::size_t>& places, double sign) {
      const double by = sign / static_cast<double>(places.size());
      for (const std::size_t k : places) changes.push_back({k, Eigen::RowVector3d(0, 0, by)});
    };
    add(peak, 1);
    const MeasuredScalar clearance =
        MeasuredSum(changes, MeanClearance(peak), surface_, neighbours_);
    add(ring, -1);
    std::sort(changes.begin(), changes.end(),
              [](const PointChange& a, const PointChange& b) { return a.place < b.place; });
    Bump bump;
    bump.place = top;
    bump.at_mm = centre;
    bump.clearance_mm = clearance;
    bump.height_mm =
        MeasuredSum(changes, MeanClearance(peak) - MeanClearance(ring), surface_, neighbours_);
    const double calibration =
        bump.height_mm.along_modes.size() > 0 ? bump.height_mm.sigma_calibration() : 0;
    bump.significance = bump.height_mm.value / std::hypot(bump.height_mm.sigma_random, calibration);
    bump.width_mm = 2 * std::sqrt(AreaOf(area) / std::numbers::pi);
    bump.surroundings = static_cast<int>(ring.size());
    return bump;
  }

  const SurfacePoints& surface_;
  const NeighbourCorrelation& neighbours_;
  const BumpOptions& options_;
  Image<double> clearance_;
  Image<int> holes_;
  Image<std::uint8_t> seen_;
};

}  // namespace

void BumpOptions::Check() const {
  if (!(least_height_mm > 0) || !(least_significance >= 0)) {
    throw UsageError("A bump has a least height above 0 mm and a least significance of 0 or more.");
  }
  if (!(top_radius_mm >= 0) || !(flat_mm > 0) || !(ring_mm > 0)) {
    throw UsageError(
        "The radius of a bump's top is 0 mm or more, its flat surroundings' clearance and reach "
        "are "
        "above 0 mm.");
  }
  if (!(flat_mm < least_height_mm)) {
    throw UsageError("Flat surroundings have to lie below the least height of a bump.");
  }
}

std::vector<Bump> FindBumps(const SurfacePoints& surface, const Image<double>& thickness_mm,
                            const NeighbourCorrelation& neighbours, const BumpOptions& options) {
  options.Check();
  surface.Check();
  if (thickness_mm.size() != surface.size()) {
    throw std::invalid_argument("FindBumps: points and thickness are of different grids");
  }
  return Finder(surface, thickness_mm, neighbours, options).Find();
}

}  // namespace plumbline
