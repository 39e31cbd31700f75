#include "fit/lift_off.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "calib/error.h"

namespace plumbline {
namespace {

// A tyre that is a paraboloid, pressed so that it leaves the ground by the law exactly.
struct Made {
  Image<Eigen::Vector3d> position, undeformed;
  Image<double> thickness;
  LiftOffFrame frame() const { return {&position, &undeformed, &thickness}; }
};

constexpr double kA0 = -8, kThickness = 20;
const Eigen::Vector2d kHalf_mm(95, 80);  // of the ellipse q = 0

Made Make(const LiftOffLaw& law, double sigma_mm = 0, unsigned seed = 1) {
  const ImageSize size{71, 61};
  Made made{Image<Eigen::Vector3d>(size, Eigen::Vector3d::Zero()),
            Image<Eigen::Vector3d>(size, Eigen::Vector3d::Zero()), Image<double>(size, kThickness)};
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  for (int r = 0; r < size.height; ++r) {
    for (int c = 0; c < size.width; ++c) {
      const Eigen::Vector2d at(4.0 * (c - 35), 4.0 * (r - 30));
      const double q = 12 * (at.cwiseQuotient(kHalf_mm).squaredNorm() - 1);
      const double gap = q <= 0 ? 0 : std::exp(law.log_k) * std::pow(q, 4) * (1 + law.m * q);
      made.position(r, c) << at, kThickness + gap + sigma_mm * normal(random);
      made.undeformed(r, c) << at, kThickness + q + kA0;
    }
  }
  return made;
}

const LiftOffLaw kLaw{std::log(0.004), -0.09, Eigen::Matrix2d::Zero()};

TEST(LiftOff, FindsTheLawAndTheBoundaryThatWereMade) {
  const Made made = Make(kLaw);
  const LiftOffFrame frames[] = {made.frame()};
  const LiftOffLaw law = FitLiftOffLaw(frames, 0.01, 1);
  EXPECT_NEAR(law.log_k, kLaw.log_k, 1e-3);
  EXPECT_NEAR(law.m, kLaw.m, 1e-4);
  const auto line = FindLiftOffLine(frames[0], law, 0.01, 1);
  ASSERT_TRUE(line.has_value());
  EXPECT_NEAR(line->a[0], kA0, 1e-3);
  EXPECT_LT(line->a.tail<4>().norm(), 1e-3);
  EXPECT_LT(line->scatter_mm, 1e-4);
  const auto patch = PatchWithin(frames[0], *line);
  ASSERT_TRUE(patch.has_value());
  EXPECT_NEAR(patch->area_mm2, std::numbers::pi * kHalf_mm.prod(), 25);
  EXPECT_NEAR(patch->length_mm, 2 * kHalf_mm.x(), 0.3);
  EXPECT_NEAR(patch->width_mm, 2 * kHalf_mm.y(), 0.3);
}

TEST(LiftOff, LineByTheLawIsTheDerivative) {
  const Made made = Make(kLaw);
  const auto line = FindLiftOffLine(made.frame(), kLaw, 0.01, 1);
  ASSERT_TRUE(line.has_value());
  for (int k = 0; k < 2; ++k) {
    const double step = k == 0 ? 1e-3 : 1e-4;
    LiftOffLaw more = kLaw, less = kLaw;
    (k == 0 ? more.log_k : more.m) += step;
    (k == 0 ? less.log_k : less.m) -= step;
    const auto a = FindLiftOffLine(made.frame(), more, 0.01, 1);
    const auto b = FindLiftOffLine(made.frame(), less, 0.01, 1);
    ASSERT_TRUE(a && b);
    const double slope = (a->a[0] - b->a[0]) / (2 * step);
    EXPECT_NEAR(line->d_a_d_law(0, k), slope, 0.03 * std::abs(slope)) << k;
  }
}

TEST(LiftOff, SigmasAreThoseOfSampling) {
  constexpr int kDraws = 60;
  double line_nees = 0, law_nees = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    const Made made = Make(kLaw, 0.03, static_cast<unsigned>(draw + 1));
    const LiftOffFrame frames[] = {made.frame()};
    const LiftOffLaw law = FitLiftOffLaw(frames, 0.03, 1);
    law_nees += std::pow(law.m - kLaw.m, 2) / law.cov(1, 1) / kDraws;
    const auto line = FindLiftOffLine(frames[0], kLaw, 0.03, 1);
    ASSERT_TRUE(line.has_value());
    line_nees += std::pow(line->a[0] - kA0, 2) / line->cov(0, 0) / kDraws;
  }
  EXPECT_NEAR(line_nees, 1, 4 * std::sqrt(2.0 / kDraws));
  EXPECT_NEAR(law_nees, 1, 4 * std::sqrt(2.0 / kDraws));
}

TEST(LiftOff, SaysWhyThereIsNone) {
  Made made = Make(kLaw);
  LiftOffOptions strict;
  strict.max_scatter_mm = 1e-3;
  const Made noisy = Make(kLaw, 0.05);
  std::string why;
  EXPECT_FALSE(FindLiftOffLine(noisy.frame(), kLaw, 0.05, 1, strict, &why).has_value());
  EXPECT_NE(why.find("scatters"), std::string::npos);
  for (Eigen::Vector3d& point : made.position.values()) point.z() += 5;
  EXPECT_FALSE(FindLiftOffLine(made.frame(), kLaw, 0.05, 1, {}, &why).has_value());
  EXPECT_NE(why.find("near the ground"), std::string::npos);
  const LiftOffFrame frames[] = {made.frame()};
  EXPECT_THROW((void)FitLiftOffLaw(frames, 0.05, 1), InputError);
  made.thickness = Image<double>({2, 2}, 20);
  EXPECT_THROW((void)FindLiftOffLine(made.frame(), kLaw, 0.05, 1), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
