#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "calib/image.h"

namespace plumbline::testing {

// The disparity of a plane: d + dx x + dy y at the left pixel (x, y).
struct DisparityPlane {
  double d = 0, dx = 0, dy = 0;
  double At(int x, int y) const { return d + dx * x + dy * y; }
};

struct SpecklePair {
  GrayImage left, right;
};

// A rectified pair of a speckled plane: Gaussian blobs summed analytically at each camera's own
// pixels, so that nothing is interpolated and the disparity is exact; then Gaussian noise (grey
// levels of 8 bits, scaled up for more) and rounding.
inline SpecklePair RenderSpecklePair(ImageSize size, const DisparityPlane& plane, double noise_grey,
                                     std::uint32_t seed, int bits = 8) {
  std::mt19937 random(seed);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * static_cast<double>(random()) / 4294967296.0;
  };
  constexpr double kMargin = 80;
  const int blobs =
      static_cast<int>((size.width + 2 * kMargin) * (size.height + 20) / 26);  // about 5 px apart
  Image<double> left(size, 110), right(size, 110);
  for (int i = 0; i < blobs; ++i) {
    const double cx = uniform(-kMargin, size.width + kMargin), cy = uniform(-10, size.height + 10);
    const double s = uniform(1.3, 2.2), a = uniform(20, 60) * (random() % 2 == 0 ? 1 : -1);
    for (int y = std::max(0, static_cast<int>(cy - 8)); y < std::min<double>(size.height, cy + 9);
         ++y) {
      const double row = a * std::exp(-(y - cy) * (y - cy) / (2 * s * s));
      for (int x = std::max(0, static_cast<int>(cx - 8)); x < std::min<double>(size.width, cx + 9);
           ++x) {
        left(y, x) += row * std::exp(-(x - cx) * (x - cx) / (2 * s * s));
      }
      // The right pixel x sees the left column u with u - (d + dx u + dy y) = x.
      const double there = cx - (plane.d + plane.dx * cx + plane.dy * y);
      for (int x = std::max(0, static_cast<int>(there - 10));
           x < std::min<double>(size.width, there + 11); ++x) {
        const double u = (x + plane.d + plane.dy * y) / (1 - plane.dx);
        right(y, x) += row * std::exp(-(u - cx) * (u - cx) / (2 * s * s));
      }
    }
  }
  const auto to_grey = [&](const Image<double>& image) {
    GrayImage out{Image<std::uint16_t>(size), bits};
    const double scale = std::pow(2.0, bits - 8);
    for (std::size_t i = 0; i < image.pixel_count(); ++i) {
      // Box and Muller's normal deviate: the standard's own differs between libraries.
      const double normal =
          std::sqrt(-2 * std::log(uniform(1e-12, 1))) * std::cos(6.283185307179586 * uniform(0, 1));
      const double grey = std::round(scale * (image.data()[i] + noise_grey * normal));
      out.grey.data()[i] = static_cast<std::uint16_t>(std::clamp<double>(grey, 0, out.max_level()));
    }
    return out;
  };
  SpecklePair pair;
  pair.left = to_grey(left);
  pair.right = to_grey(right);
  return pair;
}

}  // namespace plumbline::testing
