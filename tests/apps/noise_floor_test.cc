#include "apps/noise_floor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <nlohmann/json.hpp>
#include <random>
#include <vector>

#include "apps/internal/surface_points.h"
#include "apps/stereo_run.h"
#include "calib/error.h"
#include "io/image_writer.h"
#include "io/rig_file.h"
#include "io/series_reader.h"
#include "tests/support/plumbline_command.h"
#include "tests/support/rendered_surface.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;

using testing::CommandResult;
using testing::ConvergentRig;
using ::testing::HasSubstr;
using testing::RunPlumbline;
using testing::SpeckledSheet;
using testing::TestFolder;

constexpr double kNoiseGrey = 2;
constexpr ImageSize kSize{400, 300};

StereoRig Rig() { return ConvergentRig(kSize, 1500, 400, 110); }

// The sheet of a static set, which drifts a little as a whole from pair to pair.
SpeckledSheet Sheet(int frame, double drift_mm) {
  SpeckledSheet sheet;
  const double t = drift_mm * frame;
  sheet.rig_from_sheet =
      Rigid3::FromRotationVector({0.05, -0.1, 0.1 + 0.002 * t}, {t, -0.5 * t, 400 + 2 * t});
  return sheet;
}

// noise_grey of the right camera: another than of the left one.
StereoFrame Photograph(const StereoRig& rig, int frame, double drift_mm,
                       double noise_grey = kNoiseGrey) {
  const SpeckledSheet sheet = Sheet(frame, drift_mm);
  const auto seed = static_cast<std::uint32_t>(100 + 2 * frame);
  StereoFrame pair;
  pair.index = frame;
  pair.time_s = frame;
  pair.left = sheet.Left(rig, noise_grey, seed);
  pair.right = sheet.Right(rig, 1.5 * noise_grey, seed + 1);
  return pair;
}

// claimed: the noise that the run is told of, over the true one.
NoiseFloor Measure(int frames, double drift_mm, double claimed = 1) {
  const StereoRig rig = Rig();
  StereoRunOptions options;
  options.sequence.field.correlator.subset_px = 21;
  options.sequence.field.step_px = 7;
  const double variance = std::pow(claimed * kNoiseGrey, 2);
  options.sequence.field.correlator.noise = NoiseModel{variance, 0};
  options.sequence.right_noise = NoiseModel{2.25 * variance, 0};
  options.evaluation.strain_options.window_points = 5;
  options.evaluation.count_left_out = false;
  StereoRun run(rig, Photograph(rig, 0, drift_mm), options);
  NoiseFloorMeasurement floor(run.Header(), run.correlation_area_points());
  for (int k = 0; k < frames; ++k) floor.Add(run.Measure(Photograph(rig, k, drift_mm), k).frame);
  return floor.Result();
}

template <typename Components>
void ExpectRatio(const Components& components, double ratio, double tolerance, const char* name) {
  for (std::size_t i = 0; i < components.size(); ++i) {
    const FloorComponent& c = components[i];
    SCOPED_TRACE(std::string(name) + " " + std::to_string(i));
    std::cout << name << " " << i << ": noise " << c.noise << ", predicted " << c.predicted
              << ", ratio " << c.ratio() << " +- " << c.sigma_ratio << ", together " << c.common
              << ", bias " << c.bias << " of " << c.predicted_bias << std::endl;
    EXPECT_NEAR(c.ratio(), ratio, tolerance * ratio);
    EXPECT_NEAR(c.bias / c.predicted_bias, ratio, 2 * tolerance * ratio);
  }
}

TEST(NoiseFloor, OfStaticPairsIsThatOfTheirSigmas) {
  const NoiseFloor floor = Measure(6, 0);
  EXPECT_EQ(floor.frames, 6);
  EXPECT_GT(floor.points, 1500);
  EXPECT_EQ(floor.subset_px, 21);
  EXPECT_EQ(floor.vsg_px, 4 * 7 + 21);
  EXPECT_EQ(floor.frame, "ground");
  ExpectRatio(floor.left_px, 1, 0.05, "left");
  ExpectRatio(floor.right_px, 1, 0.05, "right");
  ExpectRatio(floor.displacement_mm, 1, 0.05, "displacement");
  ASSERT_TRUE(floor.strain);
  ExpectRatio(*floor.strain, 1, 0.08, "strain");
  // Nothing moved: what all points share is a small part of the noise.
  EXPECT_LT(floor.left_px[0].common, 0.25 * floor.left_px[0].noise);
  EXPECT_LT(floor.displacement_mm[2].common, 0.25 * floor.displacement_mm[2].noise);
}

// Few points and much noise: what the motions that are taken out take of it counts. Independent
// draws, a bent surface that is not level, and six times as much noise along z.
TEST(NoiseFloor, CountsTheNoiseThatGoesWithTheMotion) {
  constexpr ImageSize kGrid{6, 5};
  constexpr std::size_t kPoints = 30;
  constexpr int kLater = 600;
  constexpr double kSigmaPx = 0.01;
  const Eigen::Vector3d sigma_mm(0.01, 0.012, 0.06);
  std::mt19937 random(3);
  std::normal_distribution<double> gauss;
  const auto draw2 = [&] {
    return (kSigmaPx * Eigen::Vector2d(gauss(random), gauss(random))).eval();
  };
  const auto draw3 = [&] {
    return sigma_mm.cwiseProduct(Eigen::Vector3d(gauss(random), gauss(random), gauss(random)))
        .eval();
  };
  SeriesHeader header{
      .rig = Rig(), .grid_px = {}, .recipe_toml = {}, .inputs = {}, .rig_extras = {}};
  NoiseFloorMeasurement floor(header, 1);
  std::vector<Eigen::Vector3d> first_mm(kPoints), now_mm(kPoints);
  std::vector<Eigen::Vector2d> first_left(kPoints);
  for (int k = 0; k <= kLater; ++k) {
    SeriesFrame frame;
    frame.surface.status = Image<Status>(kGrid, Status::kOk);
    frame.surface.position_mm = Image<Eigen::Vector3f>(kGrid, Eigen::Vector3f::Zero());
    frame.displacement.value_mm = Image<Eigen::Vector3f>(kGrid, Eigen::Vector3f::Zero());
    frame.displacement.sigma_random_mm =
        Image<Eigen::Vector3f>(kGrid, (std::sqrt(2) * sigma_mm).cast<float>());
    // Of the left match half the variance is the reference's, as of the right one.
    const auto variance = static_cast<float>(2 * kSigmaPx * kSigmaPx);
    MatchField& match = frame.match;
    match.left_displacement_px = match.right_displacement_px =
        Image<Eigen::Vector2f>(kGrid, Eigen::Vector2f::Zero());
    match.left_cov_px2 = match.right_cov_px2 =
        Image<Eigen::Vector3f>(kGrid, Eigen::Vector3f(variance, 0, variance));
    match.left_reference_share = match.right_reference_share = Image<float>(kGrid, 0.5F);
    for (std::size_t i = 0; i < kPoints; ++i) {
      const std::size_t row = i / 6, column = i % 6;
      const double x = 10.0 * static_cast<double>(column), y = 10.0 * static_cast<double>(row);
      now_mm[i] = Eigen::Vector3d(x, y, 0.5 * x + 0.01 * (y - 20) * (y - 20)) + draw3();
      const Eigen::Vector2d left = draw2();
      if (k == 0) first_mm[i] = now_mm[i];
      if (k == 0) first_left[i] = left;
      frame.surface.position_mm.data()[i] = now_mm[i].cast<float>();
      frame.displacement.value_mm.data()[i] = (now_mm[i] - first_mm[i]).cast<float>();
      match.left_displacement_px.data()[i] = (left - first_left[i]).cast<float>();
      match.right_displacement_px.data()[i] = draw2().cast<float>();
    }
    const Rigid3 motion = internal::BestRigidMotion(first_mm, now_mm);
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& p : first_mm) centre += p / kPoints;
    frame.rigid_motion.found = true;
    frame.rigid_motion.rotation_rad = motion.RotationVector();
    frame.rigid_motion.translation_mm = motion * centre - centre;
    floor.Add(frame);
  }
  const NoiseFloor found = floor.Result();
  EXPECT_EQ(found.points, 30);
  EXPECT_FALSE(found.strain);
  // 18000 values: the ratio is known to 0.5 %. The rigid motion takes 5 % of the noise along z, and
  // hands some of that on to x, where it adds 9 %.
  for (const auto* image : {&found.left_px, &found.right_px}) {
    for (const FloorComponent& c : *image) EXPECT_NEAR(c.ratio(), 1, 0.02);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const FloorComponent& c = found.displacement_mm[i];
    std::cout << "ratio " << c.ratio() << ", of the noise with motion "
              << c.noise / (std::sqrt(2) * sigma_mm[static_cast<Eigen::Index>(i)]) << std::endl;
    EXPECT_NEAR(c.ratio(), 1, 0.02);
  }
}

TEST(NoiseFloor, TellsMotionApart) {
  constexpr double kDrift = 0.05;  // mm a pair
  const NoiseFloor floor = Measure(4, kDrift);
  ExpectRatio(floor.left_px, 1, 0.08, "left");
  ExpectRatio(floor.right_px, 1, 0.08, "right");
  ExpectRatio(floor.displacement_mm, 1, 0.08, "displacement");
  ExpectRatio(*floor.strain, 1, 0.12, "strain");
  // Pairs 1 to 3 moved by (1, -0.5, 2) drifts more each in the rig frame; they hardly turned.
  double square = 0;
  for (const FloorComponent& c : floor.displacement_mm) square += c.common * c.common;
  const double rms = kDrift * Eigen::Vector3d(1, -0.5, 2).norm() * std::sqrt((1 + 4 + 9) / 3.0);
  EXPECT_NEAR(std::sqrt(square), rms, 0.03 * rms);
  EXPECT_GT(floor.left_px[0].common, 5 * floor.left_px[0].noise);
}

TEST(NoiseFloor, ShowsSigmasThatAreTooSmall) {
  constexpr double kClaimed = 0.5;
  const NoiseFloor floor = Measure(3, 0, kClaimed);
  const double noise = kNoiseGrey * kNoiseGrey;
  const double ratio = std::sqrt((noise + kRoundingVarianceGrey2) /
                                 (kClaimed * kClaimed * noise + kRoundingVarianceGrey2));
  ExpectRatio(floor.left_px, ratio, 0.08, "left");
  ExpectRatio(floor.displacement_mm, ratio, 0.08, "displacement");
  ExpectRatio(*floor.strain, ratio, 0.15, "strain");
}

TEST(NoiseFloor, NeedsTwoGoodPairs) {
  EXPECT_THROW(Measure(1, 0), InputError);
  NoiseFloorMeasurement none(
      {.rig = Rig(), .grid_px = {}, .recipe_toml = {}, .inputs = {}, .rig_extras = {}}, 1);
  SeriesFrame bad;
  bad.problem = "truncated";
  none.Add(bad);
  EXPECT_THROW(none.Result(), InputError);
}

// --- As a user calls it --------------------------------------------------------------------------

TEST(NoiseCommand, MeasuresTheFloorOfARig) {
  const fs::path f = TestFolder();
  const StereoRig rig = Rig();
  WriteRigFile(f / "rig.h5", rig);
  for (int k = 0; k < 3; ++k) {
    const StereoFrame pair = Photograph(rig, k, 0, 1);
    WritePng(f / ("left_" + std::to_string(k) + ".png"), pair.left);
    WritePng(f / ("right_" + std::to_string(k) + ".png"), pair.right);
  }
  const auto path = [&](const char* name) { return (f / name).string(); };
  const std::string images =
      " --left '" + path("left_*.png") + "' --right '" + path("right_*.png") + "' ";
  const std::string call = "noise --rig " + path("rig.h5") + images + "-o " + path("noise.toml") +
                           " --floor " + path("floor.h5") + " --subset 21 --strain-window 5";
  const CommandResult words = RunPlumbline(call + " 2>&1");
  ASSERT_EQ(words.exit_code, 0) << words.output;
  EXPECT_THAT(words.output, HasSubstr("Noise floor of 3 static pairs (2 differences a point)"));
  EXPECT_THAT(words.output, HasSubstr("take ten or more"));

  const NoiseFile file = ReadNoiseFile(f / "noise.toml");
  EXPECT_NEAR(std::sqrt(file.cameras.at("left").model.Variance(120)), 1, 0.03);
  EXPECT_NEAR(std::sqrt(file.cameras.at("right").model.Variance(120)), 1.5, 0.04);
  ASSERT_TRUE(file.floor);
  EXPECT_EQ(file.floor->frames, 3);
  EXPECT_NEAR(file.floor->displacement_mm[2].ratio(), 1, 0.1);

  const SeriesReader series(f / "floor.h5");
  EXPECT_EQ(series.frame_count(), 3);
  EXPECT_THAT(RunPlumbline(call).output, HasSubstr("--overwrite"));
  const CommandResult again = RunPlumbline(call + " --overwrite --json -q 2>/dev/null");
  const auto json = nlohmann::json::parse(again.output);
  EXPECT_NEAR(json["floor"]["strain"]["noise"][0].get<double>(), (*file.floor->strain)[0].noise,
              1e-12);
  EXPECT_TRUE(json["left"].contains("curve"));

  // A later run takes the cameras' noise from it, and names it.
  const CommandResult run =
      RunPlumbline("measure --matcher dic --rig " + path("rig.h5") + images + "-q -o " +
                   path("run.h5") + " --noise " + path("noise.toml"));
  EXPECT_EQ(run.exit_code, 0) << run.output;
  EXPECT_THAT(SeriesReader(f / "run.h5").facts().inputs_json, HasSubstr("noise.toml"));
}

TEST(NoiseCommand, RefusesWhatIsNeitherACameraNorARig) {
  for (const char* arguments :
       {"", "--images a --left b --right c", "--images a --rig r.h5",
        "--left a --right b --roi 0,0,9,9", "--rig r --left a --right b --strategy incremental"}) {
    EXPECT_EQ(RunPlumbline(std::string("noise ") + arguments).exit_code, 2) << arguments;
  }
}

// A bar at rest. The calibration beside the images is not theirs: it fits the matches that it lists
// itself to 0.1 px, while those of the images lie 23 px from their epipolar lines and fit, to 0.02
// px, with the right camera turned by 12 degrees more. The program that the set comes from
// triangulates all the same. So does this, with tolerances to match: lengths are then only about
// right.
TEST(NoiseCommand, FindsTheFloorOfARealBarAtRest) {
  PLUMBLINE_SHARED_DATA(bar, "stereodic-static-bar");
  const fs::path output = TestFolder() / "noise.toml";
  const std::string call = "noise --rig " + (bar / "reference_DICe/cal.xml").string() +
                           " --left '" + (bar / "images/img_*_0.png").string() + "' --right '" +
                           (bar / "images/img_*_1.png").string() +
                           "' --roi 160,300,940,240 --subset 29 --max-seed-epipolar 60 "
                           "--epipolar-tolerance 60 -o " +
                           output.string();
  const CommandResult found = RunPlumbline(call + " 2>&1");
  ASSERT_EQ(found.exit_code, 0) << found.output;
  std::cout << found.output;
  const NoiseFloor floor = *ReadNoiseFile(output).floor;
  EXPECT_EQ(floor.points, 3078);
  for (const auto* image : {&floor.left_px, &floor.right_px}) {
    for (const FloorComponent& c : *image) {
      EXPECT_LT(c.noise, 0.010);
      EXPECT_NEAR(c.ratio(), 1, 0.2);
    }
  }
  EXPECT_LT(floor.displacement_mm[2].noise, 0.005);
  for (const FloorComponent& c : floor.displacement_mm) EXPECT_NEAR(c.ratio(), 1, 0.1);
  for (const FloorComponent& c : *floor.strain) EXPECT_NEAR(c.ratio(), 1, 0.15);
}

}  // namespace
}  // namespace plumbline
