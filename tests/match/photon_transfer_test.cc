#include "match/photon_transfer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <vector>

#include "calib/error.h"
#include "tests/support/rendered_speckle.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;

using Scene = std::function<double(double x, double y)>;  // mean grey level

// Speckle of all grey levels from dark to bright.
double Speckle(double x, double y) {
  return 120 + 45 * std::sin(0.61 * x + 0.13 * y) + 45 * std::sin(0.47 * y - 0.21 * x) +
         10 * std::sin(1.1 * x + 0.9 * y);
}

struct Camera {
  double offset_grey2 = 0.5;
  double slope_grey = 0.03;
  int bits = 8;
  ImageSize size = {200, 160};
  std::mt19937_64 random{1};

  // Photons and read noise together as a normal deviate of their variance (Box and Muller).
  GrayImage Photograph(const Scene& scene) {
    const auto uniform = [&] { return (static_cast<double>(random() >> 11) + 0.5) * 0x1p-53; };
    GrayImage image{Image<std::uint16_t>(size), bits};
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        const double mean = scene(x, y);
        const double normal = std::sqrt(-2 * std::log(uniform())) * std::cos(2 * M_PI * uniform());
        const double sigma = std::sqrt(offset_grey2 + slope_grey * std::max(0.0, mean));
        const double grey = std::round(mean + sigma * normal);
        image.grey(y, x) = static_cast<std::uint16_t>(
            std::clamp(grey, 0.0, static_cast<double>(image.max_level())));
      }
    }
    return image;
  }

  std::vector<GrayImage> Photographs(int count, const Scene& scene = Speckle) {
    std::vector<GrayImage> frames;
    for (int i = 0; i < count; ++i) frames.push_back(Photograph(scene));
    return frames;
  }
};

std::string Refusal(const std::vector<GrayImage>& frames) {
  try {
    FitPhotonTransfer(frames);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(PhotonTransfer, FindsTheLineWithinItsSigma) {
  for (const auto& [offset, slope] : {std::pair{0.5, 0.03}, {4.0, 0.002}, {0.2, 0.1}}) {
    Camera camera;
    camera.offset_grey2 = offset;
    camera.slope_grey = slope;
    const PhotonTransfer found = FitPhotonTransfer(camera.Photographs(6));
    EXPECT_NEAR(found.model.offset_grey2, offset, 3.5 * found.sigma_offset_grey2());
    EXPECT_NEAR(found.model.slope_grey, slope, 3.5 * found.sigma_slope_grey());
    EXPECT_LT(found.sigma_slope_grey(), 0.05 * slope + 5e-4);
    EXPECT_FALSE(found.constant);
    EXPECT_EQ(found.pairs, 5);
    EXPECT_GT(found.used_share, 0.9);
    EXPECT_LT(std::abs(found.neighbour_correlation), 0.02);
    EXPECT_LT(found.motion_px, 0.02);
    EXPECT_LT(found.chi2_per_dof, 2);
    EXPECT_TRUE(found.notes.empty()) << found.notes[0];
  }
}

TEST(PhotonTransfer, SigmasHoldOverNoiseDraws) {
  Camera camera;
  camera.size = {130, 130};
  constexpr int kDraws = 80;
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero(), claimed = Eigen::Matrix2d::Zero();
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  double nees = 0;
  for (int i = 0; i < kDraws; ++i) {
    const PhotonTransfer found = FitPhotonTransfer(camera.Photographs(3));
    const Eigen::Vector2d error(found.model.offset_grey2 - camera.offset_grey2,
                                found.model.slope_grey - camera.slope_grey);
    mean += error / kDraws;
    scatter += error * error.transpose() / kDraws;
    claimed += found.cov / kDraws;
    nees += error.dot(found.cov.inverse() * error) / kDraws;
  }
  EXPECT_NEAR(nees, 2, 4 * std::sqrt(4.0 / kDraws));
  for (int k = 0; k < 2; ++k) {
    EXPECT_NEAR(std::sqrt(scatter(k, k) / claimed(k, k)), 1, 0.25);
    EXPECT_LT(std::abs(mean[k]), 4 * std::sqrt(claimed(k, k) / kDraws));
  }
}

TEST(PhotonTransfer, TakesFlickerUnevenLightAndSmallMotionOut) {
  Camera camera;
  std::vector<GrayImage> frames;
  for (int i = 0; i < 6; ++i) {
    frames.push_back(camera.Photograph([&](double x, double y) {
      const double lamp = 1 + 0.08 * (i % 2) + 0.0004 * (i % 3) * (x - 0.7 * y);
      return lamp * (Speckle(x + 0.08 * (i % 2), y - 0.05 * (i % 3)) - 10);
    }));
  }
  const PhotonTransfer found = FitPhotonTransfer(frames);
  EXPECT_NEAR(found.model.offset_grey2, camera.offset_grey2, 4 * found.sigma_offset_grey2());
  EXPECT_NEAR(found.model.slope_grey, camera.slope_grey, 4 * found.sigma_slope_grey());
  EXPECT_NEAR(found.flicker, 0.08, 0.05);
  EXPECT_NEAR(found.motion_px, 0.12, 0.04);
}

TEST(PhotonTransfer, LeavesMovingSpotsOut) {
  Camera camera;
  std::vector<GrayImage> frames;
  for (int i = 0; i < 5; ++i) {
    frames.push_back(camera.Photograph([&](double x, double y) {
      const double dx = x - 40 - 9 * i, dy = y - 60;
      return dx * dx + dy * dy < 64 ? 210 : Speckle(x, y);
    }));
  }
  const PhotonTransfer found = FitPhotonTransfer(frames);
  EXPECT_NEAR(found.model.offset_grey2, camera.offset_grey2, 4 * found.sigma_offset_grey2());
  EXPECT_NEAR(found.model.slope_grey, camera.slope_grey, 4 * found.sigma_slope_grey());
  EXPECT_THAT(found.notes, Contains(HasSubstr("changed between frames")));
}

TEST(PhotonTransfer, LeavesClippedPixelsOut) {
  Camera camera;
  camera.offset_grey2 = 2;
  const auto stretched = [](double x, double y) { return 128 + 1.9 * (Speckle(x, y) - 120); };
  const PhotonTransfer found = FitPhotonTransfer(camera.Photographs(8, stretched));
  EXPECT_GT(found.black_share, 0.03);
  EXPECT_GT(found.white_share, 0.03);
  EXPECT_NEAR(found.model.offset_grey2, camera.offset_grey2, 4 * found.sigma_offset_grey2());
  EXPECT_NEAR(found.model.slope_grey, camera.slope_grey, 4 * found.sigma_slope_grey());

  // A sensor that saturates below the largest value of its file.
  std::vector<GrayImage> frames = camera.Photographs(8);
  for (GrayImage& frame : frames) {
    for (std::uint16_t& grey : frame.grey.values()) grey = std::min<std::uint16_t>(grey, 180);
  }
  const PhotonTransfer early = FitPhotonTransfer(frames);
  EXPECT_GT(early.white_share, 0.03);
  EXPECT_LT(early.highest_grey, 180);
  EXPECT_NEAR(early.model.slope_grey, camera.slope_grey, 4 * early.sigma_slope_grey());
}

TEST(PhotonTransfer, KnowsTwelveBits) {
  Camera camera;
  camera.bits = 12;
  camera.offset_grey2 = 60;
  camera.slope_grey = 0.4;
  const PhotonTransfer found = FitPhotonTransfer(
      camera.Photographs(4, [](double x, double y) { return 16 * Speckle(x, y); }));
  EXPECT_EQ(found.bits, 12);
  EXPECT_NEAR(found.model.offset_grey2, 60, 3.5 * found.sigma_offset_grey2());
  EXPECT_NEAR(found.model.slope_grey, 0.4, 3.5 * found.sigma_slope_grey());
}

TEST(PhotonTransfer, NarrowGreyLevelsGiveConstantNoise) {
  Camera camera;
  const PhotonTransfer found =
      FitPhotonTransfer(camera.Photographs(4, [](double, double) { return 100.3; }));
  EXPECT_TRUE(found.constant);
  EXPECT_EQ(found.model.slope_grey, 0);
  EXPECT_NEAR(found.model.offset_grey2, 0.5 + 0.03 * 100.3, 4 * found.sigma_offset_grey2());
  EXPECT_THAT(found.notes, Contains(HasSubstr("taken as constant")));
}

TEST(PhotonTransfer, TellsFilteredNoise) {
  Camera camera;
  std::vector<GrayImage> frames = camera.Photographs(3);
  for (GrayImage& frame : frames) {
    const GrayImage sharp = frame;
    for (int y = 0; y < frame.height(); ++y) {
      for (int x = 1; x < frame.width(); ++x) {
        frame.grey(y, x) =
            static_cast<std::uint16_t>((3 * sharp.grey(y, x) + sharp.grey(y, x - 1) + 2) / 4);
      }
    }
  }
  EXPECT_THAT(FitPhotonTransfer(frames).notes, Contains(HasSubstr("neighbouring pixels")));
}

TEST(PhotonTransfer, RefusesWhatTellsNothing) {
  Camera camera;
  EXPECT_THAT(Refusal({}), HasSubstr("there are none"));
  const std::vector<GrayImage> two = camera.Photographs(2);
  EXPECT_THAT(Refusal({two[0]}), HasSubstr("only 1"));
  EXPECT_THAT(Refusal({two[0], two[0], two[0]}), HasSubstr("the same, pixel by pixel"));
  EXPECT_THAT(Refusal(camera.Photographs(3, [](double, double) { return 400; })),
              HasSubstr("are saturated"));
  EXPECT_THAT(Refusal(camera.Photographs(3, [](double, double) { return -50; })),
              HasSubstr("are black"));
  Camera small = camera;
  small.size = {5, 5};
  EXPECT_THAT(Refusal(small.Photographs(3)), HasSubstr("larger images"));
  EXPECT_THAT(Refusal({two[0], small.Photograph(Speckle)}), HasSubstr("5x5 px"));
  const auto other = [](double x, double y) { return Speckle(0.8 * y + 31, 17 - 0.9 * x); };
  EXPECT_THAT(Refusal({two[0], camera.Photograph(other)}), HasSubstr("frames of one camera"));
}

TEST(PhotonTransfer, RefusesFramesThatMovedSayingHowMuch) {
  Camera camera;
  testing::SpecklePattern pattern({});
  for (const double step_px : {0.3, 0.6, 1.5, 6.0, 12.0}) {
    std::vector<GrayImage> frames;
    for (int i = 0; i < 3; ++i) {
      frames.push_back(camera.Photograph([&](double x, double y) {
        return pattern.GreyAt(Eigen::Vector2d(x + 0.8 * i * step_px, y - 0.6 * i * step_px));
      }));
    }
    const std::string message = Refusal(frames);
    ASSERT_THAT(message, HasSubstr("The picture moved by at least")) << step_px;
    const double said_px = std::stod(message.substr(message.find("least") + 6));
    EXPECT_NEAR(said_px, step_px, 0.35 * step_px);
  }
}

TEST(PhotonTransfer, LeavesOutTheFramesBetweenWhichTheCameraWasKnocked) {
  Camera camera;
  std::vector<GrayImage> frames = camera.Photographs(3);
  const auto moved = [](double x, double y) { return Speckle(x + 1, y); };
  for (const GrayImage& frame : camera.Photographs(3, moved)) frames.push_back(frame);
  const PhotonTransfer found = FitPhotonTransfer(frames);
  EXPECT_EQ(found.moved_pairs, 1);
  EXPECT_EQ(found.pairs, 4);
  EXPECT_THAT(found.notes, Contains(HasSubstr("1 of 5 pairs")));
  EXPECT_NEAR(found.model.slope_grey, camera.slope_grey, 4 * found.sigma_slope_grey());
}

TEST(PhotonTransfer, RefusesASceneThatChangesEverywhere) {
  Camera camera;
  std::vector<GrayImage> frames = camera.Photographs(3);
  for (GrayImage& frame : frames) {  // dust in the air
    for (int i = 0; i < 700; ++i) {
      const int x = static_cast<int>(camera.random() % 198),
                y = static_cast<int>(camera.random() % 158);
      const auto level = static_cast<std::uint16_t>(200 + camera.random() % 50);
      for (int k = 0; k < 4; ++k) frame.grey(y + k / 2, x + k % 2) = level;
    }
  }
  EXPECT_THAT(Refusal(frames), HasSubstr("changed between the frames in"));
}

TEST(PhotonTransfer, RealStillFramesOfTwoCameras) {
  PLUMBLINE_SHARED_DATA(bar, "stereodic-static-bar");
  for (const char* camera : {"_0.png", "_1.png"}) {
    PhotonTransferFit fit;
    for (const char* number : {"0000", "0001", "0002", "0005"}) {
      GrayImage image;
      const cv::Mat grey =
          cv::imread((bar / "images" / ("img_" + std::string(number) + camera)).string(),
                     cv::IMREAD_UNCHANGED);
      ASSERT_EQ(grey.type(), CV_8UC1);
      image.grey = Image<std::uint16_t>({grey.cols, grey.rows});
      for (int y = 0; y < grey.rows; ++y)
        std::copy_n(grey.ptr<unsigned char>(y), grey.cols, image.grey.row(y));
      fit.Add(image);
    }
    const PhotonTransfer found = fit.Fit();
    EXPECT_EQ(found.pairs, 3);
    EXPECT_LT(found.motion_px, 0.06);
    // Halves of consecutive differences, flicker removed by other means (a Gaussian of 20 px), give
    // 0.85 and 1.5 grey levels squared at level 30, and 1.55 and 2.35 at 84.
    const bool left = camera[1] == '0';
    EXPECT_NEAR(found.model.Variance(30), left ? 0.83 : 1.35, 0.15);
    EXPECT_NEAR(found.model.Variance(84), left ? 1.53 : 2.25, 0.2);
    EXPECT_GT(found.model.slope_grey, 10 * found.sigma_slope_grey());
  }
}

TEST(PhotonTransfer, MaskChoosesThePixels) {
  Camera camera;
  const auto half = [](double x, double y) { return x < 100 ? Speckle(x, y) : 128; };
  Image<std::uint8_t> mask(camera.size, 0);
  for (int y = 0; y < camera.size.height; ++y) {
    for (int x = 110; x < camera.size.width; ++x) mask(y, x) = 255;
  }
  PhotonTransferFit fit({}, mask);
  for (const GrayImage& frame : camera.Photographs(3, half)) fit.Add(frame);
  const PhotonTransfer found = fit.Fit();
  EXPECT_TRUE(found.constant);
  EXPECT_NEAR(found.lowest_grey, 128, 10);
  PhotonTransferFit other({}, Image<std::uint8_t>({5, 5}, 1));
  EXPECT_THROW(other.Add(camera.Photograph(half)), InputError);
}

}  // namespace
}  // namespace plumbline
