#include "track/right_drift.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <memory>
#include <vector>

#include "calib/parallel.h"
#include "track/internal/finite_differences.h"
#include "track/internal/grid_cell.h"
#include "track/internal/material_lookup.h"

namespace plumbline {
namespace {

constexpr double kFollowed_mm = 45;  // of the ground's way, beyond which a drift tells nothing
const Eigen::Vector2d kUnknown =
    Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());

// What a frame shows of the surface under the rig, on RollingWheel::grid.
class Shown {
 public:
  Shown(const WheelReference& wheel, const RollingWheel& rolling, const RollingFrame& frame)
      : time_s(frame.time_s),
        angle_rad(frame.angle_rad),
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
      radius_mm = std::max(radius_mm, place(p.at.y(), p.at.x()).z());
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

  const double time_s, angle_rad;
  double radius_mm = 0;          // the largest
  Image<Eigen::Vector3d> place;  // of the undeformed wheel: angle under the rig, y, radius

 private:
  Image<Eigen::Vector2d> right_px_;  // less that of the undeformed surface there
  std::unique_ptr<internal::MaterialLookup> lookup_;
};

// The slope of the parabola through three moments at that of `now`, or of the line through two of
// them; NaN where no two show the place.
Eigen::Vector2d DriftAt(const Eigen::Vector3d& where, const std::array<const Shown*, 3>& shown,
                        const Shown& now) {
  std::vector<double> times;
  std::vector<Eigen::Vector2d> right_px;
  std::size_t at = 0;
  for (const Shown* one : shown) {
    if (one == nullptr) continue;
    const Eigen::Vector2d px = one->At(where);
    if (!px.allFinite()) {
      if (one == &now) return kUnknown;
      continue;
    }
    if (one == &now) at = times.size();
    times.push_back(one->time_s);
    right_px.push_back(px);
  }
  if (times.size() < 2) return kUnknown;
  const std::vector<double> weights = internal::SlopeWeights(times, at);
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();
  for (std::size_t k = 0; k < weights.size(); ++k) slope += weights[k] * right_px[k];
  return slope;
}

// How much of the drift may be left out. at: of `shown`, the frame itself.
double LeftOutOf(const std::deque<Shown>& shown, std::size_t at) {
  double turns_rad = 0;
  for (const Shown& one : shown) turns_rad += std::abs(one.angle_rad - shown[at].angle_rad);
  const double way_mm = turns_rad * shown[at].radius_mm / static_cast<double>(shown.size() - 1);
  return std::min(1.0, way_mm / kFollowed_mm);
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

// shown: two or three frames in a row, `now` one of them.
Image<Eigen::Vector2d> DriftOf(const std::array<const Shown*, 3>& shown, const Shown& now) {
  Image<Eigen::Vector2d> drift(now.place.size(), kUnknown);
  ForEachIndex(drift.pixel_count(), [&](std::size_t i) {
    const Eigen::Vector3d& where = now.place.data()[i];
    if (where.allFinite()) drift.data()[i] = DriftAt(where, shown, now);
  });
  const bool any = std::any_of(drift.values().begin(), drift.values().end(),
                               [](const Eigen::Vector2d& d) { return d.allFinite(); });
  if (!any) return {};
  GoOn(&drift);
  return drift;
}

// The drift of a frame at finer points (px/s); 0 where none is known.
Image<Eigen::Vector2d> DriftOn(const RollingWheel& rolling, std::size_t frame,
                               const PlanarField& grid) {
  const Image<Eigen::Vector2d>& drift = rolling.frames[frame].right_drift_px_s;
  Image<Eigen::Vector2d> on(grid.size(), Eigen::Vector2d::Zero());
  if (drift.width() < 2 || drift.height() < 2) return on;
  for (int r = 0; r < on.height(); ++r) {
    for (int c = 0; c < on.width(); ++c) {
      auto cell = internal::GridCell::Of(grid.PixelOf(r, c), rolling.first_px, rolling.spacing_px,
                                         drift.size());
      cell.along = std::clamp(cell.along, 0.0, 1.0);
      cell.down = std::clamp(cell.down, 0.0, 1.0);
      on(r, c) = cell.Between(drift);
    }
  }
  return on;
}

}  // namespace

void FindRightDrift(const WheelReference& wheel, RollingWheel* rolling) {
  std::vector<RollingFrame*> placed;
  for (RollingFrame& frame : rolling->frames) {
    frame.right_drift_px_s = {};
    frame.right_drift_left_out = 0;
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
    std::array<const Shown*, 3> together{};
    for (std::size_t k = 0; k < shown.size(); ++k) together[k] = &shown[k];
    placed[f]->right_drift_px_s = DriftOf(together, shown[f - first]);
    if (!placed[f]->right_drift_px_s.empty()) {
      placed[f]->right_drift_left_out = LeftOutOf(shown, f - first);
    }
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
  Image<Eigen::Vector2d> velocity = DriftOn(rolling, frame, grid);
  for (std::size_t i = 0; i < velocity.pixel_count(); ++i) {
    velocity.data()[i] += rolling.frames[frame].speed_rad_s * flow_px.data()[i];
  }
  return velocity;
}

Eigen::Vector2d RightDriftLeftOutAt(const RollingFrame& frame, std::size_t place) {
  if (frame.right_drift_px_s.empty()) return Eigen::Vector2d::Zero();
  return frame.right_drift_left_out * frame.right_drift_px_s.data()[place];
}

Image<Eigen::Vector2d> RightDriftLeftOut(const RollingWheel& rolling, std::size_t frame,
                                         const PlanarField& grid) {
  if (rolling.frames[frame].right_drift_px_s.empty()) return {};
  Image<Eigen::Vector2d> left_out = DriftOn(rolling, frame, grid);
  const double by = rolling.frames[frame].right_drift_left_out * rolling.right_delay.value_s;
  for (Eigen::Vector2d& px : left_out.values()) px *= by;
  return left_out;
}

}  // namespace plumbline
