#include "io/virtual_rig/specimen_surfaces.h"

#include <ceres/rotation.h>

#include <cmath>
#include <numbers>

#include "calib/error.h"
#include "io/virtual_rig/internal/jet_instant.h"
#include "io/virtual_rig/internal/smooth_step.h"

namespace plumbline {
namespace {

using internal::Vector3;

class SpecimenShape {
 public:
  explicit SpecimenShape(const SpecimenOptions& options) : options_(options) {}

  template <typename S>
  struct State {
    S share;              // of the full deformation
    Vector3<S> rotation;  // rotation vector
    Vector3<S> translation;
  };

  template <typename S>
  State<S> StateAt(const S& time_s) const {
    const S share = time_s / options_.end_time_s;
    return {share, options_.rotation_rad * share, options_.translation_mm * share};
  }

  template <typename T, typename S>
  Vector3<T> Position(const State<S>& state, const T& u, const T& v) const {
    const Eigen::Matrix2d& G = options_.displacement_gradient;
    const T du = (G(0, 0) * u + G(0, 1) * v) * state.share;
    const T dv = (G(1, 0) * u + G(1, 1) * v + Star(u, v)) * state.share;
    const Vector3<T> shaped = Shaped(T(u + du), T(v + dv));
    Vector3<T> rotation, rotated;
    for (int k = 0; k < 3; ++k) rotation[k] = T(state.rotation[k]);
    ceres::AngleAxisRotatePoint(rotation.data(), shaped.data(), rotated.data());
    for (int k = 0; k < 3; ++k) rotated[k] += state.translation[k];
    return rotated;
  }

  MaterialDomain Domain() const {
    const Eigen::Vector2d half = options_.size_mm / 2;
    return {-half.x(), half.x(), -half.y(), half.y()};
  }
  // A little more than there is, so that the edge lies within what cameras look at.
  MaterialDomain WindowAt(const State<double>&) const {
    const Eigen::Vector2d half = 0.53 * options_.size_mm;
    return {-half.x(), half.x(), -half.y(), half.y()};
  }

 private:
  template <typename T>
  T Star(const T& u, const T& v) const {
    using std::cos;
    if (options_.star_amplitude_mm == 0) return T(0.0);
    const double slope =
        (options_.star_period_max_mm - options_.star_period_min_mm) / options_.size_mm.x();
    // Beyond the left edge the period stops shrinking, so that it never reaches zero.
    const T beyond = u + options_.size_mm.x() / 2;
    const T period = options_.star_period_min_mm / 2 +
                     internal::SmoothRamp(T(beyond * slope + options_.star_period_min_mm / 2),
                                          options_.star_period_min_mm / 4);
    return options_.star_amplitude_mm * cos(2 * std::numbers::pi * v / period);
  }

  template <typename T>
  Vector3<T> Shaped(const T& x, const T& y) const {
    using std::cos;
    using std::sin;
    switch (options_.shape) {
      case SpecimenOptions::Shape::kIncline:
        return {x, y, std::tan(options_.incline_rad) * internal::SmoothRamp(x, options_.crease_mm)};
      case SpecimenOptions::Shape::kCylinder: {
        const double r = options_.cylinder_radius_mm;
        return {T(r * sin(x / r)), y, T(r * (cos(x / r) - 1.0))};
      }
      default:
        return {x, y, T(0.0)};
    }
  }

  SpecimenOptions options_;
};

class Specimen : public MaterialSurface {
 public:
  explicit Specimen(const SpecimenOptions& options)
      : shape_(std::make_shared<SpecimenShape>(options)) {}

  MaterialDomain Domain() const override { return shape_->Domain(); }
  std::unique_ptr<const SurfaceInstant> At(double time_s) const override {
    return std::make_unique<internal::JetInstant<SpecimenShape>>(shape_, time_s);
  }
  std::unique_ptr<const SurfaceInstant> Reference(double) const override { return At(0); }

 private:
  std::shared_ptr<const SpecimenShape> shape_;
};

}  // namespace

void SpecimenOptions::Check() const {
  if (!(size_mm.minCoeff() > 0)) throw UsageError("The specimen's size must be positive.");
  if (!(end_time_s > 0)) throw UsageError("The specimen's end_time_s must be positive.");
  if (!(std::abs(incline_rad) < 1.4)) throw UsageError("The incline must be below 80 degrees.");
  if (!(crease_mm > 0)) throw UsageError("The crease of the wedge must have a positive width.");
  if (!(cylinder_radius_mm > 0)) throw UsageError("The cylinder's radius must be positive.");
  if (shape == Shape::kCylinder && size_mm.x() > 2.8 * cylinder_radius_mm) {
    throw UsageError("The sheet is too wide for its cylinder: at most 2.8 radii.");
  }
  if (!(star_period_min_mm > 0) || star_period_max_mm < star_period_min_mm) {
    throw UsageError("The star's periods must be positive, the smallest first.");
  }
}

std::unique_ptr<const MaterialSurface> MakeSpecimen(const SpecimenOptions& options) {
  options.Check();
  return std::make_unique<Specimen>(options);
}

}  // namespace plumbline
