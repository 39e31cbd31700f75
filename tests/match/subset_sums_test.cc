#include "match/internal/subset_sums.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <Eigen/Geometry>
#include <cmath>
#include <string>

#include "match/correlation_image.h"
#include "match/subset_warp.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline::internal {
namespace {

constexpr ImageSize kSize{120, 100};
constexpr int kDegrees[] = {3, 5};

struct Pair {
  CorrelationImage reference, deformed;

  explicit Pair(int degree)
      : reference(Speckle(0), Options(degree)), deformed(Speckle(0.37), Options(degree)) {}

  static GrayImage Speckle(double shift) {
    return testing::RenderSpeckle(
        kSize, [shift](const Eigen::Vector2d& p) -> Eigen::Vector2d { return p.array() - shift; },
        1, 1);
  }
  static CorrelationImageOptions Options(int degree) {
    return {static_cast<Interpolation>(degree), Prefilter::kLowPass};
  }
  static const Pair& OfDegree(int degree) {
    static const Pair cubic(3), quintic(5);
    return degree == 3 ? cubic : quintic;
  }

  ReferencePlanes Planes(const Image<std::uint8_t>* mask = nullptr) const {
    return {&reference.grey(),
            &reference.gradient_x(),
            &reference.gradient_y(),
            &reference.noise_gradient_x(),
            &reference.noise_gradient_y(),
            mask};
  }

  // The deformed image under a warp that counts from this place.
  TargetPixels Target(const Eigen::Vector2i& pixel, const SubsetWarp& warp) const {
    const Eigen::Vector2d centre = pixel.cast<double>() + warp.displacement_px();
    const Eigen::Vector2d base = centre.array().floor();
    TargetPixels target;
    target.stride = deformed.stride();
    target.coefficients = deformed.coefficients() + static_cast<int>(base.y()) * target.stride +
                          static_cast<int>(base.x());
    target.degree = deformed.degree();
    target.grey_offset = 100;
    for (int k = 0; k < 6; ++k) {
      target.warp_x[k] = static_cast<float>(warp.c(0, k) + (k == 1 ? 1 : 0));
      target.warp_y[k] = static_cast<float>(warp.c(1, k) + (k == 2 ? 1 : 0));
    }
    target.warp_x[0] = static_cast<float>(centre.x() - base.x());
    target.warp_y[0] = static_cast<float>(centre.y() - base.y());
    return target;
  }
};

// The sums within 1e-5 of the sum of their terms' sizes, which is at most sqrt(a a) sqrt(b b).
constexpr double kTolerance = 1e-5;

void ExpectSameMoments(const double* actual, const double* expected, int order_of_sum, double scale,
                       double radius, const std::string& what) {
  int place = 0;
  for (int n = 0; n <= order_of_sum; ++n) {
    for (int j = 0; j <= n; ++j, ++place) {
      EXPECT_NEAR(actual[place], expected[place], kTolerance * scale * std::pow(radius, n))
          << what << " moment " << place;
    }
  }
}

// Root of the subset's sum of squares.
double Root(const PackedSubset& subset, const AlignedFloats& values) {
  double sum = 0;
  for (const PackedSubset::Row& row : subset.rows) {
    for (int i = 0; i < row.runs * PackedSubset::kRun; ++i) {
      sum += std::pow(static_cast<double>(values.data()[row.at + static_cast<std::size_t>(i)]), 2);
    }
  }
  return std::sqrt(sum);
}

void ExpectSameReferenceSums(const PackedSubset& subset, int count, int radius,
                             const std::string& what) {
  const double f = Root(subset, subset.grey);
  const double gx = Root(subset, subset.gradient_x), gy = Root(subset, subset.gradient_y);
  for (int order = 0; order <= 2; ++order) {
    const ReferenceSums sums = SumReference(subset, order);
    const ReferenceSums twin = SumReferenceScalar(subset, order);
    const double root_n = std::sqrt(count);
    EXPECT_NEAR(sums.f, twin.f, kTolerance * f * root_n) << what;
    EXPECT_NEAR(sums.ff, twin.ff, kTolerance * f * f) << what;
    ExpectSameMoments(sums.gradient_x, twin.gradient_x, order, gx * root_n, radius, what);
    ExpectSameMoments(sums.gradient_y, twin.gradient_y, order, gy * root_n, radius, what);
    ExpectSameMoments(sums.f_gradient_x, twin.f_gradient_x, order, f * gx, radius, what);
    ExpectSameMoments(sums.f_gradient_y, twin.f_gradient_y, order, f * gy, radius, what);
    const ProductSums products = SumProducts(subset, subset.gradient_x, subset.noise_y, order);
    const ProductSums products_twin =
        SumProductsScalar(subset, subset.gradient_x, subset.noise_y, order);
    const double ny = Root(subset, subset.noise_y);
    ExpectSameMoments(products.xx, products_twin.xx, 2 * order, gx * gx, radius, what);
    ExpectSameMoments(products.xy, products_twin.xy, 2 * order, gx * ny, radius, what);
    ExpectSameMoments(products.yy, products_twin.yy, 2 * order, ny * ny, radius, what);
  }
}

void ExpectSameTargetSums(const PackedSubset& subset, const TargetPixels& target, int count,
                          int radius, const std::string& what) {
  const double f = Root(subset, subset.grey);
  const double gx = Root(subset, subset.gradient_x), gy = Root(subset, subset.gradient_y);
  for (int order = 0; order <= 2; ++order) {
    const TargetSums sums = SumTarget(subset, target, order);
    const TargetSums twin = SumTargetScalar(subset, target, order);
    const double g = std::sqrt(twin.gg), root_n = std::sqrt(count);
    EXPECT_NEAR(sums.g, twin.g, kTolerance * g * root_n) << what << " order " << order;
    EXPECT_NEAR(sums.gg, twin.gg, 2 * kTolerance * g * g) << what << " order " << order;
    EXPECT_NEAR(sums.fg, twin.fg, kTolerance * f * g) << what << " order " << order;
    ExpectSameMoments(sums.gradient_x, twin.gradient_x, order, g * gx, radius, what);
    ExpectSameMoments(sums.gradient_y, twin.gradient_y, order, g * gy, radius, what);
  }
}

constexpr int kSides[] = {5, 7, 15, 17, 21, 31, 33, 35, 41};

SubsetOutline OutlineOf(int side, bool circle) {
  return circle ? SubsetOutline::Circle(side / 2) : SubsetOutline::Square(side / 2);
}

// A mask with holes of many shapes, some of them whole runs, some single pixels.
Image<std::uint8_t> Holes() {
  Image<std::uint8_t> mask(kSize, 255);
  for (int y = 0; y < kSize.height; ++y) {
    for (int x = 0; x < kSize.width; ++x) {
      if ((x * 7 + y * 13) % 11 == 0 || (x > 40 && x < 62 && y % 9 < 4)) mask(y, x) = 0;
    }
  }
  return mask;
}

std::string Name(int degree, int side, bool circle) {
  return "degree " + std::to_string(degree) + ", " + std::to_string(side) + " px" +
         (circle ? ", circle" : "");
}

TEST(SubsetOutline, CountsThePixelsOfSquareAndDisc) {
  for (const int side : kSides) {
    int square = 0, circle = 0, disc = 0;
    const SubsetOutline s = OutlineOf(side, false), c = OutlineOf(side, true);
    for (std::size_t i = 0; i < static_cast<std::size_t>(side); ++i) {
      square += s.end[i] - s.begin[i];
      circle += c.end[i] - c.begin[i];
      for (int x = -side / 2; x <= side / 2; ++x) {
        disc += std::hypot(x, static_cast<int>(i) - side / 2) <= side / 2.0 ? 1 : 0;
      }
    }
    EXPECT_EQ(square, side * side);
    EXPECT_EQ(circle, disc);
  }
}

TEST(SubsetSums, PackTakesEveryPixelOnceAndNoOther) {
  const Pair& pair = Pair::OfDegree(5);
  const Image<std::uint8_t> mask = Holes();
  for (const bool circle : {false, true}) {
    for (const Eigen::Vector2i& at : {Eigen::Vector2i(60, 50), Eigen::Vector2i(3, 2),
                                      Eigen::Vector2i(119, 99), Eigen::Vector2i(0, 60)}) {
      PackedSubset subset;
      const SubsetOutline outline = OutlineOf(33, circle);
      const int count = Pack(pair.Planes(&mask), outline, at.x(), at.y(), 100, subset);
      Image<int> seen(kSize, 0);
      int total = 0;
      for (const PackedSubset::Row& row : subset.rows) {
        for (int i = 0; i < row.runs * PackedSubset::kRun; ++i) {
          const std::size_t k = row.at + static_cast<std::size_t>(i);
          if (subset.weight.data()[k] == 0) {
            EXPECT_EQ(subset.grey.data()[k], 0);
            EXPECT_EQ(subset.gradient_x.data()[k], 0);
            EXPECT_EQ(subset.noise_y.data()[k], 0);
            continue;
          }
          const int x = at.x() + row.x + i, y = at.y() + static_cast<int>(row.y);
          ASSERT_TRUE(x >= 0 && y >= 0 && x < kSize.width && y < kSize.height);
          EXPECT_NE(mask(y, x), 0);
          EXPECT_EQ(subset.grey.data()[k], pair.reference.grey()(y, x) - 100);
          EXPECT_EQ(subset.gradient_y.data()[k], pair.reference.gradient_y()(y, x));
          EXPECT_EQ(subset.noise_x.data()[k], pair.reference.noise_gradient_x()(y, x));
          EXPECT_EQ(seen(y, x)++, 0);
          ++total;
        }
      }
      EXPECT_EQ(total, count);
      int expected = 0;
      for (int y = -16; y <= 16; ++y) {
        for (int x = -16; x <= 16; ++x) {
          const int c = at.x() + x, r = at.y() + y;
          const bool inside = c >= 0 && r >= 0 && c < kSize.width && r < kSize.height;
          if (inside && mask(r, c) != 0 && (!circle || std::hypot(x, y) <= 16.5)) ++expected;
        }
      }
      EXPECT_EQ(count, expected);
    }
  }
}

TEST(SubsetSums, OfTheReferenceEqualTheirScalarTwins) {
  const Pair& pair = Pair::OfDegree(5);
  const Image<std::uint8_t> mask = Holes();
  PackedSubset subset;
  for (const int side : kSides) {
    for (const bool circle : {false, true}) {
      const SubsetOutline outline = OutlineOf(side, circle);
      for (const bool masked : {false, true}) {
        for (const Eigen::Vector2i& at : {Eigen::Vector2i(52, 47), Eigen::Vector2i(3, 4),
                                          Eigen::Vector2i(116, 97), Eigen::Vector2i(60, 99)}) {
          const int count =
              Pack(pair.Planes(masked ? &mask : nullptr), outline, at.x(), at.y(), 100, subset);
          ExpectSameReferenceSums(subset, count, side / 2,
                                  Name(5, side, circle) + (masked ? ", masked" : ""));
        }
      }
    }
  }
}

// At rest; strained by 20 %; turned by 30 degrees too; and bent by up to a pixel at the border of
// the subset; foreshortened by 7 % with shear, as between two cameras; and with a bend that turns
// round within the subset.
constexpr int kWarpKinds = 6;
SubsetWarp WarpFor(int side, const Eigen::Vector2d& shift, int kind) {
  const double r = side / 2;
  SubsetWarp warp = SubsetWarp::Of(shift);
  if (kind == 0) return warp;
  if (kind >= 4) {
    warp.c.block<2, 2>(0, 1) << -0.07, 0.03, kind == 4 ? 0.05 : 0.0, -0.02;
    if (kind == 5) warp.c.col(3) << 0, 1.4 / (r * r);
    return warp;
  }
  Eigen::Matrix2d to = Eigen::Rotation2Dd(kind == 1 ? 0 : std::numbers::pi / 6).toRotationMatrix();
  to.row(0) *= 1.2;
  to.row(1) *= 0.95;
  warp.c.block<2, 2>(0, 1) = to - Eigen::Matrix2d::Identity();
  if (kind == 3) {
    warp.c.col(3) << 1 / (r * r), -0.5 / (r * r);
    warp.c.col(4) << -0.6 / (r * r), 0.8 / (r * r);
    warp.c.col(5) << 0.4 / (r * r), 0.7 / (r * r);
  }
  return warp;
}

TEST(SubsetSums, OfTheTargetEqualTheirScalarTwinsUnderAnyWarp) {
  const Image<std::uint8_t> mask = Holes();
  const Eigen::Vector2i at(58, 49);
  PackedSubset subset;
  for (const int degree : kDegrees) {
    const Pair& pair = Pair::OfDegree(degree);
    for (const int side : kSides) {
      for (const bool circle : {false, true}) {
        for (const bool masked : {false, true}) {
          const int count = Pack(pair.Planes(masked ? &mask : nullptr), OutlineOf(side, circle),
                                 at.x(), at.y(), 100, subset);
          for (int kind = 0; kind < kWarpKinds; ++kind) {
            const SubsetWarp warp = WarpFor(side, {2.3, -1.6}, kind);
            ExpectSameTargetSums(subset, pair.Target(at, warp), count, side / 2,
                                 Name(degree, side, circle) + ", warp " + std::to_string(kind));
          }
        }
      }
    }
  }
}

TEST(SubsetSums, OfTheTargetEqualTheirScalarTwinsAtAllPhases) {
  const Eigen::Vector2i at(58, 49);
  PackedSubset subset;
  for (const int degree : kDegrees) {
    const Pair& pair = Pair::OfDegree(degree);
    const int count = Pack(pair.Planes(), OutlineOf(17, false), at.x(), at.y(), 100, subset);
    for (int i = -8; i <= 8; ++i) {
      for (int j = 0; j < 8; ++j) {
        const SubsetWarp warp = SubsetWarp::Of({i / 8.0, j / 8.0 + 1e-7});
        ExpectSameTargetSums(subset, pair.Target(at, warp), count, 8,
                             Name(degree, 17, false) + " at " + std::to_string(i) + "/8, " +
                                 std::to_string(j) + "/8");
      }
    }
  }
}

TEST(SubsetSums, OfSubsetsCutByTheImageEqualTheirScalarTwins) {
  PackedSubset subset;
  for (const int degree : kDegrees) {
    const Pair& pair = Pair::OfDegree(degree);
    for (const Eigen::Vector2i& at : {Eigen::Vector2i(5, 40), Eigen::Vector2i(114, 50),
                                      Eigen::Vector2i(60, 4), Eigen::Vector2i(114, 95)}) {
      const int count = Pack(pair.Planes(), OutlineOf(33, false), at.x(), at.y(), 100, subset);
      // Into the image, so that every pixel that counts stays inside.
      const Eigen::Vector2d inwards(at.x() < 60 ? 0.7 : -0.7, at.y() < 50 ? 0.2 : -0.2);
      ExpectSameTargetSums(subset, pair.Target(at, SubsetWarp::Of(inwards)), count, 16,
                           Name(degree, 33, false) + ", cut");
    }
  }
}

// The sums of order 0 and 1 do not use the second order of a warp.
TEST(SubsetSums, OfLowOrderUseTheAffineWarp) {
  const Eigen::Vector2i at(58, 49);
  const Pair& pair = Pair::OfDegree(5);
  PackedSubset subset;
  Pack(pair.Planes(), OutlineOf(21, false), at.x(), at.y(), 100, subset);
  SubsetWarp bent = WarpFor(21, {1.2, 0.4}, 3), affine = bent;
  affine.c.rightCols<3>().setZero();
  const TargetSums with = SumTarget(subset, pair.Target(at, bent), 1);
  const TargetSums without = SumTarget(subset, pair.Target(at, affine), 1);
  EXPECT_EQ(with.fg, without.fg);
  EXPECT_NE(SumTarget(subset, pair.Target(at, bent), 2).fg, without.fg);
}

TEST(SubsetSums, AreTheSameWithinRoundingOnEveryInstructionSet) {
  const Image<std::uint8_t> mask = Holes();
  const Eigen::Vector2i at(58, 49);
  const std::string best = SumsInstructionSet();
  int sets = 0;
  std::string names;
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    names += std::string(SumsInstructionSet()) + ' ';
    EXPECT_STREQ(SumsInstructionSet(), hwy::TargetName(target));
    ++sets;
    PackedSubset subset;
    for (const int degree : kDegrees) {
      const Pair& pair = Pair::OfDegree(degree);
      for (const int side : {7, 33}) {
        const int count =
            Pack(pair.Planes(&mask), OutlineOf(side, true), at.x(), at.y(), 100, subset);
        const std::string what = Name(degree, side, true) + " on " + SumsInstructionSet();
        ExpectSameReferenceSums(subset, count, side / 2, what);
        for (int kind = 0; kind < kWarpKinds; ++kind) {
          ExpectSameTargetSums(subset, pair.Target(at, WarpFor(side, {2.3, -1.6}, kind)), count,
                               side / 2, what);
        }
      }
    }
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
  EXPECT_EQ(SumsInstructionSet(), best);
  EXPECT_GE(sets, 1);
  RecordProperty("instruction_sets", names);
}

}  // namespace
}  // namespace plumbline::internal
