// Calibration of real and of simulated photographs whose results are known. The sets are described
// in ../shared/data.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numeric>
#include <random>

#include "calib/calibrate.h"
#include "calib/calibration_report.h"
#include "tests/support/real_photos.h"

namespace plumbline {
namespace {

constexpr double kDegrees = 180 / M_PI;

struct Photographs {
  BoardSpec board;
  ImageSize size;
  std::vector<CalibrationPair> pairs;
};

// Pairs of a folder whose left and right files sort alike, told apart by how their names begin or
// end; every step-th of them.
Photographs Detect(const std::filesystem::path& folder, const std::string& extension,
                   const std::string& left, const std::string& right, const std::string& word,
                   std::size_t step = 1) {
  Photographs out;
  out.board = BoardSpec::Parse(word);
  std::vector<std::filesystem::path> left_files, right_files;
  for (const auto& file : testing::PhotosIn(folder, extension)) {
    const std::string name = file.stem().string();
    if (name.starts_with(left) || name.ends_with(left)) left_files.push_back(file);
    if (name.starts_with(right) || name.ends_with(right)) right_files.push_back(file);
  }
  out.pairs.resize((left_files.size() + step - 1) / step);
  out.size = testing::ReadPhoto(left_files.front()).size();
  tbb::parallel_for(std::size_t{0}, out.pairs.size(), [&](std::size_t i) {
    const std::filesystem::path &l = left_files[i * step], &r = right_files[i * step];
    out.pairs[i].left_name = l.filename().string();
    out.pairs[i].right_name = r.filename().string();
    out.pairs[i].left = DetectBoard(out.board, testing::ReadPhoto(l));
    out.pairs[i].right = DetectBoard(out.board, testing::ReadPhoto(r));
  });
  return out;
}

Calibration CalibrateAll(const Photographs& photographs, CalibrationOptions options = {}) {
  options.model = LensModel::FromName("OPENCV5");
  return Calibrate(photographs.board, photographs.size, photographs.size, photographs.pairs,
                   options);
}

int Used(const Calibration& c) {
  return static_cast<int>(std::count_if(c.pairs.begin(), c.pairs.end(), [](const PairResult& p) {
    return p.used && p.problem.empty();
  }));
}

double StandardDeviation(const std::vector<double>& values) {
  const double mean =
      std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  double sum = 0;
  for (double v : values) sum += (v - mean) * (v - mean);
  return std::sqrt(sum / static_cast<double>(values.size() - 1));
}

// `step`: every so many pairs of them.
void ExpectDspecimenRig(const std::filesystem::path& folder, std::size_t step, int used) {
  const Calibration c =
      CalibrateAll(Detect(folder, ".jpeg", "_0", "_1", "donut-dots:14x10:7mm", step));
  std::printf("%s", CalibrationReport(c).c_str());
  EXPECT_EQ(Used(c), used);
  EXPECT_LE(c.joint_rms_px, 0.065);
  EXPECT_GT(c.rigid_rms_px, 0.12);
  EXPECT_NEAR(c.rig.baseline_mm(), 123.28, 0.05);
  EXPECT_NEAR(c.angle_rad * kDegrees, 18.88, 0.05);
  EXPECT_NEAR(c.target_rms_in_plane_mm, 0.017, 0.003);
  EXPECT_NEAR(c.target_rms_out_of_plane_mm, 0.007, 0.003);
}

TEST(CalibratePhotographs, DspecimenRigFromAThirdOfItsDonutDots) {
  PLUMBLINE_SHARED_DATA(folder, "stereodic-challenge-S3-Dspecimen-cal");
  ExpectDspecimenRig(folder, 3, 15);
}

TEST(CalibratePhotographs, ProveDspecimenRigFromDonutDots) {
  PLUMBLINE_SHARED_DATA(folder, "stereodic-challenge-S3-Dspecimen-cal");
  if (std::getenv("PLUMBLINE_PROVE") == nullptr)
    GTEST_SKIP() << "a long proof: ./bootstrap.sh prove";
  ExpectDspecimenRig(folder, 1, 44);
}

TEST(CalibratePhotographs, ProveDspecimenSigmaAgainstRandomHalves) {
  PLUMBLINE_SHARED_DATA(folder, "stereodic-challenge-S3-Dspecimen-cal");
  if (std::getenv("PLUMBLINE_PROVE") == nullptr)
    GTEST_SKIP() << "a long proof: ./bootstrap.sh prove";
  const Photographs all = Detect(folder, ".jpeg", "_0", "_1", "donut-dots:14x10:7mm");
  CalibrationOptions options;
  options.compare_halves = false;
  const Calibration whole = CalibrateAll(all, options);
  std::vector<double> baseline, angle, claimed_baseline, claimed_angle;
  std::mt19937 rng(1);
  constexpr int kHalves = 60;
  for (int h = 0; h < kHalves; ++h) {
    Photographs half = all;
    std::shuffle(half.pairs.begin(), half.pairs.end(), rng);
    half.pairs.resize(half.pairs.size() / 2);
    const Calibration c = CalibrateAll(half, options);
    baseline.push_back(c.rig.baseline_mm());
    angle.push_back(c.angle_rad * kDegrees);
    claimed_baseline.push_back(c.sigma_baseline_mm);
    claimed_angle.push_back(c.sigma_angle_rad * kDegrees);
  }
  // Halves drawn without replacement scatter about the whole by the standard deviation of the whole
  // (delete-half jackknife, Shao and Wu, Annals of Statistics 17, 1989): nothing is left to scale.
  const double scatter_mm = StandardDeviation(baseline), scatter_deg = StandardDeviation(angle);
  const double mean_claim_mm =
      std::accumulate(claimed_baseline.begin(), claimed_baseline.end(), 0.0) / kHalves;
  const double mean_claim_deg =
      std::accumulate(claimed_angle.begin(), claimed_angle.end(), 0.0) / kHalves;
  std::printf("| baseline mm | %.4f | %.4f | %.4f | %.2f |\n", scatter_mm, whole.sigma_baseline_mm,
              mean_claim_mm, whole.sigma_baseline_mm / scatter_mm);
  std::printf("| angle deg | %.4f | %.4f | %.4f | %.2f |\n", scatter_deg,
              whole.sigma_angle_rad * kDegrees, mean_claim_deg,
              whole.sigma_angle_rad * kDegrees / scatter_deg);
  EXPECT_NEAR(whole.sigma_baseline_mm / scatter_mm, 1, 0.3);
  EXPECT_NEAR(whole.sigma_angle_rad * kDegrees / scatter_deg, 1, 0.3);
}

TEST(CalibratePhotographs, SmallRigFromAPaperChessboard) {
  PLUMBLINE_SHARED_DATA(folder, "cal-chessboard-opencv-stereo");
  const Calibration c =
      CalibrateAll(Detect(folder, ".jpg", "left", "right", "chessboard:9x6:10mm"));
  EXPECT_EQ(Used(c), 13);
  EXPECT_LE(c.joint_rms_px, 0.11);
  EXPECT_NEAR(c.rig.baseline_mm(), 33.325, 0.04);
}

// cal-sim-known-truth: parameters that another code found from the same photographs and more,
// (left, right).
struct Gold {
  double fx[2] = {6673.3159, 6607.61}, fy[2] = {6669.3027, 6602.85};
  double cx[2] = {872.1577, 917.973}, cy[2] = {579.955, 531.635};
  Eigen::Vector3d t_mm = {122.2488, 1.84888, 17.62463};
  double beta_deg = -19.06769;
};

// And dots give the chessboard's baseline.
TEST(CalibratePhotographs, SimulatedBoardsGiveTheGoldParametersWithinTheirSigmas) {
  PLUMBLINE_SHARED_DATA(folder, "cal-sim-known-truth");
  const Calibration c = CalibrateAll(
      Detect(folder / "checkerboard_5mm_12x8", ".jpeg", "_0", "_1", "chessboard:12x8:5mm"));
  const Gold gold;
  const Eigen::VectorXd sigma = c.covariance.diagonal().cwiseSqrt();
  for (int camera : {0, 1}) {
    const Eigen::VectorXd p = (camera == 0 ? c.rig.left : c.rig.right).parameters();
    const double want[] = {gold.fx[camera], gold.fy[camera], gold.cx[camera], gold.cy[camera]};
    for (int i = 0; i < 4; ++i)
      EXPECT_LT(std::abs(p[i] - want[i]), 3 * sigma[9 * camera + i])
          << camera << " " << i << ": " << p[i];
  }
  for (int i = 0; i < 3; ++i)
    EXPECT_LT(std::abs(c.rig.right_from_left.translation_mm[i] - gold.t_mm[i]), 3 * sigma[21 + i])
        << i;
  const double beta_deg = std::asin(c.rig.right_from_left.rotation(2, 0)) * kDegrees;
  EXPECT_LT(std::abs(std::abs(beta_deg) - std::abs(gold.beta_deg)), 3 * sigma[19] * kDegrees);
  EXPECT_LT(c.joint_rms_px, 0.004);
  EXPECT_LT(c.sigma_baseline_mm, 0.003);
  const Calibration dots = CalibrateAll(
      Detect(folder / "donutdots_7mm_14x10", ".jpeg", "_0", "_1", "donut-dots:14x10:7mm"));
  const double difference_mm = dots.rig.baseline_mm() - c.rig.baseline_mm();
  std::printf("dots less chessboard: %.4f mm, sigmas %.4f and %.4f mm\n", difference_mm,
              dots.sigma_baseline_mm, c.sigma_baseline_mm);
  EXPECT_LT(std::abs(difference_mm), 3 * std::hypot(dots.sigma_baseline_mm, c.sigma_baseline_mm));
  EXPECT_LT(std::abs(difference_mm), 0.012);
}

}  // namespace
}  // namespace plumbline
