#include "fit/flat_contact.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "calib/error.h"
#include "fit/carcass_thickness.h"
#include "tests/support/tyre_frames.h"

namespace plumbline {
namespace {

using testing::TrueTyreFrame;
using testing::TyreFrame;
using testing::TyreScenario;
using testing::WithNoise;

constexpr double kDegree = std::numbers::pi / 180;

std::optional<FlatContact> Find(const TyreFrame& frame, const FlatContactOptions& options = {},
                                std::string* why = nullptr) {
  return FindFlatContact(frame.point_mm, frame.cov_mm2, frame.thickness_mm, frame.axis, options,
                         why);
}

double TiltInDegrees(const FlatContact& flat, const TyreFrame& frame) {
  return std::acos(std::min(1.0, flat.plane.normal.dot(frame.Ground().normal))) / kDegree;
}

TEST(CarcassThickness, IsAConstantOrASmoothCurveBetweenPlaces) {
  const CarcassThickness constant{{}, {20}};
  EXPECT_EQ(constant.At(-70), 20);
  const CarcassThickness map{{-80, 0, 80}, {22, 20, 24}};
  EXPECT_EQ(map.At(-80), 22);
  EXPECT_EQ(map.At(80), 24);
  EXPECT_EQ(map.At(0), 20);
  for (const double y : {-79.0, -40.0, -1.0, 1.0, 40.0, 79.0}) {  // never outside of its entries
    EXPECT_GT(map.At(y), 20) << y;
    EXPECT_LT(map.At(y), y < 0 ? 22 : 24) << y;
  }
  const CarcassThickness line{{-80, -10, 80}, {20, 27, 36}};
  EXPECT_NEAR(line.At(-50), 23, 1e-12);
  EXPECT_NEAR(line.At(40), 32, 1e-12);
  const CarcassThickness two{{0, 10}, {20, 22}};
  EXPECT_NEAR(two.At(2.5), 20.5, 1e-12);
  // A step that is smooth, from places 5 mm apart: straight lines would be off by 0.04.
  CarcassThickness smooth;
  const auto thickness = [](double y) { return 21 + std::tanh(y / 8); };
  for (double y = -80; y <= 80; y += 5) {
    smooth.y_mm.push_back(y);
    smooth.thickness_mm.push_back(thickness(y));
  }
  double worst = 0;
  for (double y = -80; y <= 80; y += 0.1) {
    worst = std::max(worst, std::abs(smooth.At(y) - thickness(y)));
  }
  EXPECT_LT(worst, 0.01);
  EXPECT_TRUE(std::isnan(map.At(81)));
  EXPECT_TRUE(std::isnan(map.At(NAN)));
  EXPECT_THROW((CarcassThickness{{0, 1}, {20}}).Check(), UsageError);
  EXPECT_THROW((CarcassThickness{{1, 0}, {20, 21}}).Check(), UsageError);
  EXPECT_THROW((CarcassThickness{{}, {-1}}).Check(), UsageError);
}

TEST(CarcassThickness, TellsWhatItsCurveMayLeaveOut) {
  CarcassThickness map;
  const auto thickness = [](double y) { return 21 + std::tanh(y / 8); };
  for (double y = -80; y <= 80; y += 5) {
    map.y_mm.push_back(y);
    map.thickness_mm.push_back(thickness(y));
  }
  double error = 0, claimed = 0;
  for (double y = -80; y <= 80; y += 0.1) {
    error += std::pow(map.At(y) - thickness(y), 2);
    claimed += std::pow(map.LeftOutAt(y), 2);
  }
  EXPECT_GT(claimed, 0.25 * error);
  EXPECT_LT(claimed, 4 * error);
  EXPECT_TRUE(std::isnan(map.LeftOutAt(81)));
  EXPECT_EQ((CarcassThickness{{}, {20}}).LeftOutAt(5), 0);
  EXPECT_NEAR((CarcassThickness{{-5, 5}, {20, 21}}).LeftOutAt(2), 0, 1e-12);
  // However far apart its entries are.
  const CarcassThickness coarse{{-79, -69, -59, 0, 59, 69, 79},
                                {22, 21.4, 20.2, 20, 20.2, 21.4, 22}};
  for (double y = -79; y <= 79; ++y) EXPECT_LT(std::abs(coarse.LeftOutAt(y)), 0.05) << y;
}

TEST(CarcassThickness, SharesAreTheDerivativesByTheEntries) {
  const CarcassThickness map{{-80, -45, -10, 30, 60, 80}, {22, 20.5, 20, 20.4, 21, 23}};
  for (const double y : {-79.0, -50.0, -20.0, 1.0, 44.0, 59.0, 75.0}) {
    const ThicknessShares shares = map.SharesAt(y);
    ASSERT_GT(shares.count, 2) << y;
    double sum = 0;
    for (std::size_t k = 0; k < map.y_mm.size(); ++k) {
      CarcassThickness more = map, less = map;
      more.thickness_mm[k] += 1e-3;
      less.thickness_mm[k] -= 1e-3;
      const bool in =
          k >= shares.first && k < shares.first + static_cast<std::size_t>(shares.count);
      const double share = in ? shares.share[k - shares.first] : 0;
      EXPECT_NEAR(share, (more.At(y) - less.At(y)) / 2e-3, 1e-4) << y << " " << k;
      sum += share;
    }
    EXPECT_NEAR(sum, 1, 1e-6) << y;
  }
  EXPECT_EQ(map.SharesAt(81).count, 0);
  EXPECT_EQ((CarcassThickness{{}, {20}}).SharesAt(5).share[0], 1);
}

TEST(CarcassThickness, HasTheModesOfWhatIsLeftOnceTheContactHasToldMore) {
  CarcassThickness map{{0, 10, 20}, {20, 21, 22}, 0.1};
  EXPECT_EQ(map.AlongMode(1).thickness_mm, (std::vector<double>{20, 21.1, 22}));
  map.modes_mm = 0.1 * Eigen::MatrixXd::Identity(3, 3);
  map.modes_mm(2, 1) = 0.05;
  EXPECT_EQ(map.AlongMode(1).thickness_mm, (std::vector<double>{20, 21.1, 22.05}));
  EXPECT_EQ(map.mode_count(), 3);
  map.modes_mm.resize(2, 2);
  EXPECT_THROW(map.Check(), UsageError);
}

TEST(CarcassThickness, GoesByThePlaceOnTheUndeformedWheel) {
  const VirtualRig rig(TyreScenario("tyre-cornering", {0.8, -1.5, 0.4}));
  const TyreFrame frame = TrueTyreFrame(rig, 0, 16);
  // The wheel's own map, by the place along the axis of the undeformed meridian.
  const auto wheel = rig.tyre()->Reference(0);
  CarcassThickness carcass;
  const auto plane = wheel->At({0, 0}).position_mm;
  const double slip = rig.tyre()->options().slip_angle_rad;
  const Eigen::Vector3d along(std::sin(slip), std::cos(slip), 0);
  for (double v = -150; v <= 150; v += 1) {
    carcass.y_mm.push_back(along.dot(wheel->At({0, v}).position_mm - plane));
    carcass.thickness_mm.push_back(rig.tyre()->CarcassThickness(v));
  }
  // The wheel frame's origin is beside the wheel's middle plane: the foot of the left camera.
  const Eigen::Vector3d middle = frame.ground_from_rig.Inverse() *
                                 Eigen::Vector3d(0, 0, rig.tyre()->Wheel(0).centre_height_mm);
  for (double& y : carcass.y_mm) y += frame.axis.direction_in_rig().dot(middle);
  const Image<double> thickness = ThicknessOver(carcass, frame.undeformed_mm, frame.axis);
  int seen = 0;
  for (std::size_t i = 0; i < thickness.pixel_count(); ++i) {
    if (!std::isfinite(frame.thickness_mm.data()[i])) continue;
    ++seen;
    EXPECT_NEAR(thickness.data()[i], frame.thickness_mm.data()[i], 0.01) << i;
  }
  EXPECT_GT(seen, 800);
}

TEST(FlatContact, FindsTheGroundWithoutNoise) {
  struct Case {
    const char* scenario;
    int frame;
    Eigen::Vector3d mounting_deg;
  };
  const Case cases[] = {{"tyre-flat", 0, {0.8, -4.5, 0.4}},
                        {"tyre-flat", 3, {0.8, 1.5, 0.4}},
                        {"tyre-cornering", 2, {-2, -1.5, 3}},
                        {"tyre-disturbed", 1, {0.8, -1.5, 0.4}},
                        {"cleat-lateral-square38", 2, {0.8, -1.5, 0.4}},
                        {"nuts", 12, {0.8, -1.5, 0.4}}};
  for (const Case& c : cases) {
    const VirtualRig rig(TyreScenario(c.scenario, c.mounting_deg));
    std::mt19937 random(1);
    const TyreFrame frame = WithNoise(TrueTyreFrame(rig, c.frame, 8), 1e-5, 1, random);
    const auto flat = Find(frame);
    ASSERT_TRUE(flat.has_value()) << c.scenario;
    EXPECT_LT(TiltInDegrees(*flat, frame), 5e-4) << c.scenario;
    EXPECT_LT(std::abs(PlaneDifference(flat->plane, frame.Ground())[2]), 2e-4) << c.scenario;
    EXPECT_LT(flat->below_share, 0.001);
  }
}

TEST(FlatContact, PointsBesideTheEdgeWouldLiftIt) {
  const VirtualRig rig(TyreScenario("cleat-lateral-square38", {0.8, -1.5, 0.4}));
  const TyreFrame truth = TrueTyreFrame(rig, 2, 10);
  std::mt19937 random(2);
  double lifted = 0, careless = 0;
  constexpr int kDraws = 12;
  for (int draw = 0; draw < kDraws; ++draw) {
    const TyreFrame frame = WithNoise(truth, 0.07, 1, random);
    const auto flat = Find(frame), with_edge = Find(frame, {.edge_mm = 0});
    ASSERT_TRUE(flat && with_edge);
    lifted -= PlaneDifference(flat->plane, frame.Ground())[2] / kDraws;
    careless -= PlaneDifference(with_edge->plane, frame.Ground())[2] / kDraws;
  }
  EXPECT_LT(std::abs(lifted), 0.0025);
  EXPECT_GT(careless, 0.004) << "careful: " << lifted;
}

TEST(FlatContact, CovarianceIsThatOfSampling) {
  std::mt19937 random(3);
  for (const char* scenario : {"tyre-flat", "cleat-lateral-square38"}) {
    const VirtualRig rig(TyreScenario(scenario, {0.8, -1.5, 0.4}));
    const TyreFrame truth = TrueTyreFrame(rig, 2, 12);
    double nees = 0;
    constexpr int kDraws = 60;
    for (int draw = 0; draw < kDraws; ++draw) {
      const TyreFrame frame = WithNoise(truth, 0.07, 1, random);
      const auto flat = Find(frame);
      ASSERT_TRUE(flat.has_value());
      const Eigen::Vector3d error = PlaneDifference(flat->plane, frame.Ground());
      nees += error.dot(flat->plane.cov.ldlt().solve(error)) / kDraws;
    }
    EXPECT_NEAR(nees, 3, 4 * std::sqrt(6.0 / kDraws)) << scenario;
  }
}

TEST(FlatContact, MismatchedPointsDoNotMatter) {
  const VirtualRig rig(TyreScenario("tyre-flat", {0.8, -1.5, 0.4}));
  std::mt19937 random(4);
  TyreFrame frame = WithNoise(TrueTyreFrame(rig, 0, 8), 0.05, 1, random);
  for (std::size_t i = 0; i < frame.point_mm.pixel_count(); i += 23) {
    frame.point_mm.data()[i] *= random() % 2 == 0 ? 1.04 : 0.97;
  }
  const auto flat = Find(frame);
  ASSERT_TRUE(flat.has_value());
  EXPECT_LT(TiltInDegrees(*flat, frame), 0.01);
  EXPECT_GT(flat->below_share, 0.005);
}

TEST(FlatContact, SaysWhyThereIsNone) {
  struct Case {
    const char* scenario;
    int frame;
  };
  // Free; on top of a bar; beside one, nearly but not on the ground.
  for (const Case& c : {Case{"tyre-lifted", 0}, Case{"cleat-lateral-square50", 6},
                        Case{"cleat-longitudinal-square50", 0}, Case{"cleat-offset-square38", 0}}) {
    const VirtualRig rig(TyreScenario(c.scenario, {0.8, -1.5, 0.4}));
    std::mt19937 random(5);
    const TyreFrame frame = WithNoise(TrueTyreFrame(rig, c.frame, 10), 0.05, 1, random);
    std::string why;
    EXPECT_FALSE(Find(frame, {}, &why).has_value()) << c.scenario;
    EXPECT_FALSE(why.empty()) << c.scenario;
  }
  TyreFrame nothing;
  nothing.point_mm = Image<Eigen::Vector3d>({4, 4}, Eigen::Vector3d::Constant(NAN));
  nothing.cov_mm2 = Image<Eigen::Matrix3d>({4, 4}, Eigen::Matrix3d::Identity());
  nothing.thickness_mm = Image<double>({4, 4}, 20);
  std::string why;
  EXPECT_FALSE(Find(nothing, {}, &why).has_value());
  EXPECT_NE(why.find("0 points"), std::string::npos);
  EXPECT_THROW(Find(nothing, {.least_points = 2}), UsageError);
  nothing.thickness_mm = Image<double>({3, 4}, 20);
  EXPECT_THROW(Find(nothing), std::invalid_argument);
}

TEST(FlatContact, FollowsItsPointsAlongAMode) {
  const VirtualRig rig(TyreScenario("tyre-flat", {0.8, -1.5, 0.4}));
  std::mt19937 random(6);
  const TyreFrame frame = WithNoise(TrueTyreFrame(rig, 0, 12), 0.05, 1, random);
  const auto flat = Find(frame);
  ASSERT_TRUE(flat.has_value());
  const Rigid3 moved = Rigid3::FromRotationVector({2e-3, -1e-3, 5e-4}, {0.1, 0.2, -0.3});
  Image<Eigen::Vector3d> points = frame.point_mm;
  for (Eigen::Vector3d& point : points.values()) point = moved * point;
  const GroundPlane plane = RefitFlatContact(*flat, points, frame.cov_mm2, frame.thickness_mm);
  const Eigen::Vector3d normal = moved.rotation * flat->plane.normal;
  EXPECT_LT((plane.normal - normal).norm(), 2e-6);
  EXPECT_NEAR(plane.offset_mm, flat->plane.offset_mm + normal.dot(moved.translation_mm), 1e-3);
}

}  // namespace
}  // namespace plumbline
