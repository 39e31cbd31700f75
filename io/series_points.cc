#include "io/series_points.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

namespace plumbline {
namespace {

// Takes out of the variances along z what the ground plane does to all points at once.
void PartGroundErrors(const Eigen::Matrix3d& errors, SurfacePoints* points) {
  points->along_common_mm.assign(3,
                                 Image<Eigen::Vector3f>(points->size(), Eigen::Vector3f::Zero()));
  for (std::size_t i = 0; i < points->point_mm.pixel_count(); ++i) {
    const Eigen::Vector3d& p = points->point_mm.data()[i];
    if (!p.allFinite()) continue;
    const Eigen::RowVector3f dz =
        (Eigen::RowVector3d(p.x(), p.y(), 1) * errors).cast<float>().eval();
    float& variance = points->cov_random_mm2.data()[i][5];
    variance = std::max(0.0F, variance - dz.squaredNorm());
    for (std::size_t k = 0; k < 3; ++k) {
      points->along_common_mm[k].data()[i].z() = dz[static_cast<Eigen::Index>(k)];
    }
  }
}

}  // namespace

Eigen::Matrix3d HeightErrorsOf(const GroundRecord& ground, const Eigen::Matrix3d& cov) {
  if (!ground.found) return Eigen::Matrix3d::Zero();
  const double none = std::numeric_limits<double>::quiet_NaN();
  if (!cov.allFinite() || !ground.e1_in_rig.allFinite()) return Eigen::Matrix3d::Constant(none);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(cov);
  const Eigen::Matrix3d roots =
      eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
  // A plane whose normal is turned by t about its centroid c and shifted by o has points at
  // t_y (x - c_x) - t_x (y - c_y) - o above it.
  const Eigen::Vector3d c = ground.ground_from_rig * ground.centroid_in_rig_mm;
  const Eigen::Vector3d e1 = ground.ground_from_rig.rotation * ground.e1_in_rig;
  const Eigen::Vector3d e2 = ground.ground_from_rig.rotation * ground.e2_in_rig;
  Eigen::Matrix3d heights;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d turn = roots(0, k) * e1 + roots(1, k) * e2;
    heights.col(k) << turn.y(), -turn.x(), turn.x() * c.y() - turn.y() * c.x() - roots(2, k);
  }
  return heights;
}

SurfacePoints PointsOf(const SeriesFrame& frame) {
  const Surface& surface = frame.surface;
  const ImageSize size = surface.status.size();
  SurfacePoints points;
  points.point_mm = Image<Eigen::Vector3d>(size, Eigen::Vector3d::Zero());
  points.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>(size, Eigen::Matrix<float, 6, 1>::Zero());
  Image<Eigen::Vector3f> calibration(size, Eigen::Vector3f::Zero());
  bool known = false;
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    points.point_mm.data()[i] = surface.position_mm.data()[i].cast<double>();
    const Eigen::Vector3f variance = surface.sigma_random_mm.data()[i].cwiseAbs2();
    points.cov_random_mm2.data()[i] << variance.x(), 0, 0, variance.y(), 0, variance.z();
    const Eigen::Vector3f& common = surface.sigma_calibration_mm.data()[i];
    if (!common.allFinite()) continue;
    known = true;
    calibration.data()[i] = common;
  }
  if (known) points.along_modes_mm.push_back(std::move(calibration));
  if (surface.frame == SurfaceFrame::kGround && frame.rig_rotation.found) {
    const Eigen::Matrix3d errors = HeightErrorsOf(frame.ground, frame.ground.cov_random);
    if (errors.allFinite()) PartGroundErrors(errors, &points);
  }
  return points;
}

NeighbourCorrelation NeighboursOf(const SeriesReader& series) {
  return NeighbourCorrelation::OfOverlap(series.grid_px().size(), series.step_px(),
                                         std::max(series.subset_px() | 1, 3), 1);
}

std::vector<double> TravelOf(const SeriesReader& series) {
  const double none = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> travel_mm;
  double sum_mm = 0, last_mm_s = none, last_s = none;
  for (std::int64_t i = 0; i < series.frame_count(); ++i) {
    const SeriesFrame frame = series.Frame(i);
    const double speed_mm_s = frame.slip.speed_mm_s;
    if (!frame.slip.found || !std::isfinite(speed_mm_s)) {
      travel_mm.push_back(none);
      continue;
    }
    if (std::isfinite(last_s)) sum_mm += (speed_mm_s + last_mm_s) / 2 * (frame.time_s - last_s);
    last_mm_s = speed_mm_s;
    last_s = frame.time_s;
    travel_mm.push_back(sum_mm);
  }
  return travel_mm;
}

}  // namespace plumbline
