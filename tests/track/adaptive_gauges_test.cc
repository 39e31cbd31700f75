#include "track/adaptive_gauges.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <cstddef>
#include <string>

#include "calib/error.h"
#include "tests/support/subset_noise.h"
#include "tests/track/surfaces.h"

namespace plumbline {
namespace {

using testing::AddMatches;
using testing::AllOk;
using testing::GaugesOf;
using testing::InstantOf;
using testing::kStepPx;
using testing::kSubsetPx;
using testing::NormalDeviates;
using testing::OnLoadedSaddle;
using testing::OnSaddle;

constexpr ImageSize kSheet{50, 30};
constexpr float kSigmaPx = 0.003F;

// A sheet in which the stretch along columns goes from 0 to 2 % within 3 mm (6 points) about s = 0.
constexpr double kStretch = 0.02, kReachMm = 1.5;
Eigen::Vector3d OnSheet(double s, double t) { return {s, t, 400}; }
Eigen::Vector3d OnStretchedSheet(double s, double t) {
  const double stretched = 0.5 * kStretch * (s + kReachMm * std::log(std::cosh(s / kReachMm)));
  return {s + stretched, t, 400};
}
Eigen::Vector3d OnEvenSheet(double s, double t) { return {1.01 * s, 0.99 * t, 400}; }

// The left match moves points along x, the right one along z and y, by mm per px.
void AddNoise(SurfaceState& instant, NormalDeviates& draw) {
  Eigen::Matrix<float, 3, 2> left, right;
  left << 0.1F, 0, 0, 0.1F, 0, 0;
  right << 0, 0, 0, 0, 0.3F, 0;
  instant.d_left = Image<Eigen::Matrix<float, 3, 2>>(kSheet, left);
  instant.d_right = Image<Eigen::Matrix<float, 3, 2>>(kSheet, right);
  instant.share_left = instant.share_right = Image<float>(kSheet, 0);
  for (Eigen::Vector3d& point : instant.point_mm.values()) {
    for (const auto& D : {left, right})
      point += D.cast<double>() * (static_cast<double>(kSigmaPx) * Eigen::Vector2d(draw(), draw()));
  }
}

AdaptiveGaugesOptions Between(int smallest, int largest) {
  AdaptiveGaugesOptions options;
  options.gauge.order = 3;
  options.gauge.window_points = largest;
  options.smallest_window_points = smallest;
  return options;
}

// Subsets that do not overlap.
AdaptiveGauges GaugesOnSheet(const SurfaceState& reference, const AdaptiveGaugesOptions& options,
                             float claimed_px = kSigmaPx) {
  return {reference,
          Image<Eigen::Vector3f>(kSheet, {claimed_px * claimed_px, 0, claimed_px * claimed_px}),
          NeighbourCorrelation::OfOverlap(kSheet, 30, kSubsetPx, 1),
          kStepPx,
          kSubsetPx,
          options};
}

struct Errors {
  double squared = 0, window = 0, within = 0, count = 0;
  double rms() const { return std::sqrt(squared / count); }
};

// Of xx in columns first to last, over draws of the noise.
Errors ErrorsOf(const AdaptiveGaugesOptions& options, const testing::Surface& loaded, int first,
                int last) {
  Errors out;
  NormalDeviates draw(5);
  for (int i = 0; i < 6; ++i) {
    SurfaceState reference = InstantOf(kSheet, OnSheet), now = InstantOf(kSheet, loaded);
    AddNoise(reference, draw);
    AddNoise(now, draw);
    const AdaptiveStrain measured = GaugesOnSheet(reference, options).Strain(now, AllOk(kSheet));
    for (int r = 10; r < 20; ++r) {
      for (int c = first; c <= last; ++c) {
        if (measured.strain.status(r, c) != Status::kOk) continue;
        constexpr double kStepMm = 1e-3;
        const double s = testing::kMmPerPx * kStepPx * (c - kSheet.width / 2);
        const double stretch =
            (loaded(s + kStepMm, 0) - loaded(s - kStepMm, 0)).x() / (2 * kStepMm);
        const double error = measured.strain.strain(r, c)[0] - 0.5 * (stretch * stretch - 1);
        out.squared += error * error;
        out.count += 1;
        if (measured.window_points.empty()) continue;
        out.window += measured.window_points(r, c);
        const double sigma = std::hypot(std::sqrt(measured.strain.cov_strain(r, c)[0]),
                                        measured.sigma_model(r, c)[0]);
        out.within += std::abs(error) < 1.96 * sigma ? 1 : 0;
      }
    }
  }
  return out;
}

TEST(AdaptiveGauges, AreSmallWhereTheStrainVariesAndLargeWhereNot) {
  const AdaptiveGaugesOptions options = Between(5, 17);
  const Errors near = ErrorsOf(options, OnStretchedSheet, 21, 28);
  const Errors far = ErrorsOf(options, OnEvenSheet, 21, 28);
  EXPECT_LT(near.window / near.count, 11.0);
  EXPECT_GT(far.window / far.count, 12.0);
  // Better than either: the large gauge where it smooths, the small one where it is noisy.
  EXPECT_LT(near.rms(), 0.7 * ErrorsOf(Between(0, 17), OnStretchedSheet, 21, 28).rms());
  EXPECT_LT(far.rms(), 0.7 * ErrorsOf(Between(0, 5), OnEvenSheet, 21, 28).rms());
  RecordProperty("near", std::to_string(near.rms()));
  RecordProperty("far", std::to_string(far.rms()));
}

TEST(AdaptiveGauges, HaveSigmasThatHoldWhereTheStrainVariesAndWhereNot) {
  for (const auto& loaded : {testing::Surface(OnStretchedSheet), testing::Surface(OnEvenSheet)}) {
    const Errors errors = ErrorsOf(Between(5, 17), loaded, 15, 34);
    EXPECT_GT(errors.within / errors.count, 0.9);
    RecordProperty("within", std::to_string(errors.within / errors.count));
  }
}

TEST(AdaptiveGauges, HaveTheSameSizesWhateverNoiseIsClaimed) {
  NormalDeviates draw(7);
  SurfaceState reference = InstantOf(kSheet, OnSheet), now = InstantOf(kSheet, OnStretchedSheet);
  AddNoise(reference, draw);
  AddNoise(now, draw);
  const auto windows = [&](float claimed_px) {
    return GaugesOnSheet(reference, Between(5, 17), claimed_px)
        .Strain(now, AllOk(kSheet))
        .window_points;
  };
  const Image<float> right = windows(kSigmaPx), too_large = windows(2 * kSigmaPx);
  int counted = 0;
  for (std::size_t i = 0; i < right.pixel_count(); ++i) {
    if (std::isnan(right.data()[i])) continue;
    EXPECT_EQ(right.data()[i], too_large.data()[i]);
    ++counted;
  }
  EXPECT_GT(counted, 1000);
}

TEST(AdaptiveGauges, OfOneSizeAreSurfaceGauges) {
  SurfaceState reference = InstantOf(testing::kGrid, OnSaddle);
  SurfaceState now = InstantOf(testing::kGrid, OnLoadedSaddle);
  AddMatches(reference, true);
  AddMatches(now, false);
  AdaptiveGaugesOptions options;
  const AdaptiveGauges gauges(
      reference, Image<Eigen::Vector3f>(testing::kGrid, {1e-4F, 0, 2e-4F}),
      NeighbourCorrelation::OfOverlap(testing::kGrid, kStepPx, kSubsetPx, 1), kStepPx, kSubsetPx,
      options);
  const AdaptiveStrain one = gauges.Strain(now, AllOk(testing::kGrid));
  const SurfaceStrain expected = GaugesOf(reference).Strain(now, AllOk(testing::kGrid));
  EXPECT_TRUE(one.window_points.empty());
  EXPECT_TRUE(one.sigma_model.empty());
  EXPECT_EQ(one.strain.strain(10, 10), expected.strain(10, 10));
  EXPECT_EQ(one.strain.cov_strain(10, 10), expected.cov_strain(10, 10));
}

TEST(AdaptiveGauges, TakeASmallerOneAtAnEdgeAndSayWhereNoneIsLeft) {
  NormalDeviates draw(2);
  SurfaceState reference = InstantOf(kSheet, OnSheet), now = InstantOf(kSheet, OnEvenSheet);
  AddNoise(reference, draw);
  AddNoise(now, draw);
  Image<Status> status = AllOk(kSheet);
  status(20, 20) = Status::kLowCorrelation;
  const AdaptiveStrain strain = GaugesOnSheet(reference, Between(5, 17)).Strain(now, status);
  EXPECT_EQ(strain.strain.status(15, 1), Status::kOk);
  EXPECT_LE(strain.window_points(15, 1), 7.0F);
  EXPECT_EQ(strain.strain.status(0, 0), Status::kExtrapolated);
  EXPECT_TRUE(std::isnan(strain.window_points(0, 0)));
  EXPECT_TRUE(strain.sigma_model(0, 0).array().isNaN().all());
  EXPECT_EQ(strain.strain.status(20, 20), Status::kLowCorrelation);
  EXPECT_TRUE(strain.strain.strain(20, 20).array().isNaN().all());
}

TEST(AdaptiveGauges, AreTheSameForAnyNumberOfThreads) {
  NormalDeviates draw(2);
  SurfaceState reference = InstantOf(kSheet, OnSheet), now = InstantOf(kSheet, OnStretchedSheet);
  AddNoise(reference, draw);
  AddNoise(now, draw);
  const auto compute = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return GaugesOnSheet(reference, Between(5, 11)).Strain(now, AllOk(kSheet));
  };
  const AdaptiveStrain one = compute(1), four = compute(4);
  for (std::size_t i = 0; i < one.window_points.pixel_count(); ++i) {
    if (one.strain.status.data()[i] != Status::kOk) continue;
    EXPECT_EQ(one.window_points.data()[i], four.window_points.data()[i]);
    EXPECT_EQ(one.strain.strain.data()[i], four.strain.strain.data()[i]);
  }
}

TEST(AdaptiveGauges, RefuseWhatTheyCannotUse) {
  const SurfaceState reference = InstantOf(kSheet, OnSheet);
  EXPECT_THROW((void)GaugesOnSheet(reference, Between(4, 17)), UsageError);
  EXPECT_THROW((void)GaugesOnSheet(reference, Between(3, 17)), UsageError);  // of order 3
  EXPECT_THROW((void)GaugesOnSheet(reference, Between(19, 17)), UsageError);
  AdaptiveGaugesOptions options = Between(5, 17);
  options.agreement_sigmas = 0;
  EXPECT_THROW((void)GaugesOnSheet(reference, options), UsageError);
}

}  // namespace
}  // namespace plumbline
