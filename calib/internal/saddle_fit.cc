#include "calib/internal/saddle_fit.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/internal/two_level_fit.h"

namespace plumbline::internal {
namespace {

// Order of the parameters: position, directions of the edges, blur.
enum : int { kAngle = 2, kBlur = 4 };

struct SaddleShape {
  static constexpr int kParameters = 5;
  using Parameters = Eigen::Matrix<double, kParameters, 1>;

  Eigen::Vector2d start_angles;
  double radius_px = 0;

  // Covered: the quadrant between edge 0 and edge 1, and the one opposite.
  static double Share(const Parameters& q, const Eigen::Vector2d& p, Parameters& slope) {
    const Eigen::Vector2d offset = p - q.head<2>();
    double side[2], density[2], d[2];
    Eigen::Vector2d normal[2];
    for (int k = 0; k < 2; ++k) {
      const double angle = q[kAngle + k];
      // Turned so that the point between the directions is on the positive side of both edges.
      const double turn = k == 0 ? 1 : -1;
      normal[k] = turn * Eigen::Vector2d(-std::sin(angle), std::cos(angle));
      d[k] = normal[k].dot(offset);
      const BlurredEdge edge(d[k], q[kBlur]);
      side[k] = 1 - 2 * edge.share;
      density[k] = 2 * edge.density;
    }
    slope.setZero();
    for (int k = 0; k < 2; ++k) {
      if (density[k] == 0) continue;
      const double by_d = 0.5 * side[1 - k] * density[k];
      const double turn = k == 0 ? 1 : -1, angle = q[kAngle + k];
      slope.head<2>() -= by_d * normal[k];
      slope[kAngle + k] =
          -by_d * turn * Eigen::Vector2d(std::cos(angle), std::sin(angle)).dot(offset);
      slope[kBlur] -= by_d * d[k] / q[kBlur];
    }
    return 0.5 * (1 + side[0] * side[1]);
  }

  bool Plausible(const Parameters& q) const {
    return q.head<2>().norm() < 0.5 * radius_px && q[kBlur] > 0.05 && q[kBlur] < radius_px &&
           std::abs(q[kAngle] - start_angles[0]) < 0.5 &&
           std::abs(q[kAngle + 1] - start_angles[1]) < 0.5;
  }
};

using Solver = TwoLevelFit<SaddleShape>;

std::vector<Solver::Sample> Collect(const GrayImage& image, const Eigen::Vector2d& start,
                                    double radius) {
  const int x0 = static_cast<int>(std::ceil(start.x() - radius));
  const int x1 = static_cast<int>(std::floor(start.x() + radius));
  const int y0 = static_cast<int>(std::ceil(start.y() - radius));
  const int y1 = static_cast<int>(std::floor(start.y() + radius));
  std::vector<Solver::Sample> samples;
  std::size_t outside = 0;
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const Eigen::Vector2d p = Eigen::Vector2d(x, y) - start;
      if (p.norm() > radius) continue;
      if (x < 0 || y < 0 || x >= image.width() || y >= image.height()) {
        ++outside;
      } else {
        samples.push_back({p, static_cast<double>(image.grey(y, x))});
      }
    }
  }
  if (3 * outside > samples.size()) return {};
  return samples;
}

}  // namespace

std::optional<SaddleFit> FitSaddle(const GrayImage& image, const Eigen::Vector2d& start,
                                   const Eigen::Vector2d& direction0,
                                   const Eigen::Vector2d& direction1, double radius_px) {
  auto samples = Collect(image, start, radius_px);
  if (samples.empty()) return std::nullopt;
  Eigen::Vector2d angles(std::atan2(direction0.y(), direction0.x()),
                         std::atan2(direction1.y(), direction1.x()));
  while (angles[1] < angles[0]) angles[1] += 2 * std::numbers::pi;
  SaddleShape::Parameters q;
  q << 0, 0, angles, std::clamp(0.1 * radius_px, 0.5, 1.2);
  // Levels: means weighted by the share of the start.
  double between = 0, weight_between = 0, beside = 0, weight_beside = 0;
  SaddleShape::Parameters unused;
  for (const auto& s : samples) {
    const double share = SaddleShape::Share(q, s.p, unused);
    between += share * s.grey;
    weight_between += share;
    beside += (1 - share) * s.grey;
    weight_beside += 1 - share;
  }
  if (weight_between < 1 || weight_beside < 1) return std::nullopt;
  Solver solver({angles, radius_px}, std::move(samples), radius_px);
  const auto result = solver.Run(q, beside / weight_beside, between / weight_between);
  if (!result) return std::nullopt;
  SaddleFit fit;
  fit.pixel = start + result->geometry.head<2>();
  fit.cov_px2 = result->cov_position;
  fit.angle_rad = {result->geometry[kAngle], result->geometry[kAngle + 1]};
  fit.dark_between = result->covered[0] < result->bright[0];
  fit.blur_px = result->geometry[kBlur];
  fit.contrast = std::abs(result->covered[0] - result->bright[0]);
  fit.residual = result->residual;
  if (fit.residual > 0.25 * fit.contrast) return std::nullopt;
  return fit;
}

}  // namespace plumbline::internal
