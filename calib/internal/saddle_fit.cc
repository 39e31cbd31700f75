#include "calib/internal/saddle_fit.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/internal/saddle_shape.h"
#include "calib/internal/two_level_fit.h"

namespace plumbline::internal {
namespace {

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
  fit.angle_rad = {result->geometry[SaddleShape::kAngle],
                   result->geometry[SaddleShape::kAngle + 1]};
  fit.dark_between = result->covered[0] < result->bright[0];
  fit.blur_px = result->geometry[SaddleShape::kBlur];
  fit.contrast = std::abs(result->covered[0] - result->bright[0]);
  fit.residual = result->residual;
  if (fit.residual > 0.25 * fit.contrast) return std::nullopt;
  return fit;
}

}  // namespace plumbline::internal
