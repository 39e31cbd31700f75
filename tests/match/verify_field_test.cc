#include "match/internal/verify_field.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <cstring>
#include <sstream>

#include "match/correlate_field.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {

using testing::RenderedSpeckleOptions;
using testing::RenderSpeckle;

constexpr ImageSize kSize{260, 240};

FieldOptions Options(int subset_px, int step_px) {
  FieldOptions options;
  options.correlator.subset_px = subset_px;
  options.step_px = step_px;
  return options;
}

// A specimen that moves (rows 60 to 180, columns 70 to 190) before a background of its own that
// does not.
struct BeforeBackground {
  Eigen::Vector2d shift;
  RenderedSpeckleOptions behind;

  explicit BeforeBackground(const Eigen::Vector2d& by) : shift(by) { behind.pattern_seed = 77; }
  static bool On(const Eigen::Vector2d& p) {
    return p.x() >= 70 && p.x() < 190 && p.y() >= 60 && p.y() < 180;
  }
  GrayImage Render(const Eigen::Vector2d& by, std::uint32_t seed) const {
    const auto moved = [&](const Eigen::Vector2d& p) -> Eigen::Vector2d { return p - by; };
    GrayImage image = RenderSpeckle(
        kSize, [](const Eigen::Vector2d& p) { return p; }, 1, seed, behind);
    const GrayImage specimen = RenderSpeckle(kSize, moved, 1, seed + 10);
    for (int y = 0; y < kSize.height; ++y) {
      for (int x = 0; x < kSize.width; ++x) {
        if (On(moved({x, y}))) image.grey(y, x) = specimen.grey(y, x);
      }
    }
    return image;
  }
  static Image<std::uint8_t> Mask(std::uint8_t value) {
    Image<std::uint8_t> mask(kSize, 0);
    for (int y = 60; y < 180; ++y) std::fill(mask.row(y) + 70, mask.row(y) + 190, value);
    return mask;
  }
};

TEST(VerifyField, RejectsAStillBackgroundBesideAMovingSpecimen) {
  for (const Eigen::Vector2d& by : {Eigen::Vector2d(12.3, -7.6), Eigen::Vector2d(2.6, 0.4)}) {
    const BeforeBackground scene(by);
    FieldOptions options = Options(21, 6);
    const GrayImage reference = scene.Render({0, 0}, 1), deformed = scene.Render(by, 2);
    const CorrelatedField result = FieldCorrelator(reference, options).Correlate(deformed);
    int found = 0, inner = 0, wrong = 0;
    std::ostringstream where;
    for (int row = 0; row < result.field.size().height; ++row) {
      for (int column = 0; column < result.field.size().width; ++column) {
        const Eigen::Vector2d p = result.field.PixelOf(row, column);
        const bool within = p.x() >= 81 && p.x() < 179 && p.y() >= 71 && p.y() < 169;
        inner += within ? 1 : 0;
        if (result.field.status(row, column) != Status::kOk) continue;
        found += within ? 1 : 0;
        const double off = (result.field.displacement_px(row, column) - by).norm();
        if (off < 0.1) continue;
        ++wrong;
        where << p.transpose() << " zncc " << result.field.zncc(row, column) << "\n";
      }
    }
    // At the edge a subset may lie on both, and fit both a little when they are 2 or 3 px apart.
    EXPECT_LE(wrong, by.norm() > 5 ? 0 : 40) << where.str().substr(0, 1000);
    EXPECT_GE(found, 0.98 * inner) << inner;
    EXPECT_GT(result.counts.still, 300);
    EXPECT_GE(result.counts.by_status[static_cast<std::size_t>(Status::kFailedVerification)],
              result.counts.still);
    options.keep_still_parts = true;
    const CorrelatedField kept = FieldCorrelator(reference, options).Correlate(deformed);
    EXPECT_EQ(kept.counts.still, 0);
    EXPECT_EQ(kept.counts.ok, result.counts.ok + result.counts.still);
  }
}

TEST(VerifyField, UsesTheMaskWhateverItsValue) {
  const Eigen::Vector2d by(12.3, -7.6);
  const BeforeBackground scene(by);
  const GrayImage reference = scene.Render({0, 0}, 1), deformed = scene.Render(by, 2);
  const CorrelatedField one =
      FieldCorrelator(reference, Options(21, 6), scene.Mask(1)).Correlate(deformed);
  const CorrelatedField full =
      FieldCorrelator(reference, Options(21, 6), scene.Mask(255)).Correlate(deformed);
  EXPECT_EQ(one.field.status.values(), full.field.status.values());
  EXPECT_EQ(one.counts.ok, full.counts.ok);
  int on = 0, worst_count = 0;
  for (std::size_t i = 0; i < one.field.status.pixel_count(); ++i) {
    const auto width = static_cast<std::size_t>(one.field.size().width);
    const Eigen::Vector2d p =
        one.field.PixelOf(static_cast<int>(i / width), static_cast<int>(i % width));
    EXPECT_EQ(one.field.status.data()[i] == Status::kMasked && !scene.On(p), !scene.On(p));
    on += scene.On(p) ? 1 : 0;
    if (one.field.status.data()[i] == Status::kOk) {
      const Eigen::Vector3f& cov = one.field.cov_displacement_px2.data()[i];
      const double sigma = std::sqrt(static_cast<double>(cov[0] + cov[2]));
      worst_count +=
          (one.field.displacement_px.data()[i] - by).norm() > std::max(0.1, 5 * sigma) ? 1 : 0;
    }
  }
  EXPECT_EQ(worst_count, 0);
  // Right up to the edge of the mask, though half of the subset is background there; not in its
  // corners, where three quarters are.
  EXPECT_GE(one.counts.ok, 0.97 * on) << on << " of them masked " << one.counts.by_status[8];
}

bool SameBits(const PlanarField& a, const PlanarField& b) {
  const auto same = [](const auto& x, const auto& y) {
    return std::memcmp(x.data(), y.data(), x.pixel_count() * sizeof(*x.data())) == 0;
  };
  return same(a.status, b.status) && same(a.displacement_px, b.displacement_px) &&
         same(a.gradient, b.gradient) && same(a.cov_displacement_px2, b.cov_displacement_px2) &&
         same(a.cov_gradient, b.cov_gradient) && same(a.zncc, b.zncc) &&
         same(a.iterations, b.iterations);
}

TEST(VerifyField, GivesTheSameBitsForAnyNumberOfThreads) {
  const Eigen::Vector2d by(12.3, -7.6);
  const BeforeBackground scene(by);
  const auto run = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return FieldCorrelator(scene.Render({0, 0}, 1), Options(21, 5), scene.Mask(1))
        .Correlate(scene.Render(by, 2));
  };
  const CorrelatedField one = run(1), two = run(2);
  EXPECT_GT(one.counts.ok, 200);
  EXPECT_TRUE(SameBits(one.field, two.field));
}

}  // namespace
}  // namespace plumbline
