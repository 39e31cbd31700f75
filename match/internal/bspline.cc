#include "match/internal/bspline.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

namespace plumbline::internal {
namespace {

// Polynomials of the first half of the taps in t, lowest power first.
constexpr double kCubic[2][6] = {{1 / 6., -3 / 6., 3 / 6., -1 / 6., 0, 0},
                                 {4 / 6., 0, -6 / 6., 3 / 6., 0, 0}};
constexpr double kQuintic[3][6] = {
    {1 / 120., -5 / 120., 10 / 120., -10 / 120., 5 / 120., -1 / 120.},
    {26 / 120., -50 / 120., 20 / 120., 20 / 120., -20 / 120., 5 / 120.},
    {66 / 120., 0, -60 / 120., 0, 30 / 120., -10 / 120.}};

const double (*Polynomials(int degree))[6] {
  if (degree == 3) return kCubic;
  if (degree == 5) return kQuintic;
  throw std::invalid_argument("B-splines of degree 3 and 5 only");
}

std::vector<double> Poles(int degree) {
  if (degree == 3) return {std::sqrt(3.0) - 2};
  return {std::sqrt(67.5 - std::sqrt(4436.25)) + std::sqrt(26.25) - 6.5,
          std::sqrt(67.5 + std::sqrt(4436.25)) - std::sqrt(26.25) - 6.5};
}

// Terms of the mirrored past that still matter in double.
int Horizon(double pole) {
  return static_cast<int>(std::ceil(std::log(1e-17) / std::log(std::abs(pole))));
}

// Rows that are filtered side by side: each step of a recursion waits for the one before it.
constexpr int kRows = 8;
using RowLanes = Eigen::Array<double, kRows, 1>;

// The two recursive filters of one pole along rows.
void FilterAlong(std::vector<RowLanes>& row, double z) {
  const int size = static_cast<int>(row.size());
  RowLanes start = RowLanes::Zero();
  double power = 1;
  for (int i = 0; i < Horizon(z); ++i, power *= z) {
    start += power * row[static_cast<std::size_t>(Mirrored(i, size))];
  }
  row[0] = start;
  for (std::size_t i = 1; i < row.size(); ++i) row[i] += z * row[i - 1];
  const std::size_t last = row.size() - 1;
  row[last] = z / (z * z - 1) * (row[last] + z * row[last - 1]);
  for (std::size_t i = last; i-- > 0;) row[i] = z * (row[i + 1] - row[i]);
}

// The same down the columns [begin, end), all at once.
void FilterColumns(Image<float>& image, double pole, int begin, int end) {
  const auto z = static_cast<float>(pole);
  const int rows = image.height();
  for (int x = begin; x < end; ++x) {
    double start = 0;
    double power = 1;
    for (int i = 0; i < Horizon(pole); ++i, power *= pole) {
      start += power * static_cast<double>(image(Mirrored(i, rows), x));
    }
    image(0, x) = static_cast<float>(start);
  }
  for (int y = 1; y < rows; ++y) {
    const float* above = image.row(y - 1);
    float* row = image.row(y);
    for (int x = begin; x < end; ++x) row[x] += z * above[x];
  }
  {
    const float* above = image.row(rows - 2);
    float* row = image.row(rows - 1);
    for (int x = begin; x < end; ++x) row[x] = z / (z * z - 1) * (row[x] + z * above[x]);
  }
  for (int y = rows - 1; y-- > 0;) {
    const float* below = image.row(y + 1);
    float* row = image.row(y);
    for (int x = begin; x < end; ++x) row[x] = z * (below[x] - row[x]);
  }
}

using Range = tbb::blocked_range<int>;

// Response at zero of the recursive filters without it.
double Gain(int degree) {
  double gain = 1;
  for (const double pole : Poles(degree)) gain *= (1 - pole) * (1 - 1 / pole);
  return gain;
}

void FilterRows(int degree, double scale, Image<float>& image) {
  const std::vector<double> poles = Poles(degree);
  const int width = image.width();
  tbb::parallel_for(Range(0, (image.height() + kRows - 1) / kRows), [&](const Range& blocks) {
    std::vector<RowLanes> line(static_cast<std::size_t>(width), RowLanes::Zero());
    for (int block = blocks.begin(); block < blocks.end(); ++block) {
      const int first = block * kRows;
      const int rows = std::min(kRows, image.height() - first);
      for (int k = 0; k < rows; ++k) {
        const float* row = image.row(first + k);
        for (int x = 0; x < width; ++x) {
          line[static_cast<std::size_t>(x)][k] = scale * static_cast<double>(row[x]);
        }
      }
      if (width > 1) {
        for (const double pole : poles) FilterAlong(line, pole);
      }
      for (int k = 0; k < rows; ++k) {
        float* row = image.row(first + k);
        for (int x = 0; x < width; ++x) {
          row[x] = static_cast<float>(line[static_cast<std::size_t>(x)][k]);
        }
      }
    }
  });
}

}  // namespace

int Mirrored(int i, int size) {
  if (size == 1) return 0;
  const int period = 2 * (size - 1);
  i = ((i % period) + period) % period;
  return i < size ? i : period - i;
}

void SplineWeights(int degree, double t, double* weights) {
  const auto* polynomials = Polynomials(degree);
  for (int k = 0; k <= degree; ++k) {
    const bool mirrored = k > degree / 2;
    const double* p = polynomials[mirrored ? degree - k : k];
    const double x = mirrored ? 1 - t : t;
    weights[k] = p[0] + x * (p[1] + x * (p[2] + x * (p[3] + x * (p[4] + x * p[5]))));
  }
}

void SplineSlopeWeights(int degree, double t, double* weights) {
  const auto* polynomials = Polynomials(degree);
  for (int k = 0; k <= degree; ++k) {
    const bool mirrored = k > degree / 2;
    const double* p = polynomials[mirrored ? degree - k : k];
    const double x = mirrored ? 1 - t : t;
    const double slope = p[1] + x * (2 * p[2] + x * (3 * p[3] + x * (4 * p[4] + x * 5 * p[5])));
    weights[k] = mirrored ? -slope : slope;
  }
}

SplineTapPolynomials TapPolynomials(int degree) {
  const auto* polynomials = Polynomials(degree);
  SplineTapPolynomials taps{};
  for (int k = 0; k <= degree / 2; ++k) {
    // p(1/2 + s) by Horner's scheme on polynomials in s.
    double shifted[6] = {};
    for (int i = 5; i >= 0; --i) {
      for (int j = 5; j > 0; --j) shifted[j] = shifted[j] * 0.5 + shifted[j - 1];
      shifted[0] = shifted[0] * 0.5 + polynomials[k][i];
    }
    for (int i = 0; i < 3; ++i) {
      taps.even[i][k] = taps.even[i][degree - k] = static_cast<float>(shifted[2 * i]);
      taps.odd[i][k] = static_cast<float>(shifted[2 * i + 1]);
      taps.odd[i][degree - k] = -taps.odd[i][k];
    }
  }
  return taps;
}

void RowSamplesToCoefficients(int degree, Image<float>& image) {
  FilterRows(degree, image.width() > 1 ? Gain(degree) : 1, image);
}

void SamplesToCoefficients(int degree, Image<float>& image) {
  const bool high = image.height() > 1;
  FilterRows(degree, (image.width() > 1 ? Gain(degree) : 1) * (high ? Gain(degree) : 1), image);
  if (!high) return;
  tbb::parallel_for(Range(0, (image.width() + 63) / 64), [&](const Range& strips) {
    for (const double pole : Poles(degree)) {
      FilterColumns(image, pole, 64 * strips.begin(), std::min(image.width(), 64 * strips.end()));
    }
  });
}

Image<float> FilterSeparably(const Image<float>& image, const std::vector<float>& along_x,
                             const std::vector<float>& along_y) {
  const int width = image.width();
  const int radius_x = static_cast<int>(along_x.size() / 2);
  const int radius_y = static_cast<int>(along_y.size() / 2);
  Image<float> down(image.size());
  Image<float> out(image.size());
  tbb::parallel_for(Range(0, image.height(), 16), [&](const Range& rows) {
    std::vector<float> padded(static_cast<std::size_t>(width + 2 * radius_x));
    for (int y = rows.begin(); y < rows.end(); ++y) {
      float* sum = down.row(y);
      for (int k = -radius_y; k <= radius_y; ++k) {
        const float weight = along_y[static_cast<std::size_t>(k + radius_y)];
        const float* from = image.row(Mirrored(y + k, image.height()));
        for (int x = 0; x < width; ++x) sum[x] += weight * from[x];
      }
      std::copy(sum, sum + width, padded.begin() + radius_x);
      for (int k = 1; k <= radius_x; ++k) {
        padded[static_cast<std::size_t>(radius_x - k)] = sum[Mirrored(-k, width)];
        padded[static_cast<std::size_t>(radius_x + width - 1 + k)] =
            sum[Mirrored(width - 1 + k, width)];
      }
      float* to = out.row(y);
      for (std::size_t k = 0; k < along_x.size(); ++k) {
        const float weight = along_x[k];
        const float* from = padded.data() + k;
        for (int x = 0; x < width; ++x) to[x] += weight * from[x];
      }
    }
  });
  return out;
}

std::vector<float> GaussianTaps(double sigma_px) {
  const int radius = static_cast<int>(std::ceil(4 * sigma_px));
  std::vector<double> taps;
  double sum = 0;
  for (int k = -radius; k <= radius; ++k) {
    taps.push_back(sigma_px > 0 ? std::exp(-0.5 * k * k / (sigma_px * sigma_px)) : 1);
    sum += taps.back();
  }
  std::vector<float> normalised;
  for (const double tap : taps) normalised.push_back(static_cast<float>(tap / sum));
  return normalised;
}

std::vector<float> LowPassTaps() {
  constexpr int kRadius = 5;
  using Taps = std::array<double, 2 * kRadius + 1>;
  // Times (a z + b + a / z) with the middle tap of the product kept in place.
  const auto times = [](const Taps& taps, double a, double b) {
    Taps product{};
    for (std::size_t i = 0; i < taps.size(); ++i) {
      product[i] = b * taps[i];
      if (i > 0) product[i] += a * taps[i - 1];
      if (i + 1 < taps.size()) product[i] += a * taps[i + 1];
    }
    return product;
  };
  Taps power{};  // (1 - x)^2 x^n, by x = (2 - z - 1 / z) / 4
  power[kRadius] = 1;
  power = times(times(power, 0.25, 0.5), 0.25, 0.5);
  Taps sum{};
  for (int n = 0; n < 4; ++n) {
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += (n + 1) * power[i];
    power = times(power, -0.25, 0.5);
  }
  std::vector<float> taps;
  for (const double tap : sum) taps.push_back(static_cast<float>(tap));
  return taps;
}

double NoiseEnergy(int degree, const std::vector<float>& taps, double t) {
  // The answer at t to a lone sample of 1 at place k, for all k around it.
  constexpr int kReach = 24;
  constexpr int kSize = 2 * kReach + 1;
  Image<float> line(ImageSize{kSize, 1});
  line(0, kReach) = 1;
  Image<float> impulse = FilterSeparably(line, taps, {1.0F});
  SamplesToCoefficients(degree, impulse);
  double weights[6];
  SplineWeights(degree, t, weights);
  const int before = (degree - 1) / 2;
  double energy = 0;
  for (int at = before; at + degree - before < kSize; ++at) {
    double value = 0;
    for (int k = 0; k <= degree; ++k) {
      value += weights[k] * static_cast<double>(impulse(0, at - before + k));
    }
    energy += value * value;
  }
  return energy;
}

}  // namespace plumbline::internal
