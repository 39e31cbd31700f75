#include "match/subset_correlator.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "calib/error.h"
#include "match/internal/normal_equations.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {

using testing::RenderedSpeckleOptions;
using testing::RenderSpeckle;

constexpr ImageSize kSize{160, 140};
const Eigen::Vector2i kCentre(80, 70);

// Rounding to 8 bits alone is worth 0.003 px at order 2: accuracy is tested with 12.
const RenderedSpeckleOptions kFine{.bits = 12};

// The material point that is seen at a pixel after the view moved by `warp`, told from kCentre.
Eigen::Vector2d Undone(const SubsetWarp& warp, const Eigen::Vector2d& pixel) {
  Eigen::Vector2d x = pixel - kCentre.cast<double>();
  const Eigen::Vector2d to = x;
  Eigen::Matrix2d affine = Eigen::Matrix2d::Identity() + warp.gradient();
  const Eigen::Matrix2d back = affine.inverse();
  for (int i = 0; i < 30; ++i) x -= back * (warp.Apply(x) - to);
  return kCentre.cast<double>() + x;
}

GrayImage Reference(double noise = 0, const RenderedSpeckleOptions& options = {}) {
  return RenderSpeckle(
      kSize, [](const Eigen::Vector2d& p) { return p; }, noise, 1, options);
}

GrayImage Deformed(const SubsetWarp& warp, double noise = 0,
                   const RenderedSpeckleOptions& options = {}) {
  return RenderSpeckle(
      kSize, [&](const Eigen::Vector2d& p) { return Undone(warp, p); }, noise, 2, options);
}

SubsetMatch MatchAtCentre(const GrayImage& reference, const GrayImage& deformed,
                          const CorrelatorOptions& options, const SubsetWarp& start = {}) {
  const CorrelationImage f(reference), g(deformed);
  return SubsetCorrelator(f, options).Match(g, kCentre, start);
}

CorrelatorOptions Options(int subset_px, int order, SubsetShape shape = SubsetShape::kSquare) {
  CorrelatorOptions options;
  options.subset_px = subset_px;
  options.order = order;
  options.shape = shape;
  return options;
}

SubsetWarp Quadratic() {
  SubsetWarp warp =
      SubsetWarp::Of({0.3, -0.6}, (Eigen::Matrix2d() << 0.03, -0.02, 0.01, -0.04).finished());
  warp.c.rightCols<3>() << 1e-3, -6e-4, 5e-4, -4e-4, 9e-4, -7e-4;
  return warp;
}

void ExpectNothingButTheStatus(const SubsetMatch& match, Status status) {
  EXPECT_EQ(Name(match.status), Name(status));
  // Where the search left the image is told, for the points beyond.
  EXPECT_TRUE(status == Status::kOutsideImage || match.warp.c.array().isNaN().all());
  EXPECT_TRUE(match.cov_displacement_px2.array().isNaN().all());
  EXPECT_TRUE(match.cov_gradient.array().isNaN().all());
  EXPECT_TRUE(std::isnan(match.noise_grey));
}

TEST(SubsetCorrelator, FindsTranslations) {
  for (const auto shape : {SubsetShape::kSquare, SubsetShape::kCircle}) {
    for (const int order : {0, 1, 2}) {
      for (const Eigen::Vector2d& u : {Eigen::Vector2d(0, 0), Eigen::Vector2d(0.25, -0.4),
                                       Eigen::Vector2d(-0.5, 0.9), Eigen::Vector2d(1.3, 1.1)}) {
        const SubsetMatch match = MatchAtCentre(
            Reference(0, kFine), Deformed(SubsetWarp::Of(u), 0, kFine), Options(31, order, shape));
        ASSERT_EQ(match.status, Status::kOk) << order;
        EXPECT_LT((match.warp.displacement_px() - u).norm(), 2e-3) << order << u.transpose();
        EXPECT_GT(match.zncc, 0.999);
      }
    }
  }
}

// It stops by what it foresees: a search that goes on must find nothing further away.
TEST(SubsetCorrelator, StopsWhereAFurtherStepWouldBeShort) {
  const SubsetWarp truth =
      SubsetWarp::Of({0.35, -0.45}, (Eigen::Matrix2d() << 0.01, -0.02, 0.02, 0.005).finished());
  const Eigen::Matrix2d slant = (Eigen::Matrix2d() << 4e-4, -2e-4, 3e-4, 1e-4).finished();
  for (const double noise : {0.0, 1.5, 6.0}) {
    const GrayImage reference = Reference(noise, kFine), deformed = Deformed(truth, noise, kFine);
    for (const double off : {0.005, 0.02, 0.05, 0.15}) {
      SubsetWarp start = truth;
      start.c.col(0) += Eigen::Vector2d(off, -0.7 * off);
      start.c.block<2, 2>(0, 1) += slant * off / 0.02;
      CorrelatorOptions options = Options(31, 1);
      const SubsetMatch match = MatchAtCentre(reference, deformed, options, start);
      options.stop_px = 1e-6;
      const SubsetMatch end = MatchAtCentre(reference, deformed, options, start);
      ASSERT_EQ(match.status, Status::kOk);
      ASSERT_EQ(end.status, Status::kOk);
      SubsetWarp rest;
      rest.c = match.warp.c - end.warp.c;
      const double left =
          std::sqrt(internal::NormalEquations::MeanSquareShift(rest, options.radius_px()));
      EXPECT_LT(left, 1.1e-3) << noise << " " << off;
      EXPECT_LE(match.iterations, end.iterations);
      EXPECT_NEAR(match.noise_grey, end.noise_grey, 0.01 * end.noise_grey);
      EXPECT_NEAR(match.zncc, end.zncc, 1e-5);
      EXPECT_NEAR(match.cov_displacement_px2(0, 0), end.cov_displacement_px2(0, 0),
                  0.02 * end.cov_displacement_px2(0, 0));
    }
  }
}

TEST(SubsetCorrelator, TakesOneLookFromACloseStart) {
  const GrayImage reference = Reference(1.5), deformed = Deformed(SubsetWarp::Of({0.3, 0.2}), 1.5);
  EXPECT_EQ(
      MatchAtCentre(reference, deformed, Options(31, 1), SubsetWarp::Of({0.31, 0.19})).iterations,
      1);
}

TEST(SubsetCorrelator, FindsAffineWarps) {
  const Eigen::Matrix2d turned = Eigen::Rotation2Dd(0.1).toRotationMatrix();
  Eigen::Matrix2d stretched = turned;
  stretched.row(0) *= 1.1;
  for (const Eigen::Matrix2d& to : {turned, stretched}) {
    const SubsetWarp truth = SubsetWarp::Of({0.7, -0.2}, to - Eigen::Matrix2d::Identity());
    for (const int order : {1, 2}) {
      const SubsetMatch match =
          MatchAtCentre(Reference(0, kFine), Deformed(truth, 0, kFine), Options(31, order));
      ASSERT_EQ(match.status, Status::kOk);
      EXPECT_LT((match.warp.displacement_px() - truth.displacement_px()).norm(), 3e-3);
      EXPECT_LT((match.warp.gradient() - truth.gradient()).norm(), 5e-4);
    }
  }
}

TEST(SubsetCorrelator, FindsLargeRotationAndStrainFromACloseStart) {
  Eigen::Matrix2d to = Eigen::Rotation2Dd(std::numbers::pi / 6).toRotationMatrix();
  to.row(0) *= 1.2;
  const SubsetWarp truth = SubsetWarp::Of({4.3, -2.6}, to - Eigen::Matrix2d::Identity());
  SubsetWarp start = truth;
  start.c.col(0) += Eigen::Vector2d(0.8, -0.8);
  start.c.block<2, 2>(0, 1) += 0.06 * Eigen::Matrix2d::Ones();
  const SubsetMatch match =
      MatchAtCentre(Reference(0, kFine), Deformed(truth, 0, kFine), Options(33, 1), start);
  ASSERT_EQ(match.status, Status::kOk);
  EXPECT_LT((match.warp.displacement_px() - truth.displacement_px()).norm(), 3e-3);
  EXPECT_LT((match.warp.gradient() - truth.gradient()).norm(), 5e-4);
}

TEST(SubsetCorrelator, FindsQuadraticWarps) {
  const SubsetWarp truth = Quadratic();
  for (const auto shape : {SubsetShape::kSquare, SubsetShape::kCircle}) {
    const SubsetMatch match =
        MatchAtCentre(Reference(0, kFine), Deformed(truth, 0, kFine), Options(41, 2, shape));
    ASSERT_EQ(match.status, Status::kOk);
    EXPECT_LT((match.warp.displacement_px() - truth.displacement_px()).norm(), 4e-3);
    EXPECT_LT((match.warp.gradient() - truth.gradient()).norm(), 1e-3);
    EXPECT_LT((match.warp.c - truth.c).rightCols<3>().cwiseAbs().maxCoeff(), 5e-5);
  }
}

TEST(SubsetCorrelator, DoesNotMindGainAndOffset) {
  const SubsetWarp truth = SubsetWarp::Of({0.37, -0.21});
  RenderedSpeckleOptions dimmed;
  dimmed.contrast = 0.7;
  dimmed.mean_grey = 0.7 * 120 + 20;
  const SubsetMatch same = MatchAtCentre(Reference(), Deformed(truth), Options(31, 1));
  const SubsetMatch dim = MatchAtCentre(Reference(), Deformed(truth, 0, dimmed), Options(31, 1));
  ASSERT_EQ(dim.status, Status::kOk);
  EXPECT_LT((dim.warp.displacement_px() - same.warp.displacement_px()).norm(), 2e-3);
  EXPECT_GT(dim.zncc, 0.999);
}

// Soft speckle on a ground near black: the spline falls below 0 there.
TEST(SubsetCorrelator, DoesNotLoseDarkPixels) {
  RenderedSpeckleOptions dark;
  dark.kind = testing::SpeckleKind::kSharpDiscs;
  dark.mean_grey = 75;  // discs near 0
  dark.contrast = 0.93;
  dark.edge_sigma_px = 0.53;
  const GrayImage reference = Reference(0, dark);
  const CorrelationImage prepared(reference);
  int dark_pixels = 0;
  for (const float value : prepared.grey().values()) dark_pixels += value < 2 ? 1 : 0;
  ASSERT_GT(dark_pixels, 1000);
  const Eigen::Vector2d u(0.4, -0.3);
  const SubsetMatch match =
      MatchAtCentre(reference, Deformed(SubsetWarp::Of(u), 0, dark), Options(31, 1));
  ASSERT_EQ(match.status, Status::kOk);
  EXPECT_LT((match.warp.displacement_px() - u).norm(), 4e-3);
}

TEST(SubsetCorrelator, UsesWhatTheMaskLeaves) {
  const SubsetWarp moved = SubsetWarp::Of({0.6, 0.2});
  const GrayImage specimen = Deformed(moved);
  GrayImage deformed = Reference();  // at rest on the right
  for (int y = 0; y < kSize.height; ++y) {
    for (int x = 0; x < kCentre.x() + 5; ++x) deformed.grey(y, x) = specimen.grey(y, x);
  }
  Image<std::uint8_t> mask(kSize, 0);
  for (int y = 0; y < kSize.height; ++y)
    std::fill(mask.row(y), mask.row(y) + kCentre.x() + 3, std::uint8_t{255});
  const CorrelationImage f(Reference()), g(deformed);
  const SubsetMatch with = SubsetCorrelator(f, Options(31, 1), &mask).Match(g, kCentre, {});
  const SubsetMatch without = SubsetCorrelator(f, Options(31, 1)).Match(g, kCentre, {});
  ASSERT_EQ(with.status, Status::kOk);
  EXPECT_LT((with.warp.displacement_px() - moved.displacement_px()).norm(), 0.02);
  EXPECT_FALSE(without.status == Status::kOk &&
               (without.warp.displacement_px() - moved.displacement_px()).norm() < 0.05);
}

TEST(SubsetCorrelator, MatchesRememberedSubsetsToTheSameBits) {
  const CorrelationImage f(Reference(1)), g(Deformed(SubsetWarp::Of({0.3, -0.4}), 1));
  Image<std::uint8_t> mask(kSize, 1);
  for (int y = 0; y < kSize.height; ++y) std::fill_n(mask.row(y), kCentre.x() - 6, std::uint8_t{0});
  for (const int order : {0, 1, 2}) {
    const SubsetCorrelator plain(f, Options(31, order), &mask);
    SubsetCorrelator remembering(f, Options(31, order), &mask);
    // Whole, cut by the mask, cut by the image, in the mask, off the image.
    const std::vector<Eigen::Vector2i> pixels = {kCentre,
                                                 kCentre + Eigen::Vector2i(25, 3),
                                                 {kSize.width - 6, kCentre.y()},
                                                 {3, kCentre.y()},
                                                 {-4, 5}};
    remembering.Remember(pixels);
    for (const Eigen::Vector2i& pixel : pixels) {
      const SubsetMatch a = plain.Match(g, pixel, {}), b = remembering.Match(g, pixel, {});
      EXPECT_EQ(a.status, b.status);
      EXPECT_EQ(a.iterations, b.iterations);
      if (a.status != Status::kOk) continue;
      EXPECT_EQ(a.warp.c, b.warp.c);
      EXPECT_EQ(a.zncc, b.zncc);
      EXPECT_EQ(a.cov_displacement_px2, b.cov_displacement_px2);
      if (order > 0) {
        EXPECT_EQ(a.cov_gradient, b.cov_gradient);
      }
    }
    EXPECT_EQ(plain.Match(g, pixels[1], {}).status, Status::kOk);
  }
}

TEST(SubsetCorrelator, TellsWhatIsMasked) {
  Image<std::uint8_t> mask(kSize, 1);
  for (int y = 0; y < kSize.height; ++y)
    std::fill(mask.row(y), mask.row(y) + kCentre.x(), std::uint8_t{0});
  const CorrelationImage f(Reference()), g(Reference());
  const SubsetCorrelator correlator(f, Options(31, 1), &mask);
  ExpectNothingButTheStatus(correlator.Match(g, kCentre - Eigen::Vector2i(1, 0), {}),
                            Status::kMasked);
  EXPECT_EQ(correlator.Match(g, kCentre, {}).status, Status::kOk);  // 16 of 31 columns
  CorrelatorOptions most = Options(31, 1);
  most.min_pixel_share = 0.7;
  ExpectNothingButTheStatus(SubsetCorrelator(f, most, &mask).Match(g, kCentre, {}),
                            Status::kMasked);
}

TEST(SubsetCorrelator, MatchesSubsetsCutByTheBorder) {
  const Eigen::Vector2d u(1.4, 0.8);
  const CorrelationImage f(Reference(0, kFine)), g(Deformed(SubsetWarp::Of(u), 0, kFine));
  const CorrelationImage shot(Reference(1)), still(Reference(1.01));
  const SubsetCorrelator correlator(f, Options(31, 1)), of_still(shot, Options(31, 1));
  for (const Eigen::Vector2i& at :
       {Eigen::Vector2i(0, 70), Eigen::Vector2i(15, 70), Eigen::Vector2i(80, 5),
        Eigen::Vector2i(6, 9), Eigen::Vector2i(12, 12)}) {
    const SubsetMatch match = correlator.Match(g, at, {});
    ASSERT_EQ(Name(match.status), Name(Status::kOk)) << at.transpose();
    EXPECT_LT((match.warp.displacement_px() - u).norm(), 5e-3) << at.transpose();
    // A view at rest is not lost at its border, whichever way the noise pushes.
    EXPECT_EQ(Name(of_still.Match(still, at, {}).status), Name(Status::kOk)) << at.transpose();
  }
  // What has left the image has no match, nor what is too little of a subset.
  ExpectNothingButTheStatus(correlator.Match(g, {159, 70}, {}), Status::kOutsideImage);
  ExpectNothingButTheStatus(correlator.Match(g, {1, 1}, {}), Status::kOutsideImage);
  ExpectNothingButTheStatus(correlator.Match(g, {-1, 70}, {}), Status::kOutsideImage);
  ExpectNothingButTheStatus(correlator.Match(g, {80, 140}, {}), Status::kOutsideImage);
  ExpectNothingButTheStatus(correlator.Match(g, kCentre, SubsetWarp::Of({90, 0})),
                            Status::kOutsideImage);
  ExpectNothingButTheStatus(correlator.Match(g, kCentre, SubsetWarp::Of({1e9, 0})),
                            Status::kOutsideImage);
}

TEST(SubsetCorrelator, ReportsStartsThatAreNone) {
  const CorrelationImage f(Reference());
  const SubsetCorrelator correlator(f, Options(31, 1));
  ExpectNothingButTheStatus(correlator.Match(f, kCentre, SubsetWarp::Of({std::nan(""), 0})),
                            Status::kNotConverged);
  SubsetWarp folded = SubsetWarp::Of({0, 0}, (Eigen::Matrix2d() << -2, 0, 0, 0).finished());
  ExpectNothingButTheStatus(correlator.Match(f, kCentre, folded), Status::kNotConverged);
}

GrayImage Flat(std::uint16_t level) { return {Image<std::uint16_t>(kSize, level), 8}; }

TEST(SubsetCorrelator, ReportsImagesWithoutTexture) {
  for (const auto level : {std::uint16_t{0}, std::uint16_t{128}, std::uint16_t{255}}) {
    for (const int order : {0, 1, 2}) {
      ExpectNothingButTheStatus(MatchAtCentre(Flat(level), Flat(level), Options(31, order)),
                                Status::kLowTexture);
      ExpectNothingButTheStatus(MatchAtCentre(Flat(level), Reference(2), Options(31, order)),
                                Status::kLowTexture);
      const SubsetMatch lost = MatchAtCentre(Reference(2), Flat(level), Options(31, order));
      EXPECT_TRUE(lost.status == Status::kLowCorrelation || lost.status == Status::kNotConverged);
      EXPECT_TRUE(lost.warp.c.array().isNaN().all());
    }
  }
  RenderedSpeckleOptions faint;  // noise alone
  faint.contrast = 0;
  const SubsetMatch noise =
      MatchAtCentre(Reference(2, faint), Deformed({}, 2, faint), Options(31, 1));
  EXPECT_NE(noise.status, Status::kOk);
}

TEST(SubsetCorrelator, DoesNotMatchAnUnrelatedSpeckle) {
  RenderedSpeckleOptions other;
  other.pattern_seed = 99;
  const CorrelationImage f(Reference(1)), g(Reference(1, other));
  const SubsetCorrelator correlator(f, Options(31, 1));
  for (int y = 20; y < 120; y += 10) {
    for (int x = 20; x < 140; x += 10) {
      const SubsetMatch match = correlator.Match(g, {x, y}, {});
      EXPECT_NE(match.status, Status::kOk) << match.zncc;
    }
  }
}

// How far off a start may be. Speckle of 4 px: half of it is a pixel or two.
TEST(SubsetCorrelator, ConvergesFromAFewPixelsOff) {
  const CorrelationImage f(Reference(1)), g(Deformed(SubsetWarp::Of({0.3, 0.2}), 1));
  for (const int order : {1, 2}) {
    const SubsetCorrelator correlator(f, Options(33, order));
    for (const double off : {1.0, 1.5, 2.0, 2.5, 3.0}) {
      int found = 0, wrong = 0, count = 0;
      for (int y = 30; y < 110; y += 13) {
        for (int x = 30; x < 130; x += 13) {
          for (int k = 0; k < 4; ++k, ++count) {
            const double angle = 0.4 + k * std::numbers::pi / 2;
            const SubsetMatch match = correlator.Match(
                g, {x, y},
                SubsetWarp::Of(off * Eigen::Vector2d(std::cos(angle), std::sin(angle)) +
                               Eigen::Vector2d(0.3, 0.2)));
            if (match.status != Status::kOk) continue;
            const bool right =
                (match.warp.displacement_px() - Eigen::Vector2d(0.3, 0.2)).norm() < 0.1;
            (right ? found : wrong) += 1;
          }
        }
      }
      EXPECT_GE(found, count * 97 / 100) << order << ' ' << off;
      EXPECT_EQ(wrong, 0) << order << ' ' << off;
    }
  }
}

TEST(SubsetCorrelator, ZnccIsOneAtTheRightPlaceOnly) {
  const SubsetWarp truth = SubsetWarp::Of({0.3, 0.2});
  const CorrelationImage f(Reference()), g(Deformed(truth));
  const SubsetCorrelator correlator(f, Options(33, 1));
  EXPECT_GT(correlator.Zncc(g, kCentre, truth), 0.999);
  EXPECT_LT(correlator.Zncc(g, kCentre, SubsetWarp::Of({5, -4})), 0.5);
  EXPECT_TRUE(std::isnan(correlator.Zncc(g, kCentre, SubsetWarp::Of({500, 0}))));
  EXPECT_NEAR(correlator.Zncc(g, kCentre, truth), correlator.Match(g, kCentre, truth).zncc, 1e-5);
}

TEST(SubsetCorrelator, SigmaFollowsTheNoiseToldOrSeen) {
  const GrayImage reference = Reference(2);
  const CorrelationImage f(reference), g(Deformed(SubsetWarp::Of({0.3, 0.2}), 2));
  CorrelatorOptions options = Options(33, 1);
  const SubsetMatch seen = SubsetCorrelator(f, options).Match(g, kCentre, {});
  EXPECT_NEAR(seen.noise_grey, std::sqrt(4 + 1 / 12.0), 0.2);
  options.noise.emplace();
  options.noise->offset_grey2 = 4;
  options.noise->slope_grey = 0;
  const SubsetMatch told = SubsetCorrelator(f, options).Match(g, kCentre, {});
  EXPECT_NEAR(told.noise_grey, std::sqrt(4 + 1 / 12.0), 1e-3);
  EXPECT_NEAR(std::sqrt(seen.cov_displacement_px2(0, 0) / told.cov_displacement_px2(0, 0)),
              seen.noise_grey / told.noise_grey, 1e-3);
  EXPECT_TRUE(told.cov_gradient.allFinite());
  EXPECT_LT((told.cov_gradient - told.cov_gradient.transpose()).norm(), 1e-12);
}

TEST(SubsetCorrelator, RefusesWhatItCannotUse) {
  const CorrelationImage f(Reference());
  const CorrelationImage cubic(Reference(), {Interpolation::kCubic, Prefilter::kLowPass});
  const CorrelationImage raw(Reference(), {Interpolation::kQuintic, Prefilter::kNone});
  const SubsetCorrelator correlator(f, Options(31, 1));
  EXPECT_THROW(correlator.Match(cubic, kCentre, {}), std::invalid_argument);
  EXPECT_THROW(correlator.Match(raw, kCentre, {}), std::invalid_argument);
  EXPECT_THROW(SubsetCorrelator(f, Options(141, 1)), InputError);
  const Image<std::uint8_t> mask({10, 10}, 1);
  EXPECT_THROW(SubsetCorrelator(f, Options(31, 1), &mask), InputError);
  for (const auto& [subset, order] :
       {std::pair(30, 1), {3, 1}, {257, 1}, {31, 3}, {31, -1}, {7, 2}}) {
    EXPECT_THROW(Options(subset, order).Check(), UsageError) << subset << ' ' << order;
  }
  const auto refused = [](auto change) {
    CorrelatorOptions options;
    change(options);
    EXPECT_THROW(options.Check(), UsageError);
  };
  refused([](CorrelatorOptions& o) { o.max_iterations = 0; });
  refused([](CorrelatorOptions& o) { o.stop_px = 0; });
  refused([](CorrelatorOptions& o) { o.min_zncc = 1.1; });
  refused([](CorrelatorOptions& o) { o.max_sigma_px = std::nan(""); });
  refused([](CorrelatorOptions& o) { o.min_pixel_share = 0; });
}

}  // namespace
}  // namespace plumbline
