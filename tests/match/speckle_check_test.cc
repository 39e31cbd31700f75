#include "match/speckle_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <cmath>
#include <cstdlib>

#include "calib/error.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;
using testing::RenderedSpeckleOptions;
using testing::RenderSpeckle;
using testing::SpeckleKind;

const auto kAtRest = [](const Eigen::Vector2d& p) { return p; };

NoiseModel WhiteNoise(double sigma) { return {sigma * sigma, 0}; }

// Separable Gaussian blur of a rendering made without noise at 16 bits; then noise and 8 bits.
GrayImage Blurred(const GrayImage& sharp, double sigma_px, double noise, std::uint64_t seed) {
  const int reach = static_cast<int>(std::ceil(4 * sigma_px));
  std::vector<double> kernel;
  double sum = 0;
  for (int k = -reach; k <= reach; ++k) {
    kernel.push_back(std::exp(-k * k / (2 * sigma_px * sigma_px + 1e-12)));
    sum += kernel.back();
  }
  Image<double> from(sharp.size()), to(sharp.size());
  for (std::size_t i = 0; i < from.pixel_count(); ++i)
    from.data()[i] = sharp.grey.data()[i] / 256.0;
  for (const bool across : {true, false}) {
    for (int y = 0; y < from.height(); ++y) {
      for (int x = 0; x < from.width(); ++x) {
        double value = 0;
        for (int k = -reach; k <= reach; ++k) {
          const int px = across ? std::clamp(x + k, 0, from.width() - 1) : x;
          const int py = across ? y : std::clamp(y + k, 0, from.height() - 1);
          value += kernel[static_cast<std::size_t>(k + reach)] * from(py, px) / sum;
        }
        to(y, x) = value;
      }
    }
    std::swap(from, to);
  }
  GrayImage out{Image<std::uint16_t>(sharp.size()), 8};
  std::uint64_t h = seed;
  const auto uniform = [&] {
    return testing::SpecklePattern::Uniform(h = testing::SpecklePattern::Hash(h));
  };
  for (std::size_t i = 0; i < from.pixel_count(); ++i) {
    const double normal =
        std::sqrt(-2 * std::log(uniform())) * std::cos(6.283185307179586 * uniform());
    out.grey.data()[i] = static_cast<std::uint16_t>(
        std::clamp(std::round(from.data()[i] + noise * normal), 0.0, 255.0));
  }
  return out;
}

TEST(SpeckleCheck, FindsTheFeatureSize) {
  // Half maximum of the autocorrelation of a blob of sigma s is at 2 s sqrt(ln 2); the blobs' root
  // mean square sigma, weighted as they enter, is 1.8.
  for (const double scale : {0.6, 1.0, 2.0, 3.0}) {
    RenderedSpeckleOptions pattern;
    pattern.scale = scale;
    const GrayImage image = RenderSpeckle({256, 220}, kAtRest, 1, 3, pattern);
    const SpeckleCheck check = CheckSpeckle(image, {.noise = WhiteNoise(1)});
    EXPECT_NEAR(check.feature_px, 2 * 2 * 1.8 * std::sqrt(std::log(2.0)) * scale, 0.08 * 6 * scale);
    if (scale == 1.0) {
      EXPECT_THAT(check.advice, ::testing::IsEmpty());
    }
  }
  RenderedSpeckleOptions fine;
  fine.scale = 0.4;
  EXPECT_THAT(CheckSpeckle(RenderSpeckle({200, 200}, kAtRest, 1, 3, fine)).advice,
              Contains(HasSubstr("features are small")));
  RenderedSpeckleOptions coarse;
  coarse.scale = 3;
  EXPECT_THAT(CheckSpeckle(RenderSpeckle({200, 200}, kAtRest, 1, 3, coarse)).advice,
              Contains(HasSubstr("features are large")));
}

TEST(SpeckleCheck, FindsTheBlurOfSharpDiscs) {
  for (const double scale : {1.0, 2.0}) {
    const GrayImage sharp = RenderSpeckle(
        {256, 220}, kAtRest, 0, 1,
        {.kind = SpeckleKind::kSharpDiscs, .scale = scale, .edge_sigma_px = 0.29, .bits = 16});
    for (const double blur_px : {0.0, 1.0, 2.0, 3.0}) {
      for (const double noise : {1.0, 3.0}) {
        const SpeckleCheck check = CheckSpeckle(Blurred(sharp, blur_px, noise, 5));
        if (blur_px > 0) {
          EXPECT_NEAR(check.blur_px, blur_px, 0.15 * blur_px) << scale << " " << noise;
        } else {
          EXPECT_LT(check.blur_px, 0.6);
        }
        const auto soft = Contains(HasSubstr("edges are as soft"));
        if (blur_px > 1.5) {
          EXPECT_THAT(check.advice, soft);
        } else {
          EXPECT_THAT(check.advice, Not(soft));
        }
      }
    }
  }
}

TEST(SpeckleCheck, EstimatesTheNoiseOfSoftAndOfSharpSpeckle) {
  for (const double noise : {0.7, 2.0, 5.0}) {
    const GrayImage soft = RenderSpeckle({256, 220}, kAtRest, noise, 2);
    EXPECT_NEAR(std::sqrt(EstimateNoiseVariance(soft)), noise, 0.08 * noise);
    const GrayImage sharp =
        RenderSpeckle({256, 220}, kAtRest, noise, 2,
                      {.kind = SpeckleKind::kSharpDiscs, .scale = 2, .contrast = 0.8});
    EXPECT_NEAR(std::sqrt(EstimateNoiseVariance(sharp)), noise, 0.25 * noise + 0.1);
  }
}

TEST(SpeckleCheck, CountsClippedPixels) {
  const GrayImage dim = RenderSpeckle({200, 200}, kAtRest, 1, 2, {.mean_grey = 20});
  const SpeckleCheck black = CheckSpeckle(dim);
  std::int64_t zeros = 0;
  for (const std::uint16_t grey : dim.grey.values()) zeros += grey == 0;
  EXPECT_DOUBLE_EQ(black.black_share, static_cast<double>(zeros) / 40000);
  EXPECT_GT(black.black_share, 0.05);
  EXPECT_THAT(black.advice, Contains(HasSubstr("clipped at black")));
  const SpeckleCheck white =
      CheckSpeckle(RenderSpeckle({200, 200}, kAtRest, 1, 2, {.mean_grey = 240}));
  EXPECT_GT(white.white_share, 0.05);
  EXPECT_THAT(white.advice, Contains(HasSubstr("saturated")));
}

TEST(SpeckleCheck, TheGradientDoesNotGrowWithNoise) {
  const double clean = CheckSpeckle(RenderSpeckle({200, 200}, kAtRest, 0, 2)).mean_gradient_grey;
  const double noisy = CheckSpeckle(RenderSpeckle({200, 200}, kAtRest, 6, 2)).mean_gradient_grey;
  EXPECT_NEAR(noisy / clean, 1, 0.06);
}

// Grey level between pixels by Lagrange's polynomial through six: a way of its own to correlate,
// for the truth of sigma.
double Interpolated(const GrayImage& image, double x, double y) {
  const int x0 = static_cast<int>(std::floor(x)) - 2, y0 = static_cast<int>(std::floor(y)) - 2;
  const auto weights = [](double t, double* w) {
    for (int i = 0; i < 6; ++i) {
      w[i] = 1;
      for (int j = 0; j < 6; ++j) w[i] *= i == j ? 1 : (t - j) / (i - j);
    }
  };
  double wx[6], wy[6], sum = 0;
  weights(x - x0, wx);
  weights(y - y0, wy);
  for (int j = 0; j < 6; ++j) {
    for (int i = 0; i < 6; ++i) sum += wx[i] * wy[j] * image.grey(y0 + j, x0 + i);
  }
  return sum;
}

// Gauss-Newton translation of a square of a to b, from zero.
Eigen::Vector2d Translation(const GrayImage& a, const GrayImage& b, Eigen::Vector2i centre,
                            int half) {
  Eigen::Vector2d u = Eigen::Vector2d::Zero();
  for (int iteration = 0; iteration < 8; ++iteration) {
    Eigen::Matrix2d H = Eigen::Matrix2d::Zero();
    Eigen::Vector2d g = Eigen::Vector2d::Zero();
    for (int y = centre.y() - half; y <= centre.y() + half; ++y) {
      for (int x = centre.x() - half; x <= centre.x() + half; ++x) {
        const auto at = [&](int dy, int dx) { return static_cast<double>(a.grey(y + dy, x + dx)); };
        const Eigen::Vector2d gradient((8 * (at(0, 1) - at(0, -1)) - at(0, 2) + at(0, -2)) / 12,
                                       (8 * (at(1, 0) - at(-1, 0)) - at(2, 0) + at(-2, 0)) / 12);
        H += gradient * gradient.transpose();
        g += gradient * (a.grey(y, x) - Interpolated(b, x + u.x(), y + u.y()));
      }
    }
    u += H.inverse() * g;
  }
  return u;
}

// What scatters over noise draws is what was predicted from each of the noisy references.
void ExpectPredictedScatter(const RenderedSpeckleOptions& pattern, double noise, int subset_px,
                            int draws, double tolerance) {
  const Eigen::Vector2i centre(24, 24);
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero(), predicted = Eigen::Matrix2d::Zero();
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  std::vector<Eigen::Vector2d> found;
  for (int i = 0; i < draws; ++i) {
    const auto seed = static_cast<std::uint32_t>(2 * i);
    const GrayImage a = RenderSpeckle({49, 49}, kAtRest, noise, seed, pattern);
    const GrayImage b = RenderSpeckle({49, 49}, kAtRest, noise, seed + 1, pattern);
    found.push_back(Translation(a, b, centre, subset_px / 2));
    mean += found.back() / draws;
    SpeckleCheckOptions options{.subset_px = subset_px, .step_px = 49, .noise = WhiteNoise(noise)};
    const SpeckleCheck check = CheckSpeckle(a, options);
    ASSERT_EQ(check.pois.size(), 1u);
    ASSERT_EQ(check.pois[0].centre_px, centre);
    ASSERT_EQ(check.pois[0].status, Status::kOk);
    predicted += check.pois[0].cov_px2 / draws;
  }
  for (const Eigen::Vector2d& u : found) scatter += (u - mean) * (u - mean).transpose() / draws;
  for (int k = 0; k < 2; ++k) {
    EXPECT_NEAR(std::sqrt(scatter(k, k) / predicted(k, k)), 1, tolerance)
        << pattern.contrast << ", subset " << subset_px << ": " << std::sqrt(scatter(k, k))
        << " px";
  }
}

TEST(SpeckleCheck, PredictsTheScatterOfAFit) {
  ExpectPredictedScatter({}, 2, 21, 200, 0.15);
  ExpectPredictedScatter({.contrast = 0.15}, 2, 33, 200, 0.2);  // the gradients are noisy
}

TEST(ProveSpeckleCheck, PredictsTheScatterOfAFitOverManyDraws) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "takes a minute";
  for (const double contrast : {1.0, 0.3}) {
    for (const int subset_px : {21, 33, 41}) {
      ExpectPredictedScatter({.contrast = contrast}, 2, subset_px, 2000, 0.05);
    }
  }
  // Gradients with twice as much noise as speckle in them.
  ExpectPredictedScatter({.contrast = 0.15}, 2, 41, 2000, 0.1);
}

TEST(SpeckleCheck, SigmaIsThatOfTheGradientEnergy) {
  const GrayImage image = RenderSpeckle({120, 120}, kAtRest, 0, 1);
  const SpeckleCheck one = CheckSpeckle(image, {.noise = WhiteNoise(1)});
  const SpeckleCheck two = CheckSpeckle(image, {.noise = WhiteNoise(2)});
  EXPECT_NEAR(two.median_sigma_px / one.median_sigma_px, std::sqrt((4 + 1 / 12.) / (1 + 1 / 12.)),
              0.06);
  const SpeckleCheck wide = CheckSpeckle(image, {.subset_px = 65, .noise = WhiteNoise(1)});
  EXPECT_NEAR(one.median_sigma_px / wide.median_sigma_px, 65.0 / 33, 0.2);
  EXPECT_GE(one.sigma95_px, one.median_sigma_px);
  EXPECT_FALSE(one.noise_estimated);
}

TEST(SpeckleCheck, TheSubsetForAWantedSigmaReachesIt) {
  const GrayImage image = RenderSpeckle({256, 256}, kAtRest, 2, 1);
  SpeckleCheckOptions options{.wanted_sigma_px = 0.006, .noise = WhiteNoise(2)};
  const int side = CheckSpeckle(image, options).subset_for_wanted_px;
  ASSERT_GT(side, 9);
  EXPECT_EQ(side % 2, 1);
  options.step_px = 16;
  options.subset_px = side;
  EXPECT_LT(CheckSpeckle(image, options).sigma95_px, 1.1 * 0.006);
  options.subset_px = side - 4;
  EXPECT_GT(CheckSpeckle(image, options).sigma95_px, 0.95 * 0.006);

  options.wanted_sigma_px = 1e-5;
  const SpeckleCheck none = CheckSpeckle(image, options);
  EXPECT_EQ(none.subset_for_wanted_px, 0);
  EXPECT_THAT(none.advice, Contains(HasSubstr("no subset up to 151 px")));
}

TEST(SpeckleCheck, NamesWeakRegions) {
  GrayImage image = RenderSpeckle({400, 300}, kAtRest, 1, 1);
  testing::SpecklePattern noise({.pattern_seed = 9});
  for (int y = 180; y < 290; ++y) {
    for (int x = 280; x < 390; ++x) {
      image.grey(y, x) = static_cast<std::uint16_t>(
          120 + (testing::SpecklePattern::Hash(static_cast<std::uint64_t>(1000 * y + x)) & 1));
    }
  }
  const SpeckleCheck check = CheckSpeckle(image, {.noise = WhiteNoise(1)});
  ASSERT_FALSE(check.weak.empty());
  EXPECT_EQ(check.weak[0].where, "the lower right");
  EXPECT_TRUE(std::isnan(check.weak[0].sigma_px) || check.weak[0].sigma_px > check.median_sigma_px);
  EXPECT_NEAR(check.weak[0].x, 280, 35);
  EXPECT_NEAR(check.weak[0].y + check.weak[0].height, 290, 35);
  EXPECT_LT(check.measurable_pois, static_cast<std::int64_t>(check.pois.size()));
}

TEST(SpeckleCheck, NoiseAloneIsNoTexture) {
  GrayImage image = RenderSpeckle({200, 200}, kAtRest, 3, 1, {.contrast = 0});
  const SpeckleCheck check = CheckSpeckle(image);
  EXPECT_NEAR(std::sqrt(check.noise.offset_grey2), 3, 0.2);
  EXPECT_EQ(check.measurable_pois, 0);
  EXPECT_TRUE(std::isnan(check.median_sigma_px));
  EXPECT_EQ(check.subset_for_wanted_px, 0);
  EXPECT_THAT(check.advice, ::testing::ElementsAre(HasSubstr("no texture above the noise")));
}

TEST(SpeckleCheck, AMaskLeavesTheRestAndCutsSubsets) {
  const GrayImage image = RenderSpeckle({200, 200}, kAtRest, 1, 1);
  Image<std::uint8_t> mask(image.size(), 0);
  for (int y = 0; y < 200; ++y) {
    for (int x = 0; x < 100; ++x) mask(y, x) = 255;
  }
  const SpeckleCheck half = CheckSpeckle(image, {.noise = WhiteNoise(1)}, mask);
  const SpeckleCheck whole = CheckSpeckle(image, {.noise = WhiteNoise(1)});
  EXPECT_EQ(half.pixels, 20000);
  EXPECT_NEAR(half.feature_px, whole.feature_px, 0.5);
  std::int64_t masked = 0;
  for (const SpecklePoi& poi : half.pois) {
    if (poi.centre_px.x() >= 100) {
      EXPECT_EQ(poi.status, Status::kMasked);
    }
    if (poi.status == Status::kMasked) ++masked;
    EXPECT_EQ(std::isnan(poi.sigma_px), poi.status != Status::kOk);
  }
  EXPECT_GT(masked, 0);
  EXPECT_GT(half.sigma95_px, whole.sigma95_px);  // subsets at the mask's edge are cut
}

std::string Refusal(const GrayImage& image, const Image<std::uint8_t>& mask = {}) {
  try {
    CheckSpeckle(image, {}, mask);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(SpeckleCheck, RefusesWhatTellsNothing) {
  const auto flat = [](int grey, ImageSize size) {
    return GrayImage{Image<std::uint16_t>(size, static_cast<std::uint16_t>(grey)), 8};
  };
  EXPECT_THAT(Refusal(flat(77, {90, 90})), HasSubstr("all pixels have the grey level 77."));
  EXPECT_THAT(Refusal(flat(255, {90, 90})), HasSubstr("white"));
  EXPECT_THAT(Refusal(flat(0, {90, 90})), HasSubstr("black"));
  EXPECT_THAT(Refusal(flat(9, {5, 5})), HasSubstr("5x5 px is smaller than the subset"));
  EXPECT_THAT(Refusal({}), HasSubstr("smaller"));
  const GrayImage image = RenderSpeckle({90, 90}, kAtRest, 1, 1);
  EXPECT_THAT(Refusal(image, Image<std::uint8_t>(image.size(), 0)), HasSubstr("no pixel"));
  EXPECT_THAT(Refusal(image, Image<std::uint8_t>({5, 5}, 1)), HasSubstr("5x5"));
  Image<std::uint8_t> dot(image.size(), 0);
  dot(3, 3) = dot(3, 4) = 1;
  EXPECT_THAT(Refusal(image, dot), HasSubstr("No subset"));
  // The smallest that can be looked at, and a picture that is white but for a speck: no crash.
  const SpeckleCheck tiny = CheckSpeckle(RenderSpeckle({5, 5}, kAtRest, 1, 1), {.subset_px = 5});
  EXPECT_TRUE(std::isnan(tiny.feature_px));
  GrayImage white = flat(255, {90, 90});
  white.grey(45, 45) = 254;
  EXPECT_EQ(CheckSpeckle(white).measurable_pois, 0);
  EXPECT_THROW(CheckSpeckle(image, {.subset_px = 32}), UsageError);
  EXPECT_THROW(CheckSpeckle(image, {.wanted_sigma_px = 0}), UsageError);
}

}  // namespace
}  // namespace plumbline
