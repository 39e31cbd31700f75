#include "track/internal/view_material.h"

#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "match/planar_field.h"
#include "track/right_flow.h"
#include "track/rolling_survey.h"
#include "track/surface_motion.h"
#include "track/surface_state.h"

namespace plumbline::internal {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;

}  // namespace

ViewMaterial MaterialOf(const WheelReference &wheel, const WheelReferenceView &view,
                        const StereoField &field) {
  const Image<Eigen::Vector3f> unit = UnitCovariance(field, field);
  StereoSurface surface = TriangulateField(wheel.rig, field, unit);
  const Rigid3 wheel_from_rig = wheel.axis.RigFromWheel(view.angle_rad).Inverse();
  const Eigen::Matrix3d &turn = wheel_from_rig.rotation;
  ViewMaterial material;
  material.cov_random_mm2 = CovarianceOf(surface.instant, unit);
  material.point_mm = std::move(surface.instant.point_mm);
  for (std::size_t i = 0; i < material.point_mm.pixel_count(); ++i) {
    Eigen::Vector3d &p = material.point_mm.data()[i];
    if (surface.status.data()[i] == Status::kOk) {
      p = wheel_from_rig * p;
      Eigen::Matrix<float, 6, 1> &cov = material.cov_random_mm2.data()[i];
      cov = TriangleOf(Eigen::Matrix3d(turn * CovarianceOf(cov) * turn.transpose()));
    } else {
      p.setConstant(std::numeric_limits<double>::quiet_NaN());
    }
  }
  return material;
}

Eigen::MatrixXf MaterialAlongModes(const WheelReference &wheel, const WheelReferenceView &view,
                                   const Image<Eigen::Vector3d> &material_mm,
                                   const ModeTriangulation &modes,
                                   const std::vector<WheelAxis> &axes_along) {
  const std::size_t count = material_mm.pixel_count(), K = axes_along.size();
  Eigen::MatrixXf along =
      Eigen::MatrixXf::Zero(static_cast<Eigen::Index>(count), static_cast<Eigen::Index>(K));
  if (K == 0) return along;
  const Rigid3 rig_from_wheel = wheel.axis.RigFromWheel(view.angle_rad);
  std::vector<std::size_t> places;
  std::vector<Eigen::Vector2d> left, right;
  std::vector<Eigen::Vector3d> in_rig;
  for (std::size_t i = 0; i < count; ++i) {
    if (!material_mm.data()[i].allFinite()) continue;
    places.push_back(i);
    in_rig.push_back(rig_from_wheel * material_mm.data()[i]);
    left.push_back(wheel.rig.left.Project(in_rig.back()));
    right.push_back(wheel.rig.right.Project(wheel.rig.right_from_left * in_rig.back()));
  }
  std::vector<Eigen::Vector3f> moved(places.size() * K);
  modes.Differences(left, right, moved);
  if (wheel.delay_mode >= 0) {
    const double late_rad = wheel.SigmaLateTurnOf(view);
    std::vector<Eigen::Vector2d> right_px;
    for (const Eigen::Vector3d &p : in_rig) {
      right_px.push_back(-late_rad * RigidRightFlow(wheel, p));
    }
    FillModeOfMatches(wheel.rig, left, right, right_px, static_cast<std::size_t>(wheel.delay_mode),
                      moved);
  }
  for (std::size_t k = 0; k < K; ++k) {
    const double angle =
        view.angle_rad + wheel.angles_along_modes_rad(static_cast<Eigen::Index>(k), view.frame);
    const Rigid3 wheel_from_rig = axes_along[k].RigFromWheel(angle).Inverse();
    for (std::size_t n = 0; n < places.size(); ++n) {
      const Eigen::Vector3d there = wheel_from_rig * (in_rig[n] + moved[n * K + k].cast<double>());
      along(static_cast<Eigen::Index>(places[n]), static_cast<Eigen::Index>(k)) =
          static_cast<float>(std::remainder(
              MaterialAngle(there) - MaterialAngle(material_mm.data()[places[n]]), kTurn_rad));
    }
  }
  return along;
}

}  // namespace plumbline::internal
