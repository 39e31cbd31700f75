#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// Which lens model, with its configuration. The names, formulas and parameter order are mrcal's.
//
//   OPENCV4  fx fy cx cy k1 k2 p1 p2
//   OPENCV5  ... k3
//   OPENCV8  ... k3 k4 k5 k6
//   SPLINED_STEREOGRAPHIC  fx fy cx cy, then (x, y) of every control point, row by row
struct LensModel {
  enum class Kind { kOpenCv4, kOpenCv5, kOpenCv8, kSplinedStereographic };

  Kind kind = Kind::kOpenCv5;
  // Splined models only: 2 (quadratic) or 3 (cubic), control points across and down, horizontal
  // field of view.
  int spline_order = 3;
  int knots_x = 0;
  int knots_y = 0;
  int fov_x_deg = 0;

  // "LENSMODEL_OPENCV5", "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=11_fov_x_deg=80": what
  // .cameramodel files hold.
  std::string Name() const;

  // Reads such a name; the prefix "LENSMODEL_" and upper case may be left out. Throws InputError on
  // one that is not supported.
  static LensModel FromName(std::string_view name);

  int ParameterCount() const;
  bool IsSplined() const { return kind == Kind::kSplinedStereographic; }

  friend bool operator==(const LensModel&, const LensModel&) = default;
};

// A camera: lens model, image size and intrinsic parameters. Immutable; copies are cheap.
//
// Frames:  camera: x right, y down, z forward.
// Pixels:  (0, 0) is the centre of the top-left pixel.
// The lens formulas are evaluated by libmrcal.
class Camera {
 public:
  // Throws std::invalid_argument when the number of parameters is not the model's, one is not
  // finite, or a focal length is not positive.
  Camera(const LensModel& model, ImageSize size, Eigen::VectorXd parameters);

  const LensModel& model() const;
  ImageSize size() const;
  const Eigen::VectorXd& parameters() const;
  int parameter_count() const { return static_cast<int>(parameters().size()); }

  // The same camera with other parameter values.
  Camera WithParameters(Eigen::VectorXd parameters) const;

  // Projects one point (mm, camera frame). NaN when the point cannot be seen by this model: z <= 0
  // for the OPENCV models.
  Eigen::Vector2d Project(const Eigen::Vector3d& point_mm) const;

  struct Projection {
    Eigen::Vector2d pixel;
    Eigen::Matrix<double, 2, 3> d_pixel_d_point;                    // px / mm
    Eigen::Matrix<double, 2, Eigen::Dynamic> d_pixel_d_parameters;  // px / parameter
  };
  // The same with exact derivatives; all NaN when the point cannot be seen.
  Projection ProjectWithJacobians(const Eigen::Vector3d& point_mm) const;

  // Many points at once; pixels.size() == points_mm.size(). Splits the work over threads for large
  // inputs.
  void Project(std::span<const Eigen::Vector3d> points_mm, std::span<Eigen::Vector2d> pixels) const;

  // The same with d pixel/d point (px / mm) of each; all NaN where a point cannot be seen.
  void ProjectWithPointJacobians(std::span<const Eigen::Vector3d> points_mm,
                                 std::span<Eigen::Vector2d> pixels,
                                 std::span<Eigen::Matrix<double, 2, 3>> d_pixel_d_point) const;

  // The unit viewing ray of a pixel. NaN where the model cannot be inverted (the distortion folds
  // over) or the solve does not reach 1e-9 px.
  Eigen::Vector3d Unproject(const Eigen::Vector2d& pixel) const;

  struct Unprojection {
    Eigen::Vector3d ray;                                          // unit length
    Eigen::Matrix<double, 3, 2> d_ray_d_pixel;                    // 1 / px
    Eigen::Matrix<double, 3, Eigen::Dynamic> d_ray_d_parameters;  // 1 / parameter
  };
  // With G = d pixel / d ray (2x3, its null space is the ray):  d ray/d pixel = G'(GG')^-1,
  // d ray/d parameters = -(d ray/d pixel)(d pixel/d parameters), by the implicit function theorem.
  Unprojection UnprojectWithJacobians(const Eigen::Vector2d& pixel) const;

  // Many pixels at once, as Project().
  void Unproject(std::span<const Eigen::Vector2d> pixels, std::span<Eigen::Vector3d> rays) const;

  // The same with d ray/d pixel (1 / px) of each, NaN where there is no ray. All spans are of one
  // size; the rays are those of Unproject() to the bit.
  void UnprojectWithPixelJacobians(std::span<const Eigen::Vector2d> pixels,
                                   std::span<Eigen::Vector3d> rays,
                                   std::span<Eigen::Matrix<double, 3, 2>> d_ray_d_pixel) const;

  bool Contains(const Eigen::Vector2d& pixel) const {
    return pixel.x() >= -0.5 && pixel.y() >= -0.5 && pixel.x() <= size().width - 0.5 &&
           pixel.y() <= size().height - 0.5;
  }

  // Where the lens model cannot be trusted to be one-to-one: the share of a grid of step_px pixels
  // for which unprojection fails or does not project back to the same pixel. 0 for a healthy
  // calibration.
  double NonInvertibleShare(int step_px = 16) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace plumbline
