#include "track/surface_motion.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/error.h"
#include "tests/support/consistency.h"
#include "tests/support/rendered_surface.h"
#include "tests/support/subset_noise.h"
#include "track/surface_state.h"

namespace plumbline {
namespace {

using testing::Consistency;
using testing::ConvergentRig;
using testing::SpeckledSheet;

constexpr double kNoiseGrey = 2;

SpeckledSheet SheetAt(int frame) {
  SpeckledSheet sheet;
  const double t = frame;
  sheet.rig_from_sheet =
      Rigid3::FromRotationVector({0.1, -0.25, 0.1 + 0.05 * t}, {0.4 * t, -0.3 * t, 400 + t});
  sheet.stretch << 1 + 0.05 * t, 0.01 * t, 0, 1 - 0.03 * t;
  return sheet;
}

// The whole chain behind the images, over draws of their noise: what positions and displacements
// claim is what they scatter by, shared reference subset, foreshortening and all.
TEST(SurfaceMotion, CoversTheTruthOverDrawsOfTheNoise) {
  const ImageSize size{150, 120};
  const StereoRig rig = ConvergentRig(size, 1500, 400, 140);
  StereoSequenceOptions options;
  options.field.correlator.subset_px = 25;
  options.field.step_px = 24;
  options.field.correlator.noise = NoiseModel{kNoiseGrey * kNoiseGrey, 0};
  options.strategy = StereoStrategy::kReference;
  const SpeckledSheet first = SheetAt(0), now = SheetAt(1);
  Consistency position, displacement, velocity;
  for (std::uint32_t draw = 0; draw < 60; ++draw) {
    const std::uint32_t seed = 100 * draw;
    StereoSequence sequence(rig, first.Left(rig, kNoiseGrey, seed),
                            first.Right(rig, kNoiseGrey, seed + 1), options);
    const StereoField seen =
        sequence.Add(now.Left(rig, kNoiseGrey, seed + 2), now.Right(rig, kNoiseGrey, seed + 3), 1);
    const StereoField again =
        sequence.Add(now.Left(rig, kNoiseGrey, seed + 4), now.Right(rig, kNoiseGrey, seed + 5), 2);
    const auto unit = UnitCovariance(sequence.reference(), seen);
    const StereoSurface before = TriangulateField(rig, sequence.reference(), unit);
    const StereoSurface after = TriangulateField(rig, seen, unit);
    const StereoSurface later = TriangulateField(rig, again, unit);
    const SurfaceMotion moved = MotionBetween(before.instant, after.instant, unit);
    const SurfaceMotion still = MotionBetween(after.instant, later.instant, unit);
    const auto cov = CovarianceOf(after.instant, unit);
    for (int r = 0; r < unit.height(); ++r) {
      for (int c = 0; c < unit.width(); ++c) {
        if (!moved.value_mm(r, c).allFinite() || !still.value_mm(r, c).allFinite()) continue;
        const Eigen::Vector2d material = first.MaterialAt(rig, seen.left.PixelOf(r, c));
        const Eigen::Vector3d truth = now.PointInRig(material);
        position.AddJoint(after.instant.point_mm(r, c) - truth, CovarianceOf(cov(r, c)));
        displacement.AddJoint(moved.value_mm(r, c) - (truth - first.PointInRig(material)),
                              CovarianceOf(moved.cov_random_mm2(r, c)));
        velocity.AddJoint(still.value_mm(r, c), CovarianceOf(still.cov_random_mm2(r, c)));
      }
    }
  }
  EXPECT_GT(position.count(), 3 * 700);
  for (const Consistency* one : {&position, &displacement, &velocity}) {
    EXPECT_NEAR(one->nees(), 1, 0.1);
    EXPECT_GT(one->coverage(), 0.93);
    EXPECT_LT(one->coverage(), 0.97);
  }
}

// Points on a bowl, with a made-up error model; moved rigidly and stretched.
struct Instants {
  SurfaceState from, to;
  Image<Eigen::Vector3f> unit;
  Rigid3 motion = Rigid3::FromRotationVector({0.1, -0.05, 0.17}, {20, -3, 5});

  explicit Instants(ImageSize size, int modes = 2) {
    const auto fill = [&](SurfaceState& instant, const Rigid3& moved, bool with_left) {
      instant.point_mm = Image<Eigen::Vector3d>(size, Eigen::Vector3d::Zero());
      instant.d_left = instant.d_right =
          Image<Eigen::Matrix<float, 3, 2>>(size, Eigen::Matrix<float, 3, 2>::Zero());
      instant.scale_left = instant.scale_right = Image<float>(size, 1.0F);
      instant.share_left = instant.share_right = Image<float>(size, 0.5F);
      instant.along_modes_mm.assign(static_cast<std::size_t>(modes),
                                    Image<Eigen::Vector3f>(size, Eigen::Vector3f::Zero()));
      for (int r = 0; r < size.height; ++r) {
        for (int c = 0; c < size.width; ++c) {
          const double x = c - 0.5 * size.width, y = r - 0.5 * size.height;
          instant.point_mm(r, c) =
              moved * Eigen::Vector3d(x, y, 100 + 0.01 * (x * x + 0.5 * y * y));
          instant.d_right(r, c) << 0.1F, 0, 0, 0.05F, 0.3F, 0.02F;
          if (with_left) instant.d_left(r, c) << 0.08F, 0, 0, 0.1F, -0.3F, 0.01F;
          for (int k = 0; k < modes; ++k) {
            instant.along_modes_mm[static_cast<std::size_t>(k)](r, c) =
                (instant.point_mm(r, c) * 1e-4 * (k + 1)).cast<float>();
          }
        }
      }
    };
    fill(from, Rigid3(), false);
    fill(to, motion, true);
    unit = Image<Eigen::Vector3f>(size, Eigen::Vector3f(1e-4F, 0, 2e-4F));
  }
};

TEST(SurfaceMotion, AddsWhatEachMatchDoesAndWhatTheyShare) {
  const Instants set({4, 3});
  const SurfaceMotion motion = MotionBetween(set.from, set.to, set.unit);
  // Three independent parts of half the variance each, and the common half.
  const Eigen::Matrix2d unit = Eigen::Vector2d(1e-4, 2e-4).asDiagonal();
  const Eigen::Matrix<double, 3, 2> a = -set.from.d_right(0, 0).cast<double>(),
                                    b = set.to.d_left(0, 0).cast<double>(),
                                    c = set.to.d_right(0, 0).cast<double>();
  const Eigen::Matrix3d expected =
      0.5 * (a * unit * a.transpose() + b * unit * b.transpose() + c * unit * c.transpose() +
             (a + b + c) * unit * (a + b + c).transpose());
  EXPECT_LT((CovarianceOf(motion.cov_random_mm2(1, 2)) - expected).norm(), 1e-6 * expected.norm());
  const Eigen::Vector3d moved = set.to.point_mm(1, 2) - set.from.point_mm(1, 2);
  EXPECT_EQ(motion.value_mm(1, 2), moved);
  const Eigen::Vector3f along = (moved * std::sqrt(5.0) * 1e-4).cwiseAbs().cast<float>();
  EXPECT_LT((motion.sigma_calibration_mm(1, 2) - along).norm(), 1e-4 * along.norm());
}

TEST(RigidMotion, IsFoundAndTakenOut) {
  const Instants set({20, 16});
  const SurfaceMotion motion = MotionBetween(set.from, set.to, set.unit);
  const SurfaceRigidMotion rigid = RigidMotionBetween(set.from, set.to, motion, 1);
  ASSERT_TRUE(rigid.found);
  EXPECT_LT((rigid.motion.rotation - set.motion.rotation).norm(), 1e-10);
  EXPECT_LT((rigid.motion.translation_mm - set.motion.translation_mm).norm(), 1e-8);
  EXPECT_LT(rigid.rms_mm, 1e-10);
  const SurfaceMotion left = WithoutRigidMotion(set.from, set.to, motion, rigid);
  for (const Eigen::Vector3d& d : left.value_mm.values()) EXPECT_LT(d.norm(), 1e-8);
  // Growing in all directions alike leaves growth and no motion: what the modes do.
  EXPECT_LT(rigid.along_modes[0].head<3>().norm(), 1e-9);
}

TEST(RigidMotion, HasTheScatterThatItClaims) {
  Instants set({9, 7}, 0);
  const SurfaceState perfect = set.to;
  testing::NormalDeviates draw(5);
  const SurfaceMotion motion = MotionBetween(set.from, set.to, set.unit);
  double sum = 0;
  constexpr int kDraws = 400;
  for (int n = 0; n < kDraws; ++n) {
    for (std::size_t i = 0; i < set.unit.pixel_count(); ++i) {
      const Eigen::Matrix3d L =
          CovarianceOf(motion.cov_random_mm2.data()[i]).llt().matrixL().toDenseMatrix();
      set.to.point_mm.data()[i] =
          perfect.point_mm.data()[i] + L * Eigen::Vector3d(draw(), draw(), draw());
    }
    const SurfaceMotion noisy = MotionBetween(set.from, set.to, set.unit);
    const SurfaceRigidMotion found = RigidMotionBetween(set.from, set.to, noisy, 1);
    Eigen::Matrix<double, 6, 1> error;
    error << Rigid3{found.motion.rotation * set.motion.rotation.transpose(), {0, 0, 0}}
                 .RotationVector(),
        found.motion * found.about_mm - set.motion * found.about_mm;
    sum += error.dot(found.cov_random.ldlt().solve(error));
  }
  EXPECT_NEAR(sum / kDraws / 6, 1, 0.1);
}

TEST(RigidMotion, NeedsPointsThatAreNotOnALine) {
  Instants set({6, 1});
  for (auto* instant : {&set.from, &set.to}) {
    for (int c = 0; c < 6; ++c) instant->point_mm(0, c) = Eigen::Vector3d(c, 2 * c, 100);
  }
  const SurfaceMotion motion = MotionBetween(set.from, set.to, set.unit);
  EXPECT_FALSE(RigidMotionBetween(set.from, set.to, motion, 1).found);
}

TEST(EpipolarDistance, TakesOutMismatchesAndNotWhatAllPointsHave) {
  const ImageSize size{300, 240};
  StereoRig rig = ConvergentRig(size, 1500, 400, 140);
  const SpeckledSheet sheet = SheetAt(0);
  StereoSequenceOptions options;
  options.field.step_px = 12;
  const StereoSequence sequence(rig, sheet.Left(rig, 1, 1), sheet.Right(rig, 1, 2), options);
  StereoField field = sequence.reference();
  // A camera that was bumped after its calibration, and one point that is wrong.
  rig.right_from_left.rotation =
      Rigid3::FromRotationVector({1e-3, 0, 0}, {0, 0, 0}).rotation * rig.right_from_left.rotation;
  field.right.displacement_px(5, 6).y() += 2;
  const StereoSurface surface =
      TriangulateField(rig, field, UnitCovariance(field, field), EpipolarOptions());
  EXPECT_EQ(surface.status(5, 6), Status::kEpipolarViolation);
  EXPECT_FALSE(surface.instant.point_mm(5, 6).allFinite());
  const auto violations = std::count(surface.status.values().begin(), surface.status.values().end(),
                                     Status::kEpipolarViolation);
  EXPECT_EQ(violations, 1);
  // What all points have is far above the tolerance: 1 mrad at 1500 px.
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    if (surface.status.data()[i] != Status::kOk) continue;
    EXPECT_NEAR(std::abs(surface.epipolar_px.data()[i]), 1.5F, 0.2F);
  }
}

TEST(SurfaceStates, OfDifferentGridsAreRefused) {
  const Instants small({4, 3}), large({5, 3});
  EXPECT_THROW(static_cast<void>(MotionBetween(small.from, large.to, small.unit)), InputError);
}

}  // namespace
}  // namespace plumbline
