#include "fit/lift_off.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
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
  Image<ThicknessShares> shares = {};
  LiftOffFrame free_frame() const { return {&position, &undeformed, &thickness, &shares}; }
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
      const double gap =
          q <= 0 ? 0
                 : std::exp(law.log_k) * std::pow(q, 4) * (1 + law.m * q * (1 + law.n * law.m * q));
      made.position(r, c) << at, kThickness + gap + sigma_mm * normal(random);
      made.undeformed(r, c) << at, kThickness + q + kA0;
    }
  }
  return made;
}

// Points and noise alone.
LiftOffOptions NextTermKnown() {
  LiftOffOptions options;
  options.sigma_next_term = 0;
  return options;
}

const LiftOffLaw kLaw{std::log(0.004), -0.09, 0.28};

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
  for (int k = 0; k < LiftOffLaw::kParameters; ++k) {
    const double step = k == 1 ? 1e-4 : 1e-3;
    LiftOffLaw more = kLaw, less = kLaw;
    (k == 0 ? more.log_k : k == 1 ? more.m : more.n) += step;
    (k == 0 ? less.log_k : k == 1 ? less.m : less.n) -= step;
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
    const LiftOffLaw law = FitLiftOffLaw(frames, 0.03, 1, NextTermKnown());
    law_nees += std::pow(law.m - kLaw.m, 2) / law.cov(1, 1) / kDraws;
    const auto line = FindLiftOffLine(frames[0], kLaw, 0.03, 1);
    ASSERT_TRUE(line.has_value());
    line_nees += std::pow(line->a[0] - kA0, 2) / line->cov(0, 0) / kDraws;
  }
  EXPECT_NEAR(line_nees, 1, 4 * std::sqrt(2.0 / kDraws));
  EXPECT_NEAR(law_nees, 1, 4 * std::sqrt(2.0 / kDraws));
}

// The made tyre under a map that is off by errors_mm, with the ground's plane off too.
Made UnderAWrongMap(const CarcassThickness& map, const std::vector<double>& errors_mm,
                    double sigma_mm, unsigned seed) {
  Made made = Make(kLaw, sigma_mm, seed);
  CarcassThickness wrong = map;
  for (std::size_t k = 0; k < errors_mm.size(); ++k) wrong.thickness_mm[k] += errors_mm[k];
  made.shares = Image<ThicknessShares>(made.position.size());
  for (std::size_t i = 0; i < made.position.pixel_count(); ++i) {
    const double y = made.position.data()[i].y();
    const double lift = map.At(y) - kThickness;
    made.position.data()[i].z() += lift + 0.02 + 3e-4 * y - 1e-4 * made.position.data()[i].x();
    made.undeformed.data()[i].z() += lift;
    made.thickness.data()[i] = wrong.At(y);
    made.shares.data()[i] = wrong.SharesAt(y);
  }
  return made;
}

CarcassThickness SmoothMap() {
  CarcassThickness map;
  for (double y = -125; y <= 125; y += 10) {
    map.y_mm.push_back(y);
    map.thickness_mm.push_back(kThickness + 5 + 0.04 * y);  // no kinks in its curve
  }
  return map;
}

TEST(LiftOff, TheContactTellsTheThicknessButForAConstantAndASlope) {
  const CarcassThickness map = SmoothMap();
  const auto entries = static_cast<Eigen::Index>(map.y_mm.size());
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 0.02);
  std::vector<double> errors_mm;
  for (Eigen::Index k = 0; k < entries; ++k) errors_mm.push_back(normal(random));
  const Made made = UnderAWrongMap(map, errors_mm, 0, 1);
  const LiftOffFrame frames[] = {made.free_frame(), made.free_frame()};
  const ThicknessPrior prior{Eigen::VectorXd::Zero(entries), 0.1};
  const LawAndThickness found = FitLawAndThickness(frames, 0.001, 1, &prior);
  // Of what touches (|y| < 80), less the best line.
  Eigen::VectorXd left(15);
  Eigen::MatrixXd line(15, 2);
  for (Eigen::Index k = 0; k < 15; ++k) {
    const auto at = static_cast<std::size_t>(k + 5);
    left[k] = found.added_mm[k + 5] + errors_mm[at];
    line.row(k) << 1, map.y_mm[at];
  }
  left -= line * (line.transpose() * line).ldlt().solve(line.transpose() * left);
  EXPECT_LT(left.cwiseAbs().maxCoeff(), 0.002);
  EXPECT_NEAR(found.law.m, kLaw.m, 2e-3);
  // What the ground can absorb, and beyond what is seen, stays as sure as it was.
  const Eigen::VectorXd constant = Eigen::VectorXd::Ones(entries) / static_cast<double>(entries);
  EXPECT_NEAR(std::sqrt(constant.dot(found.cov_mm2 * constant)),
              0.1 / std::sqrt(static_cast<double>(entries)), 0.002);
  EXPECT_NEAR(std::sqrt(found.cov_mm2(0, 0)), 0.1, 0.002);
  EXPECT_THROW((void)FitLawAndThickness(std::span(frames).first(0), 0.001, 1, &prior), InputError);
}

// The other way round: what another next term makes of k and m is in their covariance.
TEST(LiftOff, TheSigmaOfTheNextTermMovesTheOthers) {
  const Made made = Make(kLaw);
  const LiftOffFrame frames[] = {made.frame()};
  LiftOffOptions options = NextTermKnown();
  const LiftOffLaw law = FitLiftOffLaw(frames, 0.01, 1, options);
  options.sigma_next_term = 0.02;
  const LiftOffLaw unsure = FitLiftOffLaw(frames, 0.01, 1, options);
  options.next_term += 0.02;
  const LiftOffLaw other = FitLiftOffLaw(frames, 0.01, 1, options);
  EXPECT_EQ(law.cov(2, 2), 0);
  EXPECT_NEAR(std::sqrt(unsure.cov(2, 2)), 0.02, 1e-9);
  const double of_m = std::sqrt(unsure.cov(1, 1) - law.cov(1, 1));
  EXPECT_NEAR(of_m, std::abs(other.m - law.m), 0.1 * of_m);
  EXPECT_NEAR(unsure.cov(1, 2), 0.02 * (other.m - law.m), 0.1 * std::abs(unsure.cov(1, 2)));
}

// Held tightly at other values, the law goes as it says.
TEST(LiftOff, TheLawGoesWithTheThicknessAsItSays) {
  const CarcassThickness map = SmoothMap();
  const auto entries = static_cast<Eigen::Index>(map.y_mm.size());
  const Made made = UnderAWrongMap(map, {}, 0, 1);
  const LiftOffFrame frames[] = {made.free_frame()};
  const auto held = [&](const Eigen::VectorXd& at_mm) {
    const ThicknessPrior prior{at_mm, 1e-6};
    return FitLawAndThickness(frames, 0.01, 1, &prior, NextTermKnown());
  };
  const Eigen::VectorXd none = Eigen::VectorXd::Zero(entries);
  const LawAndThickness here = held(none);
  for (const Eigen::Index k : {3, 8, 12, 20}) {
    const Eigen::VectorXd step = 0.003 * Eigen::VectorXd::Unit(entries, k);
    const LawAndThickness more = held(step), less = held(-step);
    const double of_k = (more.law.log_k - less.law.log_k) / 0.006;
    const double of_m = (more.law.m - less.law.m) / 0.006;
    EXPECT_NEAR(here.d_law_d_thickness(0, k), of_k, 0.05 * std::abs(of_k) + 0.01) << k;
    EXPECT_NEAR(here.d_law_d_thickness(1, k), of_m, 0.05 * std::abs(of_m) + 0.001) << k;
  }
}

TEST(LiftOff, SigmasOfLawAndThicknessAreThoseOfSampling) {
  constexpr int kDraws = 40;
  constexpr double kMap_mm = 0.05;
  const CarcassThickness map = SmoothMap();
  const auto entries = static_cast<Eigen::Index>(map.y_mm.size());
  std::mt19937 random(5);
  std::normal_distribution<double> normal(0, kMap_mm);
  double nees = 0, law_nees = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::vector<double> errors_mm;
    for (Eigen::Index k = 0; k < entries; ++k) errors_mm.push_back(normal(random));
    const Made made = UnderAWrongMap(map, errors_mm, 0.03, static_cast<unsigned>(draw + 1));
    const LiftOffFrame frames[] = {made.free_frame()};
    const ThicknessPrior prior{Eigen::VectorXd::Zero(entries), kMap_mm};
    const LawAndThickness found = FitLawAndThickness(frames, 0.03, 1, &prior, NextTermKnown());
    const Eigen::VectorXd off =
        found.added_mm + Eigen::Map<const Eigen::VectorXd>(errors_mm.data(), entries);
    nees += off.dot(found.cov_mm2.ldlt().solve(off)) / static_cast<double>(entries * kDraws);
    const LiftOffLaw::Covariance cov = found.law.cov + found.d_law_d_thickness * found.cov_mm2 *
                                                           found.d_law_d_thickness.transpose();
    law_nees += std::pow(found.law.m - kLaw.m, 2) / cov(1, 1) / kDraws;
  }
  EXPECT_NEAR(nees, 1, 0.2);
  EXPECT_NEAR(law_nees, 1, 4 * std::sqrt(2.0 / kDraws));
}

// A point that is lifted has no say in the thickness, and neither has a frame over an obstacle.
TEST(LiftOff, WhatIsLiftedDoesNotTellTheThickness) {
  const CarcassThickness map = SmoothMap();
  const auto entries = static_cast<Eigen::Index>(map.y_mm.size());
  const ThicknessPrior prior{Eigen::VectorXd::Zero(entries), 0.1};
  Made made = UnderAWrongMap(map, {}, 0, 1);
  made.position(30, 35).z() += 4;
  LiftOffFrame frames[] = {made.free_frame()};
  EXPECT_LT(FitLawAndThickness(frames, 0.001, 1, &prior).added_mm.norm(), 0.01);
  for (int c = 30; c < 41; ++c) {
    for (int r = 25; r < 36; ++r) made.position(r, c).z() += 4;
  }
  EXPECT_THROW((void)FitLawAndThickness(frames, 0.001, 1, &prior), InputError);
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
