#include "calib/internal/point_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <numbers>
#include <numeric>
#include <optional>
#include <unordered_map>

namespace plumbline::internal {
namespace {

constexpr double kTolerance = 0.25;  // of the spacing
constexpr std::array<GridPlace, 4> kSides = {{{1, 0}, {0, 1}, {-1, 0}, {0, -1}}};

// Neighbour search among scattered points by square cells.
class Cells {
 public:
  explicit Cells(const std::vector<GridPoint>& points) : points_(points) {
    Eigen::Vector2d low = points[0].pixel, high = low;
    for (const GridPoint& p : points) {
      low = low.cwiseMin(p.pixel);
      high = high.cwiseMax(p.pixel);
    }
    const Eigen::Vector2d span = (high - low).cwiseMax(1.0);
    cell_ = std::max(1.0, std::sqrt(span.x() * span.y() / static_cast<double>(points.size())));
    for (std::size_t i = 0; i < points.size(); ++i) {
      cells_[Key(Cell(points[i].pixel))].push_back(static_cast<int>(i));
    }
  }

  // The nearest points, nearest first.
  std::vector<int> Nearest(const Eigen::Vector2d& p, std::size_t count) const {
    std::vector<int> found;
    for (int ring = 1; ring <= 64; ring *= 2) {
      found = Within(p, ring * cell_);
      if (found.size() >= count) break;
    }
    std::sort(found.begin(), found.end(), [&](int a, int b) {
      const double da = (At(a) - p).squaredNorm(), db = (At(b) - p).squaredNorm();
      return da != db ? da < db : a < b;
    });
    if (found.size() > count) found.resize(count);
    return found;
  }

  std::vector<int> Within(const Eigen::Vector2d& p, double radius) const {
    const auto low = Cell(p - Eigen::Vector2d(radius, radius));
    const auto high = Cell(p + Eigen::Vector2d(radius, radius));
    std::vector<int> found;
    for (int y = low.second; y <= high.second; ++y) {
      for (int x = low.first; x <= high.first; ++x) {
        const auto cell = cells_.find(Key({x, y}));
        if (cell == cells_.end()) continue;
        for (const int i : cell->second) {
          if ((At(i) - p).norm() <= radius) found.push_back(i);
        }
      }
    }
    return found;
  }

 private:
  const Eigen::Vector2d& At(int i) const { return points_[static_cast<std::size_t>(i)].pixel; }
  std::pair<int, int> Cell(const Eigen::Vector2d& p) const {
    return {static_cast<int>(std::floor(p.x() / cell_)),
            static_cast<int>(std::floor(p.y() / cell_))};
  }
  static long long Key(std::pair<int, int> cell) {
    return static_cast<long long>(cell.first) * 1000003 + cell.second;
  }

  const std::vector<GridPoint>& points_;
  double cell_ = 1;
  std::unordered_map<long long, std::vector<int>> cells_;
};

using Basis = std::array<Eigen::Vector2d, 2>;

// The directions to the four nearest neighbours of a point, where these are two opposite pairs at a
// wide angle. Points at the rim have no such neighbours, and diagonals are never the nearest.
std::optional<Basis> StartBasis(const std::vector<GridPoint>& points, const Cells& cells,
                                int seed) {
  const auto at = [&](int i) { return points[static_cast<std::size_t>(i)].pixel; };
  std::vector<Eigen::Vector2d> steps;
  for (const int n : cells.Nearest(at(seed), 5)) {
    if (n != seed) steps.push_back(at(n) - at(seed));
  }
  if (steps.size() != 4) return std::nullopt;
  for (std::size_t k = 1; k < 4; ++k) {
    const std::size_t other = k == 1 ? 2 : 1, last = 6 - k - other;
    const Eigen::Vector2d a = (steps[0] - steps[k]) / 2, b = (steps[other] - steps[last]) / 2;
    if ((steps[0] + steps[k]).norm() > kTolerance * a.norm()) continue;
    if ((steps[other] + steps[last]).norm() > kTolerance * b.norm()) continue;
    const double sine = (a.x() * b.y() - a.y() * b.x()) / (a.norm() * b.norm());
    if (std::abs(sine) < 0.5) continue;
    // Clockwise on the screen, where y points down.
    return sine > 0 ? Basis{a, b} : Basis{a, -b};
  }
  return std::nullopt;
}

class Grower {
 public:
  Grower(const std::vector<GridPoint>& points, const Cells& cells, double largest_ratio)
      : points_(points), cells_(cells), largest_ratio_(largest_ratio), used_(points.size()) {}

  PointGrid Grow(int seed, const Basis& basis) {
    std::deque<std::pair<GridPlace, Basis>> front;
    Put({0, 0}, seed);
    front.push_back({{0, 0}, basis});
    while (!front.empty()) {
      const auto [place, inherited] = front.front();
      front.pop_front();
      const Basis local = LocalBasis(place, inherited);
      for (const GridPlace& side : kSides) {
        const GridPlace next{place.first + side.first, place.second + side.second};
        if (grid_.Has(next)) continue;
        const Eigen::Vector2d step = side.first * local[0] + side.second * local[1];
        const auto point = Find(place, step);
        if (!point) continue;
        Put(next, *point);
        front.push_back({next, local});
      }
    }
    return std::move(grid_);
  }

 private:
  const GridPoint& At(GridPlace place) const {
    return points_[static_cast<std::size_t>(grid_.points.at(place))];
  }

  void Put(GridPlace place, int point) {
    grid_.points[place] = point;
    used_[static_cast<std::size_t>(point)] = true;
  }

  Basis LocalBasis(GridPlace place, const Basis& inherited) const {
    Basis out = inherited;
    for (int k = 0; k < 2; ++k) {
      const GridPlace side = kSides[static_cast<std::size_t>(k)];
      const GridPlace ahead{place.first + side.first, place.second + side.second};
      const GridPlace back{place.first - side.first, place.second - side.second};
      auto& step = out[static_cast<std::size_t>(k)];
      if (grid_.Has(ahead) && grid_.Has(back)) {
        step = (At(ahead).pixel - At(back).pixel) / 2;
      } else if (grid_.Has(ahead)) {
        step = At(ahead).pixel - At(place).pixel;
      } else if (grid_.Has(back)) {
        step = At(place).pixel - At(back).pixel;
      }
    }
    return out;
  }

  std::optional<int> Find(GridPlace from, const Eigen::Vector2d& step) const {
    const Eigen::Vector2d target = At(from).pixel + step;
    std::optional<int> best;
    double nearest = kTolerance * step.norm();
    for (const int i : cells_.Within(target, nearest)) {
      const GridPoint& p = points_[static_cast<std::size_t>(i)];
      const double ratio = p.size / At(from).size;
      if (used_[static_cast<std::size_t>(i)] || ratio < 0.4 || ratio > largest_ratio_) continue;
      const double distance = (p.pixel - target).norm();
      if (distance < nearest) {
        nearest = distance;
        best = i;
      }
    }
    return best;
  }

  const std::vector<GridPoint>& points_;
  const Cells& cells_;
  double largest_ratio_;
  std::vector<bool> used_;
  PointGrid grid_;
};

// Removes points that bend their row or column by more than a seventh of the spacing.
void DropBent(const std::vector<GridPoint>& points, PointGrid& grid) {
  std::map<GridPlace, int> kept;
  const auto at = [&](GridPlace place) {
    return points[static_cast<std::size_t>(grid.points.at(place))].pixel;
  };
  for (const auto& [place, index] : grid.points) {
    int straight = 0, bent = 0;
    for (std::size_t k = 0; k < 2; ++k) {
      const GridPlace a{place.first + kSides[k].first, place.second + kSides[k].second};
      const GridPlace b{place.first - kSides[k].first, place.second - kSides[k].second};
      if (!grid.Has(a) || !grid.Has(b)) continue;
      const double off = (at(place) - (at(a) + at(b)) / 2).norm();
      ++(off < (at(a) - at(b)).norm() / 14 ? straight : bent);
    }
    if (bent == 0 || straight > 0) kept[place] = index;
  }
  grid.points = std::move(kept);
}

}  // namespace

PointGrid OrderPoints(const std::vector<GridPoint>& points, std::size_t enough,
                      double largest_ratio) {
  PointGrid best;
  if (points.size() < 4) return best;
  const Cells cells(points);
  std::vector<bool> tried(points.size());
  for (std::size_t seed = 0; seed < points.size() && best.points.size() < enough; ++seed) {
    if (tried[seed]) continue;
    const auto basis = StartBasis(points, cells, static_cast<int>(seed));
    if (!basis) continue;
    PointGrid grid = Grower(points, cells, largest_ratio).Grow(static_cast<int>(seed), *basis);
    for (const auto& [place, index] : grid.points) tried[static_cast<std::size_t>(index)] = true;
    if (grid.points.size() > best.points.size()) best = std::move(grid);
  }
  DropBent(points, best);
  return best;
}

GridPlace GridPose::Turned(GridPlace place) const {
  for (int k = 0; k < quarter_turns; ++k) place = {-place.second, place.first};
  return place;
}

GridPlace GridPose::BoardPlace(GridPlace place) const {
  const GridPlace turned = Turned(place);
  return {turned.first - column0, turned.second - row0};
}

double ColumnAngle(const PointGrid& grid, const std::vector<GridPoint>& points,
                   const GridPose& pose) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  std::map<GridPlace, int> turned;
  for (const auto& [place, index] : grid.points) turned[pose.Turned(place)] = index;
  for (const auto& [place, index] : turned) {
    const auto next = turned.find({place.first + 1, place.second});
    if (next == turned.end()) continue;
    sum += points[static_cast<std::size_t>(next->second)].pixel -
           points[static_cast<std::size_t>(index)].pixel;
  }
  return std::atan2(sum.y(), sum.x());
}

int NearestToImageAxes(const std::vector<double>& column_angles) {
  if (column_angles.empty()) return -1;
  std::vector<int> order(column_angles.size());
  std::iota(order.begin(), order.end(), 0);
  const auto off = [&](int i) { return std::abs(column_angles[static_cast<std::size_t>(i)]); };
  std::sort(order.begin(), order.end(), [&](int a, int b) { return off(a) < off(b); });
  constexpr double kClear = 20 * std::numbers::pi / 180;
  if (order.size() > 1 && off(order[1]) - off(order[0]) < kClear) return -1;
  return order[0];
}

}  // namespace plumbline::internal
