#include "io/virtual_rig/speckle.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

float At(const Albedo& albedo, double u, double v) {
  const Eigen::Vector2d place(u, v);
  float value = 0;
  albedo.Evaluate({&place, 1}, {&value, 1});
  return value;
}

constexpr MaterialDomain kSheet{.u_min = -20, .u_max = 20, .v_min = -15, .v_max = 15};

TEST(Speckle, ClosesOverTheSeamOfAPeriod) {
  const MaterialDomain ring{.u_min = 0, .u_max = 60, .v_min = -10, .v_max = 10, .period_u = 60};
  const auto speckle = MakeSpeckle(ring, {});
  double contrast = 0;
  for (double v = -9; v < 9; v += 0.37) {
    for (const double u : {-0.3, -0.01, 0.0, 0.02, 0.4, 17.3}) {
      // In steps of float: places a period apart round differently.
      EXPECT_NEAR(At(*speckle, u, v), At(*speckle, u + 60, v), 1e-4) << u << " " << v;
      EXPECT_NEAR(At(*speckle, u, v), At(*speckle, u - 120, v), 1e-4);
    }
    // No seam: just before and after it the speckle is nearly the same.
    EXPECT_NEAR(At(*speckle, -1e-4, v), At(*speckle, 1e-4, v), 3e-3);
    contrast = std::max(contrast, std::abs(At(*speckle, 0, v) - At(*speckle, 0.7, v)) + 0.0);
  }
  EXPECT_GT(contrast, 0.4);
}

// However places are put together, each is what it is alone: those beyond the edge too.
TEST(Speckle, OfARowIsThatOfEachOfItsPlacesAlone) {
  MaterialDomain ring = kSheet;
  ring.period_u = 40;
  for (const MaterialDomain& domain : {kSheet, ring}) {
    const auto speckle = MakeSpeckle(domain, {});
    std::vector<Eigen::Vector2d> row;
    for (int k = 0; k < 5000; ++k) row.emplace_back(-21 + 0.0084 * k, -15.5 + 0.0062 * k);
    for (int k = 0; k < 300; ++k) row.emplace_back(-21 + 0.14 * k, 3);
    std::vector<float> values(row.size());
    speckle->Evaluate(row, values);
    int unlike = 0;
    for (std::size_t k = 0; k < row.size(); ++k) {
      unlike += values[k] != At(*speckle, row[k].x(), row[k].y());
    }
    EXPECT_EQ(unlike, 0);
  }
}

TEST(Speckle, IsSmooth) {
  const auto speckle = MakeSpeckle(kSheet, {});
  for (double u = -19; u < 19; u += 0.53) {
    // The steepest edge: 1.5 of contrast over its width, 0.4 of half a disc of 0.7 mm.
    const double slope = (At(*speckle, u + 1e-3, 3.3) - At(*speckle, u - 1e-3, 3.3)) / 2e-3;
    EXPECT_LT(std::abs(slope), 1.5 * 0.77 / (0.4 * 0.35) * 1.6);
  }
}

TEST(Speckle, CoversAsAsked) {
  for (const double coverage : {0.3, 0.5, 0.8}) {
    SpeckleOptions options;
    options.coverage = coverage;
    const auto speckle = MakeSpeckle(kSheet, options);
    double sum = 0;
    int count = 0;
    for (double u = -20; u <= 20; u += 0.11) {
      for (double v = -15; v <= 15; v += 0.11, ++count) sum += At(*speckle, u, v);
    }
    // Scattered discs leave exp(-coverage) bare if independent; one a cell leaves a little less.
    const double bare = (sum / count - options.black) / (options.white - options.black);
    EXPECT_LT(bare, std::exp(-coverage) + 0.02) << coverage;
    EXPECT_GT(bare, 1 - coverage) << coverage;
  }
}

TEST(Speckle, EndsWithTheMaterial) {
  SpeckleOptions options;
  const auto speckle = MakeSpeckle(kSheet, options);
  EXPECT_FLOAT_EQ(At(*speckle, 20.01, 0), static_cast<float>(options.background));
  EXPECT_FLOAT_EQ(At(*speckle, 0, -15.01), static_cast<float>(options.background));
  EXPECT_FLOAT_EQ(At(*speckle, NAN, 0), static_cast<float>(options.background));
}

TEST(Speckle, FollowsItsSeed) {
  SpeckleOptions other;
  other.seed = 2;
  const auto a = MakeSpeckle(kSheet, {}), b = MakeSpeckle(kSheet, {}),
             c = MakeSpeckle(kSheet, other);
  int same = 0;
  for (double u = -19; u < 19; u += 0.7) {
    EXPECT_EQ(At(*a, u, 1), At(*b, u, 1));
    same += At(*a, u, 1) == At(*c, u, 1);
  }
  EXPECT_LT(same, 30);
}

TEST(Speckle, RefusesWhatItCannotBe) {
  SpeckleOptions options;
  options.diameter_mm = 0;
  EXPECT_THROW(MakeSpeckle(kSheet, options), UsageError);
  options = {};
  options.edge = 3;
  EXPECT_THROW(MakeSpeckle(kSheet, options), UsageError);
}

}  // namespace
}  // namespace plumbline
