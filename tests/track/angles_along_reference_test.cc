#include "track/internal/angles_along_reference.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "io/virtual_rig/virtual_rig.h"

namespace plumbline::internal {
namespace {

constexpr double kRadius_mm = 384, kDistance_mm = 1e-3;

// Two views, 0.3 rad apart, and frames that turn on from them.
class AnglesAlongAnArc : public ::testing::Test {
 protected:
  AnglesAlongAnArc() {
    reference_.axis = WheelAxis::Through({20, 3, -224}, {0.03, -1, 0.02});
    reference_.frames.resize(2);
    reference_.views.resize(2);
    reference_.views[1].frame = 1;
    reference_.views[1].angle_rad = 0.3;
    reference_.cov_angles_random_rad2 = Eigen::MatrixXd::Zero(2, 2);
    for (const double angle_rad : {0.0, 0.1, 0.25, 0.4}) {
      RollingFrame& frame = wheel_.frames.emplace_back();
      frame.status = RollingFrameStatus::kPlaced;
      frame.angle_rad = angle_rad;
      frame.view = angle_rad > 0.15 ? 1 : 0;
      // Material that is below the axis by now, a little to both sides.
      for (const double place_rad : {-0.1, -0.05, 0.0, 0.05, 0.1}) {
        RollingPoint& p = frame.points.emplace_back();
        const double material_rad = place_rad + angle_rad;
        p.undeformed_mm = {kRadius_mm * std::sin(material_rad), 0,
                           -kRadius_mm * std::cos(material_rad)};
        p.point_mm = reference_.axis.RigFromWheel(angle_rad) * p.undeformed_mm;
        EXPECT_NEAR(MaterialAngle(reference_.axis.RigFromWheel(0).Inverse() * p.point_mm),
                    place_rad, 1e-9);
      }
    }
    wheel_.frames.emplace_back();  // not placed
  }

  WheelReference reference_{.rig = MakeRig(DesignOf(RigKind::kWide640))};
  RollingWheel wheel_;
};

// The material is beyond the camera: an axis that is further away from this by one sigma is so from
// the material, and turns since the view count as smaller.
TEST_F(AnglesAlongAnArc, GoInProportionToTheTurnSinceTheView) {
  reference_.cov_axis_random(3, 3) = kDistance_mm * kDistance_mm;
  const Eigen::MatrixXd along = AnglesAlongReference(reference_, wheel_);
  ASSERT_EQ(along.cols(), 5);
  const Eigen::VectorXd sigma = along.colwise().norm();
  const double turned[] = {0, 0.1, 0.05, 0.1};
  for (int f = 0; f < 4; ++f) {
    EXPECT_NEAR(sigma[f], turned[f] * kDistance_mm / kRadius_mm, 2e-3 * kDistance_mm / kRadius_mm);
  }
  EXPECT_EQ(sigma[4], 0);
}

// The angles of an arc are wrong in proportion with the axis' distance: then so are those of all
// frames, whatever view they are measured against.
TEST_F(AnglesAlongAnArc, GoInProportionToTheTurnWhereViewsGoWithTheAxis) {
  reference_.cov_axis_random(3, 3) = kDistance_mm * kDistance_mm;
  const double alone = AnglesAlongReference(reference_, wheel_).col(3).norm();
  const double view = 0.3 * kDistance_mm / kRadius_mm;
  std::vector<double> sigmas;
  for (const double by_distance : {0.3 / kRadius_mm, -0.3 / kRadius_mm}) {
    reference_.cov_angles_random_rad2(1, 1) = std::pow(by_distance * kDistance_mm, 2);
    reference_.cov_axis_angles_random = Eigen::MatrixXd::Zero(4, 2);
    reference_.cov_axis_angles_random(3, 1) = by_distance * kDistance_mm * kDistance_mm;
    sigmas.push_back(AnglesAlongReference(reference_, wheel_).col(3).norm());
  }
  std::sort(sigmas.begin(), sigmas.end());
  EXPECT_NEAR(sigmas[0], view - alone, 1e-3 * view);
  EXPECT_NEAR(sigmas[1], view + alone, 1e-3 * view);
}

// Errors of a view's angle are those of all frames that are measured against it.
TEST_F(AnglesAlongAnArc, AreThoseOfTheViews) {
  reference_.cov_angles_random_rad2(1, 1) = 4e-12;
  const Eigen::MatrixXd along = AnglesAlongReference(reference_, wheel_);
  EXPECT_NEAR(along.col(1).norm(), 0, 1e-15);
  EXPECT_NEAR(along.col(2).norm(), 2e-6, 1e-12);
  EXPECT_NEAR((along.col(3) - along.col(2)).norm(), 0, 1e-15);
}

}  // namespace
}  // namespace plumbline::internal
