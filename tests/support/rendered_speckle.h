#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numbers>

#include "calib/image.h"

namespace plumbline::testing {

enum class SpeckleKind {
  kSoftBlobs,   // Gaussian blobs of either sign, sigma 1.3 to 2.2 px, about 5 px apart
  kSharpDiscs,  // dark discs on a bright ground, radius 1.8 to 3.4 px, about 7 px apart
};

struct RenderedSpeckleOptions {
  SpeckleKind kind = SpeckleKind::kSoftBlobs;
  std::uint32_t pattern_seed = 1;  // another number, another speckle
  double scale = 1;                // of all lengths of the pattern
  // Standard deviation of the normal blur that the edge of a sharp disc has in the image. A pixel's
  // area and a good lens (0.45 px) together: 0.53 px.
  double edge_sigma_px = 0.53;
  double contrast = 1;     // factor on the departure from mean_grey
  double mean_grey = 120;  // in grey levels of 8 bits, as are contrast and noise
  int bits = 8;            // more than 8: everything times 2^(bits - 8)
};

// A speckle of unbounded extent: the grey level (of 8 bits, unrounded) of any point of the
// material. It is a formula of the point, every cell of a lattice holding one blob or disc drawn by
// hashing the cell's place, so that whatever a warp brings into view is there and nothing is
// interpolated. Keeps the blobs of the last cell: one object a thread.
class SpecklePattern {
 public:
  explicit SpecklePattern(const RenderedSpeckleOptions& options) : options_(options) {}

  double GreyAt(const Eigen::Vector2d& material_px) {
    const Eigen::Vector2d p = material_px / options_.scale;
    const double cell = options_.kind == SpeckleKind::kSoftBlobs ? 5 : 7;
    const auto column = static_cast<std::int64_t>(std::floor(p.x() / cell));
    const auto row = static_cast<std::int64_t>(std::floor(p.y() / cell));
    if (!filled_ || column != column_ || row != row_) Fill(column, row, cell);
    const double departure = options_.kind == SpeckleKind::kSoftBlobs ? Blobs(p) : Discs(p);
    return options_.mean_grey + options_.contrast * departure;
  }

  // Deterministic, well mixed 64 bits (the finaliser of SplitMix64).
  static std::uint64_t Hash(std::uint64_t x) {
    x += 0x9E3779B97F4A7C15ULL;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
    return x ^ (x >> 31);
  }
  // In (0, 1).
  static double Uniform(std::uint64_t hash) {
    return (static_cast<double>(hash >> 12) + 0.5) / 4503599627370496.0;
  }

 private:
  struct Spot {
    Eigen::Vector2d centre{0, 0};
    double size = 1;       // sigma of a blob, radius of a disc
    double amplitude = 0;  // of a blob
  };
  static constexpr int kReach = 2;  // cells: 4.5 sigma of the widest blob
  static constexpr int kSide = 2 * kReach + 1;

  void Fill(std::int64_t column, std::int64_t row, double cell) {
    filled_ = true;
    column_ = column;
    row_ = row;
    for (int i = 0; i < kSide * kSide; ++i) {
      const std::int64_t c = column + i % kSide - kReach, r = row + i / kSide - kReach;
      std::uint64_t h = Hash(options_.pattern_seed);
      h = Hash(h ^ static_cast<std::uint64_t>(c));
      h = Hash(h ^ static_cast<std::uint64_t>(r));
      Spot& spot = spots_[static_cast<std::size_t>(i)];
      spot.centre.x() = (static_cast<double>(c) + Uniform(h = Hash(h))) * cell;
      spot.centre.y() = (static_cast<double>(r) + Uniform(h = Hash(h))) * cell;
      const double size = Uniform(h = Hash(h));
      spot.size = options_.kind == SpeckleKind::kSoftBlobs ? 1.3 + 0.9 * size : 1.8 + 1.6 * size;
      spot.amplitude = 20 + 40 * Uniform(h = Hash(h));
      if ((Hash(h) & 1) != 0) spot.amplitude = -spot.amplitude;
    }
  }
  double Blobs(const Eigen::Vector2d& p) const {
    double sum = 0;
    for (const Spot& spot : spots_) {
      const double d2 = (p - spot.centre).squaredNorm() / (spot.size * spot.size);
      if (d2 < 4.5 * 4.5) sum += spot.amplitude * std::exp(-d2 / 2);
    }
    return sum;
  }
  double Discs(const Eigen::Vector2d& p) const {
    double bare = 1;  // share of the bright ground that no disc covers
    for (const Spot& spot : spots_) {
      const double inside = (spot.size - (p - spot.centre).norm()) * options_.scale;
      bare *= std::erfc(inside / (options_.edge_sigma_px * std::numbers::sqrt2)) / 2;
    }
    return 160 * bare - 80;
  }

  RenderedSpeckleOptions options_;
  std::array<Spot, kSide * kSide> spots_;
  std::int64_t column_ = 0, row_ = 0;
  bool filled_ = false;
};

// A photograph of a speckle: the grey level at the centre of each pixel is that of the material
// point `material_from_pixel` says is seen there; then independent Gaussian noise of noise_sigma
// (grey levels of 8 bits), rounding and clipping. An image of the material at rest has the identity
// as map; one deformed by x -> x + u(x) has its inverse, so that the truth is exact.
//
// noise_seed: give the images of a pair different ones. A negative noise_sigma gives the same noise
// with the opposite sign. The pattern has its own in the options and
// is the same for all images that leave it alone.
// About 0.3 s for 1000 x 1000 pixels.
inline GrayImage RenderSpeckle(
    ImageSize size,
    const std::function<Eigen::Vector2d(const Eigen::Vector2d&)>& material_from_pixel,
    double noise_sigma, std::uint32_t noise_seed, const RenderedSpeckleOptions& options = {}) {
  GrayImage out{Image<std::uint16_t>(size), options.bits};
  SpecklePattern pattern(options);
  const double levels = std::ldexp(1.0, options.bits - 8);
  const std::uint64_t noise = SpecklePattern::Hash(noise_seed + 0x100000000ULL);
  std::uint64_t index = 0;
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      double grey = pattern.GreyAt(material_from_pixel(Eigen::Vector2d(x, y)));
      if (noise_sigma != 0) {  // Box and Muller's normal deviate: the standard's differs by library
        const double u = SpecklePattern::Uniform(SpecklePattern::Hash(noise ^ index++));
        const double v = SpecklePattern::Uniform(SpecklePattern::Hash(noise ^ index++));
        grey += noise_sigma * std::sqrt(-2 * std::log(u)) * std::cos(6.283185307179586 * v);
      }
      out.grey(y, x) = static_cast<std::uint16_t>(
          std::clamp(std::round(levels * grey), 0.0, static_cast<double>(out.max_level())));
    }
  }
  return out;
}

}  // namespace plumbline::testing
