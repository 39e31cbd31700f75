#include "match/internal/field_parts.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "calib/median.h"

namespace plumbline::internal {
namespace {

constexpr double kJumpPx = 0.5;
constexpr double kStillPx = 0.05;  // what interpolation and light leave of no motion at all
constexpr double kMovingPx = 0.5;
constexpr std::size_t kFewPoints = 5;

double SigmaOf(const PlanarField& field, std::int64_t i) {
  const Eigen::Vector3f& cov = field.cov_displacement_px2.data()[i];
  return std::sqrt(std::max(0.0, static_cast<double>(cov[0] + cov[2])));
}

// Whether two neighbours are of one piece.
bool MoveTogether(const PlanarField& field, std::int64_t a, std::int64_t b,
                  const Eigen::Vector2d& from_a_to_b_px) {
  const Eigen::Matrix2d gradient =
      (field.gradient.data()[a] + field.gradient.data()[b]).cast<double>() / 2;
  const Eigen::Vector2d jump =
      field.displacement_px.data()[b] - field.displacement_px.data()[a] - gradient * from_a_to_b_px;
  // No more than as much again for the noise: what is neither here nor there has a large sigma, and
  // would join what it lies between.
  const double noise = 5 * std::hypot(SigmaOf(field, a), SigmaOf(field, b));
  return jump.norm() < kJumpPx + std::min(noise, kJumpPx);
}

FieldPart PartFrom(const PlanarField& field, std::int64_t first, Image<std::uint8_t>& seen) {
  const ImageSize size = field.size();
  const std::array<Eigen::Vector2i, 4> neighbours = {Eigen::Vector2i(1, 0), Eigen::Vector2i(-1, 0),
                                                     Eigen::Vector2i(0, 1), Eigen::Vector2i(0, -1)};
  FieldPart part;
  part.points.push_back(first);
  seen.data()[first] = 1;
  for (std::size_t next = 0; next < part.points.size(); ++next) {
    const std::int64_t from = part.points[next];
    for (const Eigen::Vector2i& by : neighbours) {
      const int c = static_cast<int>(from % size.width) + by.x();
      const int r = static_cast<int>(from / size.width) + by.y();
      if (c < 0 || r < 0 || c >= size.width || r >= size.height) continue;
      const std::int64_t to = static_cast<std::int64_t>(r) * size.width + c;
      if (seen.data()[to] != 0 || field.status.data()[to] != Status::kOk ||
          !MoveTogether(field, from, to, field.step_px * by.cast<double>())) {
        continue;
      }
      seen.data()[to] = 1;
      part.points.push_back(to);
    }
  }
  std::vector<double> motion;
  std::int64_t at_rest = 0;
  for (const std::int64_t i : part.points) {
    motion.push_back(field.displacement_px.data()[i].norm());
    at_rest += motion.back() < kStillPx + 4 * SigmaOf(field, i) ? 1 : 0;
  }
  part.still = at_rest * 10 >= static_cast<std::int64_t>(part.points.size()) * 9;
  part.median_motion_px = Median(std::move(motion));
  return part;
}

}  // namespace

std::vector<FieldPart> PartsOf(const PlanarField& field) {
  Image<std::uint8_t> seen(field.size(), 0);
  std::vector<FieldPart> parts;
  for (std::int64_t i = 0; i < static_cast<std::int64_t>(seen.pixel_count()); ++i) {
    if (seen.data()[i] == 0 && field.status.data()[i] == Status::kOk) {
      parts.push_back(PartFrom(field, i, seen));
    }
  }
  return parts;
}

std::vector<std::size_t> StillBackground(const std::vector<FieldPart>& parts) {
  std::size_t all = 0;
  std::size_t moving = 0;
  for (const FieldPart& part : parts) {
    all += part.points.size();
    if (!part.still && part.median_motion_px > kMovingPx) moving += part.points.size();
  }
  std::vector<std::size_t> background;
  if (moving * 10 < all || moving == 0) return background;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    if (parts[i].still) background.push_back(i);
  }
  return background;
}

std::vector<std::size_t> IsolatedParts(const std::vector<FieldPart>& parts,
                                       const PlanarField& field) {
  const ImageSize size = field.size();
  Image<std::uint8_t> large(size, 0);  // points of parts that are not small
  for (const FieldPart& part : parts) {
    if (part.points.size() < kFewPoints) continue;
    for (const std::int64_t i : part.points) large.data()[i] = 1;
  }
  std::vector<std::size_t> isolated;
  for (std::size_t k = 0; k < parts.size(); ++k) {
    if (parts[k].points.size() >= kFewPoints) continue;
    bool beside = false;
    for (const std::int64_t i : parts[k].points) {
      const int column = static_cast<int>(i % size.width);
      const int row = static_cast<int>(i / size.width);
      for (int r = std::max(0, row - 2); r <= std::min(size.height - 1, row + 2); ++r) {
        for (int c = std::max(0, column - 2); c <= std::min(size.width - 1, column + 2); ++c) {
          beside = beside || large(r, c) != 0;
        }
      }
    }
    if (beside) isolated.push_back(k);
  }
  return isolated;
}

}  // namespace plumbline::internal
