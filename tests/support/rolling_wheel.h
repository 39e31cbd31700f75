#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "fit/surface_points.h"
#include "fit/wheel_axis.h"
#include "io/virtual_rig/virtual_rig.h"
#include "track/material_velocity.h"

namespace plumbline::testing {

// What a rolling measurement would know of the virtual rig's tyre, without its images: true points
// under a grid of pixels, and draws of their errors.
class RollingWheel {
 public:
  // Of a grid whose subsets are `overlap` steps wide (odd; 1: errors are independent).
  explicit RollingWheel(Scenario scenario, int step_px = 16, int overlap = 1)
      : rig_(std::make_unique<VirtualRig>(std::move(scenario))),
        size_{rig_->scenario().rig.left.size().width / step_px,
              rig_->scenario().rig.left.size().height / step_px},
        step_px_(step_px),
        overlap_(overlap),
        neighbours_(NeighbourCorrelation::OfOverlap(size_, 5, 5 * overlap, 1)) {}

  const VirtualRig& rig() const { return *rig_; }
  const TyreSurface& tyre() const { return *rig_->tyre(); }
  ImageSize size() const { return size_; }
  const NeighbourCorrelation& neighbours() const { return neighbours_; }
  double Time(int frame) const { return rig_->FrameTime(frame); }
  WheelState Wheel(int frame) const { return tyre().Wheel(Time(frame)); }

  struct True {
    MaterialFrame frame;  // of points without error, but with the covariance of Noise()
    Image<Eigen::Vector3d> ground_mm, undeformed_mm, velocity_mm_s;  // ground frame
    Image<Eigen::Vector2d> material_mm;
    Image<double> thickness_mm;
  };

  // Thresholds of contact as the tyre itself has them: gap_mm.
  True Truth(int f, double gap_mm = 0.5) const {
    constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
    const Eigen::Vector3d none = Eigen::Vector3d::Constant(kNaN);
    const auto truth = rig_->Truth(f);
    const auto contact = tyre().Contact(Time(f));
    const auto reference = tyre().Reference(Time(f));
    const WheelState wheel = Wheel(f);
    True t;
    t.frame.time_s = Time(f);
    t.frame.ground.frame_from_rig = truth->ground_from_rig();
    const Rigid3 rig_from_ground = truth->ground_from_rig().Inverse();
    t.ground_mm = t.undeformed_mm = t.velocity_mm_s = t.frame.material = t.frame.points.point_mm =
        Image<Eigen::Vector3d>(size_, none);
    t.material_mm = Image<Eigen::Vector2d>(size_, Eigen::Vector2d::Constant(kNaN));
    t.thickness_mm = Image<double>(size_, kNaN);
    t.frame.contact = Image<std::uint8_t>(size_, 0);
    t.frame.points.cov_random_mm2 =
        Image<Eigen::Matrix<float, 6, 1>>(size_, Eigen::Matrix<float, 6, 1>::Zero());
    for (int r = 0; r < size_.height; ++r) {
      for (int c = 0; c < size_.width; ++c) {
        const auto point = truth->UnderLeftPixel({step_px_ * (c + 0.5), step_px_ * (r + 0.5)});
        if (!point || !point->in_right || point->hidden_in_right) continue;
        const Eigen::Vector3d undeformed = reference->At(point->material_mm).position_mm;
        const Eigen::Vector3d from_axis =
            undeformed - Eigen::Vector3d(0, 0, wheel.centre_height_mm);
        const double y = from_axis.dot(wheel.axis);
        t.ground_mm(r, c) = point->position_mm;
        t.undeformed_mm(r, c) = undeformed;
        t.velocity_mm_s(r, c) = point->velocity_mm_s;
        t.material_mm(r, c) = point->material_mm;
        t.thickness_mm(r, c) = tyre().CarcassThickness(point->material_mm.y());
        t.frame.points.point_mm(r, c) = rig_from_ground * point->position_mm;
        t.frame.material(r, c) = {point->material_mm.x() / tyre().options().section.crown_radius_mm,
                                  y, (from_axis - y * wheel.axis).norm()};
        t.frame.contact(r, c) =
            contact != nullptr && contact->Gap(point->material_mm) <= gap_mm ? 1 : 0;
      }
    }
    return t;
  }

  // Sigma along the line of sight and across it.
  void SetNoise(MaterialFrame& frame, double depth_mm, double across_mm) const {
    for (std::size_t i = 0; i < frame.points.point_mm.pixel_count(); ++i) {
      const Eigen::Vector3d sight = frame.points.point_mm.data()[i].normalized();
      const Eigen::Matrix3d cov =
          across_mm * across_mm * Eigen::Matrix3d::Identity() +
          (depth_mm * depth_mm - across_mm * across_mm) * sight * sight.transpose();
      frame.points.cov_random_mm2.data()[i] << static_cast<float>(cov(0, 0)),
          static_cast<float>(cov(0, 1)), static_cast<float>(cov(0, 2)),
          static_cast<float>(cov(1, 1)), static_cast<float>(cov(1, 2)),
          static_cast<float>(cov(2, 2));
    }
  }

  // Draws errors with these covariances; neighbours share those parts of a white field that their
  // subsets share, as NeighbourCorrelation::OfOverlap says.
  void AddNoise(SurfacePoints& points, double depth_mm, double across_mm,
                std::mt19937& random) const {
    std::normal_distribution<double> normal;
    const auto three = [&] {
      const double a = normal(random), b = normal(random), c = normal(random);
      return Eigen::Vector3d(a, b, c);
    };
    Image<Eigen::Vector3d> white({size_.width + overlap_, size_.height + overlap_},
                                 Eigen::Vector3d::Zero());
    for (Eigen::Vector3d& w : white.values()) w = three();
    for (int r = 0; r < size_.height; ++r) {
      for (int c = 0; c < size_.width; ++c) {
        Eigen::Vector3d e = Eigen::Vector3d::Zero();
        for (int i = 0; i < overlap_; ++i) {
          for (int j = 0; j < overlap_; ++j) e += white(r + i, c + j) / overlap_;
        }
        const Eigen::Vector3d sight = points.point_mm(r, c).normalized();
        points.point_mm(r, c) += across_mm * e + (depth_mm - across_mm) * sight * sight.dot(e);
      }
    }
  }

  WheelAxis Axis(int f) const {
    const Rigid3 rig_from_ground = rig_->GroundFromRig(Time(f)).Inverse();
    return WheelAxis::Through(rig_from_ground * Eigen::Vector3d(0, 0, Wheel(f).centre_height_mm),
                              rig_from_ground.rotation * Wheel(f).axis);
  }

 private:
  std::unique_ptr<VirtualRig> rig_;
  ImageSize size_;
  int step_px_, overlap_;
  NeighbourCorrelation neighbours_;
};

// Calibration errors as a rig has them: scale, a field of depth that bows, a skew. Each moves every
// point of the rig frame.
inline constexpr std::size_t kFieldModes = 3;
inline Eigen::Vector3d AlongMode(std::size_t mode, const Eigen::Vector3d& point_mm) {
  const double x = point_mm.x() / 100, y = point_mm.y() / 100, z = point_mm.z() / 300;
  switch (mode) {
    case 0:
      return 2e-4 * point_mm;
    case 1:
      return {0, 0, 0.03 * (x * x + 0.5 * y * y)};
    default:
      return {0.03 * z * y, 0.02 * z * x, 0.05 * z * x};
  }
}

inline void SetModes(SurfacePoints& points) {
  points.along_modes_mm.assign(kFieldModes,
                               Image<Eigen::Vector3f>(points.size(), Eigen::Vector3f::Zero()));
  for (std::size_t k = 0; k < kFieldModes; ++k) {
    for (std::size_t i = 0; i < points.point_mm.pixel_count(); ++i) {
      points.along_modes_mm[k].data()[i] = AlongMode(k, points.point_mm.data()[i]).cast<float>();
    }
  }
}

inline void MoveAlongModes(SurfacePoints& points, const Eigen::Vector3d& amount) {
  for (Eigen::Vector3d& p : points.point_mm.values()) {
    const Eigen::Vector3d from = p;
    for (std::size_t k = 0; k < kFieldModes; ++k) {
      p += amount[static_cast<Eigen::Index>(k)] * AlongMode(k, from);
    }
  }
}

// The wheel's axis as it is found along the modes, and what one sigma of each adds to it.
inline WheelAxis AxisAlongModes(const WheelAxis& axis, const Eigen::Vector3d& amount) {
  const auto moved = [&](const Eigen::Vector3d& p) {
    Eigen::Vector3d q = p;
    for (std::size_t k = 0; k < kFieldModes; ++k) {
      q += amount[static_cast<Eigen::Index>(k)] * AlongMode(k, p);
    }
    return q;
  };
  const Eigen::Vector3d a = moved(axis.origin_in_rig_mm() - 100 * axis.direction_in_rig());
  const Eigen::Vector3d b = moved(axis.origin_in_rig_mm() + 100 * axis.direction_in_rig());
  return WheelAxis::Through(a, b - a);
}

inline Eigen::MatrixXd ModesOfAxis(const WheelAxis& axis) {
  Eigen::MatrixXd along(kFieldModes, 4);
  for (Eigen::Index k = 0; k < along.rows(); ++k) {
    const WheelAxis moved = AxisAlongModes(axis, Eigen::Vector3d::Unit(k));
    along.row(k) << Rigid3{axis.rotation.transpose() * moved.rotation, {0, 0, 0}}
                        .RotationVector()
                        .transpose(),
        moved.distance_mm - axis.distance_mm;
  }
  return along;
}

}  // namespace plumbline::testing
