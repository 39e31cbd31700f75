#include "fit/deformation_symmetry.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

constexpr int kEven = 6;       // P_0, P_2 ... P_10 along the circumference
constexpr int kAcross = 13;    // P_0 ... P_12 along the axis
constexpr int kOdd = 5;        // P_1 ... P_9
constexpr int kOddAcross = 3;  // P_0 ... P_2
constexpr int kShape = kEven * kAcross;
constexpr int kSteps = 12;
constexpr std::size_t kFewest = 5 * kShape;
// Where the polynomials are trusted: this share of what is seen, from its middle.
constexpr double kTrusted = 0.8;

struct CylinderPoint {
  double angle, y, radius;
};

// P_0 to P_{n-1} and their derivatives (Bonnet's recursion).
void Legendre(double x, int n, double* p, double* dp) {
  p[0] = 1;
  dp[0] = 0;
  if (n > 1) {
    p[1] = x;
    dp[1] = 1;
  }
  for (int k = 2; k < n; ++k) {
    p[k] = ((2 * k - 1) * x * p[k - 1] - (k - 1) * p[k - 2]) / k;
    dp[k] = dp[k - 2] + (2 * k - 1) * p[k - 1];
  }
}

struct Fit {
  Eigen::VectorXd shape = Eigen::VectorXd::Zero(kShape);
  double step = 0;         // of the plane's angle
  double information = 0;  // on the angle, the shape eliminated, for sigma 1 mm
  double slope_mm = 0;     // rms of what a turn does to the radii, mm / rad
  double asymmetry_mm = 0;
  double rise_mm = 0;  // of the middle over what is lowest before and behind it
};

// One step of Gauss-Newton about an angle; the shape is linear.
class SymmetricShape {
 public:
  SymmetricShape(const std::vector<CylinderPoint>& points, double middle, double half, double y0,
                 double y_half)
      : points_(points), middle_(middle), half_(half), y0_(y0), y_half_(y_half) {}

  Fit Solve() const {
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(kShape, kShape);
    Eigen::VectorXd rhs = Eigen::VectorXd::Zero(kShape);
    Eigen::VectorXd row(kShape), d_row(kShape);
    for (const CylinderPoint& point : points_) {
      Row(point, &row, &d_row);
      normal.selfadjointView<Eigen::Lower>().rankUpdate(row);
      rhs += row * point.radius;
    }
    // Parts of the field without points leave some combinations open: held at nothing.
    normal.diagonal().array() += 1e-9 * static_cast<double>(points_.size());
    const Eigen::LLT<Eigen::MatrixXd, Eigen::Lower> solver(normal.selfadjointView<Eigen::Lower>());
    Fit fit;
    fit.shape = solver.solve(rhs);
    // The angle, with the shape eliminated.
    Eigen::VectorXd coupling = Eigen::VectorXd::Zero(kShape), left = coupling;
    double slope2 = 0, slope_left = 0;
    for (const CylinderPoint& point : points_) {
      Row(point, &row, &d_row);
      const double slope = -d_row.dot(fit.shape) / half_;
      const double residual = point.radius - row.dot(fit.shape);
      coupling += row * slope;
      slope2 += slope * slope;
      slope_left += slope * residual;
    }
    fit.information = slope2 - coupling.dot(solver.solve(coupling));
    fit.step = slope_left / fit.information;
    fit.asymmetry_mm = Asymmetry(fit);
    fit.rise_mm = Rise(fit.shape);
    return fit;
  }

 private:
  void Row(const CylinderPoint& point, Eigen::VectorXd* row, Eigen::VectorXd* d_row) const {
    double a[2 * kEven], da[2 * kEven], y[kAcross], dy[kAcross];
    Legendre((point.angle - middle_) / half_, 2 * kEven, a, da);
    Legendre((point.y - y0_) / y_half_, kAcross, y, dy);
    for (int i = 0; i < kEven; ++i) {
      for (int j = 0; j < kAcross; ++j) {
        (*row)[i * kAcross + j] = a[2 * i] * y[j];
        (*d_row)[i * kAcross + j] = da[2 * i] * y[j];
      }
    }
  }

  double Rise(const Eigen::VectorXd& shape) const {
    constexpr int kPlaces = 10;
    Eigen::VectorXd row(kShape), d_row(kShape);
    double rise = 0;
    for (int j = -kPlaces; j <= kPlaces; ++j) {
      const double y = y0_ + kTrusted * y_half_ * j / kPlaces;
      double middle = 0, lowest = 0;
      for (int i = 0; i <= kPlaces; ++i) {
        const double angle = kTrusted * half_ * i / kPlaces;
        Row({middle_ + angle, y, 0}, &row, &d_row);
        const double height = -row.dot(shape) * std::cos(angle);
        if (i == 0) middle = lowest = height;
        lowest = std::min(lowest, height);
      }
      rise = std::max(rise, middle - lowest);
    }
    return rise;
  }

  double Asymmetry(const Fit& fit) const {
    constexpr int kTerms = kOdd * kOddAcross;
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(kTerms, kTerms);
    Eigen::VectorXd rhs = Eigen::VectorXd::Zero(kTerms), odd(kTerms), row(kShape), d_row(kShape);
    for (const CylinderPoint& point : points_) {
      Row(point, &row, &d_row);
      double a[2 * kOdd], da[2 * kOdd], y[kOddAcross], dy[kOddAcross];
      Legendre((point.angle - middle_) / half_, 2 * kOdd, a, da);
      Legendre((point.y - y0_) / y_half_, kOddAcross, y, dy);
      for (int i = 0; i < kOdd; ++i) {
        for (int j = 0; j < kOddAcross; ++j) odd[i * kOddAcross + j] = a[2 * i + 1] * y[j];
      }
      normal += odd * odd.transpose();
      rhs += odd * (point.radius - row.dot(fit.shape));
    }
    const Eigen::VectorXd terms = normal.ldlt().solve(rhs);
    return std::sqrt(std::max(0.0, terms.dot(normal * terms)) /
                     static_cast<double>(points_.size()));
  }

  const std::vector<CylinderPoint>& points_;
  double middle_, half_, y0_, y_half_;
};

std::nullopt_t No(std::string* why, std::string reason) {
  if (why != nullptr) *why = std::move(reason);
  return std::nullopt;
}

}  // namespace

void SymmetryOptions::Check() const {
  if (!(max_asymmetry_mm > 0) || !(max_rise_mm > 0) || !(max_sigma_rad > 0) ||
      !(max_tilt_rad > 0)) {
    throw UsageError("The bounds of a symmetric deformation must be positive.");
  }
  if (!(least_half_angle_rad > 0 && least_half_angle_rad < 1.5)) {
    throw UsageError("A symmetric deformation has to be seen over 0 to 1.5 rad to either side.");
  }
  if (!(correlation_area_points >= 1)) {
    throw UsageError("At least one point shares a point's noise: its own.");
  }
}

std::optional<DeformationSymmetry> FindSymmetry(const Image<Eigen::Vector3d>& point_mm,
                                                double sigma_mm, const WheelAxis& axis,
                                                double start_rad, const SymmetryOptions& options,
                                                std::string* why) {
  options.Check();
  std::vector<CylinderPoint> all;
  for (const Eigen::Vector3d& point : point_mm.values()) {
    if (!point.allFinite()) continue;
    const Eigen::Vector3d q = axis.rotation.transpose() * (point - axis.origin_in_rig_mm());
    all.push_back({std::atan2(q.x(), -q.z()), q.y(), std::hypot(q.x(), q.z())});
  }
  if (all.size() < kFewest) return No(why, fmt::format("only {} points are there", all.size()));
  const auto [first, last] = std::minmax_element(
      all.begin(), all.end(),
      [](const CylinderPoint& a, const CylinderPoint& b) { return a.angle < b.angle; });
  const double low = first->angle, high = last->angle;
  double middle = -start_rad;
  DeformationSymmetry found;
  Fit fit;
  std::size_t used = 0;
  for (int step = 0; step < kSteps; ++step) {
    const double half = std::min(high - middle, middle - low);
    if (half < options.least_half_angle_rad) {
      return No(why, fmt::format("only {:.1f} degrees are seen on both sides of the axis",
                                 std::max(0.0, half) * 57.29578));
    }
    std::vector<CylinderPoint> both;
    double y_low = all.front().y, y_high = y_low;
    for (const CylinderPoint& point : all) {
      if (std::abs(point.angle - middle) > half) continue;
      both.push_back(point);
      y_low = std::min(y_low, point.y);
      y_high = std::max(y_high, point.y);
    }
    if (both.size() < kFewest)
      return No(why, fmt::format("only {} points are on both sides of the axis", both.size()));
    used = both.size();
    fit = SymmetricShape(both, middle, half, (y_low + y_high) / 2, (y_high - y_low) / 2).Solve();
    found.half_angle_rad = half;
    const double bound = options.max_tilt_rad / 4;
    middle += std::clamp(fit.step, -bound, bound);
    if (!(std::abs(middle + start_rad) <= options.max_tilt_rad)) {
      return No(why, "the surface is not symmetric about a plane through the axis");
    }
    if (std::abs(fit.step) < 1e-7) break;
  }
  found.pitch_rad = -middle;
  found.asymmetry_mm = fit.asymmetry_mm;
  found.sigma_noise_rad = sigma_mm * std::sqrt(options.correlation_area_points / fit.information);
  found.sigma_asymmetry_rad =
      fit.asymmetry_mm * std::sqrt(static_cast<double>(used) / fit.information);
  if (fit.rise_mm > options.max_rise_mm) {
    return No(why, fmt::format("the surface is {:.1f} mm higher below the axis than before and "
                               "behind it: an obstacle, whose symmetry need not be the wheel's",
                               fit.rise_mm));
  }
  if (found.asymmetry_mm > options.max_asymmetry_mm) {
    return No(why, fmt::format("the surface before and behind the axis differs by {:.2f} mm",
                               found.asymmetry_mm));
  }
  if (!(std::hypot(found.sigma_noise_rad, found.sigma_asymmetry_rad) <= options.max_sigma_rad)) {
    return No(why, "the surface is too little deformed to tell which way is down");
  }
  return found;
}

}  // namespace plumbline
