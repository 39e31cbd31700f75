#include "track/internal/finite_differences.h"

namespace plumbline::internal {

std::vector<double> SlopeWeights(std::span<const double> times, std::size_t at) {
  if (times.size() == 2) {
    const double per_s = 1 / (times[1] - times[0]);
    return {-per_s, per_s};
  }
  std::vector<double> weights(3);
  for (std::size_t k = 0; k < 3; ++k) {
    const double t = times[k], u = times[(k + 1) % 3], v = times[(k + 2) % 3];
    weights[k] = (2 * times[at] - u - v) / ((t - u) * (t - v));
  }
  return weights;
}

std::array<double, 3> BendWeights(const std::array<double, 3>& times) {
  std::array<double, 3> weights{};
  for (std::size_t k = 0; k < 3; ++k) {
    weights[k] = 2 / ((times[k] - times[(k + 1) % 3]) * (times[k] - times[(k + 2) % 3]));
  }
  return weights;
}

}  // namespace plumbline::internal
