#pragma once

#include <Eigen/Core>
#include <optional>

#include "calib/image.h"

namespace plumbline::internal {

// An ellipse in the image: points with (p - centre)' shape (p - centre) = 1; shape in 1/px^2.
struct Ellipse {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  Eigen::Matrix2d shape = Eigen::Matrix2d::Identity();

  double AreaPx2() const;
  double MeanRadiusPx() const;  // of the circle of the same area
  // 1 on the edge, 0 at the centre, proportional along a ray.
  double NormalisedRadius(const Eigen::Vector2d& p) const;
};

// A disc's image fitted to grey values.
struct DiscFit {
  Ellipse ellipse;          // the disc's edge; its centre is the centroid of the disc's image
  Eigen::Matrix2d cov_px2;  // of the centre: residual variance times the normal matrix's inverse
  double blur_px = 0;       // standard deviation of the edge's blur, pixel area included
  double contrast = 0;      // bright minus dark, grey levels; negative for white dots
  double residual = 0;      // rms, grey levels
};

// Fits  I = B + (D - B) C  to the pixels within `reach` normalised radii of `start`, by
// Levenberg-Marquardt on the unweighted squares. B and D are planes (background and disc level:
// shading is linear over a dot), C = Phi(-d / s) the covered share of a pixel, d the distance to
// the ellipse (first order, (rho - 1) rho / |M delta|), s the blur, whose part from the pixel's own
// area is 1/sqrt(12) px. All terms are odd or even about the centre, so that a disc under any
// linear shading, blur and sampling phase has an unbiased centre, unlike the ellipse through
// thresholded edges or the grey-weighted centroid.
//
// A `ring` has a second, brighter ellipse inside, of the same shape and a centre of its own
// (perspective shifts the centres of the two circles differently).
//
// Returns nothing when the disc leaves the image, the fit does not converge, or what it converged
// to is no disc (radius, contrast or centre changed beyond reason).
// Pure and thread-safe. Accuracy: tests/calib/detect_discs_test.cc.
std::optional<DiscFit> FitDisc(const GrayImage& image, const Ellipse& start, double reach,
                               bool ring);

}  // namespace plumbline::internal
