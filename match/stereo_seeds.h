#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <vector>

#include "calib/image.h"
#include "calib/rectify.h"
#include "calib/stereo_rig.h"
#include "match/correlation_seed.h"
#include "match/disparity.h"
#include "match/find_seeds.h"

namespace plumbline {

struct StereoSeedOptions {
  FindSeedsOptions seeds;
  // Seeds further from their epipolar line are mismatches, unless most are: then the rig does not
  // fit the images.
  double max_epipolar_px = 4;
  // Fewer seeds than this share of the textured cells of seeds.fft.spacing_px: the rectified pair
  // is matched as well.
  double min_cell_share = 0.6;
  RectificationOptions rectification = {RectificationKind::kAuto, 0.5, std::nullopt};
  DisparityOptions disparity;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct StereoSeeds {
  std::vector<CorrelationSeed> seeds;  // from left to right, the best first
  // What the search by FFT and features said of the rig, before seeds were left out.
  std::int64_t off_epipolar = 0;   // seeds further than max_epipolar_px from their line
  std::int64_t behind_camera = 0;  // seeds whose rays meet behind a camera
  std::int64_t found = 0;          // all of them
  bool from_disparity = false;     // whether the rectified pair was matched

  // Whether most of what was found contradicts the rig (then nothing else was looked for): it is
  // that of other cameras, or left and right are swapped.
  bool ContradictRig() const {
    constexpr std::int64_t kEnough = 12;
    return found >= kEnough && 2 * std::max(off_epipolar, behind_camera) > found;
  }
};

// Finds where the correlation of a stereo pair can start, without settings of the user: by FFT and
// features on the raw images (FindSeeds), kept where they lie by their epipolar lines; and where
// that leaves much of the left image without a seed, as between views that are turned or bent
// against each other, by semi-global matching of the rectified pair (ComputeDisparity), taken back
// to the raw images with the gradient that rectification and disparity give together.
//
// mask: of the left image, 0 where a pixel is not to be used; may be null.
// Throws: UsageError from options.Check(); InputError when the images are not of the cameras'
//         sizes, or nothing is found and the rectified pair cannot be matched either, with why.
//         Where most of what is found contradicts the rig, the counts tell.
// The result does not depend on the number of threads.
[[nodiscard]] StereoSeeds FindStereoSeeds(const StereoRig& rig, const GrayImage& left,
                                          const GrayImage& right,
                                          const Image<std::uint8_t>* mask = nullptr,
                                          const StereoSeedOptions& options = {});

}  // namespace plumbline
