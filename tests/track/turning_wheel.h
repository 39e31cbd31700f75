#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <numbers>
#include <random>

#include "io/virtual_rig/rig_design.h"
#include "track/wheel_adjustment.h"

namespace plumbline::testing {

inline constexpr double kDegree = std::numbers::pi / 180;

// The thesis' rig inside a wheel of 384 mm radius, a little tilted; with made-up calibration modes.
inline StereoRig WheelRig() {
  StereoRig rig = plumbline::MakeRig(DesignOf(RigKind::kWide640));
  std::mt19937 rng(21);
  std::normal_distribution<double> n(0, 1);
  const int P = rig.left.parameter_count();
  rig.modes.modes = Eigen::MatrixXd::Zero(5, rig.ParameterCount());
  for (int k = 0; k < 4; ++k) {
    auto mode = rig.modes.modes.row(k);
    for (const int first : {0, P}) {
      for (int i = 0; i < 4; ++i) mode[first + i] = 0.03 * n(rng);
    }
    for (int i = 0; i < 3; ++i) mode[2 * P + i] = 4e-5 * n(rng);
    for (int i = 3; i < 6; ++i) mode[2 * P + i] = 0.003 * n(rng);
  }
  rig.modes.modes.row(4).tail<3>() = 2e-4 * rig.right_from_left.translation_mm.transpose();
  rig.modes.has_scale_mode = true;
  return rig;
}

inline WheelAxis TrueAxis() { return WheelAxis::Through({21, 3, -224}, {0.03, -1, 0.02}); }

// Points of a crowned surface and where both cameras see them, without noise.
inline WheelProblem TurningWheel(const StereoRig& rig, int frames, double step_rad, int points,
                                 double sigma_px = 0.02) {
  WheelProblem wheel;
  wheel.axis = TrueAxis();
  for (int f = 0; f < frames; ++f) wheel.angles_rad.push_back(step_rad * f);
  std::mt19937 rng(7);
  const double arc = std::min(2 * std::numbers::pi, step_rad * frames + 0.6);
  std::uniform_real_distribution<double> phi(-0.3, arc - 0.3), across(-70, 70);
  Eigen::Matrix2d cov;
  cov << 1, 0.2, 0.2, 0.8;
  cov *= sigma_px * sigma_px;
  for (int p = 0; p < points; ++p) {
    const double a = phi(rng), y = across(rng), r = 384 - y * y / 600;
    // At the bottom when the wheel has turned by a.
    wheel.points_mm.emplace_back(r * std::sin(a), y, -r * std::cos(a));
    for (int f = 0; f < frames; ++f) {
      const Eigen::Vector3d at =
          wheel.axis.RigFromWheel(wheel.angles_rad[static_cast<std::size_t>(f)]) *
          wheel.points_mm.back();
      const Eigen::Vector2d left = rig.left.Project(at);
      const Eigen::Vector2d right = rig.right.Project(rig.right_from_left * at);
      if (!(left.allFinite() && right.allFinite()) || !rig.left.Contains(left) ||
          !rig.right.Contains(right)) {
        continue;
      }
      wheel.observations.push_back({f, p, false, left, cov});
      wheel.observations.push_back({f, p, true, right, 1.5 * cov});
    }
  }
  return wheel;
}

inline WheelProblem WithNoise(WheelProblem wheel, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> n(0, 1);
  for (WheelObservation& o : wheel.observations) {
    const Eigen::Matrix2d L = o.cov_px2.llt().matrixL();
    const double a = n(rng), b = n(rng);
    o.pixel += L * Eigen::Vector2d(a, b);
  }
  return wheel;
}

// Starting values that are off; the first angle stays.
inline WheelProblem WithPoorStart(WheelProblem wheel) {
  std::mt19937 rng(3);
  std::normal_distribution<double> n(0, 1);
  wheel.axis.rotation *= RotationFromVector({0.004, -0.006, 0.005});
  wheel.axis.distance_mm += 1.5;
  for (std::size_t f = 1; f < wheel.angles_rad.size(); ++f) wheel.angles_rad[f] += 3e-3 * n(rng);
  for (Eigen::Vector3d& p : wheel.points_mm) {
    for (double& x : p) x += n(rng);
  }
  return wheel;
}

}  // namespace plumbline::testing
