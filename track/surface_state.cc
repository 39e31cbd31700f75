#include "track/surface_state.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/parallel.h"
#include "calib/triangulate.h"

namespace plumbline {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();
using Matrix32f = Eigen::Matrix<float, 3, 2>;

// F = 1 + gradient of a match.
Eigen::Matrix2d DeformationOf(const PlanarField& field, std::size_t i) {
  return Eigen::Matrix2d::Identity() + field.gradient.data()[i].cast<double>();
}

// The covariance of a match in pixels of the reference image.
Eigen::Matrix2d PulledBack(const PlanarField& field, std::size_t i) {
  const Eigen::Matrix2d back = DeformationOf(field, i).inverse();
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
      scatter_ = 1.4826 * Median(off);
      const double limit = 3 * scatter_ + 1e-9;
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
  double scatter() const { return scatter_; }  // about it, robust

 private:
  Eigen::Vector3d Row(std::size_t i) const {
    const auto columns = static_cast<std::size_t>(columns_);
    return {1, static_cast<double>(i % columns), static_cast<double>(i / columns)};
  }

  int columns_;
  Eigen::Vector3d plane_{0, 0, 0};
  double scatter_ = 0;
};

StereoSurface EmptySurface(ImageSize size) {
  StereoSurface surface;
  SurfaceState& instant = surface.instant;
  instant.point_mm = Image<Eigen::Vector3d>(size, Eigen::Vector3d::Constant(kNoNumber));
  instant.d_left = instant.d_right = Image<Matrix32f>(size, Matrix32f::Constant(kNone));
  instant.scale_left = instant.scale_right = Image<float>(size, kNone);
  instant.share_left = instant.share_right = Image<float>(size, kNone);
  surface.epipolar_px = surface.sigma_epipolar_px = Image<float>(size, kNone);
  surface.status = Image<Status>(size, Status::kMasked);
  return surface;
}

void TakeBack(SurfaceState& instant, std::size_t i) {
  instant.point_mm.data()[i].setConstant(kNoNumber);
  instant.d_left.data()[i].setConstant(kNone);
  instant.d_right.data()[i].setConstant(kNone);
}

// Both matches of a point told in the terms of SurfaceState.
struct MatchedPoint {
  float scale_left, scale_right, share_left, share_right;
  StereoObservation seen;
};

// What both matches of a point share is not all of the noise of either. Where their covariances
// have another shape than that of the reference, from which `across` is told, it would say more.
Eigen::Matrix2d AtMostShared(const Eigen::Matrix2d& across, const Eigen::Matrix2d& left,
                             const Eigen::Matrix2d& right) {
  constexpr double kMost = 0.95;  // correlation, of any two directions
  const Eigen::LLT<Eigen::Matrix2d> left_factor(left), right_factor(right);
  if (left_factor.info() != Eigen::Success || right_factor.info() != Eigen::Success) {
    return Eigen::Matrix2d::Zero();  // one without noise, as the left one of the reference pair
  }
  const Eigen::Matrix2d left_root = left_factor.matrixL(), right_root = right_factor.matrixL();
  const Eigen::Matrix2d alike = left_root.inverse() * across * right_root.inverse().transpose();
  const double most = alike.jacobiSvd().singularValues()[0];
  return most > kMost ? Eigen::Matrix2d(across * (kMost / most)) : across;
}

MatchedPoint MatchedAt(const StereoField& field, const Eigen::Vector3f& unit, std::size_t i) {
  MatchedPoint out;
  const PlanarField &left = field.left, &right = field.right;
  out.scale_left = ScaleOf(PulledBack(left, i), unit);
  out.scale_right = ScaleOf(PulledBack(right, i), unit);
  out.share_left = left.reference_share.data()[i];
  out.share_right = right.reference_share.data()[i];
  const double common =
      std::sqrt(static_cast<double>(out.share_left) * static_cast<double>(out.share_right)) *
      static_cast<double>(out.scale_left) * static_cast<double>(out.scale_right);
  const Eigen::Matrix2d across =
      DeformationOf(left, i) * (common * CovarianceOf(unit)) * DeformationOf(right, i).transpose();
  const auto columns = static_cast<std::size_t>(left.size().width);
  const Eigen::Vector2d pixel =
      left.PixelOf(static_cast<int>(i / columns), static_cast<int>(i % columns));
  out.seen.left = pixel + left.displacement_px.data()[i];
  out.seen.right = pixel + right.displacement_px.data()[i];
  const Eigen::Matrix2d of_left = CovarianceOf(left.cov_displacement_px2.data()[i]),
                        of_right = CovarianceOf(right.cov_displacement_px2.data()[i]);
  const Eigen::Matrix2d shared = AtMostShared(across, of_left, of_right);
  out.seen.cov_px2 << of_left, shared, shared.transpose(), of_right;
  return out;
}

bool BothMatched(const StereoField& field, const Image<Eigen::Vector3f>& cov_px2, std::size_t i) {
  return Usable(field.left, i) && Usable(field.right, i) && cov_px2.data()[i].allFinite();
}

// In every direction.
bool HasNoise(const PlanarField& field, std::size_t i) {
  const Eigen::Matrix2d cov = CovarianceOf(field.cov_displacement_px2.data()[i]);
  return cov(0, 0) > 0 && cov.determinant() > 0;
}

// The points that a list of observations was made of.
struct Observed {
  std::vector<std::size_t> places;
  std::vector<StereoObservation> observations;
};

Observed Observe(const StereoField& field, const Image<Eigen::Vector3f>& cov_px2,
                 StereoSurface& surface) {
  Observed observed;
  SurfaceState& instant = surface.instant;
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    const Status left = field.left.status.data()[i], right = field.right.status.data()[i];
    surface.status.data()[i] = left != Status::kOk ? left : right;
    if (surface.status.data()[i] != Status::kOk) continue;
    if (!BothMatched(field, cov_px2, i)) {
      surface.status.data()[i] = Status::kFailedVerification;
      continue;
    }
    const MatchedPoint point = MatchedAt(field, cov_px2.data()[i], i);
    instant.scale_left.data()[i] = point.scale_left;
    instant.scale_right.data()[i] = point.scale_right;
    instant.share_left.data()[i] = point.share_left;
    instant.share_right.data()[i] = point.share_right;
    observed.places.push_back(i);
    observed.observations.push_back(point.seen);
  }
  return observed;
}

void RejectMismatches(const EpipolarOptions& options, StereoSurface& surface) {
  const EpipolarTrend trend(surface);
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    if (surface.status.data()[i] != Status::kOk) continue;
    const auto off = static_cast<double>(surface.epipolar_px.data()[i]);
    const auto sigma = static_cast<double>(surface.sigma_epipolar_px.data()[i]);
    const double limit = options.tolerance_px + options.sigmas * std::hypot(sigma, trend.scatter());
    if (std::abs(off - trend.Common(i)) <= limit) continue;
    surface.status.data()[i] = Status::kEpipolarViolation;
    TakeBack(surface.instant, i);
  }
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

std::vector<std::size_t> ObservedPlaces(const StereoField& field,
                                        const Image<Eigen::Vector3f>& cov_px2) {
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < cov_px2.pixel_count(); ++i) {
    if (BothMatched(field, cov_px2, i) && (HasNoise(field.left, i) || HasNoise(field.right, i))) {
      places.push_back(i);
    }
  }
  return places;
}

std::vector<StereoObservation> ObservationsAt(std::span<const std::size_t> places,
                                              const StereoField& field,
                                              const Image<Eigen::Vector3f>& cov_px2) {
  std::vector<StereoObservation> observations;
  for (const std::size_t i : places) {
    observations.push_back(MatchedAt(field, cov_px2.data()[i], i).seen);
  }
  return observations;
}

std::vector<StereoObservation> ObservationsOf(const StereoField& field,
                                              const Image<Eigen::Vector3f>& cov_px2) {
  return ObservationsAt(ObservedPlaces(field, cov_px2), field, cov_px2);
}

StereoSurface TriangulateField(const StereoRig& rig, const StereoField& field,
                               const Image<Eigen::Vector3f>& cov_px2,
                               const EpipolarOptions& options) {
  const ImageSize size = field.left.size();
  if (field.right.size() != size || cov_px2.size() != size) {
    throw InputError("The matches of a pair have their points on grids of different size.");
  }
  StereoSurface surface = EmptySurface(size);
  const Observed observed = Observe(field, cov_px2, surface);
  const std::vector<TriangulatedPoint> points = Triangulate(rig, observed.observations);
  SurfaceState& instant = surface.instant;
  ForEachIndex(points.size(), [&](std::size_t n) {
    const std::size_t i = observed.places[n];
    const TriangulatedPoint& point = points[n];
    surface.status.data()[i] = point.status;
    surface.epipolar_px.data()[i] = static_cast<float>(point.epipolar_px);
    surface.sigma_epipolar_px.data()[i] = static_cast<float>(point.sigma_epipolar_px);
    if (point.status != Status::kOk) return;
    instant.point_mm.data()[i] = point.point_in_rig;
    const auto turned = [&](const PlanarField& match, int first) {
      return (point.d_point_d_pixels.middleCols<2>(first) * DeformationOf(match, i)).eval();
    };
    instant.d_left.data()[i] = turned(field.left, 0).cast<float>();
    instant.d_right.data()[i] = turned(field.right, 2).cast<float>();
  });
  RejectMismatches(options, surface);
  return surface;
}

SurfaceState InFrame(const SurfaceState& in_rig, const MeasurementFrame& frame) {
  SurfaceState told = in_rig;
  const Rigid3& from_rig = frame.frame_from_rig;
  const Eigen::Matrix3f turn = from_rig.rotation.cast<float>();
  const std::size_t modes = in_rig.along_modes_mm.size();
  if (frame.along_modes.size() != modes) {
    throw std::invalid_argument("InFrame: the frame is not known along all modes");
  }
  ForEachIndex(told.point_mm.pixel_count(), [&](std::size_t i) {
    const Eigen::Vector3d& point = in_rig.point_mm.data()[i];
    if (!point.allFinite()) return;
    const Eigen::Vector3d here = from_rig * point;
    told.point_mm.data()[i] = here;
    told.d_left.data()[i] = turn * in_rig.d_left.data()[i];
    told.d_right.data()[i] = turn * in_rig.d_right.data()[i];
    if (!told.cov_left_out_mm2.empty()) {
      Eigen::Matrix<float, 6, 1>& left_out = told.cov_left_out_mm2.data()[i];
      left_out = TriangleOf(Eigen::Matrix3d(from_rig.rotation * CovarianceOf(left_out) *
                                            from_rig.rotation.transpose()));
    }
    for (std::size_t k = 0; k < modes; ++k) {
      const Eigen::Vector3d moved = point + in_rig.along_modes_mm[k].data()[i].cast<double>();
      told.along_modes_mm[k].data()[i] = (frame.along_modes[k] * moved - here).cast<float>();
    }
  });
  return told;
}

}  // namespace plumbline
