#include "match/correlate_field.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "calib/error.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::RenderedSpeckleOptions;
using testing::RenderSpeckle;

constexpr ImageSize kSize{260, 240};
constexpr int kEdge = 4;  // px at the border that the filter spoils

GrayImage Reference(std::uint32_t noise_seed = 1) {
  return RenderSpeckle(
      kSize, [](const Eigen::Vector2d& p) { return p; }, 1, noise_seed);
}

// p -> about + shift + F (p - about): a motion of the whole plane.
struct Motion {
  Eigen::Matrix2d F = Eigen::Matrix2d::Identity();
  Eigen::Vector2d shift{0, 0};
  Eigen::Vector2d about{130, 120};

  Eigen::Vector2d To(const Eigen::Vector2d& p) const { return about + shift + F * (p - about); }
  Eigen::Vector2d From(const Eigen::Vector2d& p) const {
    return about + F.inverse() * (p - about - shift);
  }
  GrayImage Render(const RenderedSpeckleOptions& options = {}) const {
    return RenderSpeckle(
        kSize, [this](const Eigen::Vector2d& p) { return From(p); }, 1, 2, options);
  }
};

FieldOptions Options(int subset_px = 25, int step_px = 8, int order = 1) {
  FieldOptions options;
  options.correlator.subset_px = subset_px;
  options.correlator.order = order;
  options.step_px = step_px;
  return options;
}

struct Verdict {
  int expected = 0;     // points whose subset stays inside the deformed image
  int found = 0;        // of those
  double worst_px = 0;  // of those off by more than five of their own sigmas
};

Verdict Judge(const PlanarField& field, const Motion& motion) {
  Verdict verdict;
  const double r = field.subset_px / 2;
  for (int row = 0; row < field.size().height; ++row) {
    for (int column = 0; column < field.size().width; ++column) {
      const Eigen::Vector2d p = field.PixelOf(row, column);
      bool inside = true;
      for (const Eigen::Vector2d& corner : {Eigen::Vector2d(-r, -r), Eigen::Vector2d(r, -r),
                                            Eigen::Vector2d(-r, r), Eigen::Vector2d(r, r)}) {
        const Eigen::Vector2d to = motion.To(p + corner);
        inside = inside && to.minCoeff() >= kEdge && to.x() <= kSize.width - 1 - kEdge &&
                 to.y() <= kSize.height - 1 - kEdge;
      }
      verdict.expected += inside ? 1 : 0;
      const bool ok = field.status(row, column) == Status::kOk;
      const Eigen::Vector2d u = field.displacement_px(row, column);
      EXPECT_EQ(ok, u.allFinite());
      EXPECT_EQ(ok, field.gradient(row, column).allFinite());
      EXPECT_EQ(ok, field.cov_displacement_px2(row, column).allFinite());
      if (!ok) continue;
      verdict.found += inside ? 1 : 0;
      const Eigen::Vector3f cov = field.cov_displacement_px2(row, column);
      const double off = (u - (motion.To(p) - p)).norm();
      if (off > 5 * std::sqrt(cov[0] + cov[2])) verdict.worst_px = std::max(verdict.worst_px, off);
    }
  }
  return verdict;
}

void ExpectFound(const CorrelatedField& result, const Motion& motion, double share,
                 const char* what) {
  const Verdict verdict = Judge(result.field, motion);
  EXPECT_LT(verdict.worst_px, 0.1) << what;
  EXPECT_GT(verdict.expected, 20) << what;
  EXPECT_GE(verdict.found, share * verdict.expected)
      << what << ": " << verdict.found << " of " << verdict.expected;
}

Eigen::Matrix2d Turned(double degrees) {
  return Eigen::Rotation2Dd(degrees * std::numbers::pi / 180).toRotationMatrix();
}

TEST(CorrelateField, FindsRotationStrainAndHalfTheImageWithoutHelp) {
  const FieldCorrelator correlator(Reference(), Options());
  Motion turned, stretched, far, all;
  turned.F = Turned(30);
  stretched.F << 1.2, 0, 0, 0.93;
  far.shift = {125.3, -4.7};
  all.F = Turned(-30) * stretched.F;
  all.shift = {-20.4, 11.2};
  for (const auto& [motion, name] : {std::pair(turned, "turned"),
                                     {stretched, "stretched"},
                                     {far, "far"},
                                     {all, "all"},
                                     {Motion(), "still"}}) {
    ExpectFound(correlator.Correlate(motion.Render()), motion, 0.98, name);
  }
}

// Strain from -0.1 to 0.1 across the image, half a pixel of second order in a subset.
TEST(CorrelateField, FindsASecondOrderFieldThatMovedFar) {
  constexpr double kBend = 4e-4, kFar = 60.4;
  const FieldCorrelator correlator(Reference(), Options(33, 8, 2));
  const GrayImage deformed = RenderSpeckle(
      kSize,
      [](const Eigen::Vector2d& p) {
        return Eigen::Vector2d(p.x() - kFar + kBend * std::pow(p.x() - 130, 2), p.y() - 2.2);
      },
      1, 2);
  const CorrelatedField result = correlator.Correlate(deformed);
  int ok = 0, inside = 0;
  for (int row = 0; row < result.field.size().height; ++row) {
    for (int column = 0; column < result.field.size().width; ++column) {
      const Eigen::Vector2d p = result.field.PixelOf(row, column);
      // kBend z^2 + z + 130 - kFar - p.x = 0 with z = to.x - 130.
      const double z = (std::sqrt(1 - 4 * kBend * (130 - kFar - p.x())) - 1) / (2 * kBend);
      const Eigen::Vector2d to(130 + z, p.y() + 2.2);
      inside += to.x() < kSize.width - 23 && to.y() < kSize.height - 21 ? 1 : 0;
      if (result.field.status(row, column) != Status::kOk) continue;
      ++ok;
      EXPECT_LT((result.field.displacement_px(row, column) - (to - p)).norm(), 0.1);
    }
  }
  EXPECT_GE(ok, 0.98 * inside) << inside;
  EXPECT_EQ(result.counts.not_found_back, 0);
}

TEST(CorrelateField, CountsWhatBecameOfThePoints) {
  Image<std::uint8_t> mask(kSize, 1);
  for (int y = 0; y < kSize.height; ++y)
    std::fill(mask.row(y) + 200, mask.row(y) + 260, std::uint8_t{0});
  Motion motion;
  motion.shift = {-40.2, 3.1};
  const CorrelatedField result =
      FieldCorrelator(Reference(), Options(), mask).Correlate(motion.Render());
  const FieldCounts& counts = result.counts;
  EXPECT_EQ(counts.points, static_cast<std::int64_t>(result.field.status.pixel_count()));
  std::int64_t sum = 0;
  for (std::size_t s = 0; s < counts.by_status.size(); ++s) {
    sum += counts.by_status[s];
    const auto here = std::count(result.field.status.values().begin(),
                                 result.field.status.values().end(), static_cast<Status>(s));
    EXPECT_EQ(counts.by_status[s], here);
  }
  EXPECT_EQ(sum, counts.points);
  EXPECT_EQ(counts.ok, counts.by_status[0]);
  EXPECT_EQ(counts.attempted,
            counts.points - counts.by_status[static_cast<std::size_t>(Status::kMasked)]);
  EXPECT_EQ(counts.not_found_back + counts.isolated + counts.still,
            counts.by_status[static_cast<std::size_t>(Status::kFailedVerification)]);
  EXPECT_GT(counts.seeds, 0);
}

TEST(CorrelateField, GoesRoundAHoleInTheMask) {
  Image<std::uint8_t> mask(kSize, 255);
  for (int y = 0; y < kSize.height; ++y) {
    for (int x = 0; x < kSize.width; ++x) {
      if (std::hypot(x - 130, y - 120) < 40) mask(y, x) = 0;
    }
  }
  Motion motion;
  motion.F = Turned(4);
  motion.shift = {3.3, -2.2};
  GrayImage reference = Reference(), deformed = motion.Render();
  for (int y = 0; y < kSize.height; ++y) {  // another pattern in the hole
    for (int x = 0; x < kSize.width; ++x) {
      if (std::hypot(x - 130, y - 120) < 38)
        reference.grey(y, x) = static_cast<std::uint16_t>((x * x + y * 31) % 256);
      if ((motion.From({x, y}) - Eigen::Vector2d(130, 120)).norm() < 38)
        deformed.grey(y, x) = static_cast<std::uint16_t>((y * y + x * 17) % 256);
    }
  }
  const CorrelatedField result = FieldCorrelator(reference, Options(), mask).Correlate(deformed);
  const Verdict verdict = Judge(result.field, motion);
  EXPECT_LT(verdict.worst_px, 0.1);
  const auto masked = result.counts.by_status[static_cast<std::size_t>(Status::kMasked)];
  EXPECT_GE(verdict.found, 0.97 * static_cast<double>(verdict.expected - masked))
      << verdict.found << ' ' << verdict.expected << ' ' << masked;
}

TEST(CorrelateField, SeedsARegionAgainThatNothingLeadsTo) {
  Image<std::uint8_t> mask(kSize, 0);
  for (int y = 0; y < kSize.height; ++y) {
    std::fill(mask.row(y), mask.row(y) + 110, std::uint8_t{1});
    std::fill(mask.row(y) + 150, mask.row(y) + 260, std::uint8_t{1});
  }
  Motion motion;
  motion.shift = {7.3, 5.6};
  const FieldCorrelator correlator(Reference(), Options(), mask);
  const CorrelatedField result =
      correlator.CorrelateFrom(motion.Render(), {{{50, 50}, {7, 6}, Eigen::Matrix2d::Zero(), 1}});
  EXPECT_EQ(result.counts.seeds, 1);
  EXPECT_GT(result.counts.reseeded, 200);
  int left = 0, right = 0;
  for (int row = 0; row < result.field.size().height; ++row) {
    for (int column = 0; column < result.field.size().width; ++column) {
      if (result.field.status(row, column) != Status::kOk) continue;
      const Eigen::Vector3f cov = result.field.cov_displacement_px2(row, column);
      EXPECT_LT((result.field.displacement_px(row, column) - motion.shift).norm(),
                std::max(0.1F, 5 * std::sqrt(cov[0] + cov[2])));
      (result.field.PixelOf(row, column).x() < 130 ? left : right) += 1;
    }
  }
  EXPECT_GT(left, 250);
  EXPECT_GT(right, 200);
}

GrayImage Flat(std::uint16_t level) { return {Image<std::uint16_t>(kSize, level), 8}; }

void ExpectNothingOk(const CorrelatedField& result, const char* what) {
  EXPECT_EQ(result.counts.ok, 0) << what;
  for (const Eigen::Vector2d& u : result.field.displacement_px.values())
    EXPECT_TRUE(std::isnan(u.x()));
}

TEST(CorrelateField, FindsNothingWhereThereIsNothing) {
  RenderedSpeckleOptions other;
  other.pattern_seed = 99;
  const GrayImage unrelated = Motion().Render(other);
  const FieldCorrelator correlator(Reference(), Options());
  ExpectNothingOk(correlator.Correlate(unrelated), "unrelated");
  ExpectNothingOk(correlator.Correlate(Flat(0)), "black");
  ExpectNothingOk(correlator.Correlate(Flat(255)), "white");
  // Told where to start it finds nothing either.
  const std::vector<CorrelationSeed> seeds = SeedsFromAffine({}, kSize, nullptr, 20);
  ExpectNothingOk(correlator.CorrelateFrom(unrelated, seeds), "unrelated, from seeds");
  ExpectNothingOk(correlator.CorrelateFrom(Flat(255), seeds), "white, from seeds");
  for (const auto level : {std::uint16_t{0}, std::uint16_t{255}}) {
    const FieldCorrelator blank(Flat(level), Options());
    ExpectNothingOk(blank.Correlate(Flat(level)), "blank with blank");
    ExpectNothingOk(blank.Correlate(unrelated), "blank with speckle");
    const CorrelatedField told = blank.CorrelateFrom(Flat(level), seeds);
    ExpectNothingOk(told, "blank from seeds");
    EXPECT_GT(told.counts.by_status[static_cast<std::size_t>(Status::kLowTexture)], 0);
  }
}

// Rendered with a margin and cut, so that the blur of the border is that of the inside.
GrayImage Blurred(const Motion& motion, double sigma, std::uint32_t noise_seed) {
  constexpr int kRim = 24;
  const Eigen::Vector2d rim(kRim, kRim);
  GrayImage wide = RenderSpeckle(
      {kSize.width + 2 * kRim, kSize.height + 2 * kRim},
      [&](const Eigen::Vector2d& p) { return motion.From(p - rim); }, 1, noise_seed);
  cv::Mat1w view(wide.height(), wide.width(), wide.grey.data());
  cv::GaussianBlur(view, view, {}, sigma);
  GrayImage image{Image<std::uint16_t>(kSize), 8};
  for (int y = 0; y < kSize.height; ++y) {
    std::copy_n(wide.grey.row(y + kRim) + kRim, kSize.width, image.grey.row(y));
  }
  return image;
}

// What is delivered is within its own error bars.
void ExpectHonest(const CorrelatedField& result, const Motion& motion, const char* what) {
  for (int row = 0; row < result.field.size().height; ++row) {
    for (int column = 0; column < result.field.size().width; ++column) {
      if (result.field.status(row, column) != Status::kOk) continue;
      const Eigen::Vector2d p = result.field.PixelOf(row, column);
      const Eigen::Vector3f& cov = result.field.cov_displacement_px2(row, column);
      const double off = (result.field.displacement_px(row, column) - motion.To(p) + p).norm();
      EXPECT_LT(off, 6 * std::sqrt(static_cast<double>(cov[0] + cov[2]))) << what << " at " << p;
    }
  }
}

TEST(CorrelateField, IsHonestAboutBlurredImages) {
  Motion motion;
  motion.shift = {3.3, -2.2};
  ExpectHonest(FieldCorrelator(Reference(), Options()).Correlate(Blurred(motion, 2, 2)), motion,
               "sharp and blurred");
  const FieldCorrelator soft(Blurred({}, 2, 1), Options());
  const CorrelatedField result = soft.Correlate(Blurred(motion, 2, 2));
  EXPECT_GT(result.counts.ok, result.counts.points * 9 / 10);
  ExpectHonest(result, motion, "both blurred");
  const FieldCorrelator lost(Blurred({}, 6, 1), Options());
  ExpectHonest(lost.Correlate(Blurred(motion, 6, 2)), motion, "all but lost");
}

TEST(CorrelateField, StartsFromAPriorField) {
  Motion before, after;
  before.shift = {20.3, -2.2};
  after.shift = {20.9, -1.8};
  const FieldCorrelator correlator(Reference(), Options());
  PlanarField prior = correlator.Correlate(before.Render()).field;
  for (std::size_t i = 0; i < prior.status.pixel_count(); i += 3) {
    prior.displacement_px.data()[i].y() = std::nan("");
    prior.gradient.data()[i + 1](0, 0) = std::numeric_limits<float>::infinity();
  }
  ExpectFound(correlator.Correlate(after.Render(), {&prior}), after, 0.99, "prior with NaN");
  // A jump, and a frame before of which nothing is known.
  Motion jumped;
  jumped.shift = {-30.4, 12.6};
  ExpectFound(correlator.Correlate(jumped.Render(), {&prior}), jumped, 0.99, "jump");
  const PlanarField nothing = correlator.Correlate(Flat(0)).field;
  ExpectFound(correlator.Correlate(after.Render(), {&nothing}), after, 0.99, "nothing known");
}

TEST(CorrelateField, WorksOnImagesSmallerThanASeedsSubset) {
  const auto strip = [](double shift) {
    return RenderSpeckle(
        {180, 30},
        [&](const Eigen::Vector2d& p) -> Eigen::Vector2d {
          return {p.x() - shift, p.y()};
        },
        1, 3);
  };
  const CorrelatedField result = FieldCorrelator(strip(0), Options(21, 5)).Correlate(strip(6.4));
  EXPECT_GT(result.counts.ok, 25);  // one row of points
  for (const Eigen::Vector2d& u : result.field.displacement_px.values()) {
    if (u.allFinite()) {
      EXPECT_LT((u - Eigen::Vector2d(6.4, 0)).norm(), 0.1);
    }
  }
}

template <typename Error>
std::string MessageOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error& error) {
    return error.what();
  }
  return "no such error";
}

TEST(CorrelateField, RefusesBadInputInOneSentence) {
  const GrayImage tiny = RenderSpeckle(
      {5, 5}, [](const Eigen::Vector2d& p) { return p; }, 1, 1);
  EXPECT_THAT(MessageOf<InputError>([&] { FieldCorrelator(tiny, Options()); }),
              AllOf(HasSubstr("subset of 25 px"), HasSubstr("5 x 5")));
  EXPECT_THAT(MessageOf<InputError>([&] { FieldCorrelator(tiny, Options(5)).Correlate(tiny); }),
              AllOf(HasSubstr("subset"), HasSubstr("5 x 5")));
  EXPECT_THAT(MessageOf<InputError>([&] { FieldCorrelator(GrayImage(), Options()); }),
              HasSubstr("without pixels"));
  const GrayImage reference = Reference();
  EXPECT_THAT(MessageOf<InputError>([&] { FieldCorrelator(reference, Options(241)); }),
              AllOf(HasSubstr("subset of 241 px"), HasSubstr("260 x 240")));
  EXPECT_THAT(MessageOf<InputError>(
                  [&] { FieldCorrelator(reference, Options(), Image<std::uint8_t>(kSize, 0)); }),
              HasSubstr("mask leaves no point"));
  EXPECT_THAT(MessageOf<InputError>([&] {
                FieldCorrelator(reference, Options(), Image<std::uint8_t>({10, 20}, 1));
              }),
              AllOf(HasSubstr("mask"), HasSubstr("10 x 20")));
  EXPECT_THAT(MessageOf<InputError>([&] { FieldCorrelator(reference, Options()).Correlate(tiny); }),
              AllOf(HasSubstr("deformed"), HasSubstr("5 x 5"), HasSubstr("260 x 240")));
  const PlanarField prior({3, 4}, {0, 0}, 8);
  EXPECT_THAT(MessageOf<InputError>(
                  [&] { FieldCorrelator(reference, Options()).Correlate(reference, {&prior}); }),
              HasSubstr("grid"));
  EXPECT_THAT(MessageOf<UsageError>([&] { FieldCorrelator(reference, Options(24)); }),
              HasSubstr("odd number"));
  EXPECT_THAT(MessageOf<UsageError>([&] { FieldCorrelator(reference, Options(25, 0)); }),
              HasSubstr("step"));
  FieldOptions options = Options();
  options.seeds.fft.spacing_px = 0;
  EXPECT_THAT(MessageOf<UsageError>([&] { FieldCorrelator(reference, options); }),
              HasSubstr("spacing"));
  options = Options();
  options.verify_tolerance_px = 0;
  EXPECT_THAT(MessageOf<UsageError>([&] { FieldCorrelator(reference, options); }),
              HasSubstr("tolerance"));
  options = Options();
  options.first_px = {20, 20};
  EXPECT_THAT(MessageOf<InputError>([&] { FieldCorrelator(reference, options); }),
              HasSubstr("no point"));
}

}  // namespace
}  // namespace plumbline
