#include "io/virtual_rig/virtual_rig.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>
#include <opencv2/video/tracking.hpp>

#include "calib/error.h"
#include "tests/io/virtual_rig/mrcal_check.h"

namespace plumbline {
namespace {

TEST(VirtualRig, TruePixelsAreMrcalsProjections) {
  testing::ExpectMrcalProjectsTheTruth(VirtualRig(MakeScenario("tyre-disturbed")), 7);
}

cv::Mat Patch(const Image<float>& image, const Eigen::Vector2i& corner, int size) {
  cv::Mat patch(size, size, CV_32F);
  for (int r = 0; r < size; ++r) {
    for (int c = 0; c < size; ++c) {
      patch.at<float>(r, c) = image(corner.y() + r, corner.x() + c);
    }
  }
  return patch;
}

// Where OpenCV's ECC finds the middle of a patch of `first` in `second`, started from the nearest
// whole pixel.
std::optional<Eigen::Vector2d> FindByEcc(const Image<float>& first, const Image<float>& second,
                                         const Eigen::Vector2i& middle,
                                         const Eigen::Vector2d& near) {
  constexpr int kHalf = 18, kReach = 26;
  const Eigen::Vector2i whole = near.array().round().cast<int>();
  const auto inside = [&](const Eigen::Vector2i& p) {
    return p.x() >= kReach && p.y() >= kReach && p.x() < first.width() - kReach &&
           p.y() < first.height() - kReach;
  };
  if (!inside(middle) || !inside(whole)) return std::nullopt;
  const cv::Mat reference = Patch(first, middle - Eigen::Vector2i::Constant(kHalf), 2 * kHalf + 1);
  const cv::Mat search = Patch(second, whole - Eigen::Vector2i::Constant(kReach), 2 * kReach + 1);
  cv::Mat warp = (cv::Mat_<float>(2, 3) << 1, 0, kReach - kHalf, 0, 1, kReach - kHalf);
  try {
    cv::findTransformECC(
        reference, search, warp, cv::MOTION_AFFINE,
        cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 80, 1e-7), cv::noArray(),
        3);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  const auto at = [&](int row) {
    return static_cast<double>(warp.at<float>(row, 0) * kHalf + warp.at<float>(row, 1) * kHalf +
                               warp.at<float>(row, 2)) -
           kReach;
  };
  return Eigen::Vector2d(whole.cast<double>() + Eigen::Vector2d(at(0), at(1)));
}

// Where an affine fit must put the middle of a patch: the mean of the true displacements over it.
std::optional<Eigen::Vector2d> TrueMiddle(const TrueFrame& before, const TrueFrame& after,
                                          Side side, const Eigen::Vector2d& middle) {
  Eigen::Vector2d moved(0, 0);
  for (int k = 0; k < 25; ++k) {
    const Eigen::Vector2d from = middle + 7.5 * Eigen::Vector2d(k % 5 - 2, k / 5 - 2);
    const auto here = before.UnderLeftPixel(from);
    if (!here) return std::nullopt;
    const TruePoint there = after.OfMaterial(here->material_mm);
    moved += ((side == Side::kLeft ? there.left_px : there.right_px) - from) / 25;
  }
  if (!moved.allFinite()) return std::nullopt;
  return middle + moved;
}

// Motion between frames, and between the cameras, by a method that is not ours. ECC interpolates
// linearly: each patch may be off by some hundredths, which average out over sub-pixel places.
void ExpectEccAgrees(const Scenario& scenario, Side second_side, int step_px, int least_patches) {
  const VirtualRig rig(scenario);
  const int second_frame = second_side == Side::kLeft ? 1 : 0;
  const Image<float> first = rig.MeanImage(0, Side::kLeft);
  const Image<float> second = rig.MeanImage(second_frame, second_side);
  const auto before = rig.Truth(0), after = rig.Truth(second_frame);
  Eigen::Vector2d sum(0, 0), squares(0, 0);
  Eigen::Vector2d halves[4] = {{0, 0}, {0, 0}, {0, 0}, {0, 0}};
  int count = 0, counts[4] = {};
  for (int y = 30; y < first.height() - 30; y += step_px) {
    for (int x = 30; x < first.width() - 30; x += step_px) {
      const auto truth = TrueMiddle(*before, *after, second_side, Eigen::Vector2d(x, y));
      if (!truth) continue;
      const auto found = FindByEcc(first, second, {x, y}, *truth);
      if (!found || (*found - *truth).norm() > 0.5) continue;
      sum += *found - *truth;
      squares += (*found - *truth).cwiseAbs2();
      ++count;
      for (const int k : {x < first.width() / 2 ? 0 : 1, y < first.height() / 2 ? 2 : 3}) {
        halves[k] += *found - *truth;
        ++counts[k];
      }
    }
  }
  ASSERT_GT(count, least_patches) << scenario.name;
  const Eigen::Vector2d mean = sum / count;
  std::printf("%s: %d patches, mean %.4f %.4f px, rms %.3f %.3f px\n", scenario.name.c_str(), count,
              mean.x(), mean.y(), std::sqrt(squares.x() / count), std::sqrt(squares.y() / count));
  EXPECT_LT(mean.cwiseAbs().maxCoeff(), 0.005) << scenario.name << ": " << mean.transpose();
  EXPECT_LT((squares / count).cwiseSqrt().maxCoeff(), 0.06) << scenario.name;
  // Nor do errors of opposite sign hide each other: the halves of the image agree too.
  for (int k = 0; k < 4; ++k) {
    const Eigen::Vector2d half = halves[k] / counts[k];
    EXPECT_LT(half.cwiseAbs().maxCoeff(), 0.012) << scenario.name << " " << k;
  }
}

Scenario Quiet(const std::string& name) {
  Scenario scenario = MakeScenario(name);
  scenario.exposure_s = 0;
  return scenario;
}

TEST(VirtualRig, EccBetweenFramesAgreesWithTheTruth) {
  ExpectEccAgrees(Quiet("stretch"), Side::kLeft, 41, 350);
  Scenario turning = Quiet("rigid");
  turning.frames_per_second *= 12;  // smaller steps
  ExpectEccAgrees(turning, Side::kLeft, 24, 350);
  Scenario rolling = Quiet("tyre-flat");
  rolling.frames_per_second = 400;
  ExpectEccAgrees(rolling, Side::kLeft, 23, 250);
}

TEST(VirtualRig, EccBetweenTheCamerasAgreesWithTheTruth) {
  ExpectEccAgrees(Quiet("tyre-lifted"), Side::kRight, 20, 200);
}

TEST(VirtualRig, BrightnessFlickersBetweenFrames) {
  Scenario scenario = MakeScenario("still", RigKind::kWide640);
  scenario.lighting.flicker = 0.05;
  scenario.frames = 8;
  const VirtualRig rig(scenario);
  std::vector<double> means;
  for (int i = 0; i < scenario.frames; ++i) {
    const Image<float> image = rig.MeanImage(i, Side::kLeft);
    double sum = 0;
    for (const float grey : image.values()) sum += static_cast<double>(grey);
    means.push_back(sum / static_cast<double>(image.pixel_count()));
  }
  const auto [low, high] = std::minmax_element(means.begin(), means.end());
  EXPECT_GT(*high / *low, 1.02);
  EXPECT_LT(*high / *low, 1.4);
}

TEST(VirtualRig, DisturbancesAreInTheTruth) {
  const Scenario still = MakeScenario("cleat-lateral-square38");
  const VirtualRig steady(still), disturbed(MakeScenario("tyre-disturbed"));
  double largest_pitch = 0, largest_turn = 0;
  for (int i = 0; i < 12; ++i) {
    const double t = steady.FrameTime(i);
    const auto turn = [](const Rigid3& a, const Rigid3& b) {
      return (a * b.Inverse()).RotationVector().norm();
    };
    EXPECT_LT(turn(steady.GroundFromRig(t), steady.GroundFromRig(0)), 1e-12);
    EXPECT_LT(turn(steady.RightFromLeft(t), still.rig.right_from_left), 1e-15);
    largest_pitch =
        std::max(largest_pitch, turn(disturbed.GroundFromRig(t), steady.GroundFromRig(t)));
    largest_turn =
        std::max(largest_turn, turn(disturbed.RightFromLeft(t), still.rig.right_from_left));
    // The right camera turns about its own centre.
    EXPECT_LT((disturbed.RightFromLeft(t).Inverse().translation_mm -
               still.rig.right_from_left.Inverse().translation_mm)
                  .norm(),
              1e-9);
  }
  EXPECT_GT(largest_pitch, 0.03);  // rad: a few degrees
  EXPECT_LT(largest_pitch, 0.09);
  EXPECT_GT(largest_turn, 1e-4);
}

TEST(VirtualRig, DisturbancesHaveTheirSign) {
  Scenario scenario = MakeScenario("cleat-lateral-square50");
  scenario.motion = {};
  const VirtualRig level(scenario);
  scenario.motion.wheelbase_mm = 2794;
  const VirtualRig pitching(scenario);
  const double on_the_bar_s = 0.11;
  ASSERT_GT(level.tyre()->Wheel(on_the_bar_s).centre_height_mm, 390);
  // The axle rises and the nose with it: what points ahead points up.
  const auto ahead = [&](const VirtualRig& rig) -> Eigen::Vector3d {
    const Rigid3 ground_from_rig = rig.GroundFromRig(on_the_bar_s);
    return ground_from_rig.rotation.col(0);
  };
  EXPECT_GT(ahead(pitching).z(), ahead(level).z() + 1e-3);

  // Speeding up turns the torque arm backwards about the axle: about +y, its lower end to the rear.
  scenario.motion = {};
  scenario.motion.flexure_rad_per_m_s2 = 0.02;
  auto& tyre = std::get<TyreOptions>(scenario.surface);
  tyre.speed_swing_mm_s = 200;
  const VirtualRig flexing(scenario);
  ASSERT_GT(flexing.tyre()->Wheel(0).acceleration_mm_s2, 1000);
  EXPECT_LT(flexing.GroundFromRig(0).translation_mm.x(),
            level.GroundFromRig(0).translation_mm.x() - 1);

  // Sliding to its left, the wheel heads to the right of the way it goes.
  scenario = MakeScenario("tyre-cornering");
  scenario.motion = {};
  const VirtualRig cornering(scenario);
  const Rigid3 turned = cornering.GroundFromRig(0) * scenario.ground_from_rig.Inverse();
  const Eigen::Vector3d heading = turned.rotation.col(0);
  EXPECT_NEAR(std::atan2(heading.y(), heading.x()), -3 * std::numbers::pi / 180, 1e-12);
}

// By just the delay: what it takes is what cameras without it take one frame later, where frames
// follow each other so fast.
TEST(VirtualRig, TheRightCameraExposesLaterWhereAsked) {
  Scenario scenario = MakeScenario("tyre-disturbed");
  scenario.lighting.flicker = 0;
  scenario.dropped.clear();
  scenario.right_delay_s = 0;
  scenario.frames = 2;
  scenario.frames_per_second = 500;
  Scenario late = scenario;
  late.frames_per_second = 50;
  late.right_delay_s = 2e-3;
  const VirtualRig a(scenario), b(late);
  EXPECT_EQ(a.MeanImage(0, Side::kLeft).values(), b.MeanImage(0, Side::kLeft).values());
  EXPECT_NE(a.MeanImage(0, Side::kRight).values(), b.MeanImage(0, Side::kRight).values());
  EXPECT_EQ(a.MeanImage(1, Side::kRight).values(), b.MeanImage(0, Side::kRight).values());
}

// As one would measure the noise of a real camera: a scene that stands still, the same pixels again
// and again. The variance goes with the mean as stated, in each part of the scale.
TEST(VirtualRig, NoiseOfAStillSceneIsThePhotonTransferThatWasAskedFor) {
  Scenario scenario = MakeScenario("still", RigKind::kWide640);
  scenario.lighting.flicker = 0;
  scenario.frames = 6;
  scenario.sensor.gain_grey = 0.05;
  scenario.sensor.read_noise_grey = 0.7;
  const VirtualRig rig(scenario);
  std::vector<GrayImage> images;
  for (int i = 0; i < scenario.frames; ++i) images.push_back(rig.TakeImage(i, Side::kRight));
  const Image<float> mean = rig.MeanImage(0, Side::kRight);
  constexpr int kBins = 8;
  double variance[kBins] = {}, expected[kBins] = {};
  int counts[kBins] = {};
  for (std::size_t i = 0; i < mean.pixel_count(); ++i) {
    const auto grey = static_cast<double>(mean.data()[i]);
    const int bin = static_cast<int>(grey / 25);
    if (bin < 0 || bin >= kBins) continue;
    double sum = 0, squares = 0;
    for (const GrayImage& image : images) {
      const double value = image.grey.data()[i];
      sum += value;
      squares += value * value;
    }
    variance[bin] += (squares - sum * sum / scenario.frames) / (scenario.frames - 1);
    expected[bin] += 0.05 * grey + 0.49 + 1.0 / 12;  // photons, reading, rounding
    ++counts[bin];
  }
  int filled = 0;
  for (int bin = 0; bin < kBins; ++bin) {
    if (counts[bin] < 2000) continue;
    ++filled;
    // A variance of n values with 5 degrees of freedom each scatters by sqrt(2 / (5 n)).
    EXPECT_NEAR(variance[bin] / expected[bin], 1, 5 * std::sqrt(0.4 / counts[bin])) << bin;
  }
  EXPECT_GE(filled, 5);
}

TEST(VirtualRig, IsAnImageSourceWithoutTheDroppedFrames) {
  Scenario scenario = MakeScenario("still", RigKind::kWide640);
  scenario.frames = 5;
  scenario.dropped = {1, 3};
  const auto source = OpenVirtualRig(std::make_shared<const VirtualRig>(scenario));
  EXPECT_EQ(source->DeclaredCount(), 3);
  std::vector<std::string> names;
  std::vector<double> times;
  while (const auto frame = source->Next()) {
    names.push_back(frame->left_id);
    times.push_back(frame->time_s);
    EXPECT_EQ(frame->left.size(), (ImageSize{640, 480}));
  }
  EXPECT_THAT(names, ::testing::ElementsAre("left_00000", "left_00002", "left_00004"));
  EXPECT_NEAR(times[2] - times[1], 0.2, 1e-12);
  EXPECT_THAT(source->Notes(), ::testing::ElementsAre("2 of 5 frames were dropped"));
}

TEST(Scenarios, ArePlentyAndAllCanBeMade) {
  const std::vector<ScenarioEntry> entries = ListScenarios();
  for (const ScenarioEntry& entry : entries) {
    EXPECT_NO_THROW(MakeScenario(entry.name).Check()) << entry.name;
    EXPECT_NO_THROW(VirtualRig(MakeScenario(entry.name, RigKind::kWide1280))) << entry.name;
    EXPECT_EQ(entry.summary.find('\n'), std::string::npos);
  }
  // Every test of the thesis.
  for (const char* section :
       {"5.1:", "5.3.1:", "5.3.2:", "5.3.3:", "5.3.4:", "5.3.5:", "5.3.6:", "5.3.7:"}) {
    EXPECT_TRUE(std::any_of(entries.begin(), entries.end(), [&](const ScenarioEntry& entry) {
      return entry.summary.rfind(section, 0) == 0;
    })) << section;
  }
}

TEST(Scenarios, RefuseWhatTheyCannotBe) {
  EXPECT_THROW(MakeScenario("tyre-square"), UsageError);
  Scenario scenario = MakeScenario("still");
  scenario.dropped = {99};
  EXPECT_THROW(VirtualRig{scenario}, UsageError);
  scenario.dropped = {0};  // the reference
  EXPECT_THROW(VirtualRig{scenario}, UsageError);
  scenario = MakeScenario("tyre-flat");
  scenario.frames = 2;
  scenario.dropped = {0, 1};
  EXPECT_THROW(VirtualRig{scenario}, UsageError);
  scenario = MakeScenario("tyre-flat");
  std::get<TyreOptions>(scenario.surface).speed_mm_s = 1e4;
  scenario.exposure_s = 0.01;  // a blur of 100 mm
  EXPECT_THROW(VirtualRig{scenario}, UsageError);
  scenario = MakeScenario("tyre-flat", MakeRig({}), 350);  // beyond the hub
  EXPECT_THROW(VirtualRig{scenario}, UsageError);
  scenario = MakeScenario("still");
  scenario.exposure_s = 1;
  EXPECT_THROW(VirtualRig{scenario}, UsageError);
}

}  // namespace
}  // namespace plumbline
