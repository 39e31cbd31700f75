#include "track/internal/surface_memory.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "calib/median.h"

namespace plumbline::internal {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;

double RadiusOf(const Eigen::Vector3d& in_wheel) { return std::hypot(in_wheel.x(), in_wheel.z()); }

// What one camera should see of the points.
Image<Eigen::Vector2d> PlacesOf(const Camera& camera, const Rigid3& camera_from_rig,
                                const Image<Eigen::Vector3d>& points_mm) {
  std::vector<Eigen::Vector3d> there;
  for (const Eigen::Vector3d& p : points_mm.values()) there.push_back(camera_from_rig * p);
  Image<Eigen::Vector2d> places(points_mm.size(), Eigen::Vector2d::Zero());
  camera.Project(there, places.values());
  return places;
}

// How places change along the grid, out of the neighbours on both sides or one; NaN without any.
Eigen::Vector2d Along(const Image<Eigen::Vector2d>& places, int r, int c, int down, int along,
                      double step_px) {
  const auto at = [&](int sign) -> Eigen::Vector2d {
    const int row = r + sign * down, column = c + sign * along;
    if (row < 0 || column < 0 || row >= places.height() || column >= places.width() ||
        !places(row, column).allFinite()) {
      return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    }
    return places(row, column);
  };
  const Eigen::Vector2d before = at(-1), after = at(1);
  if (before.allFinite() && after.allFinite()) return (after - before) / (2 * step_px);
  return (before.allFinite() ? places(r, c) - before : after - places(r, c)) / step_px;
}

void SetStarts(const Image<Eigen::Vector2d>& places, PlanarField* field) {
  for (int r = 0; r < places.height(); ++r) {
    for (int c = 0; c < places.width(); ++c) {
      if (field->status(r, c) != Status::kOk) continue;
      Eigen::Matrix2d F;
      F << Along(places, r, c, 0, 1, field->step_px), Along(places, r, c, 1, 0, field->step_px);
      field->displacement_px(r, c) = places(r, c) - field->PixelOf(r, c);
      F -= Eigen::Matrix2d::Identity();
      field->gradient(r, c) =
          F.allFinite() ? Eigen::Matrix2f(F.cast<float>()) : Eigen::Matrix2f::Zero();
    }
  }
}

}  // namespace

void SurfaceMemory::Take(const RollingFrame& frame, double time_s) {
  const Rigid3 wheel_from_rig = wheel_->axis.RigFromWheel(0).Inverse();
  double angle = frame.measured_angle_rad;
  // The angle at which the points lie where the surface was: twice, since where it was depends on
  // the angle too.
  for (int round = 0; round < 2 && !empty(); ++round) {
    std::vector<double> says;
    for (const RollingPoint& p : frame.points) {
      const double psi = MaterialAngle(p.undeformed_mm);
      const Eigen::Vector3d was =
          DeformationAt(std::remainder(psi - angle, kTurn_rad), p.undeformed_mm.y());
      if (!was.allFinite()) continue;
      const double place = MaterialAngle(wheel_from_rig * p.point_mm);
      says.push_back(std::remainder(psi - place + was.x() - angle, kTurn_rad));
    }
    if (!says.empty()) angle += Median(std::move(says));
  }
  before_s_ = now_s_;
  before_rad_ = now_rad_;
  now_s_ = time_s;
  now_rad_ = angle;
  std::vector<Moved> points;
  double radius = 0;
  for (const RollingPoint& p : frame.points) {
    const Eigen::Vector3d here = wheel_from_rig * p.point_mm;
    const double place = std::remainder(MaterialAngle(p.undeformed_mm) - angle, kTurn_rad);
    points.push_back(
        {place,
         p.undeformed_mm.y(),
         {std::remainder(MaterialAngle(here) - place, kTurn_rad), here.y() - p.undeformed_mm.y(),
          RadiusOf(here) - RadiusOf(p.undeformed_mm)}});
    radius += RadiusOf(p.undeformed_mm) / static_cast<double>(frame.points.size());
  }
  if (empty()) MakeLattice(points, radius);
  Remember(points);
  ++frames_;
}

// As fine as the points lie, and some way beyond them.
void SurfaceMemory::MakeLattice(const std::vector<Moved>& points, double radius_mm) {
  Eigen::Array2d least = Eigen::Array2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Array2d most = -least;
  for (const Moved& p : points) {
    const Eigen::Array2d at(p.place_rad * radius_mm, p.y_mm);
    least = least.min(at);
    most = most.max(at);
  }
  const Eigen::Array2d size = most - least;
  pitch_mm_ = std::max(1.0, std::sqrt(size.prod() / static_cast<double>(points.size())));
  pitch_rad_ = pitch_mm_ / radius_mm;
  constexpr double kBeyond = 0.5;
  first_place_rad_ = (least.x() - kBeyond * size.x()) / radius_mm;
  first_y_mm_ = least.y() - kBeyond * size.y();
  const Eigen::Array2i nodes = ((1 + 2 * kBeyond) * size / pitch_mm_).cast<int>() + 2;
  deformation_ = Image<Eigen::Vector3d>({nodes.x(), nodes.y()},
                                        Eigen::Vector3d::Constant(RollingFrame::kNone));
}

// Where no point is near a node, it stays as it was seen last.
void SurfaceMemory::Remember(const std::vector<Moved>& points) {
  Image<Eigen::Vector3d> sums(deformation_.size(), Eigen::Vector3d::Zero());
  Image<double> weights(deformation_.size(), 0);
  for (const Moved& p : points) {
    const double x = (p.place_rad - first_place_rad_) / pitch_rad_;
    const double y = (p.y_mm - first_y_mm_) / pitch_mm_;
    const int c = static_cast<int>(std::floor(x)), r = static_cast<int>(std::floor(y));
    if (c < 0 || r < 0 || c + 1 >= sums.width() || r + 1 >= sums.height()) continue;
    for (const int down : {0, 1}) {
      for (const int along : {0, 1}) {
        const double weight = (1 - std::abs(x - c - along)) * (1 - std::abs(y - r - down));
        sums(r + down, c + along) += weight * p.by;
        weights(r + down, c + along) += weight;
      }
    }
  }
  constexpr double kNear = 0.05;  // of a point's weight
  for (std::size_t i = 0; i < weights.pixel_count(); ++i) {
    if (weights.data()[i] > kNear) deformation_.data()[i] = sums.data()[i] / weights.data()[i];
  }
}

std::optional<double> SurfaceMemory::AngleAt(double time_s) const {
  if (frames_ < 2 || !(now_s_ > before_s_)) return std::nullopt;
  const double speed = std::remainder(now_rad_ - before_rad_, kTurn_rad) / (now_s_ - before_s_);
  const double angle = now_rad_ + speed * (time_s - now_s_);
  return angle - kTurn_rad * std::floor(angle / kTurn_rad);
}

Eigen::Vector3d SurfaceMemory::DeformationAt(double place_rad, double y_mm) const {
  const double x = (place_rad - first_place_rad_) / pitch_rad_;
  const double y = (y_mm - first_y_mm_) / pitch_mm_;
  const int c = static_cast<int>(std::floor(x)), r = static_cast<int>(std::floor(y));
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weights = 0;
  for (const int down : {0, 1}) {
    for (const int along : {0, 1}) {
      const int row = r + down, column = c + along;
      if (row < 0 || column < 0 || row >= deformation_.height() || column >= deformation_.width() ||
          !deformation_(row, column).allFinite()) {
        continue;
      }
      const double weight = (1 - std::abs(x - column)) * (1 - std::abs(y - row));
      sum += weight * deformation_(row, column);
      weights += weight;
    }
  }
  return sum / weights;
}

StereoField SurfaceMemory::Expect(double angle_rad, const PlanarField& grid,
                                  const Image<Eigen::Vector3d>& material_mm, double room_px) const {
  const Rigid3 rig_from_wheel = wheel_->axis.RigFromWheel(0);
  Image<Eigen::Vector3d> points_mm(material_mm.size(), Eigen::Vector3d::Zero());
  for (std::size_t i = 0; i < material_mm.pixel_count(); ++i) {
    const Eigen::Vector3d& m = material_mm.data()[i];
    const double undeformed = std::remainder(MaterialAngle(m) - angle_rad, kTurn_rad);
    Eigen::Vector3d moved = m.allFinite() ? DeformationAt(undeformed, m.y()) : m;
    if (m.allFinite() && !moved.allFinite()) moved.setZero();
    const double place = undeformed + moved.x(), radius = RadiusOf(m) + moved.z();
    points_mm.data()[i] =
        rig_from_wheel *
        Eigen::Vector3d(radius * std::sin(place), m.y() + moved.y(), -radius * std::cos(place));
  }
  const Rigid3 as_it_is;
  const Image<Eigen::Vector2d> left = PlacesOf(wheel_->rig.left, as_it_is, points_mm);
  const Image<Eigen::Vector2d> right =
      PlacesOf(wheel_->rig.right, wheel_->rig.right_from_left, points_mm);
  const auto inside = [&](const Eigen::Vector2d& at, const Camera& camera) {
    return at.minCoeff() >= room_px && at.x() < camera.size().width - room_px &&
           at.y() < camera.size().height - room_px;
  };
  StereoField out;
  out.left = out.right = PlanarField(grid.size(), grid.first_px, grid.step_px);
  for (std::size_t i = 0; i < points_mm.pixel_count(); ++i) {
    if (!inside(left.data()[i], wheel_->rig.left) || !inside(right.data()[i], wheel_->rig.right)) {
      continue;
    }
    out.left.status.data()[i] = out.right.status.data()[i] = Status::kOk;
  }
  SetStarts(left, &out.left);
  SetStarts(right, &out.right);
  return out;
}

double ShareFound(const StereoField& expected, const StereoField& field) {
  int wanted = 0, found = 0;
  for (std::size_t i = 0; i < expected.left.status.pixel_count(); ++i) {
    if (expected.left.status.data()[i] != Status::kOk) continue;
    ++wanted;
    found +=
        field.left.status.data()[i] == Status::kOk && field.right.status.data()[i] == Status::kOk
            ? 1
            : 0;
  }
  return wanted == 0 ? 0 : static_cast<double>(found) / wanted;
}

}  // namespace plumbline::internal
