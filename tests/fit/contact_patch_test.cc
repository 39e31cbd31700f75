#include "fit/contact_patch.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <set>

#include "calib/error.h"

namespace plumbline {
namespace {

using Points = Image<Eigen::Vector3d>;
constexpr double kThickness_mm = 20;

struct Grid {
  ImageSize size{61, 47};
  double pitch_mm = 5;
  Eigen::Matrix2d turn = Eigen::Matrix2d::Identity();  // of the grid in the ground

  // height: of the outer surface over the ground.
  Points At(const std::function<double(const Eigen::Vector2d&)>& height_mm) const {
    Points points(size, Eigen::Vector3d::Zero());
    for (int r = 0; r < size.height; ++r) {
      for (int c = 0; c < size.width; ++c) {
        const Eigen::Vector2d at =
            turn * (pitch_mm * Eigen::Vector2d(c - size.width / 2, r - size.height / 2));
        points(r, c) << at, height_mm(at) + kThickness_mm;
      }
    }
    return points;
  }
};

Image<double> Thickness(const Points& points) {
  return Image<double>(points.size(), kThickness_mm);
}

ContactPatch Find(const Points& points, const ContactPatchOptions& options = {}) {
  const auto patch = FindContactPatch(points, Thickness(points), options);
  EXPECT_TRUE(patch.has_value());
  return patch.value_or(ContactPatch());
}

constexpr double kA_mm = 103, kB_mm = 71;
const Eigen::Vector2d kCentre_mm(12.3, -7.7);

// An ellipse at threshold 0.5 mm.
double Ellipse(const Eigen::Vector2d& at) {
  const Eigen::Vector2d d = at - kCentre_mm;
  return 0.5 + 8 * (std::hypot(d.x() / kA_mm, d.y() / kB_mm) - 1);
}

TEST(ContactPatch, MeasuresAnEllipse) {
  for (const double mirrored : {1.0, -1.0}) {
    Grid grid;
    grid.turn << 1, 0, 0, mirrored;
    const ContactPatch patch = Find(grid.At(Ellipse));
    EXPECT_NEAR(patch.area_mm2, std::numbers::pi * kA_mm * kB_mm, 20);  // 0.1 %
    EXPECT_NEAR(patch.length_mm, 2 * kA_mm, 0.4);
    EXPECT_NEAR(patch.width_mm, 2 * kB_mm, 0.4);
    EXPECT_LT((patch.centroid_mm - kCentre_mm).norm(), 0.02);
    EXPECT_NEAR(patch.shape_factor, std::numbers::pi / 4, 0.005);
    // area = pi a b (1 + (threshold - 0.5) / 8)^2
    EXPECT_NEAR(patch.d_area_d_threshold_mm, std::numbers::pi * kA_mm * kB_mm / 4, 40);
    EXPECT_TRUE(patch.complete());
    EXPECT_EQ(patch.contours_mm.size(), 1U);
    EXPECT_NEAR(patch.perimeter_mm, 552.5, 2);  // Ramanujan's formula: 552.6
  }
}

TEST(ContactPatch, LeavesAHoleOutAndSpecksTo) {
  const Points points = Grid().At([](const Eigen::Vector2d& at) {
    if ((at - Eigen::Vector2d(-40, 5)).norm() < 1) return 3.0;     // a speck of a hole
    if ((at - Eigen::Vector2d(-140, 100)).norm() < 1) return 0.0;  // and of a part
    const double hole = 0.5 + (25 - (at - Eigen::Vector2d(30, 0)).norm());
    return std::max(Ellipse(at), hole);
  });
  const ContactPatch patch = Find(points);
  EXPECT_EQ(patch.contours_mm.size(), 2U);
  EXPECT_EQ(patch.left_out, 2);
  EXPECT_NEAR(patch.area_mm2, std::numbers::pi * (kA_mm * kB_mm - 25 * 25), 40);
  EXPECT_EQ(Find(points, {.least_share = 0}).left_out, 0);
}

TEST(ContactPatch, SaysWhereItIsCutOff) {
  Grid narrow;
  narrow.size = {31, 47};  // ends at 75 mm
  const ContactPatch cut = Find(narrow.At(Ellipse));
  EXPECT_FALSE(cut.complete());
  EXPECT_GT(cut.unseen_perimeter_mm, 100);
  EXPECT_LT(cut.area_mm2, std::numbers::pi * kA_mm * kB_mm);
  EXPECT_EQ(cut.length_mm, 150);
  Points holed = Grid().At(Ellipse);
  holed(23, 30).setConstant(NAN);
  const ContactPatch missing = Find(holed, {.least_share = 0});
  EXPECT_FALSE(missing.complete());
  EXPECT_LT(missing.area_mm2, Find(Grid().At(Ellipse)).area_mm2 - 40);
}

TEST(ContactPatch, IsNotThereWithoutContact) {
  const Points points = Grid().At([](const Eigen::Vector2d&) { return 4.0; });
  std::string why;
  EXPECT_FALSE(FindContactPatch(points, Thickness(points), {}, &why).has_value());
  EXPECT_NE(why.find("0.5 mm"), std::string::npos);
  EXPECT_THROW(FindContactPatch(points, Thickness(points), {.least_share = 1}), UsageError);
  EXPECT_THROW(FindContactPatch(points, Image<double>({2, 2})), std::invalid_argument);
}

TEST(ContactPatch, InfluencesAreTheDerivatives) {
  for (const double mirrored : {1.0, -1.0}) {
    Grid grid;
    grid.turn << std::cos(0.3), -std::sin(0.3), mirrored * std::sin(0.3), mirrored * std::cos(0.3);
    const Points points = grid.At(Ellipse);
    const ContactPatch patch = Find(points);
    EXPECT_GT(patch.influences.size(), 100U);
    constexpr double kStep_mm = 1e-5;
    for (std::size_t k = 0; k < patch.influences.size(); k += 3) {
      const ContactPatch::Influence& influence = patch.influences[k];
      for (int axis = 0; axis < 3; ++axis) {
        Points more = points, less = points;
        more.data()[influence.place][axis] += kStep_mm;
        less.data()[influence.place][axis] -= kStep_mm;
        const auto slope = ((Find(more).results() - Find(less).results()) / (2 * kStep_mm)).eval();
        EXPECT_LT((slope - influence.change.col(axis)).cwiseAbs().maxCoeff(), 1e-4)
            << influence.place << " along " << axis << ": " << slope.transpose();
      }
    }
    const double by_threshold = (Find(points, {.threshold_mm = 0.5 + 1e-5}).area_mm2 -
                                 Find(points, {.threshold_mm = 0.5 - 1e-5}).area_mm2) /
                                2e-5;
    EXPECT_NEAR(patch.d_area_d_threshold_mm, by_threshold, 1e-3);
    // A common error of all heights is one of the threshold.
    const Points raised(points.size(), Eigen::Vector3d::UnitZ());
    EXPECT_NEAR(patch.ChangeWith(raised)[0], -by_threshold, 1e-3);
    EXPECT_NEAR(patch.ChangeWith(Points(points.size(), Eigen::Vector3d::UnitX()))[3], 1, 1e-9);
  }
}

TEST(ContactPatch, CovarianceIsThatOfSampling) {
  const Points points = Grid().At(Ellipse);
  Eigen::Matrix3d root;
  root << 0.03, 0, 0, 0.01, 0.03, 0, -0.02, 0.01, 0.08;
  // Neighbours along a row share half of their noise.
  const double share = std::sqrt(0.5);
  const int columns = points.width();
  const auto correlation = [&](std::size_t a, std::size_t b) {
    if (a == b) return 1.0;
    const auto row = [&](std::size_t place) { return place / static_cast<std::size_t>(columns); };
    return row(a) == row(b) && std::max(a, b) - std::min(a, b) == 1 ? 0.5 : 0.0;
  };
  const ContactPatch plain = Find(points);
  const ContactPatch::Covariance claimed =
      plain.CovarianceOf([&](std::size_t) { return root * root.transpose(); }, correlation);
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  constexpr int kDraws = 2000;
  Eigen::Matrix<double, ContactPatch::kResults, kDraws> drawn;
  for (int draw = 0; draw < kDraws; ++draw) {
    Points noisy = points;
    for (int r = 0; r < points.height(); ++r) {
      const auto three = [&] {
        Eigen::Vector3d numbers = Eigen::Vector3d::Zero();
        for (double& number : numbers) number = normal(random);
        return numbers;
      };
      Eigen::Vector3d before = three();
      for (int c = 0; c < columns; ++c) {
        const Eigen::Vector3d next = three();
        noisy(r, c) += root * (share * (before + next));
        before = next;
      }
    }
    drawn.col(draw) = Find(noisy).results();
  }
  const auto centred = (drawn.colwise() - drawn.rowwise().mean()).eval();
  const ContactPatch::Covariance sampled = centred * centred.transpose() / (kDraws - 1);
  for (const int k : {0, 3, 4}) {
    EXPECT_NEAR(std::sqrt(claimed(k, k) / sampled(k, k)), 1, 0.06) << k;
  }
  EXPECT_NEAR(claimed(0, 3) / std::sqrt(claimed(0, 0) * claimed(3, 3)),
              sampled(0, 3) / std::sqrt(sampled(0, 0) * sampled(3, 3)), 0.08);
  // Length and width are the largest of several: less scatter than one corner has, and longer.
  for (const int k : {1, 2}) {
    EXPECT_LT(std::sqrt(sampled(k, k) / claimed(k, k)), 1.1) << k;
    EXPECT_GT(std::sqrt(sampled(k, k) / claimed(k, k)), 0.4) << k;
  }
}

TEST(ContactPatch, OuterSurfaceLiesBelowByTheThickness) {
  // A slope of 45 degrees along x.
  const Points points = Grid().At([](const Eigen::Vector2d& at) { return at.x(); });
  const Points outer = OuterSurface(points, Thickness(points));
  const Eigen::Vector3d expected = kThickness_mm * Eigen::Vector3d(1, 0, -1).normalized();
  EXPECT_LT((outer(20, 20) - points(20, 20) - expected).norm(), 1e-9);
  EXPECT_TRUE(std::isnan(outer(0, 20).x()));
}

TEST(Outline, PartsNodesThatTouchByACornerAlone) {
  Image<std::uint8_t> inside({3, 3}, 0);
  inside(0, 0) = inside(1, 1) = inside(2, 2) = 1;
  const auto loops = OutlinesOf(inside);
  ASSERT_EQ(loops.size(), 3U);
  std::set<GridEdge> edges;
  for (const auto& loop : loops) edges.insert(loop.begin(), loop.end());
  EXPECT_EQ(edges.size(), 12U);
  inside(0, 1) = 1;
  EXPECT_EQ(OutlinesOf(inside).size(), 2U);
  EXPECT_TRUE(OutlinesOf(Image<std::uint8_t>({3, 3}, 0)).empty());
}

}  // namespace
}  // namespace plumbline
