#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

namespace plumbline::internal {

// By which values at two or three growing times make a slope (1 / unit of time): of the line, or of
// the parabola at times[at]. Its error: half of the second derivative by the interval; one sixth of
// the third by the product of the intervals to the other two.
[[nodiscard]] std::vector<double> SlopeWeights(std::span<const double> times, std::size_t at);

// By which values at three growing times make the second derivative of the parabola through them
// (1 / unit of time squared).
[[nodiscard]] std::array<double, 3> BendWeights(const std::array<double, 3>& times);

}  // namespace plumbline::internal
