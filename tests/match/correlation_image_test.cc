#include "match/correlation_image.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/error.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {

GrayImage Speckle(ImageSize size, double noise = 0) {
  return testing::RenderSpeckle(
      size, [](const Eigen::Vector2d& p) { return p; }, noise, 1);
}

TEST(CorrelationImage, PassesThroughTheGreyLevelsWithoutAFilter) {
  const GrayImage image = Speckle({40, 30});
  for (const auto interpolation : {Interpolation::kCubic, Interpolation::kQuintic}) {
    const CorrelationImage prepared(image, {interpolation, Prefilter::kNone});
    EXPECT_EQ(prepared.size(), image.size());
    EXPECT_EQ(prepared.max_level(), 255);
    for (int y = 0; y < 30; ++y) {
      for (int x = 0; x < 40; ++x) {
        EXPECT_EQ(prepared.grey()(y, x), image.grey(y, x));
        EXPECT_NEAR(prepared.Value(Eigen::Vector2d(x, y)), image.grey(y, x), 1e-3);
      }
    }
  }
}

TEST(CorrelationImage, GradientsAreTheSplinesDerivatives) {
  for (const auto interpolation : {Interpolation::kCubic, Interpolation::kQuintic}) {
    for (const auto prefilter : {Prefilter::kNone, Prefilter::kLowPass, Prefilter::kGaussian}) {
      const CorrelationImage image(Speckle({40, 30}, 2), {interpolation, prefilter});
      for (const Eigen::Vector2i& at : {Eigen::Vector2i(20, 15), Eigen::Vector2i(0, 0),
                                        Eigen::Vector2i(39, 7), Eigen::Vector2i(3, 29)}) {
        const Eigen::Vector2d x(at.x(), at.y());
        const double h = 1e-3;
        const auto slope = [&](const Eigen::Vector2d& by) {
          return (image.Value(x + h * by) - image.Value(x - h * by)) / (2 * h);
        };
        EXPECT_NEAR(image.gradient_x()(at.y(), at.x()), slope({1, 0}), 0.02);
        EXPECT_NEAR(image.gradient_y()(at.y(), at.x()), slope({0, 1}), 0.02);
      }
    }
  }
}

// Between the pixels the spline is that of the coefficients, whose margin is mirrored.
TEST(CorrelationImage, MirrorsTheCoefficientsInAMargin) {
  for (const ImageSize size : {ImageSize{40, 30}, {5, 9}, {2, 1}, {1, 1}}) {
    const CorrelationImage image(Speckle(size, 1));
    const auto mirrored = [](int i, int n) {
      while (n > 1 && (i < 0 || i >= n)) i = i < 0 ? -i : 2 * (n - 1) - i;
      return n > 1 ? i : 0;
    };
    for (int y = -CorrelationImage::kMargin; y < size.height + CorrelationImage::kMargin; ++y) {
      for (int x = -CorrelationImage::kMargin; x < size.width + CorrelationImage::kMargin; ++x) {
        ASSERT_EQ(image.coefficients()[y * image.stride() + x],
                  image.coefficients()[mirrored(y, size.height) * image.stride() +
                                       mirrored(x, size.width)]);
      }
    }
  }
}

TEST(CorrelationImage, TakesImagesOfOneRowAndOneColumn) {
  for (const ImageSize size : {ImageSize{1, 1}, {2, 1}, {1, 2}, {30, 1}, {1, 30}}) {
    const GrayImage image = Speckle(size);
    const CorrelationImage prepared(image, {Interpolation::kQuintic, Prefilter::kNone});
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        EXPECT_NEAR(prepared.Value(Eigen::Vector2d(x, y)), image.grey(y, x), 1e-3);
        if (size.width == 1) {
          EXPECT_NEAR(prepared.gradient_x()(y, x), 0, 1e-4);
        }
      }
    }
  }
}

// The noise of a flat image, between the pixels, against its predicted share.
TEST(CorrelationImage, NoiseShareIsWhatIsLeftOfWhiteNoise) {
  const testing::RenderedSpeckleOptions flat{.contrast = 0, .mean_grey = 2000 / 16.0, .bits = 12};
  const GrayImage noise = testing::RenderSpeckle(
      {300, 300}, [](const Eigen::Vector2d& p) { return p; }, 2, 7, flat);
  const double sigma2 = 32.0 * 32 + 1 / 12.0;
  for (const auto interpolation : {Interpolation::kCubic, Interpolation::kQuintic}) {
    for (const auto prefilter : {Prefilter::kNone, Prefilter::kLowPass}) {
      const CorrelationImage image(noise, {interpolation, prefilter});
      double total = 0;
      for (const Eigen::Vector2d& at :
           {Eigen::Vector2d(0, 0), Eigen::Vector2d(0.5, 0.5), Eigen::Vector2d(0.25, 0.8)}) {
        double sum2 = 0;
        int count = 0;
        for (int y = 10; y < 290; y += 2) {
          for (int x = 10; x < 290; x += 2, ++count) {
            sum2 += std::pow(image.Value(Eigen::Vector2d(x, y) + at) - 2000, 2);
          }
        }
        EXPECT_NEAR(sum2 / count / sigma2, image.NoiseShare(at.x(), at.y()), 0.04);
        EXPECT_EQ(image.NoiseShare(at.x(), at.y()), image.NoiseShare(at.x() + 3, at.y() - 2));
      }
      for (int i = 0; i < 64; ++i) {
        for (int j = 0; j < 64; ++j) total += image.NoiseShare(i / 64.0, j / 64.0);
      }
      EXPECT_NEAR(image.MeanNoiseShare(), total / 4096, 1e-3);
    }
  }
}

// What lies beyond the border, or is masked, must not reach the pixels that are used.
TEST(CorrelationImage, PixelsAnEdgeAwayFromTheBorderDoNotSeeIt) {
  const GrayImage wide = Speckle({60, 60});
  GrayImage part{Image<std::uint16_t>({40, 40}), 8};
  for (int y = 0; y < 40; ++y) std::copy_n(wide.grey.row(y + 10) + 10, 40, part.grey.row(y));
  for (const auto interpolation : {Interpolation::kCubic, Interpolation::kQuintic}) {
    for (const auto prefilter : {Prefilter::kNone, Prefilter::kLowPass, Prefilter::kGaussian}) {
      const CorrelationImage a(wide, {interpolation, prefilter});
      const CorrelationImage b(part, {interpolation, prefilter});
      double at_border = 0, inside = 0;
      int border_count = 0, inside_count = 0;
      for (int y = 0; y < 40; ++y) {
        for (int x = 0; x < 40; ++x) {
          const int edge = std::min(std::min(x, 39 - x), std::min(y, 39 - y));
          const double off = std::abs(a.grey()(y + 10, x + 10) - b.grey()(y, x)) +
                             std::abs(a.gradient_x()(y + 10, x + 10) - b.gradient_x()(y, x));
          (edge >= b.edge_px() ? inside : at_border) += off * off;
          (edge >= b.edge_px() ? inside_count : border_count) += 1;
        }
      }
      EXPECT_LT(std::sqrt(inside / inside_count), 0.1 * std::sqrt(at_border / border_count));
    }
  }
}

TEST(CorrelationImage, RefusesWhatItCannotPrepare) {
  EXPECT_THROW(CorrelationImage(GrayImage{}, {}), InputError);
  CorrelationImageOptions options;
  options.prefilter = Prefilter::kGaussian;
  options.gaussian_sigma_px = 0;
  EXPECT_THROW(CorrelationImage(Speckle({5, 5}), options), UsageError);
  options.gaussian_sigma_px = std::nan("");
  EXPECT_THROW(options.Check(), UsageError);
  options = {};
  options.interpolation = static_cast<Interpolation>(4);
  EXPECT_THROW(options.Check(), UsageError);
}

}  // namespace
}  // namespace plumbline
