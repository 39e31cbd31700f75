#include "match/internal/bspline.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "tests/support/subset_noise.h"

namespace plumbline::internal {
namespace {

constexpr int kDegrees[] = {3, 5};

int MirroredIndex(int i, int size) {
  if (size == 1) return 0;
  while (i < 0 || i >= size) i = i < 0 ? -i : 2 * (size - 1) - i;
  return i;
}

// The B-spline by its recursion (de Boor), centred on 0: shares nothing with the code's
// polynomials.
double Basis(int degree, double x) {
  if (degree == 0) return x >= -0.5 && x < 0.5 ? 1 : 0;
  const double half = (degree + 1) / 2.0;
  return ((half + x) * Basis(degree - 1, x + 0.5) + (half - x) * Basis(degree - 1, x - 0.5)) /
         degree;
}

// The value at x of a row of coefficients, mirrored at its ends.
double ValueAt(int degree, const float* coefficients, int size, double x) {
  double weights[6];
  const int x0 = static_cast<int>(std::floor(x));
  SplineWeights(degree, x - x0, weights);
  double value = 0;
  for (int k = 0; k <= degree; ++k) {
    const int at = MirroredIndex(x0 - (degree - 1) / 2 + k, size);
    value += weights[k] * static_cast<double>(coefficients[at]);
  }
  return value;
}

double ValueAt(int degree, const Image<float>& coefficients, double x, double y) {
  double weights[6];
  const int y0 = static_cast<int>(std::floor(y));
  SplineWeights(degree, y - y0, weights);
  double value = 0;
  for (int k = 0; k <= degree; ++k) {
    const int row = MirroredIndex(y0 - (degree - 1) / 2 + k, coefficients.height());
    value += weights[k] * ValueAt(degree, coefficients.row(row), coefficients.width(), x);
  }
  return value;
}

Image<float> RandomImage(ImageSize size, std::uint32_t seed) {
  testing::NormalDeviates draw(seed);
  Image<float> image(size);
  for (float& value : image.values()) value = static_cast<float>(255 * draw.Uniform());
  return image;
}

TEST(BSpline, WeightsAreTheBasisFunctionAndItsSlope) {
  for (const int degree : kDegrees) {
    for (double t = 0; t <= 1; t += 1 / 64.0) {
      double weights[6], slopes[6];
      SplineWeights(degree, t, weights);
      SplineSlopeWeights(degree, t, slopes);
      for (int k = 0; k <= degree; ++k) {
        const double x = t + (degree - 1) / 2 - k;
        EXPECT_NEAR(weights[k], Basis(degree, x), 1e-15);
        const double slope = (Basis(degree, x + 1e-5) - Basis(degree, x - 1e-5)) / 2e-5;
        EXPECT_NEAR(slopes[k], slope, 1e-9);
      }
    }
  }
}

TEST(BSpline, TapPolynomialsAreTheWeights) {
  for (const int degree : kDegrees) {
    const SplineTapPolynomials taps = TapPolynomials(degree);
    for (double t = 0; t <= 1; t += 1 / 64.0) {
      double weights[6];
      SplineWeights(degree, t, weights);
      const double s = t - 0.5;
      for (int k = 0; k < 8; ++k) {
        double even = 0, odd = 0;
        for (int i = 2; i >= 0; --i) {
          even = even * s * s + static_cast<double>(taps.even[i][k]);
          odd = odd * s * s + static_cast<double>(taps.odd[i][k]);
        }
        EXPECT_NEAR(even + s * odd, k <= degree ? weights[k] : 0, 1e-7);
      }
    }
  }
}

TEST(BSpline, FloatWeightsOfTheCubicAreTheWeights) {
  for (float t = 0; t < 1; t += 1 / 64.0F) {
    double weights[6];
    float floats[4];
    SplineWeights(3, static_cast<double>(t), weights);
    CubicWeights(t, floats);
    for (int k = 0; k < 4; ++k) EXPECT_NEAR(floats[k], weights[k], 1e-6);
  }
}

TEST(BSpline, PassesThroughTheSamplesOfImagesOfAnySize) {
  for (const int degree : kDegrees) {
    for (const ImageSize size :
         {ImageSize{1, 1}, {2, 1}, {1, 2}, {2, 2}, {1, 40}, {40, 1}, {3, 7}, {17, 13}, {150, 70}}) {
      const Image<float> samples = RandomImage(size, 3);
      Image<float> coefficients = samples;
      SamplesToCoefficients(degree, coefficients);
      double worst = 0;
      for (int y = 0; y < size.height; ++y) {
        for (int x = 0; x < size.width; ++x) {
          const double value = ValueAt(degree, coefficients, x, y);
          worst = std::max(worst, std::abs(value - static_cast<double>(samples(y, x))));
        }
      }
      EXPECT_LT(worst, 1e-3) << degree << ' ' << size.width << 'x' << size.height;
    }
  }
}

// The coefficients by solving for them: sum_j B(i - j) c(mirrored j) = sample(i).
Eigen::VectorXd SolvedCoefficients(int degree, const Eigen::VectorXd& samples) {
  const auto n = static_cast<int>(samples.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, n);
  for (int i = 0; i < n; ++i) {
    for (int k = -degree / 2; k <= degree / 2; ++k) {
      A(i, MirroredIndex(i + k, n)) += Basis(degree, k);
    }
  }
  return A.partialPivLu().solve(samples);
}

TEST(BSpline, CoefficientsSolveTheInterpolationWithMirroredBorders) {
  for (const int degree : kDegrees) {
    for (const int size : {2, 3, 5, 9, 20, 64}) {
      Image<float> row = RandomImage({size, 2}, 5);
      const Eigen::VectorXd samples =
          Eigen::Map<const Eigen::VectorXf>(row.row(1), size).cast<double>();
      const Eigen::VectorXd expected = SolvedCoefficients(degree, samples);
      Image<float> column({1, size});
      for (int i = 0; i < size; ++i) column(i, 0) = row(1, i);
      RowSamplesToCoefficients(degree, row);
      SamplesToCoefficients(degree, column);
      for (int i = 0; i < size; ++i) {
        EXPECT_NEAR(row(1, i), expected[i], 1e-3) << degree << ' ' << size;
        EXPECT_NEAR(column(i, 0), expected[i], 2e-3) << degree << ' ' << size;
      }
    }
  }
}

TEST(BSpline, ReproducesPolynomialsUpToItsDegreeAwayFromTheBorders) {
  constexpr int kSize = 90;
  for (const int degree : kDegrees) {
    for (int power = 0; power <= degree; ++power) {
      const auto polynomial = [power](double x) { return 100 * std::pow((x - 45) / 45, power); };
      Image<float> image(ImageSize{kSize, kSize});
      for (int y = 0; y < kSize; ++y) {
        for (int x = 0; x < kSize; ++x) {
          image(y, x) = static_cast<float>(polynomial(x) + polynomial(y));
        }
      }
      SamplesToCoefficients(degree, image);
      for (double x = 30; x < 60; x += 0.37) {
        const double y = 89.3 - x;
        EXPECT_NEAR(ValueAt(degree, image, x, y), polynomial(x) + polynomial(y), 2e-4)
            << degree << ' ' << power << ' ' << x;
      }
    }
  }
}

TEST(BSpline, FollowsAWaveBetweenTheSamples) {
  Image<float> image({80, 2});
  for (int x = 0; x < 80; ++x) image(1, x) = 100 * std::sin(0.7F * static_cast<float>(x));
  RowSamplesToCoefficients(3, image);
  for (float x = 15; x < 65; x += 0.13F) {
    EXPECT_NEAR(ValueAt(3, image.row(1), 80, static_cast<double>(x)), 100 * std::sin(0.7F * x),
                0.1F)
        << x;
    EXPECT_EQ(image(0, static_cast<int>(x)), 0);
  }
}

// Gain of symmetric taps for a wave of this many radians a pixel.
double GainOf(const std::vector<float>& taps, double omega) {
  const int radius = static_cast<int>(taps.size() / 2);
  double gain = 0;
  for (int k = -radius; k <= radius; ++k) {
    gain += static_cast<double>(taps[static_cast<std::size_t>(k + radius)]) * std::cos(k * omega);
  }
  return gain;
}

TEST(BSpline, LowPassHasTheGainOfItsFormula) {
  const std::vector<float> taps = LowPassTaps();
  ASSERT_EQ(taps.size(), 11U);
  for (std::size_t i = 0; i < taps.size(); ++i) EXPECT_EQ(taps[i], taps[taps.size() - 1 - i]);
  for (double omega = 0; omega < 3.2; omega += 0.1) {
    const double x = std::pow(std::sin(omega / 2), 2);
    const double gain = (1 - x) * (1 - x) * (1 + 2 * x + 3 * x * x + 4 * x * x * x);
    EXPECT_NEAR(GainOf(taps, omega), gain, 1e-6) << omega;
  }
  EXPECT_NEAR(GainOf(taps, 0), 1, 1e-6);
  EXPECT_NEAR(GainOf(taps, std::numbers::pi), 0, 1e-6);
  EXPECT_GT(GainOf(taps, 2 * std::numbers::pi * 0.2), 0.94);
  EXPECT_NEAR(GainOf(taps, 2 * std::numbers::pi * 0.31), 0.5, 0.01);
}

TEST(BSpline, GaussianTapsHaveTheGainOfAGaussian) {
  for (const double sigma : {0.7, 1.0, 2.5}) {
    const std::vector<float> taps = GaussianTaps(sigma);
    EXPECT_NEAR(GainOf(taps, 0), 1, 1e-6);
    EXPECT_NEAR(GainOf(taps, 0.8), std::exp(-0.5 * std::pow(0.8 * sigma, 2)), 1e-3);
  }
}

TEST(BSpline, FiltersAreSeparableAndMirrored) {
  const Image<float> image = RandomImage({9, 4}, 8);
  const std::vector<float> along_x = {0.1F, 0.2F, 0.4F, 0.25F, 0.05F};
  const std::vector<float> along_y = {-0.5F, 0, 0.5F, 0.25F, -0.25F, 0.1F, 0.2F};
  const Image<float> filtered = FilterSeparably(image, along_x, along_y);
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 9; ++x) {
      double expected = 0;
      for (int j = -3; j <= 3; ++j) {
        for (int i = -2; i <= 2; ++i) {
          expected += static_cast<double>(along_x[static_cast<std::size_t>(i + 2)]) *
                      static_cast<double>(along_y[static_cast<std::size_t>(j + 3)]) *
                      static_cast<double>(image(MirroredIndex(y + j, 4), MirroredIndex(x + i, 9)));
        }
      }
      EXPECT_NEAR(filtered(y, x), expected, 1e-4);
    }
  }
}

TEST(BSpline, NoiseEnergyIsWhatFilteredAndInterpolatedNoiseShows) {
  constexpr int kSize = 200000;
  testing::NormalDeviates draw(17);
  Image<float> noise(ImageSize{kSize, 1});
  for (float& value : noise.values()) value = static_cast<float>(draw());
  for (const int degree : kDegrees) {
    for (const std::vector<float>& taps : {std::vector<float>{1.0F}, LowPassTaps()}) {
      Image<float> line = FilterSeparably(noise, taps, {1.0F});
      RowSamplesToCoefficients(degree, line);
      for (const double t : {0.0, 0.3, 0.5, 0.9}) {
        double energy = 0;
        for (int x = 50; x < kSize - 50; ++x) {
          energy += std::pow(ValueAt(degree, line.row(0), kSize, x + t), 2);
        }
        energy /= kSize - 100;
        // The sample variance of a correlated series: a few times sqrt(2 / n).
        EXPECT_NEAR(energy, NoiseEnergy(degree, taps, t), 0.015) << degree << ' ' << t;
      }
    }
    EXPECT_NEAR(NoiseEnergy(degree, {1.0F}, 0), 1, 1e-6);
  }
}

}  // namespace
}  // namespace plumbline::internal
