#include "track/right_drift.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "tests/support/true_wheel.h"
#include "tests/track/lifted_wheel.h"

namespace plumbline {
namespace {

using testing::kDegrees;

constexpr int kFrames = 5, kStep_px = 10;

// The truth of a loaded tyre as a survey without errors would tell it, and how the right pixels go.
class RolledTruth {
 public:
  explicit RolledTruth(const std::string& scenario, double step_rad = 2 * kDegrees)
      : RolledTruth(testing::LiftedWheel(ScenarioOf(scenario, step_rad))) {}
  // Root mean squares over the points of a frame, px/s.
  struct Rms {
    double velocity = 0, without_drift = 0, with_it = 0, left_out = 0;
  };
  Rms Off(std::size_t f) const {
    Rms rms;
    const RollingFrame& frame = survey.frames[f];
    for (std::size_t i = 0; i < frame.points.size(); ++i) {
      const Eigen::Vector2d& true_px_s = velocity_px_s[f][i];
      const RollingPoint& p = frame.points[i];
      rms.velocity += true_px_s.squaredNorm();
      rms.without_drift += (frame.speed_rad_s * p.right_flow_px - true_px_s).squaredNorm();
      rms.with_it += (RightVelocityOf(frame, p) - true_px_s).squaredNorm();
      const int place = p.at.y() * survey.grid.width + p.at.x();
      rms.left_out += RightDriftLeftOutAt(frame, static_cast<std::size_t>(place)).squaredNorm();
    }
    for (double* sum : {&rms.velocity, &rms.without_drift, &rms.with_it, &rms.left_out}) {
      *sum = std::sqrt(*sum / static_cast<double>(frame.points.size()));
    }
    return rms;
  }

  WheelReference wheel;
  RollingWheel survey;
  std::vector<std::vector<Eigen::Vector2d>> velocity_px_s;  // of each point

 private:
  explicit RolledTruth(const testing::LiftedWheel& rolled)
      : wheel{.rig = rolled.rig(), .axis = rolled.Axis()} {
    const ImageSize image = rolled.rig().left.size();
    survey.grid = {image.width / kStep_px - 1, image.height / kStep_px - 1};
    survey.first_px = {kStep_px, kStep_px};
    survey.spacing_px = kStep_px;
    for (int f = 0; f < kFrames; ++f) AddFrame(rolled, f);
  }

  static Scenario ScenarioOf(const std::string& name, double step_rad) {
    RigDesign design = DesignOf(RigKind::kWide640);
    design.image_size = {320, 240};
    design.pixel_um *= 2;
    return testing::TurningBy(step_rad, kFrames,
                              MakeScenario(name, plumbline::MakeRig(design), design.distance_mm));
  }

  void AddFrame(const testing::LiftedWheel& rolled, int f) {
    RollingFrame& frame = survey.frames.emplace_back();
    velocity_px_s.emplace_back();
    frame.time_s = rolled.virtual_rig().FrameTime(f);
    frame.status = RollingFrameStatus::kPlaced;
    frame.angle_rad = rolled.Angle(f);
    frame.speed_rad_s = rolled.Angle(1) / rolled.virtual_rig().FrameTime(1);
    const auto truth = rolled.virtual_rig().Truth(f);
    const Rigid3 rig_from_ground = truth->ground_from_rig().Inverse();
    const Rigid3 wheel_from_ground =
        wheel.axis.RigFromWheel(frame.angle_rad).Inverse() * rig_from_ground;
    const auto undeformed = [&](const TruePoint& point) -> Eigen::Vector3d {
      return wheel_from_ground * (point.position_mm - point.displacement_mm);
    };
    const Eigen::Vector3d forwards(rolled.Wheel(f).speed_mm_s, 0, 0);  // the ground goes back
    for (int r = 0; r < survey.grid.height; ++r) {
      for (int c = 0; c < survey.grid.width; ++c) {
        const Eigen::Vector2d pixel = kStep_px * Eigen::Vector2d(c + 1, r + 1);
        const auto seen = truth->UnderLeftPixel(pixel);
        if (!seen || !seen->in_right) continue;
        constexpr double kStep_mm = 0.1;
        const TruePoint behind = truth->OfMaterial(seen->material_mm -
                                                   kStep_mm * Eigen::Vector2d::UnitX()),
                        ahead = truth->OfMaterial(seen->material_mm +
                                                  kStep_mm * Eigen::Vector2d::UnitX());
        RollingPoint& p = frame.points.emplace_back();
        p.left_px = pixel;
        p.right_px = seen->right_px;
        p.undeformed_mm = undeformed(*seen);
        p.at = {c, r};
        // The material goes to places of smaller angles.
        p.right_flow_px = (behind.right_px - ahead.right_px) /
                          (MaterialAngle(undeformed(ahead)) - MaterialAngle(undeformed(behind)));
        const StereoRig& rig = wheel.rig;
        const Camera::Projection right = rig.right.ProjectWithJacobians(
            rig.right_from_left * (rig_from_ground * seen->position_mm));
        velocity_px_s.back().push_back(right.d_pixel_d_point * rig.right_from_left.rotation *
                                       rig_from_ground.rotation * (seen->velocity_mm_s - forwards));
      }
    }
  }
};

TEST(RightDrift, IsNothingOnFlatGround) {
  RolledTruth truth("tyre-flat");
  FindRightDrift(truth.wheel, &truth.survey);
  for (std::size_t f = 0; f < kFrames; ++f) {
    const RolledTruth::Rms off = truth.Off(f);
    EXPECT_GT(off.velocity, 1000);
    EXPECT_LT(off.without_drift, 0.01);
    EXPECT_LT(off.with_it, 0.01);
  }
}

TEST(RightDrift, TellsMostOfWhatAnObstacleUnderTheTyreAdds) {
  RolledTruth truth("cleat-lateral-square38");
  FindRightDrift(truth.wheel, &truth.survey);
  for (std::size_t f = 0; f < kFrames; ++f) {
    const RolledTruth::Rms off = truth.Off(f);
    EXPECT_GT(off.without_drift, 0.15 * off.velocity) << f;
    // At the ends both frames beside are on one side.
    EXPECT_LT(off.with_it, (f % (kFrames - 1) == 0 ? 0.4 : 0.3) * off.without_drift) << f;
  }
}

TEST(RightDrift, IsOffByAsMuchAsItSays) {
  for (const double step_rad : {2 * kDegrees, 4 * kDegrees}) {
    for (const char* scenario : {"cleat-lateral-square38", "cleat-diagonal-square38"}) {
      RolledTruth truth(scenario, step_rad);
      FindRightDrift(truth.wheel, &truth.survey);
      double squares = 0;
      for (std::size_t f = 0; f < kFrames; ++f) {
        const RolledTruth::Rms off = truth.Off(f);
        squares += std::pow(off.with_it / off.left_out, 2) / kFrames;
      }
      EXPECT_GT(squares, 0.4) << scenario << step_rad;
      EXPECT_LT(squares, 1.5) << scenario << step_rad;
    }
  }
}

TEST(RightDrift, IsToldAcrossFramesThatAreLost) {
  RolledTruth truth("cleat-lateral-square38");
  truth.survey.frames[2].status = RollingFrameStatus::kNotFound;
  FindRightDrift(truth.wheel, &truth.survey);
  EXPECT_TRUE(truth.survey.frames[2].right_drift_px_s.empty());
  for (const std::size_t f : {0, 1, 3, 4}) {
    const RolledTruth::Rms off = truth.Off(f);
    EXPECT_LT(off.with_it, 0.6 * off.without_drift) << f;
  }
}

TEST(RightDrift, IsNotKnownOfAFrameByItself) {
  RolledTruth truth("cleat-lateral-square38");
  for (const std::size_t f : {0, 1, 3, 4}) {
    truth.survey.frames[f].status = RollingFrameStatus::kNotFound;
  }
  FindRightDrift(truth.wheel, &truth.survey);
  EXPECT_TRUE(truth.survey.frames[2].right_drift_px_s.empty());
  const RolledTruth::Rms off = truth.Off(2);
  EXPECT_EQ(off.with_it, off.without_drift);
}

// The survey's points are some of those that are measured.
TEST(RightVelocity, LiesBetweenTheDriftsOfTheSurveysPoints) {
  RolledTruth truth("cleat-lateral-square38");
  FindRightDrift(truth.wheel, &truth.survey);
  const RollingFrame& frame = truth.survey.frames[2];
  const ImageSize survey = truth.survey.grid;
  const PlanarField fine({2 * survey.width - 1, 2 * survey.height - 1}, truth.survey.first_px,
                         kStep_px / 2);
  const Eigen::Vector2d flow(3, -2);
  Image<Eigen::Vector2d> flow_px(fine.size(), flow);
  flow_px(4, 6).setConstant(std::nan(""));
  const Image<Eigen::Vector2d> velocity = RightVelocity(truth.survey, 2, flow_px, fine);
  const auto drift = [&](int r, int c) -> Eigen::Vector2d {
    return velocity(r, c) - frame.speed_rad_s * flow;
  };
  EXPECT_LT((drift(20, 30) - frame.right_drift_px_s(10, 15)).norm(), 1e-9);
  const Eigen::Vector2d between =
      (frame.right_drift_px_s(10, 15) + frame.right_drift_px_s(10, 16)) / 2;
  EXPECT_LT((drift(20, 31) - between).norm(), 1e-9);
  EXPECT_GT(between.norm(), 1);
  EXPECT_TRUE(velocity(4, 6).hasNaN());
}

}  // namespace
}  // namespace plumbline
