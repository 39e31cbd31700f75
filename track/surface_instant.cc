#include "track/surface_instant.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/triangulate.h"

namespace plumbline {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();
using Matrix32f = Eigen::Matrix<float, 3, 2>;

// The covariance of a match in pixels of the reference image.
Eigen::Matrix2d PulledBack(const PlanarField& field, std::size_t i) {
  const Eigen::Matrix2d F = Eigen::Matrix2d::Identity() + field.gradient.data()[i].cast<double>();
  const Eigen::Matrix2d back = F.inverse();
  return back * CovarianceOf(field.cov_displacement_px2.data()[i]) * back.transpose();
}

bool Usable(const PlanarField& field, std::size_t i) {
  return field.status.data()[i] == Status::kOk && field.gradient.data()[i].allFinite() &&
         field.cov_displacement_px2.data()[i].allFinite();
}

float ScaleOf(const Eigen::Matrix2d& cov_px2, const Eigen::Vector3f& unit_px2) {
  const double unit = static_cast<double>(unit_px2[0]) + static_cast<double>(unit_px2[2]);
  return static_cast<float>(std::sqrt(std::max(0.0, cov_px2.trace()) / unit));
}

// What all points have in common of the epipolar distances, a plane over the grid, by least squares
// with the points beyond three times the median deviation left out.
class EpipolarTrend {
 public:
  EpipolarTrend(const StereoSurface& surface) : columns_(surface.status.size().width) {
    std::vector<std::size_t> places;
    std::vector<double> values;
    for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
      if (surface.status.data()[i] != Status::kOk) continue;
      places.push_back(i);
      values.push_back(static_cast<double>(surface.epipolar_px.data()[i]));
    }
    if (values.empty()) return;
    plane_ = {Median(values), 0, 0};
    constexpr int kRounds = 3;
    for (int round = 0; round < kRounds && values.size() >= 9; ++round) {
      std::vector<double> off(values.size());
      for (std::size_t n = 0; n < values.size(); ++n) {
        off[n] = std::abs(values[n] - Common(places[n]));
      }
      const double limit = 3 * 1.4826 * Median(off) + 1e-9;
      Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
      Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
      for (std::size_t n = 0; n < values.size(); ++n) {
        if (off[n] > limit) continue;
        const Eigen::Vector3d row = Row(places[n]);
        normal += row * row.transpose();
        rhs += row * values[n];
      }
      const Eigen::LDLT<Eigen::Matrix3d> solver(normal);
      if (!(solver.vectorD().minCoeff() > 1e-9 * solver.vectorD().maxCoeff())) return;
      plane_ = solver.solve(rhs);
    }
  }

  double Common(std::size_t i) const { return plane_.dot(Row(i)); }

 private:
  Eigen::Vector3d Row(std::size_t i) const {
    const auto columns = static_cast<std::size_t>(columns_);
    return {1, static_cast<double>(i % columns), static_cast<double>(i / columns)};
  }

  int columns_;
  Eigen::Vector3d plane_{0, 0, 0};
};

StereoSurface EmptySurface(ImageSize size) {
  StereoSurface surface;
  SurfaceInstant& instant = surface.instant;
  instant.point_mm = Image<Eigen::Vector3d>(size, Eigen::Vector3d::Constant(kNoNumber));
  instant.d_left = instant.d_right = Image<Matrix32f>(size, Matrix32f::Constant(kNone));
  instant.scale_left = instant.scale_right = Image<float>(size, kNone);
  instant.share_left = instant.share_right = Image<float>(size, kNone);
  surface.epipolar_px = surface.sigma_epipolar_px = Image<float>(size, kNone);
  surface.status = Image<Status>(size, Status::kMasked);
  return surface;
}

void TakeBack(SurfaceInstant& instant, std::size_t i) {
  instant.point_mm.data()[i].setConstant(kNoNumber);
  instant.d_left.data()[i].setConstant(kNone);
  instant.d_right.data()[i].setConstant(kNone);
}

// The points that a list of observations was made of.
struct Observed {
  std::vector<std::size_t> places;
  std::vector<StereoObservation> observations;
};

Observed ObservationsOf(const StereoField& field, const Image<Eigen::Vector3f>& cov_px2,
                        StereoSurface& surface) {
  Observed observed;
  SurfaceInstant& instant = surface.instant;
  const auto columns = static_cast<std::size_t>(field.left.size().width);
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    const Status left = field.left.status.data()[i], right = field.right.status.data()[i];
    surface.status.data()[i] = left != Status::kOk ? left : right;
    if (surface.status.data()[i] != Status::kOk) continue;
    if (!Usable(field.left, i) || !Usable(field.right, i) || !cov_px2.data()[i].allFinite()) {
      surface.status.data()[i] = Status::kFailedVerification;
      continue;
    }
    instant.scale_left.data()[i] = ScaleOf(PulledBack(field.left, i), cov_px2.data()[i]);
    instant.scale_right.data()[i] = ScaleOf(PulledBack(field.right, i), cov_px2.data()[i]);
    instant.share_left.data()[i] = field.left.reference_share.data()[i];
    instant.share_right.data()[i] = field.right.reference_share.data()[i];
    const Eigen::Matrix2d F_left =
        Eigen::Matrix2d::Identity() + field.left.gradient.data()[i].cast<double>();
    const Eigen::Matrix2d F_right =
        Eigen::Matrix2d::Identity() + field.right.gradient.data()[i].cast<double>();
    const double common = std::sqrt(static_cast<double>(instant.share_left.data()[i]) *
                                    static_cast<double>(instant.share_right.data()[i])) *
                          static_cast<double>(instant.scale_left.data()[i]) *
                          static_cast<double>(instant.scale_right.data()[i]);
    StereoObservation seen;
    const Eigen::Vector2d pixel =
        field.left.PixelOf(static_cast<int>(i / columns), static_cast<int>(i % columns));
    seen.left = pixel + field.left.displacement_px.data()[i];
    seen.right = pixel + field.right.displacement_px.data()[i];
    const Eigen::Matrix2d across =
        F_left * (common * CovarianceOf(cov_px2.data()[i])) * F_right.transpose();
    seen.cov_px2 << CovarianceOf(field.left.cov_displacement_px2.data()[i]), across,
        across.transpose(), CovarianceOf(field.right.cov_displacement_px2.data()[i]);
    observed.places.push_back(i);
    observed.observations.push_back(seen);
  }
  return observed;
}

void RejectMismatches(const EpipolarOptions& options, StereoSurface& surface) {
  const EpipolarTrend trend(surface);
  double sum = 0, squares = 0, expected = 0;
  std::int64_t count = 0;
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    if (surface.status.data()[i] != Status::kOk) continue;
    const auto off = static_cast<double>(surface.epipolar_px.data()[i]);
    const auto sigma = static_cast<double>(surface.sigma_epipolar_px.data()[i]);
    if (!(std::abs(off - trend.Common(i)) <= options.tolerance_px + options.sigmas * sigma)) {
      surface.status.data()[i] = Status::kEpipolarViolation;
      TakeBack(surface.instant, i);
      continue;
    }
    sum += off;
    squares += off * off;
    expected += sigma * sigma;
    ++count;
  }
  const auto n = static_cast<double>(count);
  surface.mean_epipolar_px = sum / n;
  surface.rms_epipolar_px = std::sqrt(squares / n);
  surface.expected_epipolar_px = std::sqrt(expected / n);
}

}  // namespace

Image<Eigen::Vector3f> UnitCovariance(const StereoField& reference, const StereoField& now) {
  const ImageSize size = reference.right.size();
  if (now.left.size() != size) {
    throw InputError("The pairs of a sequence have their points on grids of different size.");
  }
  Image<Eigen::Vector3f> unit(size, Eigen::Vector3f::Constant(kNone));
  for (std::size_t i = 0; i < unit.pixel_count(); ++i) {
    const PlanarField* const from = Usable(reference.right, i) ? &reference.right
                                    : Usable(now.left, i)      ? &now.left
                                                               : nullptr;
    if (from == nullptr) continue;
    const Eigen::Vector3f cov = TriangleOf(PulledBack(*from, i));
    if (cov.allFinite() && cov[0] + cov[2] > 0) unit.data()[i] = cov;
  }
  return unit;
}

StereoSurface TriangulateField(const StereoRig& rig, const StereoField& field,
                               const Image<Eigen::Vector3f>& cov_px2,
                               const EpipolarOptions& options) {
  const ImageSize size = field.left.size();
  if (field.right.size() != size || cov_px2.size() != size) {
    throw InputError("The matches of a pair have their points on grids of different size.");
  }
  StereoSurface surface = EmptySurface(size);
  const Observed observed = ObservationsOf(field, cov_px2, surface);
  const std::vector<TriangulatedPoint> points = Triangulate(rig, observed.observations);
  SurfaceInstant& instant = surface.instant;
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, points.size(), 1024),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t n = range.begin(); n != range.end(); ++n) {
                        const std::size_t i = observed.places[n];
                        const TriangulatedPoint& point = points[n];
                        surface.status.data()[i] = point.status;
                        surface.epipolar_px.data()[i] = static_cast<float>(point.epipolar_px);
                        surface.sigma_epipolar_px.data()[i] =
                            static_cast<float>(point.sigma_epipolar_px);
                        if (point.status != Status::kOk) continue;
                        instant.point_mm.data()[i] = point.point_in_rig;
                        const auto turned = [&](const PlanarField& match, int first) {
                          const Eigen::Matrix2d F =
                              Eigen::Matrix2d::Identity() + match.gradient.data()[i].cast<double>();
                          return (point.d_point_d_pixels.middleCols<2>(first) * F).eval();
                        };
                        instant.d_left.data()[i] = turned(field.left, 0).cast<float>();
                        instant.d_right.data()[i] = turned(field.right, 2).cast<float>();
                      }
                    });
  RejectMismatches(options, surface);
  return surface;
}

SurfaceInstant InFrame(const SurfaceInstant& in_rig, const MeasurementFrame& frame) {
  SurfaceInstant told = in_rig;
  const Rigid3& from_rig = frame.frame_from_rig;
  const Eigen::Matrix3f turn = from_rig.rotation.cast<float>();
  const std::size_t modes = in_rig.along_modes_mm.size();
  if (frame.along_modes.size() != modes) {
    throw std::invalid_argument("InFrame: the frame is not known along all modes");
  }
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, told.point_mm.pixel_count(), 1024),
      [&](const tbb::blocked_range<std::size_t>& range) {
        for (std::size_t i = range.begin(); i != range.end(); ++i) {
          const Eigen::Vector3d& point = in_rig.point_mm.data()[i];
          if (!point.allFinite()) continue;
          const Eigen::Vector3d here = from_rig * point;
          told.point_mm.data()[i] = here;
          told.d_left.data()[i] = turn * in_rig.d_left.data()[i];
          told.d_right.data()[i] = turn * in_rig.d_right.data()[i];
          for (std::size_t k = 0; k < modes; ++k) {
            const Eigen::Vector3d moved = point + in_rig.along_modes_mm[k].data()[i].cast<double>();
            told.along_modes_mm[k].data()[i] = (frame.along_modes[k] * moved - here).cast<float>();
          }
        }
      });
  return told;
}

}  // namespace plumbline
