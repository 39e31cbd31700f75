#include "match/internal/subset_search.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace plumbline::internal {
namespace {

using Row = Eigen::Map<const Eigen::VectorXf>;
constexpr double kNoMatch = -2;  // no ZNCC: the window leaves the image or has no contrast

// Smaller over larger eigenvalue of the structure tensor. Along a stripe it is the noise's alone.
bool HasTwoDirections(const Image<float>& image, const SubsetTemplate& subset) {
  double xx = 0, xy = 0, yy = 0;
  const int r = subset.radius_px, side = subset.side_px();
  for (int i = 1; i < side - 1; ++i) {
    const int y = subset.centre_px.y() - r + i;
    for (int j = 1; j < side - 1; ++j) {
      if (!subset.weight.empty() && subset.weight[static_cast<std::size_t>(i * side + j)] == 0) {
        continue;
      }
      const int x = subset.centre_px.x() - r + j;
      const double gx = static_cast<double>(image(y, x + 1) - image(y, x - 1));
      const double gy = static_cast<double>(image(y + 1, x) - image(y - 1, x));
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
  }
  constexpr double kLeastShare = 0.05;
  const double mean = (xx + yy) / 2, spread = std::hypot((xx - yy) / 2, xy);
  return mean - spread > kLeastShare * (mean + spread);
}

// The deformed image along the predicted motion: cell (row, column) shows what the template's pixel
// (row - reach, column - reach) is predicted to have become.
struct Patch {
  int side = 0;
  std::vector<float> grey, square;
  // Corners of the template's window at a shift, in the image.
  bool Inside(ImageSize size, const Eigen::Matrix2d& a, const Eigen::Vector2d& origin, int column,
              int row, int window) const {
    for (const int dy : {0, window - 1}) {
      for (const int dx : {0, window - 1}) {
        const Eigen::Vector2d p = origin + a * Eigen::Vector2d(column + dx, row + dy);
        if (!(p.x() >= 0 && p.y() >= 0 && p.x() <= size.width - 1 && p.y() <= size.height - 1)) {
          return false;
        }
      }
    }
    return true;
  }
};

float Bilinear(const Image<float>& image, const Eigen::Vector2d& p) {
  const double x = std::clamp(p.x(), 0.0, image.width() - 1.0);
  const double y = std::clamp(p.y(), 0.0, image.height() - 1.0);
  const int x0 = std::min(static_cast<int>(x), image.width() - 2);
  const int y0 = std::min(static_cast<int>(y), image.height() - 2);
  const auto fx = static_cast<float>(x - x0), fy = static_cast<float>(y - y0);
  const float* top = image.row(y0) + x0;
  const float* bottom = image.row(y0 + 1) + x0;
  return (1 - fy) * ((1 - fx) * top[0] + fx * top[1]) +
         fy * ((1 - fx) * bottom[0] + fx * bottom[1]);
}

Patch Sample(const Image<float>& image, const Eigen::Matrix2d& a, const Eigen::Vector2d& origin,
             int side) {
  Patch patch;
  patch.side = side;
  patch.grey.resize(static_cast<std::size_t>(side * side));
  patch.square.resize(patch.grey.size());
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      const auto k = static_cast<std::size_t>(i * side + j);
      patch.grey[k] = Bilinear(image, origin + a * Eigen::Vector2d(j, i));
    }
  }
  // About their mean, so that the sums of squares keep their digits.
  const float mean = Row(patch.grey.data(), side * side).mean();
  for (std::size_t k = 0; k < patch.grey.size(); ++k) {
    patch.grey[k] -= mean;
    patch.square[k] = patch.grey[k] * patch.grey[k];
  }
  return patch;
}

double ZnccAt(const SubsetTemplate& subset, const Patch& patch, int column, int row) {
  const int side = subset.side_px();
  double product = 0, sum = 0, square = 0;
  for (int i = 0; i < side; ++i) {
    const auto at = static_cast<std::size_t>((row + i) * patch.side + column);
    const Row grey(&patch.grey[at], side), squares(&patch.square[at], side);
    product +=
        static_cast<double>(Row(&subset.value[static_cast<std::size_t>(i * side)], side).dot(grey));
    if (subset.weight.empty()) {
      sum += static_cast<double>(grey.sum());
      square += static_cast<double>(squares.sum());
    } else {
      const Row weight(&subset.weight[static_cast<std::size_t>(i * side)], side);
      sum += static_cast<double>(weight.dot(grey));
      square += static_cast<double>(weight.dot(squares));
    }
  }
  const double norm = std::sqrt(std::max(0.0, square - sum * sum / subset.count));
  return norm < kLeastContrastShare * subset.norm ? kNoMatch : product / (norm * subset.norm);
}

}  // namespace

double ParabolaPeak(double left, double centre, double right) {
  const double curvature = left - 2 * centre + right;
  if (!(curvature < 0)) return 0;
  return std::clamp((left - right) / (2 * curvature), -0.5, 0.5);
}

std::optional<SubsetTemplate> CutTemplate(const Image<float>& reference,
                                          const Image<std::uint8_t>& mask,
                                          const Eigen::Vector2i& centre_px, int radius_px,
                                          double min_contrast) {
  SubsetTemplate out;
  out.centre_px = centre_px;
  out.radius_px = radius_px;
  const int side = out.side_px();
  const int x0 = centre_px.x() - radius_px, y0 = centre_px.y() - radius_px;
  if (x0 < 0 || y0 < 0 || x0 + side > reference.width() || y0 + side > reference.height()) {
    return std::nullopt;
  }
  double sum = 0;
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      const bool used = mask(y0 + i, x0 + j) != 0;
      out.weight.push_back(used ? 1.0F : 0.0F);
      out.value.push_back(reference(y0 + i, x0 + j));
      if (!used) continue;
      out.count += 1;
      sum += static_cast<double>(out.value.back());
    }
  }
  if (2 * out.count < side * side) return std::nullopt;
  const auto mean = static_cast<float>(sum / out.count);
  double square = 0;
  for (std::size_t k = 0; k < out.value.size(); ++k) {
    out.value[k] = out.weight[k] * (out.value[k] - mean);
    square += static_cast<double>(out.value[k] * out.value[k]);
  }
  out.norm = std::sqrt(square);
  if (out.count == side * side) out.weight.clear();
  if (square < min_contrast * min_contrast * out.count || !HasTwoDirections(reference, out)) {
    return std::nullopt;
  }
  return out;
}

std::optional<SubsetMatch> SearchAround(const SubsetTemplate& subset, const Image<float>& deformed,
                                        const Eigen::Vector2d& displacement_px,
                                        const Eigen::Matrix2d& gradient, int reach_px) {
  const Eigen::Matrix2d a = Eigen::Matrix2d::Identity() + gradient;
  const int places = 2 * reach_px + 1, reach = subset.radius_px + reach_px;
  Eigen::Vector2d displacement = displacement_px;
  if (gradient.isZero(0)) displacement = displacement.array().round();  // no blur by interpolation
  std::vector<double> zncc(static_cast<std::size_t>(places * places));
  const auto at = [&](int row, int column) {
    return row < 0 || column < 0 || row >= places || column >= places
               ? kNoMatch
               : zncc[static_cast<std::size_t>(row * places + column)];
  };
  for (int move = 0; move < 3; ++move) {
    const Eigen::Vector2d origin =
        subset.centre_px.cast<double>() + displacement - a * Eigen::Vector2d(reach, reach);
    if (!(origin.array().abs() < 1e6).all()) return std::nullopt;
    const Patch patch = Sample(deformed, a, origin, 2 * reach + 1);
    int best = -1;
    for (int k = 0; k < places * places; ++k) {
      const int row = k / places, column = k % places;
      auto& score = zncc[static_cast<std::size_t>(k)];
      score = patch.Inside(deformed.size(), a, origin, column, row, subset.side_px())
                  ? ZnccAt(subset, patch, column, row)
                  : kNoMatch;
      if (score > kNoMatch && (best < 0 || score > zncc[static_cast<std::size_t>(best)])) best = k;
    }
    if (best < 0) return std::nullopt;
    const int row = best / places, column = best % places;
    Eigen::Vector2d shift(column - reach_px, row - reach_px);
    if (shift.cwiseAbs().maxCoeff() == reach_px && reach_px > 0) {
      displacement += a * shift;
      continue;
    }
    const double peak = at(row, column);
    const double left = at(row, column - 1), right = at(row, column + 1);
    const double above = at(row - 1, column), below = at(row + 1, column);
    // Beside a window that leaves the image the true maximum may be out there.
    if (std::min({left, right, above, below}) <= kNoMatch) return std::nullopt;
    shift.x() += ParabolaPeak(left, peak, right);
    shift.y() += ParabolaPeak(above, peak, below);
    return SubsetMatch{displacement + a * shift, peak};
  }
  return std::nullopt;
}

}  // namespace plumbline::internal
