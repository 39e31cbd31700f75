// From images to strain: whether the sigmas hold at the end of the chain, overlap and all.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cstdlib>

#include "match/correlate_field.h"
#include "tests/support/consistency.h"
#include "tests/support/rendered_speckle.h"
#include "track/planar_strain.h"

namespace plumbline {
namespace {

using testing::Consistency;

struct Chain {
  Consistency displacement, gradient, strain;
};

// A stretched, sheared and turned specimen in noise of two grey levels.
Chain Simulate(int draws, bool know_the_noise) {
  const ImageSize size{190, 190};
  const Eigen::Vector2d middle(95, 95);
  const Eigen::Vector2d shift(0.37, -0.61);
  Eigen::Matrix2d gradient;
  gradient << 0.004, 0.003, -0.002, -0.006;
  const Eigen::Matrix2d back = (Eigen::Matrix2d::Identity() + gradient).inverse();
  const auto deformed_from = [&](const Eigen::Vector2d& p) {
    return Eigen::Vector2d(middle + back * (p - middle - shift));
  };
  const Eigen::Matrix2d green =
      (gradient + gradient.transpose() + gradient.transpose() * gradient) / 2;
  const Eigen::Vector3d true_strain(green(0, 0), green(1, 1), green(0, 1));
  constexpr double kNoise = 2;
  FieldOptions options;
  options.correlator.subset_px = 21;
  options.step_px = 7;  // subsets three deep in each other
  if (know_the_noise) options.correlator.noise = NoiseModel{kNoise * kNoise, 0};
  PlanarStrainOptions gauge;
  gauge.window_points = 5;
  Chain chain;
  for (int draw = 0; draw < draws; ++draw) {
    const auto seed = static_cast<std::uint32_t>(2 * draw + 1);
    const FieldCorrelator correlator(
        testing::RenderSpeckle(
            size, [](const Eigen::Vector2d& p) { return p; }, kNoise, seed),
        options);
    const CorrelatedField found =
        correlator.CorrelateFrom(testing::RenderSpeckle(size, deformed_from, kNoise, seed + 1),
                                 {{middle, shift, gradient, 1}});
    const PlanarField& field = found.field;
    for (int r = 0; r < field.size().height; ++r) {
      for (int c = 0; c < field.size().width; ++c) {
        if (field.status(r, c) != Status::kOk) continue;
        const Eigen::Vector2d truth = shift + gradient * (field.PixelOf(r, c) - middle);
        chain.displacement.AddJoint(Eigen::Vector2d(field.displacement_px(r, c) - truth),
                                    CovarianceOf(field.cov_displacement_px2(r, c)));
        const Eigen::Matrix2d off = field.gradient(r, c).cast<double>() - gradient;
        chain.gradient.AddJoint(Eigen::Vector4d(off(0, 0), off(0, 1), off(1, 0), off(1, 1)),
                                CovarianceOf(field.cov_gradient(r, c)));
      }
    }
    const PlanarStrain strain = ComputePlanarStrain(field, correlator.neighbours(), gauge);
    for (std::size_t i = 0; i < strain.status.pixel_count(); ++i) {
      if (strain.status.data()[i] != Status::kOk) continue;
      const Eigen::Matrix<double, 6, 1> c = strain.cov_strain.data()[i].cast<double>();
      Eigen::Matrix3d cov;
      cov << c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5];
      chain.strain.AddJoint(Eigen::Vector3d(strain.strain.data()[i].cast<double>() - true_strain),
                            cov);
    }
  }
  return chain;
}

void ExpectConsistent(const Chain& chain, double nees, double coverage) {
  chain.displacement.Print("displacement");
  chain.gradient.Print("gradient");
  chain.strain.Print("strain, overlapping gauges");
  for (const Consistency* part : {&chain.displacement, &chain.gradient, &chain.strain}) {
    EXPECT_NEAR(part->nees(), 1, nees);
    EXPECT_NEAR(part->coverage(), 0.95, coverage);
  }
}

TEST(PlanarChain, SigmasHoldFromImagesToStrain) {
  ExpectConsistent(Simulate(30, true), 0.12, 0.025);
}

TEST(PlanarChain, ProveSigmasOver200Draws) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE=1";
  for (const bool know : {true, false}) {
    std::printf("noise %s\n| | NEES / dimension | 95 %% interval | vectors |\n",
                know ? "known" : "estimated");
    ExpectConsistent(Simulate(200, know), 0.10, 0.02);
  }
}

}  // namespace
}  // namespace plumbline
