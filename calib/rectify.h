#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>

#include "calib/image.h"
#include "calib/stereo_rig.h"

namespace plumbline {

enum class RectificationKind {
  kAuto,
  kPinhole,
  kLatLon
};  // auto: pinhole up to 90 degrees of view, else lat-lon

struct RectificationOptions {
  RectificationKind kind = RectificationKind::kAuto;
  double pixels_per_input_pixel = 1.0;  // resolution at the image centre
};

// A pair of virtual cameras whose rows are epipolar lines, and the maps to and from them.
//
// A point at the rectified left pixel (x, y) lies at (x - d, y) in the right one; d is the
// disparity in px. Source: mrcal's rectified systems (LENSMODEL_PINHOLE, LENSMODEL_LATLON).
class Rectification {
 public:
  // Throws InputError when the cameras do not look at anything in common.
  Rectification(const StereoRig& rig, const RectificationOptions& options = {});

  ImageSize size() const;
  RectificationKind kind() const;  // never kAuto
  Eigen::Matrix3d rectified_from_left() const;

  // Resamples a photograph of the left (right) camera; bilinear. `valid` is 0 where the photograph
  // has no such pixel.
  GrayImage RemapLeft(const GrayImage& image, Image<std::uint8_t>* valid = nullptr) const;
  GrayImage RemapRight(const GrayImage& image, Image<std::uint8_t>* valid = nullptr) const;

  // Rectified pixel -> raw pixel of that camera, with the derivative; NaN where it is outside the
  // lens model.
  Eigen::Vector2d LeftRawPixel(const Eigen::Vector2d& rectified,
                               Eigen::Matrix2d* d_raw_d_rectified = nullptr) const;
  Eigen::Vector2d RightRawPixel(const Eigen::Vector2d& rectified,
                                Eigen::Matrix2d* d_raw_d_rectified = nullptr) const;
  // Raw pixel -> rectified pixel.
  Eigen::Vector2d LeftRectifiedPixel(const Eigen::Vector2d& raw) const;
  Eigen::Vector2d RightRectifiedPixel(const Eigen::Vector2d& raw) const;

  // Disparity (px) of a point at a distance (mm, along the ray of the rectified left pixel at the
  // image centre).
  double DisparityAtDistance(double distance_mm) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace plumbline
