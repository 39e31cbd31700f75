#include "track/right_delay.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "tests/track/lifted_wheel.h"
#include "tests/track/turning_wheel.h"
#include "track/right_delay_estimate.h"
#include "track/right_flow.h"

namespace plumbline {
namespace {

using testing::kDegrees;
using testing::LiftedWheel;

TEST(RightDelay, RefusesWhatIsNoSmallTime) {
  EXPECT_NO_THROW((RightDelay{-1e-3, 1e-4}.Check()));
  EXPECT_THROW((RightDelay{2e-3, 0}.Check()), UsageError);
  EXPECT_THROW((RightDelay{0, -1e-6}.Check()), UsageError);
  EXPECT_THROW((RightDelay{std::nan(""), 0}.Check()), UsageError);
}

TEST(WithDelayMode, NeedsARigWithModes) {
  const WheelReference none{.rig = plumbline::MakeRig(DesignOf(RigKind::kWide640))};
  EXPECT_THROW((void)WithDelayMode(none, {0, 1e-6}), UsageError);
  EXPECT_EQ(WithDelayMode(none, {1e-5, 0}).delay_mode, -1);
}

// The truth of a wheel before and after it is let down, on a grid of the left image; no images.
class LoadedTruth {
 public:
  static constexpr int kStep_px = 20;

  LoadedTruth()
      : lifted_(LiftedWheel::ScenarioOf(2, kTurn_rad)),
        loaded_(LetDown()),
        reference_{.rig = lifted_.rig(), .axis = lifted_.Axis()} {
    reference_.views.resize(1);
    const auto view = lifted_.virtual_rig().Truth(0), now = loaded_.virtual_rig().Truth(0);
    const ImageSize image = lifted_.rig().left.size();
    const ImageSize grid{image.width / kStep_px - 1, image.height / kStep_px - 1};
    pair_.left = pair_.right = PlanarField(grid, {kStep_px, kStep_px}, kStep_px);
    now_ = pair_;
    for (PlanarField* field : {&pair_.left, &pair_.right, &now_.left, &now_.right}) {
      field->cov_displacement_px2 = Image<Eigen::Vector3f>(grid, {1e-4F, 0, 1e-4F});
      field->gradient = Image<Eigen::Matrix2f>(grid, Eigen::Matrix2f::Zero());
      field->reference_share = Image<float>(grid, 0.5F);
    }
    velocity_px_s_ = view_right_px_ =
        Image<Eigen::Vector2d>(grid, Eigen::Vector2d::Constant(std::nan("")));
    for (int r = 0; r < grid.height; ++r) {
      for (int c = 0; c < grid.width; ++c) Fill(*view, *now, r, c);
    }
    speed_rad_s_ = loaded_.Angle(1) / loaded_.virtual_rig().FrameTime(1);
  }

  const WheelReference& reference() const { return reference_; }
  const StereoField& pair() const { return pair_; }
  const StereoField& now() const { return now_; }
  double speed_rad_s() const { return speed_rad_s_; }
  const Eigen::Vector2d& VelocityOf(std::size_t i) const { return velocity_px_s_.data()[i]; }
  ImageSize grid() const { return velocity_px_s_.size(); }
  // Of the undeformed wheel, every 5 mm.
  WheelProfile Profile() const {
    WheelProfile profile;
    const auto view = lifted_.virtual_rig().Truth(0);
    const Rigid3 wheel_from_ground =
        reference_.axis.RigFromWheel(0).Inverse() * view->ground_from_rig().Inverse();
    for (double v = -100; v <= 100; v += 5) {
      const Eigen::Vector3d there = wheel_from_ground * view->OfMaterial({0, v}).position_mm;
      profile.y_mm.push_back(there.y());
      profile.radius_mm.push_back(std::hypot(there.x(), there.z()));
    }
    if (profile.y_mm.front() > profile.y_mm.back()) {
      std::reverse(profile.y_mm.begin(), profile.y_mm.end());
      std::reverse(profile.radius_mm.begin(), profile.radius_mm.end());
    }
    profile.crown_radius_mm = *std::max_element(profile.radius_mm.begin(), profile.radius_mm.end());
    return profile;
  }

  // A frame of a survey of it, whose right camera is late; with noise of the right pixels.
  RollingFrame Frame(double delay_s, double sigma_px, std::mt19937& random) const {
    std::normal_distribution<double> noise(0, sigma_px);
    const Image<Eigen::Vector2d> flow = RightFlow(reference_, pair_).Of(now_.right);
    RollingFrame frame;
    frame.status = RollingFrameStatus::kPlaced;
    frame.speed_rad_s = speed_rad_s_;
    for (int r = 0; r < grid().height; ++r) {
      for (int c = 0; c < grid().width; ++c) {
        if (now_.right.status(r, c) != Status::kOk || !flow(r, c).allFinite()) continue;
        RollingPoint p;
        p.point_mm = p.undeformed_mm = Eigen::Vector3d::Zero();
        p.cov_random_mm2.setZero();
        const Eigen::Vector2d pixel = now_.left.PixelOf(r, c);
        p.left_px = pixel + now_.left.displacement_px(r, c);
        p.right_px = pixel + now_.right.displacement_px(r, c) + delay_s * velocity_px_s_(r, c);
        p.right_px += Eigen::Vector2d(noise(random), noise(random));
        p.right_flow_px = flow(r, c);
        p.view_right_px = view_right_px_(r, c);
        frame.points.push_back(p);
      }
    }
    return frame;
  }

 private:
  static constexpr double kTurn_rad = 4 * kDegrees;

  static Scenario LetDown() {
    Scenario scenario = LiftedWheel::ScenarioOf(2, kTurn_rad);
    std::get<TyreOptions>(scenario.surface).lifted_mm = 0;
    return scenario;
  }

  void Fill(const TrueFrame& view, const TrueFrame& now, int r, int c) {
    const Eigen::Vector2d pixel = pair_.left.PixelOf(r, c);
    const auto there = [&](const Eigen::Vector2d& q) -> std::optional<TruePoint> {
      const auto seen = view.UnderLeftPixel(q);
      if (!seen || !seen->in_right) return std::nullopt;
      return now.OfMaterial(seen->material_mm);
    };
    const auto seen = view.UnderLeftPixel(pixel);
    const auto here = there(pixel);
    if (!here || !here->in_left || !here->in_right) return;
    pair_.left.displacement_px(r, c).setZero();
    pair_.right.displacement_px(r, c) = seen->right_px - pixel;
    now_.left.displacement_px(r, c) = here->left_px - pixel;
    now_.right.displacement_px(r, c) = here->right_px - pixel;
    constexpr double kStep = 0.5;
    for (Eigen::Index k = 0; k < 2; ++k) {
      const Eigen::Vector2d step = kStep * Eigen::Vector2d::Unit(k);
      const auto beyond = there(pixel + step), before = there(pixel - step);
      if (!beyond || !before) return;
      now_.right.gradient(r, c).col(k) =
          ((beyond->right_px - before->right_px) / (2 * kStep) - Eigen::Vector2d::Unit(k))
              .cast<float>();
    }
    // The ground goes back under the wheel.
    const Rigid3 rig_from_ground = now.ground_from_rig().Inverse();
    const Eigen::Vector3d forwards(loaded_.Wheel(0).speed_mm_s, 0, 0);
    const StereoRig& rig = reference_.rig;
    const Camera::Projection right =
        rig.right.ProjectWithJacobians(rig.right_from_left * (rig_from_ground * here->position_mm));
    velocity_px_s_(r, c) = right.d_pixel_d_point * rig.right_from_left.rotation *
                           rig_from_ground.rotation * (here->velocity_mm_s - forwards);
    const auto before = view.UnderLeftPixel(here->left_px);
    if (before) view_right_px_(r, c) = before->right_px;
    for (PlanarField* field : {&pair_.left, &pair_.right, &now_.left, &now_.right}) {
      field->status(r, c) = Status::kOk;
    }
  }

  LiftedWheel lifted_, loaded_;
  WheelReference reference_;
  StereoField pair_, now_;
  Image<Eigen::Vector2d> velocity_px_s_, view_right_px_;
  double speed_rad_s_ = 0;
};

const LoadedTruth& Truth() {
  static const LoadedTruth truth;
  return truth;
}

TEST(RightFlow, IsHowTheMaterialOfALoadedTyreGoesThroughTheRightImage) {
  const LoadedTruth& truth = Truth();
  const Image<Eigen::Vector2d> flow =
      RightFlow(truth.reference(), truth.pair()).Of(truth.now().right);
  int seen = 0;
  double sum_off = 0, sum = 0;
  for (std::size_t i = 0; i < flow.pixel_count(); ++i) {
    if (!flow.data()[i].allFinite()) continue;
    ++seen;
    sum_off += (truth.speed_rad_s() * flow.data()[i] - truth.VelocityOf(i)).squaredNorm();
    sum += truth.VelocityOf(i).squaredNorm();
  }
  EXPECT_GT(seen, 60);
  EXPECT_LT(std::sqrt(sum_off / sum), 0.01);
}

// Where the right image of the view ends, the frame's may not.
TEST(RightFlow, IsThatOfTheWheelsProfileWhereTheViewHasNoRightMatch) {
  const LoadedTruth& truth = Truth();
  const Image<Eigen::Vector2d> all =
      RightFlow(truth.reference(), truth.pair()).Of(truth.now().right);
  WheelReference wheel = truth.reference();
  StereoField pair = truth.pair();
  for (Status& status : pair.right.status.values()) status = Status::kOutsideImage;
  const Image<Eigen::Vector2d> none = RightFlow(wheel, pair).Of(truth.now().right);
  wheel.profile = truth.Profile();
  const Image<Eigen::Vector2d> by_profile = RightFlow(wheel, pair).Of(truth.now().right);
  int compared = 0;
  for (std::size_t i = 0; i < all.pixel_count(); ++i) {
    EXPECT_TRUE(none.data()[i].hasNaN());
    if (!all.data()[i].allFinite()) continue;
    ++compared;
    EXPECT_LT((by_profile.data()[i] - all.data()[i]).norm(), 0.003 * all.data()[i].norm());
  }
  EXPECT_GT(compared, 60);
}

TEST(MoveAlong, KeepsNoMatchOfWhichTheFlowIsNotKnown) {
  PlanarField right({2, 1}, {10, 10}, 10);
  std::fill(right.status.values().begin(), right.status.values().end(), Status::kOk);
  for (Eigen::Vector2d& px : right.displacement_px.values()) px.setZero();
  Image<Eigen::Vector2d> flow({2, 1}, Eigen::Vector2d(3, -1));
  flow(0, 1).setConstant(std::nan(""));
  MoveAlong(flow, 0, &right);
  EXPECT_EQ(right.status(0, 1), Status::kOk);
  MoveAlong(flow, 0.5, &right);
  EXPECT_EQ(right.displacement_px(0, 0), Eigen::Vector2d(1.5, -0.5));
  EXPECT_EQ(right.status(0, 0), Status::kOk);
  EXPECT_EQ(right.status(0, 1), Status::kExtrapolated);
}

TEST(RightFlow, OfTheUndeformedWheelIsThatOfItsTurn) {
  const StereoRig rig = testing::WheelRig();
  const WheelReference wheel{.rig = rig, .axis = testing::TrueAxis()};
  constexpr double kStep_rad = 1e-5;
  const auto right = [&](double turn_rad, const Eigen::Vector3d& point) {
    return rig.right.Project(rig.right_from_left * (wheel.axis.RigFromWheel(turn_rad) * point));
  };
  for (const Eigen::Vector3d& point :
       std::vector<Eigen::Vector3d>{{30, 40, -380}, {-60, -50, -370}}) {
    const Eigen::Vector2d turned =
        (right(kStep_rad, point) - right(-kStep_rad, point)) / (2 * kStep_rad);
    const Eigen::Vector2d flow = RigidRightFlow(wheel, wheel.axis.RigFromWheel(0) * point);
    EXPECT_LT((flow - turned).norm(), 1e-6 * turned.norm());
  }
}

TEST(EstimateRightDelay, IsRightAndKnowsHowSure) {
  const LoadedTruth& truth = Truth();
  constexpr int kDraws = 40;
  constexpr double kDelay_s = 5e-5, kNoise_px = 0.005;
  std::mt19937 random(5);
  double sum = 0, squares = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    RollingWheel rolling;
    rolling.spacing_px = LoadedTruth::kStep_px;
    rolling.frames.push_back(truth.Frame(kDelay_s, kNoise_px, random));
    const std::vector<std::uint8_t> steady{1};
    const RightDelayEstimate found = EstimateRightDelay(truth.reference(), rolling, steady, 17);
    ASSERT_TRUE(found.found) << found.problem;
    const double off = (found.value_s - kDelay_s) / found.sigma_s;
    sum += off;
    squares += off * off;
  }
  EXPECT_LT(std::abs(sum / kDraws), 4 / std::sqrt(kDraws));
  // Of normal errors 1, within 4 sigma of the draws; the scatter is by the median.
  EXPECT_NEAR(squares / kDraws, 1, 4 * std::sqrt(2.0 / kDraws));
}

TEST(EstimateRightDelay, TellsTheWholeDelayOfWhatWasMovedBackByAPart) {
  const LoadedTruth& truth = Truth();
  std::mt19937 random(6);
  RollingWheel rolling;
  rolling.spacing_px = LoadedTruth::kStep_px;
  rolling.frames.push_back(truth.Frame(2e-5, 0, random));
  rolling.right_delay.value_s = 3e-5;
  const std::vector<std::uint8_t> steady{1}, none{0};
  EXPECT_NEAR(EstimateRightDelay(truth.reference(), rolling, steady, 17).value_s, 5e-5, 2e-6);
  const RightDelayEstimate nothing = EstimateRightDelay(truth.reference(), rolling, none, 17);
  EXPECT_FALSE(nothing.found);
  EXPECT_THAT(nothing.problem, ::testing::HasSubstr("flat ground"));
}

// A wheel that turns ever faster before a right camera that is late.
class LateWheel : public ::testing::Test {
 protected:
  static constexpr double kDelay_s = 4e-4;

  LateWheel() : rig_(testing::WheelRig()) {
    problem_ = testing::TurningWheel(rig_, 12, 0.1, 250);
    for (int f = 0; f < 12; ++f) times_s_.push_back(0.1 * f - 0.002 * f * f);
    const std::vector<double> speeds = TurningSpeeds(problem_.angles_rad, times_s_);
    for (WheelObservation& o : problem_.observations) {
      if (!o.right) continue;
      const auto f = static_cast<std::size_t>(o.frame);
      const Eigen::Vector3d later =
          problem_.axis.RigFromWheel(problem_.angles_rad[f] + kDelay_s * speeds[f]) *
          problem_.points_mm[static_cast<std::size_t>(o.point)];
      o.pixel = rig_.right.Project(rig_.right_from_left * later);
    }
  }

  StereoRig rig_;
  WheelProblem problem_;
  std::vector<double> times_s_;
};

TEST_F(LateWheel, IsFoundAsItIs) {
  const WheelAdjustment off = AdjustWheel(rig_, problem_);
  EXPECT_GT(std::abs(off.axis.distance_mm - problem_.axis.distance_mm), 0.1);
  const WheelAdjustment found = AdjustLateWheel(rig_, problem_, times_s_, {kDelay_s, 0}, -1);
  EXPECT_NEAR(found.axis.distance_mm, problem_.axis.distance_mm, 0.002);
  for (std::size_t p = 0; p < found.points_mm.size(); ++p) {
    if (!found.points_mm[p].allFinite()) continue;
    EXPECT_LT((found.points_mm[p] - problem_.points_mm[p]).norm(), 0.02) << p;
  }
}

TEST_F(LateWheel, HasAModeThatDoesWhatAnotherDelayDoes) {
  constexpr double kSigma_s = 2e-6;
  problem_ = testing::WithNoise(std::move(problem_), 4);  // against which the change is small
  const WheelReference late = WithDelayMode({.rig = rig_}, {kDelay_s, kSigma_s});
  ASSERT_EQ(late.delay_mode, 5);
  const WheelAdjustment found =
      AdjustLateWheel(late.rig, problem_, times_s_, {kDelay_s, kSigma_s}, late.delay_mode);
  const WheelAdjustment more =
      AdjustLateWheel(rig_, problem_, times_s_, {kDelay_s + kSigma_s, 0}, -1);
  const Eigen::RowVectorXd mode = found.along_modes.row(late.delay_mode);
  const double change = more.axis.distance_mm - found.axis.distance_mm;
  EXPECT_GT(std::abs(change), 0.003);
  EXPECT_NEAR(mode[3], change, 0.02 * std::abs(change));
  for (std::size_t p = 0; p < found.points_mm.size(); p += 10) {
    if (!found.points_mm[p].allFinite() || !more.points_mm[p].allFinite()) continue;
    const Eigen::Vector3d moved = more.points_mm[p] - found.points_mm[p];
    EXPECT_LT((found.points_along_modes_mm[p].col(5) - moved).norm(), 0.05 * moved.norm()) << p;
  }
}

TEST_F(LateWheel, NeedsTimes) {
  const std::vector<double> none(12, std::nan(""));
  EXPECT_THROW((void)AdjustLateWheel(rig_, problem_, none, {kDelay_s, 0}, -1), InputError);
}

}  // namespace
}  // namespace plumbline
