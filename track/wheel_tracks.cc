#include "track/wheel_tracks.h"

#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "track/internal/view_match.h"

namespace plumbline {
namespace {

// What to look for in a frame.
struct Task {
  std::size_t view;
  internal::ExpectedPoint point;
};

}  // namespace

struct WheelTracks::Impl {
  Impl(const StereoRig& r, WheelChain c, const WheelChainOptions& o, const Image<std::uint8_t>& m);

  std::vector<Task> TasksOf(int frame);
  void Observe(int frame, const std::vector<Task>& tasks, const std::vector<SubsetMatch>& matches);
  int NumberOf(const Task& task) const {
    return first_point[task.view] +
           task.point.row * chain.views[task.view].point_in_rig_mm.width() + task.point.column;
  }

  StereoRig rig;
  WheelChain chain;
  WheelChainOptions options;
  Image<std::uint8_t> mask;
  std::vector<int> first_point;
  std::map<std::size_t, internal::ViewMatcher> matchers;  // of the views that the last frame saw
  WheelProblem problem;
};

WheelTracks::Impl::Impl(const StereoRig& r, WheelChain c, const WheelChainOptions& o,
                        const Image<std::uint8_t>& m)
    : rig(r), chain(std::move(c)), options(o), mask(m) {
  problem.axis = chain.axis;
  problem.angles_rad = chain.angles_rad;
  for (double& angle : problem.angles_rad) {
    if (!std::isfinite(angle)) angle = 0;  // no observation will name it
  }
  for (const WheelView& view : chain.views) {
    first_point.push_back(static_cast<int>(problem.points_mm.size()));
    const Rigid3 wheel_from_rig = chain.axis.RigFromWheel(view.angle_rad).Inverse();
    for (const Eigen::Vector3d& p : view.point_in_rig_mm.values()) {
      problem.points_mm.push_back(wheel_from_rig * p);
    }
  }
}

// Prepares the views of which the frame should show something, and forgets the others.
std::vector<Task> WheelTracks::Impl::TasksOf(int frame) {
  // Of a wheel seen from inside, the half that lies before the cameras.
  constexpr double kMost_rad = std::numbers::pi / 2;
  const double room_px = options.matching.field.correlator.radius_px();
  std::vector<Task> tasks;
  const double angle = chain.angles_rad[static_cast<std::size_t>(frame)];
  for (std::size_t v = 0; v < chain.views.size(); ++v) {
    const WheelView& view = chain.views[v];
    const std::size_t before = tasks.size();
    if (std::abs(std::remainder(angle - view.angle_rad, 2 * std::numbers::pi)) < kMost_rad) {
      const Rigid3 motion =
          chain.axis.RigFromWheel(angle) * chain.axis.RigFromWheel(view.angle_rad).Inverse();
      for (const bool right : {false, true}) {
        for (const internal::ExpectedPoint& point :
             internal::ExpectPoints(rig, view, motion, right, room_px)) {
          tasks.push_back({v, point});
        }
      }
    }
    if (tasks.size() == before) {
      matchers.erase(v);
    } else {
      matchers.try_emplace(v, rig, view, options.matching, mask);
    }
  }
  return tasks;
}

void WheelTracks::Impl::Observe(int frame, const std::vector<Task>& tasks,
                                const std::vector<SubsetMatch>& matches) {
  for (std::size_t n = 0; n < tasks.size(); ++n) {
    const Task& task = tasks[n];
    const SubsetMatch& match = matches[n];
    const WheelView& view = chain.views[task.view];
    const bool own = view.frame == frame;
    if (match.status != Status::kOk || (own && !task.point.right)) continue;
    const int point = NumberOf(task);
    const Eigen::Vector2d pixel = view.PixelOf(task.point.row, task.point.column).cast<double>();
    const Eigen::Matrix2d& cov = match.cov_displacement_px2;
    problem.observations.push_back({frame, point, task.point.right,
                                    pixel + match.warp.displacement_px(),
                                    (1 - match.reference_share) * cov});
    if (!own) continue;
    const Eigen::Matrix2d back = (Eigen::Matrix2d::Identity() + match.warp.gradient()).inverse();
    problem.observations.push_back(
        {frame, point, false, pixel, match.reference_share * back * cov * back.transpose()});
  }
}

WheelTracks::WheelTracks(const StereoRig& rig, WheelChain chain, const WheelChainOptions& options,
                         const Image<std::uint8_t>& mask)
    : impl_(std::make_unique<Impl>(rig, std::move(chain), options, mask)) {}

WheelTracks::~WheelTracks() = default;

const WheelChain& WheelTracks::chain() const { return impl_->chain; }
int WheelTracks::FirstPoint(std::size_t view) const { return impl_->first_point[view]; }

WheelFrameMatches WheelTracks::Add(int frame, const GrayImage& left, const GrayImage& right) {
  Impl& impl = *impl_;
  WheelFrameMatches out;
  if (!std::isfinite(impl.chain.angles_rad[static_cast<std::size_t>(frame)])) return out;
  const std::vector<Task> tasks = impl.TasksOf(frame);
  const internal::PreparedPair pair(left, right, impl.options.matching.field.image);
  std::vector<SubsetMatch> matches(tasks.size());
  tbb::parallel_for(std::size_t{0}, tasks.size(), [&](std::size_t n) {
    matches[n] = impl.matchers.at(tasks[n].view).Match(pair, tasks[n].point);
  });
  out.looked_for = static_cast<int>(tasks.size());
  out.found = static_cast<int>(std::count_if(
      matches.begin(), matches.end(), [](const auto& m) { return m.status == Status::kOk; }));
  out.placed = out.found >= 2 * impl.options.least_points &&
               out.found > impl.options.least_share * out.looked_for;
  if (out.placed) impl.Observe(frame, tasks, matches);
  return out;
}

WheelProblem WheelTracks::Problem() const {
  // Two rays make a point, four and more check each other.
  constexpr int kLeast = 4;
  WheelProblem out = impl_->problem;
  std::vector<int> seen(out.points_mm.size(), 0);
  for (const WheelObservation& o : out.observations) ++seen[static_cast<std::size_t>(o.point)];
  std::erase_if(out.observations, [&](const WheelObservation& o) {
    return seen[static_cast<std::size_t>(o.point)] < kLeast;
  });
  return out;
}

}  // namespace plumbline
