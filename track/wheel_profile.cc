#include "track/wheel_profile.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

double RadiusOf(const Eigen::Vector3d& point) { return std::hypot(point.x(), point.z()); }

// A weighted sum of radii with its sigmas.
class RadiusSum {
 public:
  explicit RadiusSum(const WheelAdjustment& adjusted) : adjusted_(adjusted) {}

  // slope: d radius / d y of the profile, where the weight does not follow a point along y.
  void Add(int point, double weight, double slope = 0) {
    const Eigen::Vector3d& p = adjusted_.points_mm[static_cast<std::size_t>(point)];
    const double r = RadiusOf(p);
    points_.push_back(point);
    derivatives_.push_back(weight * Eigen::Vector3d(p.x() / r, -slope, p.z() / r));
  }

  double SigmaRandom() const { return std::sqrt(adjusted_.VarianceOfSum(points_, derivatives_)); }
  double SigmaCalibration() const {
    if (adjusted_.along_modes.rows() == 0) return kNone;
    Eigen::RowVectorXd along = Eigen::RowVectorXd::Zero(adjusted_.along_modes.rows());
    for (std::size_t n = 0; n < points_.size(); ++n) {
      along += derivatives_[n].transpose() *
               adjusted_.points_along_modes_mm[static_cast<std::size_t>(points_[n])];
    }
    return along.norm();
  }

 private:
  const WheelAdjustment& adjusted_;
  std::vector<int> points_;
  std::vector<Eigen::Vector3d> derivatives_;
};

// The parabola r = a + b (y - y0) + c (y - y0)^2 about the largest mean, and its vertex.
void FindCrown(const WheelAdjustment& adjusted, WheelProfile& profile) {
  profile.crown_radius_mm = profile.crown_y_mm = kNone;
  profile.sigma_crown_random_mm = profile.sigma_crown_calibration_mm = kNone;
  if (profile.y_mm.empty()) return;
  const auto top = std::max_element(profile.radius_mm.begin(), profile.radius_mm.end());
  const double y0 = profile.y_mm[static_cast<std::size_t>(top - profile.radius_mm.begin())];
  if (y0 - profile.y_mm.front() < WheelProfile::kCrown_mm / 2 ||
      profile.y_mm.back() - y0 < WheelProfile::kCrown_mm / 2) {
    return;
  }
  const auto row = [&](double y) { return Eigen::Vector3d(1, y - y0, (y - y0) * (y - y0)); };
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
  std::vector<int> near;
  for (std::size_t p = 0; p < adjusted.points_mm.size(); ++p) {
    const Eigen::Vector3d& point = adjusted.points_mm[p];
    if (!(std::abs(point.y() - y0) < WheelProfile::kCrown_mm)) continue;
    near.push_back(static_cast<int>(p));
    normal += row(point.y()) * row(point.y()).transpose();
    rhs += row(point.y()) * RadiusOf(point);
  }
  const Eigen::LDLT<Eigen::Matrix3d> solver(normal);
  const Eigen::Vector3d fit = solver.solve(rhs);
  const double off = -fit[1] / (2 * fit[2]);
  if (!(fit[2] < 0) || !(std::abs(off) < WheelProfile::kCrown_mm)) return;
  profile.crown_y_mm = y0 + off;
  profile.crown_radius_mm = fit.dot(row(y0 + off));
  // At the vertex the radius does not depend on where it is.
  const Eigen::Vector3d weights = solver.solve(row(y0 + off));
  RadiusSum sum(adjusted);
  for (const int p : near) {
    const double y = adjusted.points_mm[static_cast<std::size_t>(p)].y();
    sum.Add(p, weights.dot(row(y)), fit[1] + 2 * fit[2] * (y - y0));
  }
  profile.sigma_crown_random_mm = sum.SigmaRandom();
  profile.sigma_crown_calibration_mm = sum.SigmaCalibration();
}

}  // namespace

WheelProfile ProfileOf(const WheelAdjustment& adjusted) {
  std::map<long, std::vector<int>> bins;
  for (std::size_t p = 0; p < adjusted.points_mm.size(); ++p) {
    const Eigen::Vector3d& point = adjusted.points_mm[p];
    if (!point.allFinite()) continue;
    bins[std::lround(point.y() / WheelProfile::kBin_mm)].push_back(static_cast<int>(p));
  }
  WheelProfile profile;
  for (const auto& [bin, points] : bins) {
    if (points.size() < static_cast<std::size_t>(WheelProfile::kFewest)) continue;
    const auto n = static_cast<double>(points.size());
    double y = 0, radius = 0, yy = 0, yr = 0;
    for (const int p : points) {
      const Eigen::Vector3d& point = adjusted.points_mm[static_cast<std::size_t>(p)];
      y += point.y() / n;
      radius += RadiusOf(point) / n;
    }
    for (const int p : points) {
      const Eigen::Vector3d& point = adjusted.points_mm[static_cast<std::size_t>(p)];
      yy += (point.y() - y) * (point.y() - y);
      yr += (point.y() - y) * (RadiusOf(point) - radius);
    }
    const double slope = yy > 0 ? yr / yy : 0;
    RadiusSum errors(adjusted);
    double squares = 0;
    for (const int p : points) {
      const Eigen::Vector3d& point = adjusted.points_mm[static_cast<std::size_t>(p)];
      const double off = RadiusOf(point) - radius - slope * (point.y() - y);
      squares += off * off / n;
      errors.Add(p, 1 / n, slope);
    }
    profile.y_mm.push_back(y);
    profile.radius_mm.push_back(radius);
    profile.sigma_random_mm.push_back(errors.SigmaRandom());
    profile.sigma_calibration_mm.push_back(errors.SigmaCalibration());
    profile.scatter_mm.push_back(std::sqrt(squares));
    profile.points.push_back(static_cast<int>(points.size()));
  }
  FindCrown(adjusted, profile);
  return profile;
}

}  // namespace plumbline
