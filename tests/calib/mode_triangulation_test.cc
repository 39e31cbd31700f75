#include "calib/mode_triangulation.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <random>

#include "calib/triangulate.h"

namespace plumbline {
namespace {

using Pixels = std::vector<Eigen::Vector2d>;

LensModel Splined(int order) {
  return LensModel::FromName("splined_stereographic_order=" + std::to_string(order) +
                             "_Nx=14_Ny=11_fov_x_deg=110");
}

Camera MakeCamera(const LensModel& model, double shift_px) {
  Eigen::VectorXd p = Eigen::VectorXd::Zero(model.ParameterCount());
  if (model.IsSplined()) {  // a fisheye of 95 degrees with bumps
    p.head<4>() << 700 + shift_px, 702, 640, 480 - shift_px;
    std::mt19937 rng(3);
    std::normal_distribution<double> bump(0, 0.005);
    for (Eigen::Index i = 4; i < p.size(); ++i) p[i] = bump(rng);
  } else {  // a lens of 65 degrees that moves the corners of the image by some 150 px
    p.head<4>() << 1000 + shift_px, 1003, 640, 480 - shift_px;
    const double d[] = {-0.27, 0.09, 1e-3, -7e-4, -0.01, 0.02, 0.01, 0.003};
    for (Eigen::Index i = 4; i < p.size(); ++i) p[i] = d[i - 4];
  }
  return Camera(model, {1280, 960}, p);
}

// Every mode moves everything: lenses by parts of a pixel, principal points largely made up for by
// turns, as a calibration has them.
StereoRig MakeRig(const LensModel& model, int modes = 7) {
  StereoRig rig{MakeCamera(model, 0),
                MakeCamera(model, 9),
                Rigid3::FromRotationVector({0.012, 0.33, -0.02}, {-121, 2, 20}),
                {},
                ""};
  rig.modes.modes = Eigen::MatrixXd::Zero(modes, rig.ParameterCount());
  std::mt19937 rng(5);
  std::normal_distribution<double> n(0, 1);
  const int P = rig.left.parameter_count();
  for (int k = 0; k < modes; ++k) {
    auto mode = rig.modes.modes.row(k);
    for (const int first : {0, P}) {
      for (int i = 0; i < 4; ++i) mode[first + i] = n(rng);
      for (int i = 4; i < P; ++i) mode[first + i] = (model.IsSplined() ? 5e-4 : 1e-3) * n(rng);
    }
    for (int i = 0; i < 3; ++i) mode[2 * P + i] = 3e-4 * n(rng);
    mode[2 * P + 1] += (mode[P + 2] - mode[2]) / rig.left.parameters()[0];
    for (int i = 3; i < 6; ++i) mode[2 * P + i] = 0.05 * n(rng);
  }
  return rig;
}

// Pixels of points all over the left image, 350 to 450 mm away, that the right camera sees too.
void See(const StereoRig& rig, int count, Pixels* left, Pixels* right) {
  std::mt19937 rng(11);
  std::uniform_real_distribution<double> x(-0.5, 1279.5), y(-0.5, 959.5), z(350, 450);
  std::normal_distribution<double> noise(0, 0.1);
  while (static_cast<int>(left->size()) < count) {
    const Eigen::Vector2d q(x(rng), y(rng));
    const Eigen::Vector3d ray = rig.left.Unproject(q);
    const Eigen::Vector2d seen = rig.right.Project(rig.right_from_left * (ray / ray.z() * z(rng)));
    if (!rig.right.Contains(seen)) continue;
    left->push_back(q);
    right->push_back(seen + Eigen::Vector2d(noise(rng), noise(rng)));
  }
}

// What the fast way stands for: out[i * modes + k].
std::vector<Eigen::Vector3d> Outright(const StereoRig& rig, const Pixels& left,
                                      const Pixels& right) {
  const int modes = rig.modes.count();
  const auto nominal = TriangulatePoints(rig, left, right);
  std::vector<Eigen::Vector3d> out(left.size() * static_cast<std::size_t>(modes));
  for (int k = 0; k < modes; ++k) {
    const auto moved = TriangulatePoints(rig.AlongMode(k), left, right);
    for (std::size_t i = 0; i < left.size(); ++i) {
      out[i * static_cast<std::size_t>(modes) + static_cast<std::size_t>(k)] =
          moved[i] - nominal[i];
    }
  }
  return out;
}

std::vector<Eigen::Vector3f> Differences(const StereoRig& rig, const Pixels& left,
                                         const Pixels& right) {
  std::vector<Eigen::Vector3f> out(left.size() * static_cast<std::size_t>(rig.modes.count()));
  ModeTriangulation(rig).Differences(left, right, out);
  return out;
}

std::string LensName(const ::testing::TestParamInfo<LensModel>& info) {
  const char* const names[] = {"OpenCv4", "OpenCv5", "OpenCv8", "Quadratic", "Cubic"};
  return names[info.index];
}

class EveryLens : public ::testing::TestWithParam<LensModel> {};

TEST_P(EveryLens, DifferencesAreThoseOfTriangulatingAlongEachMode) {
  const StereoRig rig = MakeRig(GetParam());
  Pixels left, right;
  See(rig, 20000, &left, &right);
  const auto expected = Outright(rig, left, right);
  const auto found = Differences(rig, left, right);
  const auto modes = static_cast<std::size_t>(rig.modes.count());
  double square = 0;
  for (const Eigen::Vector3d& d : expected) square += d.squaredNorm();
  const double together_mm = std::sqrt(square / static_cast<double>(left.size()));
  std::vector<double> worst(modes);
  for (std::size_t i = 0; i < expected.size(); ++i) {
    const double error_mm = (found[i].cast<double>() - expected[i]).norm();
    const double allowed_mm = 1e-3 * expected[i].norm() + 2e-4 * together_mm;
    ASSERT_TRUE(std::isfinite(error_mm)) << left[i / modes].transpose();
    worst[i % modes] = std::max(worst[i % modes], error_mm / allowed_mm);
  }
  for (std::size_t k = 0; k < modes; ++k) EXPECT_LT(worst[k], 1) << "mode " << k;
}

// A length does not depend on the rigid motion of the rig, which is most of what modes do.
TEST_P(EveryLens, TheSigmaOfALengthIsThatOfTriangulatingAlongEachMode) {
  const StereoRig rig = MakeRig(GetParam());
  Pixels left, right;
  See(rig, 1000, &left, &right);
  const auto points = TriangulatePoints(rig, left, right);
  const auto expected = Outright(rig, left, right);
  const auto found = Differences(rig, left, right);
  const auto modes = static_cast<std::size_t>(rig.modes.count());
  for (std::size_t a = 0; a + 1 < points.size(); a += 2) {
    const Eigen::Vector3d along = (points[a + 1] - points[a]).normalized();
    double variance = 0, fast_variance = 0;
    for (std::size_t k = 0; k < modes; ++k) {
      const std::size_t i = a * modes + k;
      const double d = along.dot(expected[i + modes] - expected[i]);
      const double fast = along.dot((found[i + modes] - found[i]).cast<double>());
      variance += d * d;
      fast_variance += fast * fast;
    }
    EXPECT_NEAR(std::sqrt(fast_variance), std::sqrt(variance), 0.01 * std::sqrt(variance) + 1e-5);
  }
}

INSTANTIATE_TEST_SUITE_P(ModeTriangulation, EveryLens,
                         ::testing::Values(LensModel::FromName("opencv4"),
                                           LensModel::FromName("opencv5"),
                                           LensModel::FromName("opencv8"), Splined(2), Splined(3)),
                         LensName);

TEST(ModeTriangulation, TriangulatesOutrightWhereTheTableEnds) {
  // The left lens folds over in the corners of the image, the right pixels leave theirs.
  StereoRig rig = MakeRig(LensModel::FromName("opencv4"));
  Eigen::VectorXd p = rig.left.parameters();
  p.segment<4>(4) << -0.45, 0, 0, 0;
  rig.left = rig.left.WithParameters(p);
  Pixels left, right;
  for (double y = -20; y < 980; y += 11) {
    for (double x = -20; x < 1300; x += 13) {
      left.emplace_back(x, y);
      right.emplace_back(x - 350, y);
    }
  }
  left[5].x() = std::nan("");
  const auto expected = Outright(rig, left, right);
  const auto found = Differences(rig, left, right);
  std::size_t none = 0, outside = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    ASSERT_EQ(found[i].allFinite(), expected[i].allFinite()) << i;
    none += expected[i].allFinite() ? 0 : 1;
    if (!expected[i].allFinite() || rig.right.Contains(right[i / 7])) continue;
    ++outside;
    EXPECT_LT((found[i].cast<double>() - expected[i]).norm(), 1e-6 * expected[i].norm() + 1e-9);
  }
  EXPECT_GT(none, expected.size() / 50);
  EXPECT_GT(outside, expected.size() / 50);
}

TEST(ModeTriangulation, GivesNaNWhereRaysDoNotMeetInFront) {
  StereoRig rig = MakeRig(LensModel::FromName("opencv5"));
  const Pixels left = {{640, 480}}, behind = {{1200, 480}};
  ASSERT_FALSE(TriangulatePoints(rig, left, behind)[0].allFinite());
  for (const auto& d : Differences(rig, left, behind)) EXPECT_TRUE(d.array().isNaN().all());
  rig.right = rig.left;
  rig.right_from_left.rotation.setIdentity();
  rig.modes.modes.setZero();
  for (const auto& d : Differences(rig, left, left)) EXPECT_TRUE(d.array().isNaN().all());
}

TEST(ModeTriangulation, GivesTheSameBitsForAnyNumberOfThreadsAndGroupOfModes) {
  const StereoRig rig = MakeRig(LensModel::FromName("opencv8"));
  Pixels left, right;
  See(rig, 5003, &left, &right);
  std::vector<Eigen::Vector3f> one_thread;
  {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
    one_thread = Differences(rig, left, right);
  }
  EXPECT_EQ(Differences(rig, left, right), one_thread);
  const ModeTriangulation modes(rig);
  ASSERT_EQ(modes.count(), 7);
  for (const auto& [first, count] : {std::pair(0, 4), std::pair(3, 4), std::pair(6, 1)}) {
    std::vector<Eigen::Vector3f> part(left.size() * static_cast<std::size_t>(count));
    modes.Differences(left, right, first, count, part);
    for (std::size_t i = 0; i < part.size(); ++i) {
      const std::size_t point = i / static_cast<std::size_t>(count);
      const std::size_t k = i % static_cast<std::size_t>(count) + static_cast<std::size_t>(first);
      ASSERT_EQ(part[i], one_thread[point * 7 + k]);
    }
  }
}

TEST(ModeTriangulation, RefusesSpansAndModesThatDoNotFit) {
  const ModeTriangulation modes(MakeRig(LensModel::FromName("opencv4"), 2));
  const Pixels one(1), two(2);
  std::vector<Eigen::Vector3f> out(2);
  EXPECT_THROW(modes.Differences(one, two, out), std::invalid_argument);
  EXPECT_THROW(modes.Differences(two, two, out), std::invalid_argument);
  EXPECT_THROW(modes.Differences(one, one, 1, 2, out), std::invalid_argument);
  EXPECT_NO_THROW(modes.Differences(one, one, out));
  EXPECT_NO_THROW(
      ModeTriangulation(MakeRig(LensModel::FromName("opencv4"), 0)).Differences(one, one, {}));
}

}  // namespace
}  // namespace plumbline
