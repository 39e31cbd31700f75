#include "track/rim_angles.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "track/internal/axis_along_modes.h"

namespace plumbline {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr std::size_t kCorners = 4;
using Pixels = Eigen::Matrix<double, 16, 1>;

Pixels PixelsOf(const StereoTag& seen) {
  Pixels pixels;
  for (std::size_t k = 0; k < kCorners; ++k) {
    pixels.segment<4>(static_cast<Eigen::Index>(4 * k)) << seen.left_px[k], seen.right_px[k];
  }
  return pixels;
}

std::array<Eigen::Vector3d, kCorners> MovedAlong(const WheelTag& tag, Eigen::Index mode) {
  std::array<Eigen::Vector3d, kCorners> corners = tag.corner_mm;
  for (std::size_t k = 0; k < kCorners; ++k) {
    corners[k] +=
        tag.along_modes_mm.block<1, 3>(mode, static_cast<Eigen::Index>(3 * k)).transpose();
  }
  return corners;
}

// Four sigmas above what chi-squared is expected to be (Wilson and Hilferty, "The Distribution of
// Chi-Square", 1931).
double LargestChi2(double freedoms) {
  constexpr double kSigmas = 4;
  const double variance = 2 / (9 * freedoms);
  return freedoms * std::pow(1 - variance + kSigmas * std::sqrt(variance), 3);
}

// Frames in which both surface and rim tell an angle.
struct Both {
  std::size_t frame;
  double off_rad;  // surface less rim
  double weight;
};

}  // namespace

TagProjection ProjectTag(const StereoRig& rig, const WheelAxis& axis,
                         const std::array<Eigen::Vector3d, 4>& corner_mm, double angle_rad) {
  TagProjection out;
  out.d_corner.setZero();
  Eigen::Matrix3d d_turn;
  const Eigen::Matrix3d turn = axis.rotation * TurnAboutY(angle_rad, &d_turn);
  const Eigen::Matrix3d d_turned = axis.rotation * d_turn;
  for (std::size_t k = 0; k < kCorners; ++k) {
    const Eigen::Vector3d in_rig = turn * corner_mm[k] + axis.origin_in_rig_mm();
    const auto row = static_cast<Eigen::Index>(4 * k), column = static_cast<Eigen::Index>(3 * k);
    for (const bool right : {false, true}) {
      const Camera& camera = right ? rig.right : rig.left;
      const Eigen::Matrix3d camera_from_rig =
          right ? rig.right_from_left.rotation : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
      const Camera::Projection seen =
          camera.ProjectWithJacobians(right ? rig.right_from_left * in_rig : in_rig);
      const Eigen::Index at = row + (right ? 2 : 0);
      const Eigen::Matrix<double, 2, 3> d_rig = seen.d_pixel_d_point * camera_from_rig;
      out.pixels.segment<2>(at) = seen.pixel;
      out.d_angle.segment<2>(at) = d_rig * d_turned * corner_mm[k];
      out.d_corner.block<2, 3>(at, column) = d_rig * turn;
    }
  }
  return out;
}

RimAngleFinder::RimAngleFinder(const WheelReference& wheel)
    : wheel_(wheel), axes_along_(internal::AxesAlongModes(wheel)) {
  for (std::size_t k = 0; k < axes_along_.size(); ++k) {
    rigs_along_.push_back(wheel.rig.AlongMode(static_cast<int>(k)));
  }
}

RimAngle RimAngleFinder::Find(const StereoTags& seen, double near_rad) const {
  constexpr int kSteps = 20;
  constexpr double kEnough_rad = 1e-10, kLongest_rad = 0.1;
  std::vector<std::pair<const WheelTag*, Pixels>> tags;
  for (const StereoTag& tag : seen.tags) {
    const WheelTag* known = wheel_.tags.Find(tag.id);
    if (known != nullptr && known->on_rim) tags.emplace_back(known, PixelsOf(tag));
  }
  RimAngle out;
  if (tags.empty()) return out;
  double angle = near_rad;
  std::vector<TagProjection> there(tags.size());
  double JJ = 0;
  bool settled = false;
  for (int step = 0; step < kSteps && !settled; ++step) {
    double Jr = 0;
    JJ = out.squares_px2 = 0;
    for (std::size_t i = 0; i < tags.size(); ++i) {
      there[i] = ProjectTag(wheel_.rig, wheel_.axis, tags[i].first->corner_mm, angle);
      const Pixels residual = tags[i].second - there[i].pixels;
      Jr += there[i].d_angle.dot(residual);
      JJ += there[i].d_angle.squaredNorm();
      out.squares_px2 += residual.squaredNorm();
    }
    const double change = Jr / JJ;
    if (!std::isfinite(change) || std::abs(change) > kLongest_rad) return out;
    angle += change;
    settled = std::abs(change) < kEnough_rad;
  }
  if (!settled) return out;
  out.found = true;
  out.angle_rad = angle;
  out.sigma_per_px_rad = 1 / std::sqrt(JJ);
  out.freedoms = static_cast<int>(16 * tags.size()) - 1;
  out.along_modes_rad = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(axes_along_.size()));
  double variance = 0;
  for (std::size_t i = 0; i < tags.size(); ++i) {
    const WheelTag& tag = *tags[i].first;
    const Eigen::Matrix<double, 12, 1> a = there[i].d_corner.transpose() * there[i].d_angle / JJ;
    variance += a.dot(tag.cov_random_mm2 * a);
    for (std::size_t k = 0; k < axes_along_.size(); ++k) {
      const auto mode = static_cast<Eigen::Index>(k);
      const TagProjection moved =
          ProjectTag(rigs_along_[k], axes_along_[k], MovedAlong(tag, mode), angle);
      out.along_modes_rad[mode] -= there[i].d_angle.dot(moved.pixels - there[i].pixels) / JJ;
    }
  }
  out.sigma_reference_rad = std::sqrt(variance);
  return out;
}

AnglesOfRim HoldToRim(std::span<const double> surface_rad,
                      std::span<const double> surface_sigma_rad,
                      const Eigen::MatrixXd& surface_along, std::span<const RimAngle> rim) {
  const std::size_t n = surface_rad.size();
  const Eigen::Index modes = surface_along.rows();
  if (surface_sigma_rad.size() != n || rim.size() != n ||
      (modes > 0 && surface_along.cols() != static_cast<Eigen::Index>(n))) {
    throw std::invalid_argument("HoldToRim: surface and rim must be of as many frames");
  }
  AnglesOfRim out;
  out.angles_rad.assign(surface_rad.begin(), surface_rad.end());
  out.sigmas_rad.assign(surface_sigma_rad.begin(), surface_sigma_rad.end());
  out.along_modes_rad = surface_along;
  double squares = 0, freedoms = 0;
  for (const RimAngle& angle : rim) {
    if (!angle.found) continue;
    squares += angle.squares_px2;
    freedoms += angle.freedoms;
  }
  CarcassTwist& twist = out.twist;
  twist.corner_sigma_px = freedoms > 0 ? std::sqrt(squares / freedoms) : 0;
  const auto sigma_of = [&](std::size_t f) {
    return twist.corner_sigma_px * rim[f].sigma_per_px_rad;
  };
  std::vector<Both> both;
  double weights = 0, mean = 0, reference = 0;
  Eigen::VectorXd along = Eigen::VectorXd::Zero(modes);
  for (std::size_t f = 0; f < n; ++f) {
    if (!rim[f].found || !std::isfinite(surface_rad[f])) continue;
    const double weight =
        1 / (surface_sigma_rad[f] * surface_sigma_rad[f] + sigma_of(f) * sigma_of(f));
    both.push_back({f, std::remainder(surface_rad[f] - rim[f].angle_rad, kTurn_rad), weight});
    weights += weight;
    mean += weight * both.back().off_rad;
    reference += weight * rim[f].sigma_reference_rad;
    if (modes > 0) {
      along += weight * (surface_along.col(static_cast<Eigen::Index>(f)) - rim[f].along_modes_rad);
    }
  }
  if (both.empty()) return out;
  twist.known = true;
  twist.frames = static_cast<int>(both.size());
  twist.angle_rad = mean / weights;
  along /= weights;
  twist.sigma_calibration_rad = along.norm();
  double chi2 = 0;
  for (const Both& one : both) {
    chi2 += one.weight * (one.off_rad - twist.angle_rad) * (one.off_rad - twist.angle_rad);
  }
  const double expected = static_cast<double>(both.size()) - 1;
  twist.steady = expected == 0 || chi2 <= LargestChi2(expected);
  const double scatter = expected > 0 ? std::max(1.0, chi2 / expected) : 1;
  twist.sigma_random_rad = std::hypot(std::sqrt(scatter / weights), reference / weights);
  out.sigma_common_rad = twist.sigma_random_rad;
  const double changes = twist.steady ? 0 : std::sqrt((chi2 - expected) / weights);
  for (std::size_t f = 0; f < n; ++f) {
    const auto column = static_cast<Eigen::Index>(f);
    if (!twist.steady && rim[f].found && std::isfinite(surface_rad[f])) {
      out.angles_rad[f] =
          surface_rad[f] - std::remainder(surface_rad[f] - rim[f].angle_rad, kTurn_rad);
      out.sigmas_rad[f] = sigma_of(f);
      if (modes > 0) out.along_modes_rad.col(column) = rim[f].along_modes_rad;
      continue;
    }
    out.angles_rad[f] -= twist.angle_rad;
    out.sigmas_rad[f] = std::hypot(out.sigmas_rad[f], changes);
    if (modes > 0) out.along_modes_rad.col(column) -= along;
  }
  return out;
}

}  // namespace plumbline
