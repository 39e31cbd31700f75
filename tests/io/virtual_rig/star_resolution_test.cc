// Spatial resolution and noise of the correlator on the virtual rig's star pattern: a wavy
// displacement whose period grows along the image. The table is that of docs/correlation.md.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "calib/median.h"
#include "io/virtual_rig/scenario.h"
#include "io/virtual_rig/virtual_rig.h"
#include "match/subset_correlator.h"

namespace plumbline {
namespace {

// One column of the image: the true displacement of its points, and its period.
struct Column {
  double period_px = 0;
  std::vector<Eigen::Vector2i> pixel;
  std::vector<Eigen::Vector2d> truth_px;
};

struct StarPair {
  GrayImage reference, deformed;
  std::vector<Column> columns;
};

StarPair TakeStar() {
  const Scenario scenario = MakeScenario("star");  // two frames: without, and with all of it
  const VirtualRig rig(scenario);
  StarPair pair{rig.TakeImage(0, Side::kLeft), rig.TakeImage(1, Side::kLeft), {}};
  const auto before = rig.Truth(0);
  const auto after = rig.Truth(1);
  const auto& specimen = std::get<SpecimenOptions>(scenario.surface);
  constexpr int kMargin = 30;
  for (int x = kMargin; x < pair.reference.width() - kMargin; x += 2) {
    Column column;
    const Eigen::Vector2d middle(x, pair.reference.height() / 2.0);
    const auto at = before->UnderLeftPixel(middle);
    const auto below = before->UnderLeftPixel(middle + Eigen::Vector2d(0, 10));
    if (!at || !below) continue;
    // The waves run down the image; the camera sees the specimen at an angle.
    const double px_per_mm = 10 / std::abs(below->material_mm.y() - at->material_mm.y());
    const double along = (at->material_mm.x() + specimen.size_mm.x() / 2) / specimen.size_mm.x();
    column.period_px =
        px_per_mm * (specimen.star_period_min_mm +
                     along * (specimen.star_period_max_mm - specimen.star_period_min_mm));
    // Only along the crest through the middle do the waves stand square to the columns: away from
    // it they fan out, and are shorter.
    const double crest =
        middle.y() - at->material_mm.y() * 10 / (below->material_mm.y() - at->material_mm.y());
    const int reach = static_cast<int>(0.06 * column.period_px);
    for (int y = static_cast<int>(std::lround(crest)) - reach; y <= crest + reach + 0.5; y += 3) {
      const Eigen::Vector2d pixel(x, y);
      const auto point = before->UnderLeftPixel(pixel);
      if (!point) continue;
      column.pixel.emplace_back(x, y);
      column.truth_px.push_back(after->OfMaterial(point->material_mm).left_px - pixel);
    }
    pair.columns.push_back(std::move(column));
  }
  return pair;
}

struct Resolution {
  double period_px = 0;       // at which a tenth of the amplitude is lost
  double noise_px = 0;        // across the waves, where nothing moves
  double worst_off_sinc = 0;  // of the gain from sinc(subset / period), periods over two subsets
};

Resolution Measure(const StarPair& pair, int subset, int order) {
  const CorrelationImage reference(pair.reference);
  const CorrelationImage deformed(pair.deformed);
  CorrelatorOptions options;
  options.subset_px = subset;
  options.order = order;
  options.max_sigma_px = 1;
  options.min_zncc = 0.3;
  const SubsetCorrelator correlator(reference, options);
  Resolution resolution;
  std::vector<double> periods, gains;
  std::vector<double> across;
  for (const Column& column : pair.columns) {
    double with = 0, energy = 0;
    for (std::size_t i = 0; i < column.pixel.size(); ++i) {
      const SubsetMatch match = correlator.Match(deformed, column.pixel[i], SubsetWarp());
      if (match.status != Status::kOk) continue;
      const double truth = column.truth_px[i].y();
      with += match.warp.displacement_px().y() * truth;
      energy += truth * truth;
      across.push_back(std::abs(match.warp.displacement_px().x() - column.truth_px[i].x()));
    }
    periods.push_back(column.period_px);
    gains.push_back(with / energy);
  }
  // The median over 31 columns takes the noise off a curve that only rises.
  std::vector<double> smooth;
  for (std::size_t i = 15; i + 15 < gains.size(); ++i) {
    const auto at = gains.begin() + static_cast<std::ptrdiff_t>(i);
    smooth.push_back(Median(std::vector<double>(at - 15, at + 16)));
    const double ratio = subset / periods[i];
    if (order == 1 && ratio < 0.5) {
      const double sinc = std::sin(M_PI * ratio) / (M_PI * ratio);
      resolution.worst_off_sinc =
          std::max(resolution.worst_off_sinc, std::abs(smooth.back() - sinc));
    }
  }
  for (std::size_t i = smooth.size(); i-- > 0;) {
    if (smooth[i] < 0.9) break;
    resolution.period_px = periods[i + 15];
  }
  resolution.noise_px = Median(across) / 0.6745;
  return resolution;
}

TEST(StarResolution, FollowsTheSubsetsWindow) {
  const StarPair star = TakeStar();
  const Resolution first = Measure(star, 21, 1);
  const Resolution second = Measure(star, 21, 2);
  EXPECT_LT(first.worst_off_sinc, 0.05);
  EXPECT_NEAR(first.period_px, 84, 6);
  EXPECT_LT(second.period_px, 33);
  EXPECT_GT(second.noise_px, first.noise_px);
}

TEST(StarResolution, ProveTableOfSubsets) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  const StarPair star = TakeStar();
  std::printf("| subset | order | period at 90 %%, px | noise, px | product, px2 |\n");
  for (const int order : {1, 2}) {
    for (const int subset : {9, 13, 17, 21, 25, 29, 33, 37, 41}) {
      const Resolution r = Measure(star, subset, order);
      std::printf("| %d | %d | %.0f | %.4f | %.2f |\n", subset, order, r.period_px, r.noise_px,
                  r.period_px * r.noise_px);
    }
  }
}

}  // namespace
}  // namespace plumbline
