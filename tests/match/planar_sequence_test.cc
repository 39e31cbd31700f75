#include "match/planar_sequence.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <limits>

#include "calib/error.h"
#include "calib/median.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {

using testing::RenderSpeckle;

constexpr ImageSize kSize{176, 150};
constexpr double kNoise = 2;

// The specimen moves, stretches and turns a little more each frame: x -> c + t + F (x - c).
struct Motion {
  Eigen::Vector2d step_px{0.73, -0.41};
  double stretch = 4e-4;
  double turn_rad = 1.5e-3;

  Eigen::Matrix2d F(int frame) const {
    const double a = turn_rad * frame;
    Eigen::Matrix2d R;
    R << std::cos(a), -std::sin(a), std::sin(a), std::cos(a);
    return R * Eigen::Vector2d(1 + stretch * frame, 1 - 0.3 * stretch * frame).asDiagonal();
  }
  Eigen::Vector2d Displacement(int frame, const Eigen::Vector2d& x) const {
    return kCentre + frame * step_px + F(frame) * (x - kCentre) - x;
  }
  GrayImage Render(int frame, double noise, std::uint32_t seed) const {
    const Eigen::Matrix2d back = F(frame).inverse();
    const Eigen::Vector2d to = kCentre + frame * step_px;
    return RenderSpeckle(
        kSize, [&](const Eigen::Vector2d& p) { return kCentre + back * (p - to); }, noise, seed);
  }

  const Eigen::Vector2d kCentre{88, 75};
};

SequenceOptions Options(ReferenceMode mode, int every = 1) {
  SequenceOptions options;
  options.field.correlator.subset_px = 21;
  options.field.correlator.noise = NoiseModel{kNoise * kNoise, 0};
  options.field.step_px = 21;
  options.field.first_px = {22, 32};
  options.field.grid = {6, 5};
  options.reference = mode;
  options.update_every = every;
  return options;
}

Eigen::Matrix2d Covariance(const PlanarField& field, int r, int c) {
  const Eigen::Vector3f& v = field.cov_displacement_px2(r, c);
  Eigen::Matrix2d cov;
  cov << v[0], v[1], v[1], v[2];
  return cov;
}

// Sums over points and draws at one frame.
struct Sampled {
  double points = 0, nees = 0, variance = 0, claimed = 0, gradient_nees = 0;
  Eigen::Vector2d bias{0, 0};
  void Add(const Motion& motion, int frame, const PlanarField& field) {
    for (int r = 0; r < field.size().height; ++r) {
      for (int c = 0; c < field.size().width; ++c) {
        if (field.status(r, c) != Status::kOk) continue;
        const Eigen::Vector2d e =
            field.displacement_px(r, c) - motion.Displacement(frame, field.PixelOf(r, c));
        const Eigen::Matrix2d cov = Covariance(field, r, c);
        points += 1;
        bias += e;
        nees += e.dot(cov.inverse() * e);
        variance += e.squaredNorm() / 2;
        claimed += cov.trace() / 2;
        const Eigen::Matrix2d G =
            field.gradient(r, c).cast<double>() + Eigen::Matrix2d::Identity() - motion.F(frame);
        const auto& g = field.cov_gradient(r, c);
        gradient_nees += G(0, 0) * G(0, 0) / g[0] + G(0, 1) * G(0, 1) / g[4] +
                         G(1, 0) * G(1, 0) / g[7] + G(1, 1) * G(1, 1) / g[9];
      }
    }
  }
  void Print(int frame) const {
    std::cout << "  frame " << frame << ": " << points << " points, NEES " << nees / points
              << ", rms " << std::sqrt(variance / points) << " px, claimed "
              << std::sqrt(claimed / points) << ", mean error " << bias.transpose() / points
              << ", gradients " << gradient_nees / points / 4 << "\n";
  }
};

std::vector<Sampled> Sample(const SequenceOptions& options, int frames, int draws) {
  const Motion motion;
  std::vector<Sampled> sampled(static_cast<std::size_t>(frames));
  for (int draw = 0; draw < draws; ++draw) {
    const auto seed = static_cast<std::uint32_t>(1000 * draw);
    PlanarSequence sequence(motion.Render(0, kNoise, seed), options);
    for (int k = 1; k <= frames; ++k) {
      const auto frame =
          sequence.Add(motion.Render(k, kNoise, seed + static_cast<std::uint32_t>(k)), k);
      sampled[static_cast<std::size_t>(k - 1)].Add(motion, k, frame.field);
    }
  }
  return sampled;
}

void ExpectConsistent(ReferenceMode mode, int every, int draws) {
  const std::vector<Sampled> sampled = Sample(Options(mode, every), 30, draws);
  std::cout << (mode == ReferenceMode::kFixed ? "fixed" : "updated every ") << every << "\n";
  for (const int k : {1, 2, 5, 10, 20, 30}) sampled[static_cast<std::size_t>(k - 1)].Print(k);
  Sampled last;
  for (std::size_t k = 25; k < 30; ++k) {
    last.points += sampled[k].points;
    last.nees += sampled[k].nees;
    last.variance += sampled[k].variance;
    last.claimed += sampled[k].claimed;
    last.gradient_nees += sampled[k].gradient_nees;
  }
  EXPECT_GE(last.points, 5 * draws * 28);
  EXPECT_NEAR(last.nees / last.points, 2, 0.3);
  EXPECT_NEAR(std::sqrt(last.variance / last.claimed), 1, 0.1);
  EXPECT_NEAR(last.gradient_nees / last.points / 4, 1, 0.2);
}

TEST(PlanarSequence, ErrorsAreAsClaimedWithTheReferenceUpdatedEveryFrame) {
  ExpectConsistent(ReferenceMode::kEvery, 1, 10);
}

TEST(PlanarSequence, ErrorsAreAsClaimedWithTheReferenceUpdatedEveryFiveFrames) {
  ExpectConsistent(ReferenceMode::kEvery, 5, 10);
}

TEST(PlanarSequence, LostPointsComeBackWithAFixedReference) {
  const Motion motion;
  PlanarSequence sequence(motion.Render(0, 1, 1), Options(ReferenceMode::kFixed));
  ASSERT_EQ(sequence.Add(motion.Render(1, 1, 2), 1).counts.ok, 30);
  GrayImage hidden = motion.Render(2, 1, 3);
  for (int y = 0; y < 150; ++y) std::fill_n(hidden.grey.row(y) + 88, 88, std::uint16_t{100});
  EXPECT_LT(sequence.Add(hidden, 2).counts.ok, 20);
  EXPECT_EQ(sequence.Add(motion.Render(3, 1, 4), 3).counts.ok, 30);
  // A frame that shows nothing at all is no end either.
  std::fill(hidden.grey.values().begin(), hidden.grey.values().end(), std::uint16_t{100});
  EXPECT_EQ(sequence.Add(hidden, 4).counts.ok, 0);
  EXPECT_EQ(sequence.Add(motion.Render(5, 1, 6), 5).counts.ok, 30);
}

TEST(PlanarSequence, PointsLostAtAnUpdateStayLostAndAreCounted) {
  const Motion motion;
  PlanarSequence sequence(motion.Render(0, 1, 1), Options(ReferenceMode::kEvery, 2));
  sequence.Add(motion.Render(1, 1, 2), 1);
  GrayImage hidden = motion.Render(2, 1, 3);
  for (int y = 0; y < 150; ++y) std::fill_n(hidden.grey.row(y) + 120, 56, std::uint16_t{100});
  const SequenceFrame at_update = sequence.Add(hidden, 2);
  EXPECT_EQ(at_update.lost_at_updates, 0);
  ASSERT_LT(at_update.counts.ok, 30);
  const SequenceFrame after = sequence.Add(motion.Render(3, 1, 4), 3);
  EXPECT_EQ(after.reference_frame, 2);
  EXPECT_EQ(after.counts.ok, at_update.counts.ok);
  EXPECT_EQ(after.lost_at_updates, 30 - at_update.counts.ok);
  for (std::size_t i = 0; i < after.field.status.pixel_count(); ++i) {
    if (at_update.field.status.data()[i] == Status::kOk) continue;
    EXPECT_EQ(after.field.status.data()[i], at_update.field.status.data()[i]);
    EXPECT_TRUE(std::isnan(after.field.displacement_px.data()[i].x()));
  }
}

TEST(PlanarSequence, UpdatesByItselfWhereThatHelps) {
  Motion motion;
  motion.turn_rad = 0.01;
  const auto worn = [&](int frame) {
    GrayImage image = motion.Render(frame, 1, static_cast<std::uint32_t>(frame));
    // The speckle wears off: another one comes through.
    testing::RenderedSpeckleOptions other;
    other.pattern_seed = 77;
    const Eigen::Matrix2d back = motion.F(frame).inverse();
    const GrayImage under = RenderSpeckle(
        kSize,
        [&](const Eigen::Vector2d& p) {
          return Eigen::Vector2d(motion.kCentre +
                                 back * (p - motion.kCentre - frame * motion.step_px));
        },
        0, 1, other);
    const double share = 0.07 * frame;
    for (std::size_t i = 0; i < image.grey.pixel_count(); ++i) {
      image.grey.data()[i] = static_cast<std::uint16_t>(
          std::lround((1 - share) * image.grey.data()[i] + share * under.grey.data()[i]));
    }
    return image;
  };
  SequenceOptions options = Options(ReferenceMode::kAuto);
  options.least_zncc_share = 0.97;
  options.field.grid = {4, 3};
  options.field.first_px = {56, 54};
  PlanarSequence sequence(worn(0), options);
  options.reference = ReferenceMode::kFixed;
  PlanarSequence fixed(worn(0), options);
  std::int64_t updates = 0;
  std::int64_t reference = -1;
  SequenceFrame frame;
  SequenceFrame with_fixed;
  for (int k = 1; k <= 9; ++k) {
    frame = sequence.Add(worn(k), k);
    with_fixed = fixed.Add(worn(k), k);
    updates += frame.reference_frame != reference ? 1 : 0;
    reference = frame.reference_frame;
  }
  EXPECT_GE(updates, 2);
  EXPECT_LE(updates, 6);
  EXPECT_LE(with_fixed.counts.ok, 6);
  EXPECT_GE(frame.counts.ok, 8);
  std::vector<double> errors;  // what comes through is no noise that sigmas know of
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 4; ++c) {
      if (frame.field.status(r, c) != Status::kOk) continue;
      const Eigen::Vector2d x = frame.field.PixelOf(r, c);
      errors.push_back((frame.field.displacement_px(r, c) - motion.Displacement(9, x)).norm());
    }
  }
  std::cout << updates << " updates, " << frame.counts.ok << " points, with a fixed reference "
            << with_fixed.counts.ok << "; median error " << Median(errors) << " px\n";
  EXPECT_LT(Median(errors), 0.5);
}

TEST(PlanarSequence, RefusesWhatIsNoFrameOfIt) {
  const Motion motion;
  PlanarSequence sequence(motion.Render(0, 1, 1), Options(ReferenceMode::kEvery));
  const GrayImage small{Image<std::uint16_t>({100, 100}, 5), 8};
  EXPECT_THROW(sequence.Add(small, 1), InputError);
  EXPECT_EQ(sequence.Add(motion.Render(1, 1, 2), 2).counts.ok, 30);
  EXPECT_THROW(sequence.Add(small, 3), InputError);
  EXPECT_EQ(sequence.Add(motion.Render(2, 1, 3), 4).reference_frame, 2);
  SequenceOptions none = Options(ReferenceMode::kEvery);
  none.update_every = 0;
  EXPECT_THROW(PlanarSequence(motion.Render(0, 1, 1), none), UsageError);
}

TEST(FieldCorrelator, PassesOverPriorsThatAreNoNumbers) {
  const Motion motion;
  const SequenceOptions options = Options(ReferenceMode::kFixed);
  const FieldCorrelator correlator(motion.Render(0, 1, 1), options.field);
  PlanarField prior = correlator.Correlate(motion.Render(1, 1, 2)).field;
  for (std::size_t i = 0; i < prior.status.pixel_count(); i += 2) {
    prior.displacement_px.data()[i].x() = std::numeric_limits<double>::quiet_NaN();
    prior.gradient.data()[i](0, 1) = std::numeric_limits<float>::infinity();
  }
  EXPECT_EQ(correlator.Correlate(motion.Render(2, 1, 3), {&prior}).counts.ok, 30);
  for (Eigen::Vector2d& d : prior.displacement_px.values()) d.setConstant(NAN);
  EXPECT_EQ(correlator.Correlate(motion.Render(2, 1, 3), {&prior}).counts.ok, 30);
}

TEST(PlanarSequence, ProveErrorsOfSequences) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE to run this";
  ExpectConsistent(ReferenceMode::kFixed, 1, 100);
  ExpectConsistent(ReferenceMode::kEvery, 1, 100);
  ExpectConsistent(ReferenceMode::kEvery, 5, 100);
}

}  // namespace
}  // namespace plumbline
