#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "calib/image.h"
#include "match/noise_model.h"

namespace plumbline {

struct PhotonTransferOptions {
  int tile_px = 32;  // brightness and motion between two frames are taken out tile by tile
  // Two frames between which the picture moved more than that do not count as still.
  double max_motion_px = 0.2;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// One point of the photon-transfer curve.
struct PhotonTransferPoint {
  double grey = 0;            // mean level of its pixels
  double variance_grey2 = 0;  // of a pixel's level, rounding taken off
  double sigma_grey2 = 0;     // of that variance
  std::int64_t pixels = 0;
};

// Noise of a camera as found from still frames, and how sure it is.
struct PhotonTransfer {
  NoiseModel model;
  Eigen::Matrix2d cov = Eigen::Matrix2d::Zero();  // of (offset_grey2, slope_grey)
  bool constant = false;                          // the slope could not be told: it is 0
  double chi2_per_dof = 0;                        // of the line through the curve; 1 is perfect
  double misfit = 0;  // rms of the curve's departure from the line, relative
  std::vector<PhotonTransferPoint> curve;

  int bits = 8;
  ImageSize size;
  int frames = 0;
  int pairs = 0;           // of consecutive frames, used
  int moved_pairs = 0;     // left out, because something moved
  double motion_px = 0;    // largest between the frames of a used pair; taken out
  double flicker = 0;      // largest change of brightness between two frames, relative; taken out
  double used_share = 0;   // of the pixels, over the used pairs
  double black_share = 0;  // clipped at the dark end
  double white_share = 0;  // saturated
  double lowest_grey = 0;  // of the pixels used: outside, the line is extrapolated
  double highest_grey = 0;
  // Of the noise of a pixel and its neighbour, in row or column, the larger. Cameras and videos
  // that filter their images have it; sigmas for independent pixels are then too small.
  double neighbour_correlation = 0;
  std::vector<std::string> notes;  // what the user should know, one sentence each

  double sigma_offset_grey2() const;
  double sigma_slope_grey() const;
};

// Fits the photon-transfer line sigma^2(I) = b + a I (Janesick, "Photon Transfer", SPIE 2007) to
// still frames of one camera, given one after the other; two are held at a time.
//
// Of each two consecutive frames the difference is taken. Tile by tile a plane, a part in
// proportion to the grey level and one to its gradients are fitted to it and subtracted: flicker,
// drift, uneven changes of the light and small motions. What is left has twice the pixel's
// variance. It is collected by grey level; pixels that are clipped, or so near to an end that their
// noise would be, do not count, nor do tiles whose scatter stands out (moving spots). The line is
// the weighted least-squares fit to the variances less that of rounding (1/12), neither slope nor
// offset negative. Sigmas: from normally distributed noise and the frames that pairs share, scaled
// by the root of chi2_per_dof where that is above 1.
//
// Units: grey levels of the frames' own bits. Independent of the number of threads.
// Accuracy: tests/match/photon_transfer_test.cc.
class PhotonTransferFit {
 public:
  // `mask`: 0 is left out; empty: all counts. Throws UsageError from the options.
  explicit PhotonTransferFit(const PhotonTransferOptions& options = {},
                             Image<std::uint8_t> mask = {});
  ~PhotonTransferFit();

  // Throws InputError when the frame's size is not that of the mask or the first frame.
  void Add(const GrayImage& frame);

  // Throws InputError saying why nothing can be found: fewer than two frames, identical ones,
  // frames that moved or changed, nothing but clipped pixels.
  PhotonTransfer Fit() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The same of frames that are all there.
PhotonTransfer FitPhotonTransfer(const std::vector<GrayImage>& frames,
                                 const PhotonTransferOptions& options = {});

}  // namespace plumbline
