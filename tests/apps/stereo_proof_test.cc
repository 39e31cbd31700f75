// Whether the sigmas of stereo-DIC hold at the end of the whole chain: draws of the images' noise,
// of the calibration, and of both.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <Eigen/Eigenvalues>
#include <array>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "tests/apps/stereo_scene.h"
#include "tests/support/subset_noise.h"

namespace plumbline {
namespace {

using testing::Consistency;
using testing::PairOf;
using testing::SpeckledSheet;

constexpr int kFrames = 3;  // after the reference

// Stretched, sheared, turned and moved.
SpeckledSheet SheetAt(int frame) {
  SpeckledSheet sheet;
  const double t = frame;
  sheet.rig_from_sheet = Rigid3::FromRotationVector(
      {0.1 + 0.02 * t, -0.25 - 0.01 * t, 0.1 + 0.04 * t}, {0.4 * t, -0.3 * t, 400 + 0.7 * t});
  sheet.stretch << 1 + 0.01 * t, 0.004 * t, -0.002 * t, 1 - 0.006 * t;
  return sheet;
}

// Standard normal numbers, one row a draw, scaled and sheared so that their sample means are 0 and
// their sample covariance is 1 (moment matching): what linear propagation makes of them has no
// sampling error in its mean square.
Eigen::MatrixXd Draws(int draws, int modes, std::uint32_t seed) {
  testing::NormalDeviates normal(seed);
  Eigen::MatrixXd g(draws, modes);
  for (int n = 0; n < draws; ++n) {
    for (int k = 0; k < modes; ++k) g(n, k) = normal();
  }
  g.rowwise() -= g.colwise().mean().eval();
  const Eigen::MatrixXd cov = g.transpose() * g / draws;
  return g * Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(cov).operatorInverseSqrt();
}

struct Kind {
  const char* name;
  bool noise, calibration;
};

struct Proof {
  Consistency x, y, z, height_at_rest, displacement, strain_xx, strain_yy, strain_xy, angles,
      offset;
};

struct Part {
  const char* name;
  Consistency Proof::*part;
  double looser = 1;  // factor on the tolerances, in images without noise
};
// Without noise the heights of the reference pair show what matches are off by on their own
// (docs/stereo_dic.md).
constexpr std::array kParts = {Part{"position x, mm", &Proof::x},
                               Part{"position y, mm", &Proof::y},
                               Part{"position z, mm", &Proof::z},
                               Part{"z of the reference pair, mm", &Proof::height_at_rest, 2.2},
                               Part{"displacement, mm", &Proof::displacement},
                               Part{"strain xx", &Proof::strain_xx},
                               Part{"strain yy", &Proof::strain_yy},
                               Part{"strain xy", &Proof::strain_xy},
                               Part{"plane angles, rad", &Proof::angles},
                               Part{"plane offset, mm", &Proof::offset}};

// One sigma of what the kind of draw varies.
template <typename Random, typename Calibration>
Eigen::Vector3d SigmaOf(const Kind& kind, const Random& random, const Calibration& calibration) {
  Eigen::Vector3d variance = Eigen::Vector3d::Zero();
  if (kind.noise) variance += random.template cast<double>().cwiseAbs2();
  if (kind.calibration) variance += calibration.template cast<double>().cwiseAbs2();
  return variance.cwiseSqrt();
}

// All that the frames of one run say, against the truth.
void Compare(const Kind& kind, const StereoRig& true_rig, const SeriesFrame& at_rest,
             const Image<Eigen::Vector2f>& grid_px, int number, const SeriesFrame& frame,
             Proof& proof) {
  const SpeckledSheet first = SheetAt(0), now = SheetAt(number);
  const Rigid3 ground_from_rig = testing::TrueGroundFromRig(first, true_rig, grid_px, at_rest);
  const Eigen::Vector3d plane =
      PlaneDifference(testing::PlaneOf(frame.ground), testing::PlaneOf(now));
  const Eigen::Vector3d plane_sigma =
      SigmaOf(kind, frame.ground.cov_random.diagonal().cwiseSqrt().eval(),
              frame.ground.cov_calibration.diagonal().cwiseSqrt().eval());
  proof.angles.AddEach(plane.head<2>().eval(), plane_sigma.head<2>().eval());
  proof.offset.Add(plane[2], plane_sigma[2]);
  for (std::size_t i = 0; i < frame.surface.status.pixel_count(); ++i) {
    if (frame.surface.status.data()[i] != Status::kOk) continue;
    const Eigen::Vector2d material = first.MaterialAt(true_rig, grid_px.data()[i].cast<double>());
    const Eigen::Vector3d before = ground_from_rig * first.PointInRig(material);
    const Eigen::Vector3d after = ground_from_rig * now.PointInRig(material);
    const Eigen::Vector3d off = frame.surface.position_mm.data()[i].cast<double>() - after;
    const Eigen::Vector3d sigma_position = SigmaOf(kind, frame.surface.sigma_random_mm.data()[i],
                                                   frame.surface.sigma_calibration_mm.data()[i]);
    proof.x.Add(off[0], sigma_position[0]);
    proof.y.Add(off[1], sigma_position[1]);
    proof.z.Add(off[2], sigma_position[2]);
    if (number == 0) proof.height_at_rest.Add(off[2], sigma_position[2]);
    if (number == 0) continue;
    proof.displacement.AddEach(
        (frame.displacement.value_mm.data()[i].cast<double>() - (after - before)).eval(),
        SigmaOf(kind, frame.displacement.sigma_random_mm.data()[i],
                frame.displacement.sigma_calibration_mm.data()[i]));
    if (frame.strain.status.data()[i] != Status::kOk) continue;
    const Eigen::Vector3d error = frame.strain.value.data()[i].cast<double>() -
                                  TrueStrain(first, now, material, Eigen::Vector3d::UnitX());
    const Eigen::Vector3d sigma = SigmaOf(kind, frame.strain.sigma_random.data()[i],
                                          frame.strain.sigma_calibration.data()[i]);
    proof.strain_xx.Add(error[0], sigma[0]);
    proof.strain_yy.Add(error[1], sigma[1]);
    proof.strain_xy.Add(error[2], sigma[2]);
  }
}

// One draw: a run over all frames.
Proof ProofOf(const Kind& kind, const StereoRig& rig, const Eigen::VectorXd& along_modes,
              std::uint32_t seed) {
  constexpr double kNoise = 1.5;  // grey levels of 8 bits
  testing::RenderedSpeckleOptions speckle;
  speckle.bits = 16;  // so that images without noise have none
  StereoRunOptions options;
  options.sequence.field.correlator.subset_px = 25;
  options.sequence.field.correlator.noise = NoiseModel{std::pow(256 * kNoise, 2), 0};
  options.sequence.field.step_px = 12;
  options.evaluation.strain_options.window_points = 5;
  options.evaluation.strain_axes = "ground";
  StereoRig true_rig = rig;
  if (kind.calibration) {
    true_rig = rig.WithParameters(rig.Parameters() + rig.modes.modes.transpose() * along_modes);
  }
  const auto pair = [&](int number) {
    return PairOf(true_rig, SheetAt(number), kind.noise ? kNoise : 0,
                  10 * seed + static_cast<std::uint32_t>(number), number, speckle);
  };
  Proof proof;
  const StereoFrame reference = pair(0);
  StereoRun run(rig, reference, options);
  const Image<Eigen::Vector2f> grid_px = run.Header().grid_px;
  const SeriesFrame at_rest = run.Measure(reference, 0).frame;
  Compare(kind, true_rig, at_rest, grid_px, 0, at_rest, proof);
  for (int number = 1; number <= kFrames; ++number) {
    const SeriesFrame frame = run.Measure(pair(number), number).frame;
    Compare(kind, true_rig, at_rest, grid_px, number, frame, proof);
  }
  return proof;
}

void Prove(const Kind& kind, int draws, double nees, double coverage) {
  const StereoRig rig = testing::WithModes(testing::ConvergentRig({200, 160}, 1500, 400, 140));
  const Eigen::MatrixXd g = Draws(draws, rig.modes.count(), 7);
  std::vector<Proof> each(static_cast<std::size_t>(draws));
  tbb::parallel_for(0, draws, [&](int draw) {
    each[static_cast<std::size_t>(draw)] =
        ProofOf(kind, rig, g.row(draw), static_cast<std::uint32_t>(draw + 1));
  });
  for (const auto& [name, part, looser] : kParts) {
    Consistency all;
    for (const Proof& proof : each) all.Add(proof.*part);
    all.Print(fmt::format("{} | {}", kind.name, name).c_str());
    const double factor = kind.noise ? 1 : looser;
    EXPECT_NEAR(all.nees(), 1, factor * nees) << kind.name << ", " << name;
    EXPECT_NEAR(all.coverage(), 0.95, factor * coverage) << kind.name << ", " << name;
  }
}

constexpr std::array kKinds = {Kind{"noise", true, false}, Kind{"calibration", false, true},
                               Kind{"both", true, true}};

TEST(StereoProof, SigmasHoldFromImagesToStrain) { Prove(kKinds[2], 16, 0.2, 0.06); }

TEST(StereoProof, ProveSigmasOver200Draws) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  for (const Kind& kind : kKinds) Prove(kind, 200, 0.10, 0.02);
}

}  // namespace
}  // namespace plumbline
