#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "fit/outline.h"

namespace plumbline {

// Where a tyre touches the ground, from its inner surface.
//
// Definition. A point is in contact where its gap, the height above the ground plane less the
// thickness of the carcass over it, is at most threshold_mm. The gross contact area is what the
// outline of these points encloses in the ground plane, tread grooves included; between a point in
// contact and its neighbour that is not, the gap is taken to be linear, so that the outline lies
// between the points of the grid.
//
// The gap rises slowly from nothing where the carcass lifts off, so that the area depends on the
// threshold: d_area_d_threshold tells how much. It has to be above what noise does to the gap.
struct ContactPatchOptions {
  double threshold_mm = 0.5;
  // Outlines that enclose less than this share of the largest one's area are specks of noise: left
  // out, parts and holes alike, and counted.
  double least_share = 0.01;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct ContactPatch {
  double area_mm2 = 0;
  double length_mm = 0;               // extent along the ground's x
  double width_mm = 0;                // along y
  Eigen::Vector2d centroid_mm{0, 0};  // ground x, y
  double shape_factor = 0;            // area / (length width): 1 a rectangle, pi / 4 an ellipse
  double d_area_d_threshold_mm = 0;   // mm^2 a mm
  std::vector<Polygon> contours_mm;   // ground x, y; parts to their left, holes the other way
  int left_out = 0;                   // specks

  // The outline's length, and how much of it runs along points that are missing or the edge of the
  // grid, not along a threshold that was passed: where that is not 0 the patch is at least as large
  // as is said here.
  double perimeter_mm = 0, unseen_perimeter_mm = 0;
  bool complete() const { return unseen_perimeter_mm == 0; }

  // Area, length, width, centroid x and y, shape factor; in units of mm.
  static constexpr int kResults = 6;
  using Results = Eigen::Matrix<double, kResults, 1>;
  Results results() const;

  // What a point's error does to the results; columns: the point's x, y, z. To first order: length
  // and width hang on the outermost points alone, and are longer by about a sigma of these where
  // the ends are blunt.
  struct Influence {
    std::size_t place = 0;  // row * columns + column
    Eigen::Matrix<double, kResults, 3> change;
  };
  std::vector<Influence> influences;  // by place

  // Of the results. cov_mm2: of a point. correlation: of the errors of two points, 1 for a point
  // with itself.
  using Covariance = Eigen::Matrix<double, kResults, kResults>;
  Covariance CovarianceOf(
      const std::function<Eigen::Matrix3d(std::size_t place)>& cov_mm2,
      const std::function<double(std::size_t a, std::size_t b)>& correlation) const;
  // What a common error of all points does (one entry a point of the grid), as along one
  // calibration mode.
  Results ChangeWith(const Image<Eigen::Vector3d>& error_mm) const;
};

// position_mm: points of a grid in the ground frame (z up); NaN where there is none. thickness_mm:
// of the carcass over each, measured along z. Nothing where no point is in contact, or only specks
// (the reason is then in *why, if given). Throws UsageError from the options,
// std::invalid_argument where the sizes differ.
// Accuracy: tests/fit/contact_patch_test.cc.
std::optional<ContactPatch> FindContactPatch(const Image<Eigen::Vector3d>& position_mm,
                                             const Image<double>& thickness_mm,
                                             const ContactPatchOptions& options = {},
                                             std::string* why = nullptr);

// The outer surface, as far as the thickness tells: each point moved by it along the surface's
// normal, away from the wheel axis (downwards in the patch). The normal is that of the plane
// through the point's neighbours; NaN where one of the four is missing.
Image<Eigen::Vector3d> OuterSurface(const Image<Eigen::Vector3d>& position_mm,
                                    const Image<double>& thickness_mm);

}  // namespace plumbline
