#include "match/correlation_area.h"

#include <algorithm>

namespace plumbline {

double CorrelationArea(const NeighbourCorrelation& neighbours, ImageSize grid) {
  constexpr int kSamples = 12;  // along each axis
  double sum = 0;
  int count = 0;
  const int reach = neighbours.reach();
  for (int r = 0; r < grid.height; r += std::max(1, grid.height / kSamples)) {
    for (int c = 0; c < grid.width; c += std::max(1, grid.width / kSamples)) {
      for (int dr = -reach; dr <= reach; ++dr) {
        for (int dc = -reach; dc <= reach; ++dc) {
          sum += static_cast<double>(neighbours.Between(r, c, dr, dc).trace()) / 2;
        }
      }
      ++count;
    }
  }
  return std::max(1.0, sum / std::max(1, count));
}

}  // namespace plumbline
