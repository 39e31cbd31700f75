#include <cmath>

#include "match/internal/bspline.h"
#include "match/internal/subset_sums.h"

namespace plumbline::internal {
namespace {

// Calls visit(place in the arrays, monomials of the offset) for every value that counts.
template <typename Visit>
void ForEachPixel(const PackedSubset& subset, const Visit& visit) {
  for (const PackedSubset::Row& row : subset.rows) {
    const auto y = static_cast<double>(row.y);
    for (int i = 0; i < row.runs * PackedSubset::kRun; ++i) {
      const std::size_t at = row.at + static_cast<std::size_t>(i);
      if (subset.weight.data()[at] == 0) continue;
      const double x = row.x + i;
      const double m[15] = {1,
                            x,
                            y,
                            x * x,
                            x * y,
                            y * y,
                            x * x * x,
                            x * x * y,
                            x * y * y,
                            y * y * y,
                            x * x * x * x,
                            x * x * x * y,
                            x * x * y * y,
                            x * y * y * y,
                            y * y * y * y};
      visit(at, m);
    }
  }
}

double SplineValue(const TargetPixels& target, double x, double y) {
  const int degree = target.degree;
  const double x0 = std::floor(x);
  const double y0 = std::floor(y);
  double along_x[6];
  double along_y[6];
  SplineWeights(degree, x - x0, along_x);
  SplineWeights(degree, y - y0, along_y);
  const int before = (degree - 1) / 2;
  const float* corner = target.coefficients +
                        (static_cast<std::ptrdiff_t>(y0) - before) * target.stride +
                        static_cast<std::ptrdiff_t>(x0) - before;
  double value = 0;
  for (int j = 0; j <= degree; ++j) {
    double sum = 0;
    for (int i = 0; i <= degree; ++i) {
      sum += along_x[i] * static_cast<double>(corner[j * target.stride + i]);
    }
    value += along_y[j] * sum;
  }
  return value;
}

double At(const AlignedFloats& values, std::size_t at) {
  return static_cast<double>(values.data()[at]);
}

}  // namespace

ReferenceSums SumReferenceScalar(const PackedSubset& subset, int order) {
  ReferenceSums sums;
  ForEachPixel(subset, [&](std::size_t at, const double* m) {
    const double f = At(subset.grey, at);
    sums.f += f;
    sums.ff += f * f;
    for (int k = 0; k < kShapeTerms[order]; ++k) {
      const double x = At(subset.gradient_x, at) * m[k];
      const double y = At(subset.gradient_y, at) * m[k];
      sums.gradient_x[k] += x;
      sums.gradient_y[k] += y;
      sums.f_gradient_x[k] += f * x;
      sums.f_gradient_y[k] += f * y;
    }
  });
  return sums;
}

ProductSums SumProductsScalar(const PackedSubset& subset, const AlignedFloats& x,
                              const AlignedFloats& y, int order) {
  ProductSums sums;
  ForEachPixel(subset, [&](std::size_t at, const double* m) {
    for (int k = 0; k < kProductTerms[order]; ++k) {
      sums.xx[k] += At(x, at) * At(x, at) * m[k];
      sums.xy[k] += At(x, at) * At(y, at) * m[k];
      sums.yy[k] += At(y, at) * At(y, at) * m[k];
    }
  });
  return sums;
}

TargetSums SumTargetScalar(const PackedSubset& subset, const TargetPixels& target, int order) {
  TargetSums sums;
  ForEachPixel(subset, [&](std::size_t at, const double* m) {
    double x = 0;
    double y = 0;
    for (int k = 0; k < (order < 2 && !target.bent ? 3 : 6); ++k) {
      x += static_cast<double>(target.warp_x[k]) * m[k];
      y += static_cast<double>(target.warp_y[k]) * m[k];
    }
    const double g = SplineValue(target, x, y) - static_cast<double>(target.grey_offset);
    sums.g += g;
    sums.gg += g * g;
    sums.fg += g * At(subset.grey, at);
    for (int k = 0; k < kShapeTerms[order]; ++k) {
      sums.gradient_x[k] += g * At(subset.gradient_x, at) * m[k];
      sums.gradient_y[k] += g * At(subset.gradient_y, at) * m[k];
    }
  });
  return sums;
}

}  // namespace plumbline::internal
