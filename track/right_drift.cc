#include "track/right_drift.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <memory>
#include <vector>

#include "calib/parallel.h"
#include "track/internal/grid_cell.h"
#include "track/internal/material_lookup.h"

namespace plumbline {
namespace {

const Eigen::Vector2d kUnknown =
    Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());

// What a frame shows of the surface under the rig, on RollingWheel::grid.
class Shown {
 public:
  Shown(const WheelReference& wheel, const RollingWheel& rolling, const RollingFrame& frame)
      : time_s(frame.time_s),
        place(rolling.grid, Eigen::Vector3d::Constant(kUnknown.x())),
        right_px_(rolling.grid, kUnknown) {
    const Rigid3 right_from_wheel =
        wheel.rig.right_from_left * wheel.axis.RigFromWheel(frame.angle_rad);
    for (const RollingPoint& p : frame.points) {
      place(p.at.y(), p.at.x()) = {MaterialAngle(p.undeformed_mm) - frame.angle_rad,
                                   p.undeformed_mm.y(),
                                   std::hypot(p.undeformed_mm.x(), p.undeformed_mm.z())};
      right_px_(p.at.y(), p.at.x()) =
          p.right_px - wheel.rig.right.Project(right_from_wheel * p.undeformed_mm);
    }
    lookup_ = std::make_unique<internal::MaterialLookup>(place, place, 0);
  }
  Shown(const Shown&) = delete;  // the lookup refers to `place`
  Shown& operator=(const Shown&) = delete;

  // NaN where its points do not surround the place.
  Eigen::Vector2d At(const Eigen::Vector3d& where) const {
    const auto shares = lookup_->SharesAt(where);
    if (shares.empty()) return kUnknown;
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (const auto& [i, share] : shares) sum += share * right_px_.data()[i];
    return sum;
  }

  const double time_s;
  Image<Eigen::Vector3d> place;  // of the undeformed wheel: angle under the rig, y, radius

 private:
  Image<Eigen::Vector2d> right_px_;  // less that of the undeformed surface there
  std::unique_ptr<internal::MaterialLookup> lookup_;
};

// The slope of the parabola through three moments at that of `now`, or of the line through two.
Eigen::Vector2d DriftAt(const Eigen::Vector3d& where, const Shown& now,
                        const std::array<const Shown*, 2>& beside) {
  const Eigen::Vector2d here = now.At(where);
  std::array<Eigen::Vector2d, 2> slope = {kUnknown, kUnknown};
  std::array<double, 2> until_s{};
  for (std::size_t k = 0; k < 2; ++k) {
    if (beside[k] == nullptr) continue;
    until_s[k] = beside[k]->time_s - now.time_s;
    slope[k] = (beside[k]->At(where) - here) / until_s[k];
  }
  if (!slope[0].allFinite()) return slope[1];
  if (!slope[1].allFinite()) return slope[0];
  return (until_s[1] * slope[0] - until_s[0] * slope[1]) / (until_s[1] - until_s[0]);
}

// Unknown values become the mean of those beside them, from the rim on outwards.
void GoOn(Image<Eigen::Vector2d>* values) {
  for (bool more = true; more;) {
    more = false;
    const Image<Eigen::Vector2d> before = *values;
    for (int r = 0; r < before.height(); ++r) {
      for (int c = 0; c < before.width(); ++c) {
        if (before(r, c).allFinite()) continue;
        Eigen::Vector2d sum = Eigen::Vector2d::Zero();
        int count = 0;
        for (const auto& [down, along] :
             std::array<std::array<int, 2>, 4>{{{-1, 0}, {1, 0}, {0, -1}, {0, 1}}}) {
          const int row = r + down, column = c + along;
          if (row < 0 || column < 0 || row >= before.height() || column >= before.width() ||
              !before(row, column).allFinite()) {
            continue;
          }
          sum += before(row, column);
          ++count;
        }
        if (count == 0) continue;
        (*values)(r, c) = sum / count;
        more = true;
      }
    }
  }
}

Image<Eigen::Vector2d> DriftOf(const Shown& now, const std::array<const Shown*, 2>& beside) {
  Image<Eigen::Vector2d> drift(now.place.size(), kUnknown);
  ForEachIndex(drift.pixel_count(), [&](std::size_t i) {
    const Eigen::Vector3d& where = now.place.data()[i];
    if (where.allFinite()) drift.data()[i] = DriftAt(where, now, beside);
  });
  const bool any = std::any_of(drift.values().begin(), drift.values().end(),
                               [](const Eigen::Vector2d& d) { return d.allFinite(); });
  if (!any) return {};
  GoOn(&drift);
  return drift;
}

}  // namespace

void FindRightDrift(const WheelReference& wheel, RollingWheel* rolling) {
  std::vector<RollingFrame*> placed;
  for (RollingFrame& frame : rolling->frames) {
    frame.right_drift_px_s = {};
    if (frame.status == RollingFrameStatus::kPlaced && std::isfinite(frame.time_s)) {
      placed.push_back(&frame);
    }
  }
  // The frames from `first` on that are looked at together: one to three.
  std::deque<Shown> shown;
  std::size_t first = 0;
  for (std::size_t f = 0; f < placed.size(); ++f) {
    // One on either side, or at an end both on one.
    const std::size_t from =
        std::min(std::max<std::size_t>(f, 1) - 1, std::max<std::size_t>(placed.size(), 3) - 3);
    for (; first < from; ++first) shown.pop_front();
    while (shown.size() < 3 && first + shown.size() < placed.size()) {
      shown.emplace_back(wheel, *rolling, *placed[first + shown.size()]);
    }
    std::array<const Shown*, 2> beside{};
    for (std::size_t k = 0, found = 0; k < shown.size(); ++k) {
      if (first + k != f) beside[found++] = &shown[k];
    }
    placed[f]->right_drift_px_s = DriftOf(shown[f - first], beside);
  }
}

Eigen::Vector2d RightVelocityAt(const RollingFrame& frame, std::size_t place,
                                const Eigen::Vector2d& flow_px) {
  Eigen::Vector2d velocity = frame.speed_rad_s * flow_px;
  if (!frame.right_drift_px_s.empty()) velocity += frame.right_drift_px_s.data()[place];
  return velocity;
}

Eigen::Vector2d RightVelocityOf(const RollingFrame& frame, const RollingPoint& point) {
  return RightVelocityAt(
      frame, static_cast<std::size_t>(point.at.y() * frame.right_drift_px_s.width() + point.at.x()),
      point.right_flow_px);
}

Image<Eigen::Vector2d> RightVelocity(const RollingWheel& rolling, std::size_t frame,
                                     const Image<Eigen::Vector2d>& flow_px,
                                     const PlanarField& grid) {
  const RollingFrame& now = rolling.frames[frame];
  const Image<Eigen::Vector2d>& drift = now.right_drift_px_s;
  Image<Eigen::Vector2d> velocity = flow_px;
  for (int r = 0; r < velocity.height(); ++r) {
    for (int c = 0; c < velocity.width(); ++c) {
      velocity(r, c) *= now.speed_rad_s;
      if (drift.width() < 2 || drift.height() < 2) continue;
      auto cell = internal::GridCell::Of(grid.PixelOf(r, c), rolling.first_px, rolling.spacing_px,
                                         drift.size());
      cell.along = std::clamp(cell.along, 0.0, 1.0);
      cell.down = std::clamp(cell.down, 0.0, 1.0);
      velocity(r, c) += cell.Between(drift);
    }
  }
  return velocity;
}

}  // namespace plumbline
