#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

namespace plumbline::internal {

// Fits a pattern of two grey levels,  I(p) = B(p) + (D(p) - B(p)) c(p; q),  to grey values. B and D
// are planes, because shading is linear over a small window; c is the share of the pixel that is
// covered by level D, a function of the parameters q of the pattern's geometry.
//
// `Shape` gives the geometry:
//   static constexpr int kParameters;      the first two are the position
//   using Parameters = Eigen::Matrix<double, kParameters, 1>;
//   static double Share(const Parameters& q, const Eigen::Vector2d& p, Parameters& d_share_d_q);
//   bool Plausible(const Parameters& q) const;   steps out of it are refused
template <class Shape>
class TwoLevelFit {
 public:
  static constexpr int kGeometry = Shape::kParameters;
  static constexpr int kAll = kGeometry + 6;
  using Parameters = typename Shape::Parameters;

  struct Sample {
    Eigen::Vector2d p;
    double grey = 0;
  };
  struct Result {
    Parameters geometry;
    Eigen::Vector3d bright, covered;  // planes B and D: value, slope along x and y per scale_px
    Eigen::Matrix2d cov_position;     // px^2
    double residual = 0;              // rms with degrees of freedom, grey levels
  };

  // `scale_px` is the size of the window, for the conditioning of the slopes.
  TwoLevelFit(Shape shape, std::vector<Sample> samples, double scale_px)
      : shape_(std::move(shape)), samples_(std::move(samples)), scale_(scale_px) {}

  // Levenberg-Marquardt with Marquardt's scaling. Nothing when it does not come to rest.
  std::optional<Result> Run(const Parameters& start, double background, double level) {
    if (samples_.size() < static_cast<std::size_t>(kAll) + 10) return std::nullopt;
    Vector q = Vector::Zero();
    q.template head<kGeometry>() = start;
    q[kGeometry] = background;
    q[kGeometry + 3] = level;
    Matrix JtJ;
    double sum = 0;
    if (!Minimise(q, JtJ, sum)) return std::nullopt;
    const Eigen::Matrix<double, kAll, 2> unit = Eigen::Matrix<double, kAll, 2>::Identity();
    const double variance = sum / static_cast<double>(samples_.size() - kAll);
    Result out;
    out.geometry = q.template head<kGeometry>();
    out.bright = q.template segment<3>(kGeometry);
    out.covered = q.template segment<3>(kGeometry + 3);
    // Rounding to whole grey levels is noise too, even where the residuals happen to be smaller.
    out.cov_position = std::max(variance, 1.0 / 12) * JtJ.ldlt().solve(unit).template topRows<2>();
    out.residual = std::sqrt(variance);
    if (!out.cov_position.allFinite() || !(out.cov_position.trace() > 0)) return std::nullopt;
    return out;
  }

 private:
  using Vector = Eigen::Matrix<double, kAll, 1>;
  using Matrix = Eigen::Matrix<double, kAll, kAll>;

  // Sum of squares, normal matrix and gradient side J'r.
  double Evaluate(const Vector& q, Matrix& JtJ, Vector& Jtr) const {
    const Parameters geometry = q.template head<kGeometry>();
    double sum = 0;
    JtJ.setZero();
    Jtr.setZero();
    Vector row;
    Parameters slope;
    for (const Sample& s : samples_) {
      const Eigen::Vector3d plane(1, s.p.x() / scale_, s.p.y() / scale_);
      const double background = q.template segment<3>(kGeometry).dot(plane);
      const double step = q.template segment<3>(kGeometry + 3).dot(plane) - background;
      const double share = Shape::Share(geometry, s.p, slope);
      const double r = s.grey - background - step * share;
      sum += r * r;
      if ((share == 0 || share == 1) && slope.isZero(0)) {  // away from all edges: one plane only
        const int at = share == 0 ? kGeometry : kGeometry + 3;
        JtJ.template block<3, 3>(at, at).noalias() += plane * plane.transpose();
        Jtr.template segment<3>(at) += r * plane;
        continue;
      }
      row.template head<kGeometry>() = step * slope;
      row.template segment<3>(kGeometry) = (1 - share) * plane;
      row.template segment<3>(kGeometry + 3) = share * plane;
      JtJ.template selfadjointView<Eigen::Lower>().rankUpdate(row);
      Jtr += r * row;
    }
    JtJ = Matrix(JtJ.template selfadjointView<Eigen::Lower>());
    return sum;
  }

  bool Minimise(Vector& q, Matrix& JtJ, double& sum) const {
    Vector Jtr, next_Jtr;
    Matrix next_JtJ;
    sum = Evaluate(q, JtJ, Jtr);
    double lambda = 1e-3;
    for (int iteration = 0; iteration < 40; ++iteration) {
      Matrix damped = JtJ;
      damped.diagonal() *= 1 + lambda;
      const Vector step = damped.ldlt().solve(Jtr);
      const Vector next = q + step;
      const bool plausible = next.allFinite() && shape_.Plausible(next.template head<kGeometry>());
      const double trial = plausible ? Evaluate(next, next_JtJ, next_Jtr) : HUGE_VAL;
      if (trial <= sum) {
        const bool rest = step.template head<2>().norm() < 1e-3 && sum - trial < 1e-4 * sum + 1e-9;
        q = next;
        sum = trial;
        JtJ = next_JtJ;
        Jtr = next_Jtr;
        if (rest) return true;
        lambda = std::max(lambda / 10, 1e-9);
      } else {
        if (step.template head<2>().norm() < 1e-6) return true;
        lambda *= 10;
        if (lambda > 1e8) return false;
      }
    }
    return false;
  }

  Shape shape_;
  std::vector<Sample> samples_;
  double scale_;
};

// A straight edge under Gaussian blur: the covered share at signed distance d, and its derivative.
struct BlurredEdge {
  double share = 0;    // 1 far on the negative side
  double density = 0;  // -d share / d d

  BlurredEdge(double d, double blur) {
    const double z = d / blur;
    if (z > 5) return;
    if (z < -5) {
      share = 1;
      return;
    }
    share = 0.5 * std::erfc(z / std::numbers::sqrt2);
    density = std::exp(-0.5 * z * z) / (blur * std::sqrt(2 * std::numbers::pi));
  }
};

}  // namespace plumbline::internal
