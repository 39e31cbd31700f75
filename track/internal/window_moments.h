#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// A rectangle of a grid's points.
struct GridTile {
  int row = 0, column = 0, rows = 0, columns = 0;
  std::size_t cells() const {
    return static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
  }
  // Of the grid; cells go row by row.
  int RowOf(std::size_t cell) const { return row + static_cast<int>(cell) / columns; }
  int ColumnOf(std::size_t cell) const { return column + static_cast<int>(cell) % columns; }
};

// Offsets from a window's centre, both ends included.
struct OffsetRange {
  int first = 0, last = 0;
};

// Values at the points of a tile and `half` points around it, row by row; zero where there is none.
class PaddedTile {
 public:
  PaddedTile(const GridTile& tile, int half)
      : half_(half),
        rows_(tile.rows + 2 * half),
        columns_(tile.columns + 2 * half),
        values_(static_cast<std::size_t>(rows_) * static_cast<std::size_t>(columns_)) {}

  void Clear() { std::fill(values_.begin(), values_.end(), 0.0); }
  int half() const { return half_; }
  int rows() const { return rows_; }
  int columns() const { return columns_; }
  double* row(int r) {
    return values_.data() + static_cast<std::size_t>(r) * static_cast<std::size_t>(columns_);
  }
  const double* row(int r) const { return const_cast<PaddedTile*>(this)->row(r); }

 private:
  int half_, rows_, columns_;
  std::vector<double> values_;
};

// Fills padded tiles, one a component, from the points of the field that they cover: value(row,
// column) is the array of the components there.
template <std::size_t kTiles, typename Value>
void Fill(const GridTile& tile, ImageSize field, const Value& value,
          std::array<PaddedTile, kTiles>& out) {
  const int half = out[0].half();
  const int first = std::max(0, half - tile.column);
  const int last = std::min(out[0].columns(), field.width - tile.column + half);
  for (PaddedTile& component : out) component.Clear();
  for (int r = 0; r < out[0].rows(); ++r) {
    const int row = tile.row - half + r;
    if (row < 0 || row >= field.height) continue;
    for (int c = first; c < last; ++c) {
      const auto values = value(row, tile.column - half + c);
      for (std::size_t i = 0; i < kTiles; ++i) out[i].row(r)[c] = values[i];
    }
  }
}

// The index of x^a y^b among 1, x, y, x^2, x y, y^2, x^3, ...
constexpr int MomentIndex(int a, int b) { return (a + b) * (a + b + 1) / 2 + b; }

// Sums over windows of x^a y^b value, a + b <= degree, for the windows centred at each point of a
// tile; x and y run over the given offsets in units of the half window.
class WindowMoments {
 public:
  explicit WindowMoments(const GridTile& tile) : tile_(tile) {}

  void Compute(const PaddedTile& values, OffsetRange x, OffsetRange y, int degree);

  double operator()(int moment, std::size_t cell) const {
    return sums_[static_cast<std::size_t>(moment) * tile_.cells() + cell];
  }

 private:
  GridTile tile_;
  std::vector<double> row_sums_;  // by power of x, then rows of the padded tile
  std::vector<double> sums_;      // by moment, then cells
};

}  // namespace plumbline::internal
