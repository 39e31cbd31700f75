#include "track/wheel_deformation.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "calib/error.h"
#include "track/internal/local_fit.h"

namespace plumbline {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr Eigen::Index kGround = 6, kAngle = 1, kAxis = 4, kCommon = kGround + kAngle + kAxis;

// A point of the axis and its direction, and what each error adds to them (3 x errors).
struct UncertainAxis {
  Eigen::Vector3d centre_mm, direction;
  Eigen::Matrix3Xd centre_along_common, direction_along_common;
  Eigen::Matrix3Xd centre_along_modes, direction_along_modes;
};

class Deformation {
 public:
  Deformation(const LoadedWheel& wheel, const NeighbourCorrelation& neighbours,
              const WheelDeformationOptions& options)
      : wheel_(wheel),
        neighbours_(neighbours),
        options_(options),
        modes_(static_cast<Eigen::Index>(wheel.loaded.along_modes_mm.size())),
        loaded_(InFrame(wheel.loaded, wheel.ground)),
        undeformed_(InFrame(wheel.undeformed, wheel.ground)),
        axis_(Axis()) {
    const Eigen::Vector3d& a = axis_.direction;
    heading_ = Eigen::Vector3d(a.y(), -a.x(), 0).normalized();
    left_ = {-heading_.y(), heading_.x(), 0};
    AddAngle();
  }

  WheelDeformation Measure() {
    SetDisplacement();
    SetLoadedRadius();
    SetDeflection();
    SetShift();
    SetRadial();
    return std::move(d_);
  }

 private:
  const Eigen::Vector3d& Loaded(std::size_t i) const { return loaded_.point_mm.data()[i]; }
  const Eigen::Vector3d& Undeformed(std::size_t i) const { return undeformed_.point_mm.data()[i]; }
  bool Known(std::size_t i) const { return Loaded(i).allFinite() && Undeformed(i).allFinite(); }
  std::size_t count() const { return loaded_.point_mm.pixel_count(); }
  ErrorSum NoErrors() const { return {kCommon, modes_}; }

  void Miss(const char* what) {
    if (!d_.problem.empty()) d_.problem += "; ";
    d_.problem += what;
  }

  UncertainAxis Axis() const {
    const WheelAxis& wheel = wheel_.axis;
    const Rigid3& ground = wheel_.ground.frame_from_rig;
    const Eigen::Vector3d direction = wheel.direction_in_rig();
    const Eigen::Vector3d centre = wheel.origin_in_rig_mm() + options_.centre_y_mm * direction;
    // By a turn about the wheel's x, y, z and the distance, in the rig.
    Eigen::Matrix<double, 3, 4> by_direction = Eigen::Matrix<double, 3, 4>::Zero(), by_centre;
    by_direction.leftCols<3>() = -wheel.rotation * Skew(Eigen::Vector3d::UnitY());
    by_centre << -wheel.distance_mm * wheel.rotation * Skew(Eigen::Vector3d::UnitZ()),
        wheel.rotation.col(2);
    by_centre += options_.centre_y_mm * by_direction;
    UncertainAxis axis;
    axis.centre_mm = ground * centre;
    axis.direction = ground.rotation * direction;
    axis.centre_along_common = axis.direction_along_common = Eigen::Matrix3Xd::Zero(3, kCommon);
    const Eigen::Matrix<double, 6, 6> root = wheel_.ground.Root();
    axis.centre_along_common.leftCols<kGround>() =
        root.bottomRows<3>() - Skew(axis.centre_mm) * root.topRows<3>();
    axis.direction_along_common.leftCols<kGround>() = -Skew(axis.direction) * root.topRows<3>();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(wheel_.cov_axis_random);
    const Eigen::Matrix4d own =
        solver.eigenvectors() * solver.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
    axis.centre_along_common.rightCols<kAxis>() = ground.rotation * by_centre * own;
    axis.direction_along_common.rightCols<kAxis>() = ground.rotation * by_direction * own;
    axis.centre_along_modes = axis.direction_along_modes = Eigen::Matrix3Xd::Zero(3, modes_);
    for (Eigen::Index k = 0; k < modes_; ++k) {
      Eigen::Vector4d change = Eigen::Vector4d::Zero();
      if (wheel_.axis_along_modes.rows() > 0) change = wheel_.axis_along_modes.row(k).transpose();
      const Rigid3& moved = wheel_.ground.along_modes.empty()
                                ? ground
                                : wheel_.ground.along_modes[static_cast<std::size_t>(k)];
      axis.centre_along_modes.col(k) = moved * (centre + by_centre * change) - axis.centre_mm;
      axis.direction_along_modes.col(k) =
          moved.rotation * (direction + by_direction * change) - axis.direction;
    }
    return axis;
  }

  // The errors in common of both surfaces: ground frame, wheel angle, axis.
  void AddAngle() {
    const Image<Eigen::Vector3f> none(loaded_.size(), Eigen::Vector3f::Zero());
    loaded_.along_common_mm.resize(static_cast<std::size_t>(kCommon), none);
    undeformed_.along_common_mm.resize(static_cast<std::size_t>(kCommon), none);
    Image<Eigen::Vector3f>& turned = undeformed_.along_common_mm[static_cast<std::size_t>(kGround)];
    for (std::size_t i = 0; i < count(); ++i) {
      turned.data()[i] =
          (wheel_.sigma_angle_rad * axis_.direction.cross(Undeformed(i) - axis_.centre_mm))
              .cast<float>();
    }
  }

  void SetDisplacement() {
    SurfacePoints& d = d_.displacement_mm;
    d = loaded_;
    const auto subtract = [](std::vector<Image<Eigen::Vector3f>>& from,
                             const std::vector<Image<Eigen::Vector3f>>& what) {
      for (std::size_t k = 0; k < from.size(); ++k) {
        for (std::size_t i = 0; i < from[k].pixel_count(); ++i) {
          from[k].data()[i] -= what[k].data()[i];
        }
      }
    };
    subtract(d.along_common_mm, undeformed_.along_common_mm);
    subtract(d.along_modes_mm, undeformed_.along_modes_mm);
    for (std::size_t i = 0; i < count(); ++i) {
      d.point_mm.data()[i] -= Undeformed(i);
      d.cov_random_mm2.data()[i] += undeformed_.cov_random_mm2.data()[i];
    }
  }

  void SetLoadedRadius() {
    const double lean = axis_.direction.z(), upright = std::sqrt(1 - lean * lean);
    if (!(upright > 1e-3)) {
      Miss("there is no loaded radius: the wheel lies flat");
      return;
    }
    const double height = axis_.centre_mm.z();
    const double by_lean = height * lean / std::pow(upright, 3);
    ErrorSum errors = NoErrors();
    errors.AddCommon(axis_.centre_along_common.row(2) / upright +
                     by_lean * axis_.direction_along_common.row(2));
    errors.AddModes(axis_.centre_along_modes.row(2) / upright +
                    by_lean * axis_.direction_along_modes.row(2));
    d_.loaded_radius_mm = errors.Of(height / upright);
  }

  // Places whose points lie within the radius of one in the ground plane, as seen from there.
  struct Around {
    std::vector<std::size_t> places;
    std::vector<Eigen::Vector2d> apart;
    std::vector<double> weights;  // of a paraboloid; empty: not told
  };
  Around AroundGround(const Image<Eigen::Vector3d>& point_mm, const Eigen::Vector2d& at) const {
    Around around;
    for (std::size_t i = 0; i < count(); ++i) {
      const Eigen::Vector2d apart = point_mm.data()[i].head<2>() - at;
      if (!(apart.norm() <= options_.radius_mm)) continue;
      around.places.push_back(i);
      around.apart.push_back(apart);
    }
    around.weights = internal::ParaboloidWeights(around.apart);
    return around;
  }

  // The height of a surface over a place, with what its points do to it. A sideways error counts by
  // the mean slope of the surface there.
  bool HeightAt(const SurfacePoints& surface, const Eigen::Vector2d& at, double sign,
                double* height, ErrorSum* errors) const {
    const Around around = AroundGround(surface.point_mm, at);
    if (around.weights.empty()) return false;
    std::vector<PointChange> changes;
    *height = 0;
    Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
    Eigen::Vector2d rise = Eigen::Vector2d::Zero();
    for (std::size_t k = 0; k < around.places.size(); ++k) {
      const double z = surface.point_mm.data()[around.places[k]].z();
      *height += around.weights[k] * z;
      spread += around.apart[k] * around.apart[k].transpose();
    }
    for (std::size_t k = 0; k < around.places.size(); ++k) {
      rise += around.apart[k] * (surface.point_mm.data()[around.places[k]].z() - *height);
    }
    const Eigen::Vector2d slope = spread.inverse() * rise;
    for (std::size_t k = 0; k < around.places.size(); ++k) {
      changes.push_back({around.places[k],
                         sign * around.weights[k] * Eigen::RowVector3d(-slope.x(), -slope.y(), 1)});
    }
    errors->AddPoints(changes, surface, neighbours_);
    return true;
  }

  void SetDeflection() {
    ErrorSum errors = NoErrors();
    double loaded = 0, undeformed = 0;
    const Eigen::Vector2d under = axis_.centre_mm.head<2>();
    if (HeightAt(loaded_, under, 1, &loaded, &errors) &&
        HeightAt(undeformed_, under, -1, &undeformed, &errors)) {
      d_.deflection_mm = errors.Of(loaded - undeformed);
    } else {
      Miss("there is no deflection: the inner surface is not seen under the wheel's centre");
    }
  }

  // Of the surface around a point, in the ground plane.
  double GroundArea(int r, int c) const {
    const auto side = [&](int dr, int dc) {
      const auto at = [&](int sign) {
        const int row = r + sign * dr, column = c + sign * dc;
        const bool inside =
            row >= 0 && column >= 0 && row < loaded_.size().height && column < loaded_.size().width;
        return inside ? loaded_.point_mm(row, column) : Eigen::Vector3d::Constant(kNaN).eval();
      };
      const Eigen::Vector3d here = loaded_.point_mm(r, c), next = at(1), last = at(-1);
      if (next.allFinite() && last.allFinite()) return ((next - last) / 2).eval();
      return next.allFinite() ? (next - here).eval() : (here - last).eval();
    };
    const double area = std::abs(side(0, 1).cross(side(1, 0)).z());
    return std::isfinite(area) ? area : 0;
  }

  // The weighted displacement along the heading or to its left. Both turn with the axis: along the
  // heading it gains what there is to the left, and the other way round it loses.
  MeasuredScalar Along(bool forwards,
                       const std::vector<std::pair<std::size_t, double>>& weights) const {
    const Eigen::Vector3d& direction = forwards ? heading_ : left_;
    std::vector<PointChange> changes;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const auto& [i, weight] : weights) {
      sum += weight * d_.displacement_mm.point_mm.data()[i];
      changes.push_back({i, weight * direction.transpose()});
    }
    const double by_heading = forwards ? left_.dot(sum) : -heading_.dot(sum);
    const Eigen::Vector3d& a = axis_.direction;
    const Eigen::RowVector3d by_axis =
        by_heading * Eigen::RowVector3d(-a.y(), a.x(), 0) / a.head<2>().squaredNorm();
    ErrorSum errors = NoErrors();
    errors.AddPoints(changes, d_.displacement_mm, neighbours_);
    errors.AddCommon(by_axis * axis_.direction_along_common);
    errors.AddModes(by_axis * axis_.direction_along_modes);
    return errors.Of(direction.dot(sum));
  }

  void SetShift() {
    std::vector<std::pair<std::size_t, double>> weights;
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();
    double sum = 0;
    for (std::size_t i = 0; i < count(); ++i) {
      if (wheel_.contact.data()[i] == 0 || !Known(i)) continue;
      const int columns = loaded_.size().width;
      const double area = GroundArea(static_cast<int>(i) / columns, static_cast<int>(i) % columns);
      weights.emplace_back(i, area);
      centre += area * Loaded(i).head<2>();
      sum += area;
    }
    if (!(sum > 0)) {
      Miss("there is no shift of the carcass: no point is in contact");
      return;
    }
    for (auto& [i, weight] : weights) weight /= sum;
    d_.longitudinal_mm = Along(true, weights);
    d_.lateral_mm = Along(false, weights);
    const Around around = AroundGround(loaded_.point_mm, centre / sum);
    std::vector<std::pair<std::size_t, double>> local;
    bool known = !around.weights.empty();
    for (std::size_t k = 0; known && k < around.places.size(); ++k) {
      local.emplace_back(around.places[k], around.weights[k]);
      known = Known(around.places[k]);
    }
    if (!known) {
      Miss("there is no shift in the patch's centre: material is missing there");
      return;
    }
    d_.longitudinal_centre_mm = Along(true, local);
    d_.lateral_centre_mm = Along(false, local);
  }

  // From the axis to a point, perpendicular to it.
  Eigen::Vector3d FromAxis(const Eigen::Vector3d& point) const {
    const Eigen::Vector3d from = point - axis_.centre_mm;
    return from - axis_.direction * axis_.direction.dot(from);
  }
  double Approach(std::size_t i) const {
    return FromAxis(Undeformed(i)).norm() - FromAxis(Loaded(i)).norm();
  }

  // The surface around a point as it was made, unrolled about the axis.
  Around AroundMaterial(std::size_t place) const {
    Around around;
    const Eigen::Vector3d out = FromAxis(Undeformed(place)).normalized();
    const Eigen::Vector3d on = axis_.direction.cross(out);
    for (std::size_t i = 0; i < count(); ++i) {
      if (!((Undeformed(i) - Undeformed(place)).norm() <= options_.radius_mm) || !Known(i))
        continue;
      const Eigen::Vector3d from = FromAxis(Undeformed(i));
      const double angle = std::atan2(from.dot(on), from.dot(out));
      around.places.push_back(i);
      around.apart.emplace_back(from.norm() * angle,
                                axis_.direction.dot(Undeformed(i) - Undeformed(place)));
    }
    around.weights = internal::ParaboloidWeights(around.apart);
    return around;
  }

  void SetRadial() {
    double largest = -std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < count(); ++i) {
      if (Known(i)) largest = std::max(largest, Approach(i));
    }
    // What a paraboloid may add to or take from one point is less than this share of it.
    constexpr double kShare = 0.7;
    double most = -std::numeric_limits<double>::infinity();
    std::size_t place = 0;
    Around best;
    for (std::size_t i = 0; i < count(); ++i) {
      if (!Known(i) || !(Approach(i) >= kShare * largest)) continue;
      Around around = AroundMaterial(i);
      if (around.weights.empty()) continue;
      double value = 0;
      for (std::size_t k = 0; k < around.places.size(); ++k) {
        value += around.weights[k] * Approach(around.places[k]);
      }
      if (!(value > most)) continue;
      most = value;
      place = i;
      best = std::move(around);
    }
    if (best.weights.empty()) {
      Miss("there is no largest radial deflection: no point has others all around it");
      return;
    }
    std::vector<PointChange> by_loaded, by_undeformed;
    ErrorSum errors = NoErrors();
    for (std::size_t k = 0; k < best.places.size(); ++k) {
      const std::size_t i = best.places[k];
      const double w = best.weights[k];
      const Eigen::RowVector3d loaded = w * FromAxis(Loaded(i)).normalized().transpose();
      const Eigen::RowVector3d undeformed = w * FromAxis(Undeformed(i)).normalized().transpose();
      by_loaded.push_back({i, -loaded});
      by_undeformed.push_back({i, undeformed});
      // The axis moves against both.
      const double far = axis_.direction.dot(Loaded(i) - axis_.centre_mm);
      const double near = axis_.direction.dot(Undeformed(i) - axis_.centre_mm);
      const Eigen::RowVector3d by_centre = loaded - undeformed;
      const Eigen::RowVector3d by_direction = far * loaded - near * undeformed;
      errors.AddCommon(by_centre * axis_.centre_along_common +
                       by_direction * axis_.direction_along_common);
      errors.AddModes(by_centre * axis_.centre_along_modes +
                      by_direction * axis_.direction_along_modes);
    }
    errors.AddPoints(by_loaded, loaded_, neighbours_);
    errors.AddPoints(by_undeformed, undeformed_, neighbours_);
    d_.radial_mm = errors.Of(most);
    d_.radial_at_mm = Loaded(place);
  }

  const LoadedWheel& wheel_;
  const NeighbourCorrelation& neighbours_;
  const WheelDeformationOptions& options_;
  Eigen::Index modes_;
  SurfacePoints loaded_, undeformed_;  // in the ground frame
  UncertainAxis axis_;                 // likewise
  Eigen::Vector3d heading_, left_;
  WheelDeformation d_;
};

}  // namespace

void WheelDeformationOptions::Check() const {
  if (!std::isfinite(centre_y_mm)) throw UsageError("The wheel's middle plane has a finite place.");
  if (!(radius_mm > 0)) {
    throw UsageError("The radius over which a surface is read off has to be above 0 mm.");
  }
}

WheelDeformation MeasureDeformation(const LoadedWheel& wheel,
                                    const NeighbourCorrelation& neighbours,
                                    const WheelDeformationOptions& options) {
  options.Check();
  const std::size_t modes = wheel.loaded.along_modes_mm.size();
  if (wheel.undeformed.size() != wheel.loaded.size() ||
      wheel.contact.size() != wheel.loaded.size() ||
      wheel.undeformed.along_modes_mm.size() != modes ||
      (wheel.axis_along_modes.rows() > 0 &&
       wheel.axis_along_modes.rows() != static_cast<Eigen::Index>(modes))) {
    throw std::invalid_argument("MeasureDeformation: parts of different grids or modes");
  }
  if (!wheel.loaded.along_common_mm.empty() || !wheel.undeformed.along_common_mm.empty()) {
    throw std::invalid_argument("MeasureDeformation: errors in common are those of the wheel");
  }
  return Deformation(wheel, neighbours, options).Measure();
}

}  // namespace plumbline
