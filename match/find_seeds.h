#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "calib/image.h"
#include "match/correlation_seed.h"
#include "match/feature_seeds.h"
#include "match/fft_seeds.h"
#include "match/planar_field.h"

namespace plumbline {

struct FindSeedsOptions {
  FftSeedOptions fft;
  FeatureSeedOptions features;
  bool use_features = true;  // false: FFT only
  // Features are looked for where more than this share of the textured places of the reference has
  // no seed from the FFT near it, and does not leave the image either.
  double max_unexplained = 0.1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Finds where to start correlating a pair, without being told anything of the motion: by FFT
// (FindFftSeeds); and where that leaves part of the reference unexplained, as after a large
// rotation, by features as well (FindFeatureSeeds). Seeds that neighbours contradict and none bears
// out are dropped; parts that move differently, such as a background at rest, keep their own
// motion.
//
// Returns: the best first (then by place), with gradients from the neighbours. Nothing where the
//          images have no texture or nothing in common.
// Throws:  UsageError from options.Check(); InputError when the images or the mask differ in size
//          or the subset does not fit into them.
// The result does not depend on the number of threads.
[[nodiscard]] std::vector<CorrelationSeed> FindSeeds(const GrayImage& reference,
                                                     const GrayImage& deformed,
                                                     const Image<std::uint8_t>* mask = nullptr,
                                                     const FindSeedsOptions& options = {});

// Seeds from a field known before, such as that of the previous frame against the same reference:
// in each cell of spacing_px the point that is kOk with the highest ZNCC (1 where the field has no
// ZNCC, gradient 0 where it has none). Points with a number that is not finite are passed over.
// The best first. Throws InputError when the field's images differ in size, UsageError when
// spacing_px is below 1.
[[nodiscard]] std::vector<CorrelationSeed> SeedsFromField(const PlanarField& prior,
                                                          int spacing_px = 50);

// A motion told by the user: x goes to x + displacement_px + gradient (x - about_px).
struct AffineMotion {
  Eigen::Vector2d about_px{0, 0};
  Eigen::Vector2d displacement_px{0, 0};
  Eigen::Matrix2d gradient = Eigen::Matrix2d::Zero();

  // Turned about about_px, from x towards y for positive angles, and moved.
  static AffineMotion Rigid(const Eigen::Vector2d& about_px, double angle_rad,
                            const Eigen::Vector2d& displacement_px);
};

// Seeds of that motion on a lattice over an image of this size (where mask is not 0; may be null),
// those left out that leave the image. All have the score 1; sorted by place. Throws InputError
// when the mask has another size or the motion is not finite, UsageError when spacing_px is
// below 1.
[[nodiscard]] std::vector<CorrelationSeed> SeedsFromAffine(
    const AffineMotion& motion, ImageSize size, const Image<std::uint8_t>* mask = nullptr,
    int spacing_px = 50);

}  // namespace plumbline
