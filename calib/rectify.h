#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "calib/image.h"
#include "calib/stereo_rig.h"

namespace plumbline {

enum class RectificationKind {
  kAuto,     // pinhole up to 90 degrees of view, else lat-lon
  kPinhole,  // x = fx X/Z + cx, y = fy Y/Z + cy
  kLatLon    // x = fx asin(X/|P|) + cx, y = fy atan2(Y, Z) + cy: the same angle everywhere
};

struct RectificationOptions {
  RectificationKind kind = RectificationKind::kAuto;
  double pixels_per_input_pixel = 1.0;  // resolution where the cameras look at
  // Distance along the left camera's optical axis at which the disparity is to be about zero.
  // Empty: where the optical axes come closest; for parallel axes, infinity.
  std::optional<double> working_distance_mm;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// A pair of virtual cameras whose rows are epipolar lines, and the maps to and from them.
//
// Both sit where the real ones do and are turned alike: x points from the left to the right camera,
// z is the mean viewing direction without its part along x, y completes them. So a point P lies at
// P in the left one and at P - (baseline, 0, 0) in the right one, on the same row. Source: mrcal's
// rectified systems (LENSMODEL_PINHOLE, LENSMODEL_LATLON); axes and projections are mrcal's.
//
// Disparity. A point at the rectified left pixel (x, y) lies at (x - d, y) in the right image.
// Unlike mrcal's, the two images have principal points of their own: cx of the right one is larger
// by ZeroDisparityOffset_px(), chosen so that d is zero at the working distance. On a rig whose
// cameras converge, both images thus show the same scene at nearly the same place and d stays
// small; for the pinhole kind
//   d = fx baseline / Z - ZeroDisparityOffset_px().
// So d is negative beyond the working distance and positive before it.
//
// Size. The images hold all that either camera sees at the working distance, in the rows that both
// see, within 75 degrees of z for pinhole; at the input resolution times pixels_per_input_pixel at
// the working point, reduced where the image would have more than 4 times the pixels of the larger
// photograph.
//
// Frames: `rectified` is the left virtual camera. Pixels: (0, 0) is the centre of the top-left one.
// Copies are cheap; all methods are thread-safe. Accuracy: tests/calib/rectify_test.cc.
class Rectification {
 public:
  // Throws InputError when the cameras do not look at anything in common, UsageError for options
  // out of range.
  Rectification(const StereoRig& rig, const RectificationOptions& options = {});

  ImageSize size() const;          // of both rectified images
  RectificationKind kind() const;  // never kAuto
  Eigen::Matrix3d rectified_from_left() const;
  Eigen::Matrix3d rectified_from_right() const;
  double baseline_mm() const;

  // fx, fy, cx, cy in px (pinhole) or px / rad (lat-lon).
  Eigen::Vector4d LeftIntrinsics() const;
  Eigen::Vector4d RightIntrinsics() const;

  // Resamples a photograph of the left (right) camera, bilinear, at its own bit depth. `valid` is
  // 255, and 0 where the photograph has no such pixel (the image is 0 there). The map (float, 8
  // bytes a pixel) is computed at the first call and kept. Bits are the same for any number of
  // threads. Throws InputError when the photograph has not the camera's size.
  GrayImage RemapLeft(const GrayImage& image, Image<std::uint8_t>* valid = nullptr) const;
  GrayImage RemapRight(const GrayImage& image, Image<std::uint8_t>* valid = nullptr) const;

  // Rectified pixel -> raw pixel of that camera, with the derivative; exact, not through the map.
  // NaN where it is outside the lens model: no projection, or further off axis than what the image
  // shows.
  Eigen::Vector2d LeftRawPixel(const Eigen::Vector2d& rectified,
                               Eigen::Matrix2d* d_raw_d_rectified = nullptr) const;
  Eigen::Vector2d RightRawPixel(const Eigen::Vector2d& rectified,
                                Eigen::Matrix2d* d_raw_d_rectified = nullptr) const;

  // Many at once, in parallel, the same bits. Spans are of one size; the derivatives' may be empty.
  void LeftRawPixels(std::span<const Eigen::Vector2d> rectified, std::span<Eigen::Vector2d> raw,
                     std::span<Eigen::Matrix2d> d_raw_d_rectified = {}) const;
  void RightRawPixels(std::span<const Eigen::Vector2d> rectified, std::span<Eigen::Vector2d> raw,
                      std::span<Eigen::Matrix2d> d_raw_d_rectified = {}) const;

  // Raw pixel -> rectified pixel, with the derivative. NaN where the lens model has no ray, or the
  // ray points out of the back of a pinhole image.
  Eigen::Vector2d LeftRectifiedPixel(const Eigen::Vector2d& raw,
                                     Eigen::Matrix2d* d_rectified_d_raw = nullptr) const;
  Eigen::Vector2d RightRectifiedPixel(const Eigen::Vector2d& raw,
                                      Eigen::Matrix2d* d_rectified_d_raw = nullptr) const;

  // cx of the right image less cx of the left one: the disparity is zero where the two rays' pixel
  // distance equals it.
  double ZeroDisparityOffset_px() const;

  // Disparity (px) of a point at a distance (mm, along the ray of the rectified left pixel at the
  // image centre), and back. DistanceAtDisparity is infinite for parallel rays, NaN for diverging
  // ones.
  double DisparityAtDistance(double distance_mm) const;
  double DistanceAtDisparity(double disparity_px) const;

  // The point (mm, rig frame) at a rectified left pixel and a disparity: mrcal's stereo_unproject
  // with the offset. NaN where the rays do not meet in front.
  Eigen::Vector3d PointInRig(const Eigen::Vector2d& rectified_left, double disparity_px) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace plumbline
