// Random error, its claim, and bias of the correlator on rendered translations, against the full
// Cramer-Rao bound (all shape terms, offset and gain unknown, rounding counted). The long runs
// print the tables of docs/correlation.md.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "match/subset_correlator.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {

using testing::RenderedSpeckleOptions;
using testing::RenderSpeckle;
using testing::SpeckleKind;

RenderedSpeckleOptions Speckle(SpeckleKind kind, int bits) {
  RenderedSpeckleOptions options;
  options.kind = kind;
  options.edge_sigma_px = 0.6;
  options.bits = bits;
  return options;
}

GrayImage Shifted(int side, const Eigen::Vector2d& shift, double noise, std::uint32_t seed,
                  const RenderedSpeckleOptions& speckle) {
  return RenderSpeckle(
      {side, side}, [&](const Eigen::Vector2d& p) { return Eigen::Vector2d(p - shift); }, noise,
      seed, speckle);
}

// Sums of both components' errors over subsets that share no pixel.
struct Errors {
  double n = 0, squares = 0, claimed = 0, bound = 0;
  Eigen::Vector2d sum{0, 0};
  int lost = 0;
};

template <typename Visit>
void ForEachSubset(int side, int subset, const Visit& visit) {
  const int margin = subset / 2 + 4;
  for (int y = margin; y < side - margin; y += subset) {
    for (int x = margin; x < side - margin; x += subset) visit(Eigen::Vector2i(x, y));
  }
}

struct Case {
  SpeckleKind kind;
  double noise;
  int subset, order;
};

// The bound of each subset from the gradients of the image without noise.
double BoundOf(const Case& c, int side) {
  const GrayImage clean = Shifted(side, {0, 0}, 0, 1, Speckle(c.kind, 14));
  CorrelationImageOptions plain;
  plain.prefilter = Prefilter::kNone;
  const CorrelationImage image(clean, plain);
  CorrelatorOptions options;
  options.subset_px = c.subset;
  options.order = c.order;
  // In levels of 14 bits, whose own rounding the correlator counts too.
  options.noise = NoiseModel{
      (c.noise * c.noise + kRoundingVarianceGrey2) * 64 * 64 - kRoundingVarianceGrey2, 0};
  const SubsetCorrelator correlator(image, options);
  double sum = 0;
  double n = 0;
  ForEachSubset(side, c.subset, [&](const Eigen::Vector2i& at) {
    sum += correlator.Match(image, at, SubsetWarp()).cov_displacement_px2.trace();
    n += 2;
  });
  return sum / n;
}

struct Outcome {
  double deviation = 0, over_bound = 0, claimed_known = 0, claimed_estimated = 0;
  int lost = 0;
};

Outcome Run(const Case& c, int side, int shifts) {
  Errors known, estimated;
  CorrelatorOptions options;
  options.subset_px = c.subset;
  options.order = c.order;
  double mean_squares = 0;
  for (int s = 0; s < shifts; ++s) {
    const Eigen::Vector2d shift((s + 0.5) / shifts, std::fmod(0.37 * s + 0.2, 1.0));
    const auto seed = static_cast<std::uint32_t>(10 * s);
    const CorrelationImage a(Shifted(side, {0, 0}, c.noise, 100 + seed, Speckle(c.kind, 8)));
    const CorrelationImage b(Shifted(side, shift, c.noise, 101 + seed, Speckle(c.kind, 8)));
    for (const bool know : {true, false}) {
      options.noise.reset();
      if (know) options.noise = NoiseModel{c.noise * c.noise, 0};
      Errors& errors = know ? known : estimated;
      const SubsetCorrelator correlator(a, options);
      Eigen::Vector2d sum(0, 0);
      double n = 0;
      ForEachSubset(side, c.subset, [&](const Eigen::Vector2i& at) {
        const SubsetMatch match =
            correlator.Match(b, at, SubsetWarp::Of(shift.array().round().matrix()));
        if (match.status != Status::kOk) {
          ++errors.lost;
          return;
        }
        const Eigen::Vector2d error = match.warp.displacement_px() - shift;
        errors.squares += error.squaredNorm();
        errors.claimed += match.cov_displacement_px2.trace();
        errors.n += 2;
        sum += error;
        n += 1;
      });
      if (know) mean_squares += sum.squaredNorm() / n;
    }
  }
  Outcome outcome;
  outcome.deviation = std::sqrt((known.squares - mean_squares) / (known.n - 2 * shifts));
  outcome.over_bound = outcome.deviation / std::sqrt(BoundOf(c, side));
  outcome.claimed_known = std::sqrt(known.claimed / known.n) / outcome.deviation;
  outcome.claimed_estimated = std::sqrt(estimated.claimed / estimated.n) / outcome.deviation;
  outcome.lost = known.lost + estimated.lost;
  return outcome;
}

const char* Name(SpeckleKind kind) { return kind == SpeckleKind::kSoftBlobs ? "soft" : "sharp"; }

void ExpectAtTheBound(const Case& c, int side, int shifts, double margin) {
  const Outcome o = Run(c, side, shifts);
  std::printf("| %s | %g | %d | %d | %.5f | %.3f | %.3f | %.3f |\n", Name(c.kind), c.noise,
              c.subset, c.order, o.deviation, o.over_bound, o.claimed_known, o.claimed_estimated);
  EXPECT_EQ(o.lost, 0);
  EXPECT_LT(o.over_bound, 1.05 + margin);
  EXPECT_GT(o.over_bound, 0.95 - margin);
  EXPECT_NEAR(o.claimed_known, 1, 0.05 + margin);
  EXPECT_NEAR(o.claimed_estimated, 1, 0.06 + margin);
}

// margin: three standard deviations of what so few subsets can tell.
TEST(NoiseLimit, RandomErrorAndItsClaimAreAtTheBound) {
  ExpectAtTheBound({SpeckleKind::kSoftBlobs, 2, 33, 1}, 500, 2, 0.06);
  ExpectAtTheBound({SpeckleKind::kSharpDiscs, 2, 21, 2}, 400, 2, 0.06);
  ExpectAtTheBound({SpeckleKind::kSoftBlobs, 1, 21, 1}, 400, 2, 0.06);
}

TEST(NoiseLimit, ProveRandomErrorAndItsClaimAtTheBound) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  std::printf(
      "| speckle | noise | subset | order | std px | of bound | claimed, known | estimated |\n");
  for (const SpeckleKind kind : {SpeckleKind::kSoftBlobs, SpeckleKind::kSharpDiscs}) {
    for (const double noise : {1.0, 2.0}) {
      for (const int subset : {21, 33, 41}) {
        for (const int order : {1, 2})
          ExpectAtTheBound({kind, noise, subset, order}, 1000, 8, 0.01);
      }
    }
  }
}

// The largest mean error over sub-pixel shifts along x, either component. Noise comes in pairs of
// opposite sign, so that its linear part cancels and what it adds to the mean remains.
double LargestBias(SpeckleKind kind, const CorrelationImageOptions& image, double noise, int side,
                   int shifts) {
  CorrelatorOptions options;
  const int bits = noise > 0 ? 8 : 14;
  double largest = 0;
  for (int s = 0; s < shifts; ++s) {
    const Eigen::Vector2d shift(static_cast<double>(s) / shifts, std::fmod(0.37 * s, 1.0));
    Eigen::Vector2d sum(0, 0);
    double n = 0;
    for (const double sign : {1.0, -1.0}) {
      if (noise == 0 && sign < 0) continue;
      const auto seed = static_cast<std::uint32_t>(10 * s);
      const CorrelationImage a(Shifted(side, {0, 0}, sign * noise, 7 + seed, Speckle(kind, bits)),
                               image);
      const CorrelationImage b(Shifted(side, shift, sign * noise, 8 + seed, Speckle(kind, bits)),
                               image);
      const SubsetCorrelator correlator(a, options);
      ForEachSubset(side, 17, [&](const Eigen::Vector2i& at) {
        const SubsetMatch match =
            correlator.Match(b, at, SubsetWarp::Of(shift.array().round().matrix()));
        if (match.status != Status::kOk) return;
        sum += match.warp.displacement_px() - shift;
        n += 1;
      });
    }
    largest = std::max(largest, (sum / n).cwiseAbs().maxCoeff());
  }
  return largest;
}

TEST(NoiseLimit, InterpolationBiasIsBelowTwoTenThousandthsOfAPixel) {
  for (const SpeckleKind kind : {SpeckleKind::kSoftBlobs, SpeckleKind::kSharpDiscs}) {
    EXPECT_LT(LargestBias(kind, {}, 0, 300, 4), 2e-4) << Name(kind);
  }
}

TEST(NoiseLimit, ProveBiasOfEverySetting) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  std::printf(
      "| interpolation | pre-filter | soft, noise 0 | noise 2 | sharp, noise 0 | noise 2 |\n");
  struct Setting {
    const char* name;
    CorrelationImageOptions image;
  };
  const Setting settings[] = {
      {"quintic | low-pass", {}},
      {"quintic | none", {Interpolation::kQuintic, Prefilter::kNone}},
      {"quintic | Gaussian 0.6", {Interpolation::kQuintic, Prefilter::kGaussian, 0.6}},
      {"quintic | Gaussian 0.8", {Interpolation::kQuintic, Prefilter::kGaussian, 0.8}},
      {"cubic | low-pass", {Interpolation::kCubic, Prefilter::kLowPass}},
      {"cubic | none", {Interpolation::kCubic, Prefilter::kNone}},
  };
  for (const Setting& setting : settings) {
    double bias[4];
    int i = 0;
    for (const SpeckleKind kind : {SpeckleKind::kSoftBlobs, SpeckleKind::kSharpDiscs}) {
      for (const double noise : {0.0, 2.0}) {
        bias[i++] = LargestBias(kind, setting.image, noise, 600, 10);
      }
    }
    std::printf("| %s | %.1e | %.1e | %.1e | %.1e |\n", setting.name, bias[0], bias[1], bias[2],
                bias[3]);
    if (&setting == settings) {  // the default
      EXPECT_LT(bias[0], 2e-4);
      EXPECT_LT(bias[1], 5e-4);
      EXPECT_LT(bias[2], 2e-4);
      EXPECT_LT(bias[3], 5e-4);
    }
  }
}

}  // namespace
}  // namespace plumbline
