#include "match/internal/row_spline.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace plumbline::internal {
namespace {

// One row, in place: the two first-order recursive filters with the pole sqrt(3) - 2.
void Prefilter(float* c, int n) {
  if (n < 2) return;
  const double pole = std::sqrt(3.0) - 2.0;
  const double gain = (1 - pole) * (1 - 1 / pole);
  std::vector<double> s(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) s[static_cast<std::size_t>(i)] = gain * static_cast<double>(c[i]);
  // pole^30 < 1e-17: the mirrored past of the row need not be followed further.
  const int horizon = std::min(n, 30);
  double start = s[0];
  double power = pole;
  for (int i = 1; i < horizon; ++i, power *= pole) start += power * s[static_cast<std::size_t>(i)];
  s[0] = start;
  for (std::size_t i = 1; i < s.size(); ++i) s[i] += pole * s[i - 1];
  const std::size_t last = s.size() - 1;
  s[last] = pole / (pole * pole - 1) * (s[last] + pole * s[last - 1]);
  for (std::size_t i = last; i-- > 0;) s[i] = pole * (s[i + 1] - s[i]);
  for (int i = 0; i < n; ++i) c[i] = static_cast<float>(s[static_cast<std::size_t>(i)]);
}

}  // namespace

Image<float> RowSplineCoefficients(const Image<float>& image) {
  Image<float> coefficients = image;
  tbb::parallel_for(0, image.height(),
                    [&](int y) { Prefilter(coefficients.row(y), image.width()); });
  return coefficients;
}

}  // namespace plumbline::internal
