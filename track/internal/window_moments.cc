#include "track/internal/window_moments.h"

#include <Eigen/Core>
#include <algorithm>

namespace plumbline::internal {

// First along the rows, then down the columns: linear in the window's side, not in its area.
void WindowMoments::Compute(const PaddedTile& values, OffsetRange x, OffsetRange y, int degree) {
  using Row = Eigen::Map<Eigen::ArrayXd>;
  using ConstRow = Eigen::Map<const Eigen::ArrayXd>;
  const int half = values.half(), columns = tile_.columns;
  const double unit = 1.0 / std::max(1, half);
  const auto width = static_cast<std::size_t>(columns);
  const auto height = static_cast<std::size_t>(values.rows());
  row_sums_.assign(static_cast<std::size_t>(degree + 1) * height * width, 0.0);
  const auto row_sum = [&](int power, int r) {
    return row_sums_.data() +
           (static_cast<std::size_t>(power) * height + static_cast<std::size_t>(r)) * width;
  };
  for (int r = half + y.first; r < half + y.last + tile_.rows; ++r) {
    for (int dx = x.first; dx <= x.last; ++dx) {
      const ConstRow value(values.row(r) + half + dx, columns);
      double factor = 1;
      for (int a = 0; a <= degree; ++a, factor *= unit * dx)
        Row(row_sum(a, r), columns) += factor * value;
    }
  }
  sums_.assign(static_cast<std::size_t>((degree + 1) * (degree + 2) / 2) * tile_.cells(), 0.0);
  for (int a = 0; a <= degree; ++a) {
    for (int r = 0; r < tile_.rows; ++r) {
      for (int dy = y.first; dy <= y.last; ++dy) {
        const ConstRow sum(row_sum(a, r + half + dy), columns);
        double factor = 1;
        for (int b = 0; a + b <= degree; ++b, factor *= unit * dy) {
          double* to = sums_.data() + static_cast<std::size_t>(MomentIndex(a, b)) * tile_.cells() +
                       static_cast<std::size_t>(r) * width;
          Row(to, columns) += factor * sum;
        }
      }
    }
  }
}

}  // namespace plumbline::internal
