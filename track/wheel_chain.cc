#include "track/wheel_chain.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <numbers>
#include <string>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/triangulate.h"
#include "track/internal/view_match.h"
#include "track/surface_state.h"

namespace plumbline {
namespace {

using internal::PreparedPair;
using internal::ViewMatcher;

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// The rigid motion of points seen twice.
struct PlacedBy {
  Rigid3 motion;  // later = motion * earlier, in the rig
  int points = 0;
};

// Least squares with points beyond three times the median distance left out.
std::optional<PlacedBy> RobustMotion(const Image<Eigen::Vector3d>& before,
                                     const Image<Eigen::Vector3d>& after, int least_points) {
  std::vector<std::size_t> kept;
  for (std::size_t i = 0; i < before.pixel_count(); ++i) {
    if (before.data()[i].allFinite() && after.data()[i].allFinite()) kept.push_back(i);
  }
  PlacedBy placed;
  constexpr int kRounds = 4;
  for (int round = 0; round < kRounds; ++round) {
    if (kept.size() < static_cast<std::size_t>(std::max(3, least_points))) return std::nullopt;
    Eigen::Matrix3Xd a(3, kept.size()), b(3, kept.size());
    for (std::size_t n = 0; n < kept.size(); ++n) {
      a.col(static_cast<Eigen::Index>(n)) = before.data()[kept[n]];
      b.col(static_cast<Eigen::Index>(n)) = after.data()[kept[n]];
    }
    const Eigen::Matrix4d fitted = Eigen::umeyama(a, b, false);
    placed.motion = {fitted.topLeftCorner<3, 3>(), fitted.topRightCorner<3, 1>()};
    placed.points = static_cast<int>(kept.size());
    const auto off = [&](std::size_t i) {
      return (placed.motion * before.data()[i] - after.data()[i]).norm();
    };
    std::vector<double> distances;
    for (const std::size_t i : kept) distances.push_back(off(i));
    const double limit = 3 * Median(std::move(distances)) + 1e-6;
    std::erase_if(kept, [&](std::size_t i) { return off(i) > limit; });
  }
  return placed;
}

int CountOf(const Image<Eigen::Vector3d>& points) {
  int count = 0;
  for (const Eigen::Vector3d& p : points.values()) count += p.allFinite() ? 1 : 0;
  return count;
}

Image<Eigen::Vector3d> PointsOf(const StereoRig& rig, const StereoField& reference,
                                const StereoField& field) {
  return TriangulateField(rig, field, UnitCovariance(reference, field)).instant.point_mm;
}

void CheckRig(const StereoSeeds& seeds, double max_epipolar_px) {
  if (!seeds.ContradictRig()) return;
  throw InputError(fmt::format(
      "Of {} places found in both images of a pair, {} lie more than {:g} px from their epipolar "
      "lines and {} would lie behind the cameras: the rig file is that of other cameras, the "
      "cameras have moved since it was made (calibrate again), or left and right are swapped.",
      seeds.found, seeds.off_epipolar, max_epipolar_px, seeds.behind_camera));
}

}  // namespace

void WheelChainOptions::Check() const {
  matching.Check();
  if (matching.field.step_px < matching.field.correlator.subset_px) {
    throw UsageError(fmt::format(
        "The points of a wheel lie at least a subset apart, so that they share no noise: a step of "
        "{} px is less than the subset's {}.",
        matching.field.step_px, matching.field.correlator.subset_px));
  }
  if (!(least_seen_share > 0.2 && least_seen_share < 1)) {
    throw UsageError(fmt::format(
        "A new view of the wheel begins where a share between 0.2 and 1 of the last is seen; {} is "
        "not.",
        least_seen_share));
  }
  if (least_points < 6 || !(least_share >= 0 && least_share < least_seen_share)) {
    throw UsageError(
        "A frame is placed by 6 points or more, and a smaller share than begins a new view.");
  }
}

double WheelChain::largest_angle_rad() const {
  double largest = 0;
  for (const double angle : angles_rad) {
    if (angle > largest) largest = angle;
  }
  return largest;
}

struct WheelChainBuilder::Impl {
  Impl(const StereoRig& r, const WheelChainOptions& o, const Image<std::uint8_t>& m)
      : rig(r), options(o), mask(m) {}

  bool Begin(const GrayImage& left, const GrayImage& right);
  bool StartSequence(const GrayImage& left, const GrayImage& right);
  void LookFrom(const WheelView& view);
  void BeginView(int frame, const GrayImage& left, const GrayImage& right,
                 const PreparedPair& pair);
  std::optional<PlacedBy> FindAnew(const GrayImage& left, const GrayImage& right);
  std::optional<PlacedBy> FindTurned(const ViewMatcher& view, const PreparedPair& pair,
                                     double turn_rad, double near_rad, double far_rad,
                                     int least_points) const;
  void TryToClose(int frame, const PreparedPair& pair);
  int LeastPoints() const {
    return std::max(options.least_points, static_cast<int>(options.least_share * last_inner));
  }
  Rigid3 TurnBy(double angle_rad) const {
    return axis->RigFromWheel(angle_rad) * axis->RigFromWheel(0).Inverse();
  }
  void Estimate();

  // Where a frame was seen: view and motion since then.
  struct Sighting {
    std::size_t view = 0;
    std::optional<PlacedBy> placed;
  };

  StereoRig rig;
  WheelChainOptions options;
  Image<std::uint8_t> mask;
  std::string problem;  // of the last pair that could not be matched
  std::deque<WheelView> views;
  std::vector<Sighting> frames;
  // Until the axis is known, frames are found by seeds.
  std::unique_ptr<StereoSequence> sequence;
  std::unique_ptr<ViewMatcher> last, first;
  int last_count = 0;  // points of the last view
  int last_inner = 0;  // of them, those that frames can be placed by
  // The frame that showed the first view again, and its motion since then.
  std::optional<std::pair<int, PlacedBy>> closing;
  std::optional<WheelAxis> axis;
  std::vector<double> angles;
};

void WheelChainBuilder::Impl::LookFrom(const WheelView& view) {
  last = std::make_unique<ViewMatcher>(rig, view, options.matching, mask);
  last_inner =
      static_cast<int>(std::min(last->Expect({}, false).size(), last->Expect({}, true).size()));
}

// The view of the first pair. False, with `problem`, where it cannot be matched.
bool WheelChainBuilder::Impl::StartSequence(const GrayImage& left, const GrayImage& right) {
  try {
    StereoSequenceOptions second = options.matching;
    second.field.correlator.order = 2;  // the bend between the cameras' views is not known yet
    sequence = std::make_unique<StereoSequence>(rig, left, right, second, mask);
  } catch (const InputError& error) {
    problem = error.what();
    return false;
  }
  CheckRig(sequence->reference_seeds(), options.matching.seeds.max_epipolar_px);
  return true;
}

bool WheelChainBuilder::Impl::Begin(const GrayImage& left, const GrayImage& right) {
  const auto frame = static_cast<int>(frames.size());
  frames.emplace_back();
  if (!StartSequence(left, right)) return false;
  const Image<Eigen::Vector3d> points = PointsOf(rig, sequence->reference(), sequence->reference());
  last_count = CountOf(points);
  if (last_count < options.least_points) {
    problem = fmt::format("only {} points were found in both images of a pair", last_count);
    return false;
  }
  const SubsetGrid grid = sequence->correlator().grid();
  views.push_back({frame, 0, left, right, grid.first_px, grid.step_px, points});
  LookFrom(views.back());
  frames.back() = {0, PlacedBy{{}, last_count}};
  return true;
}

// A frame becomes the next view, where its surface is found as well as the last one was: a blurred
// frame is nothing to match others with.
void WheelChainBuilder::Impl::BeginView(int frame, const GrayImage& left, const GrayImage& right,
                                        const PreparedPair& pair) {
  constexpr double kAsGood = 0.7;
  const Image<Eigen::Vector3d> points =
      internal::SurfaceLike(rig, views.back(), left, pair, options.matching, mask);
  const int count = CountOf(points);
  if (count < kAsGood * last_count) return;
  views.push_back({frame, 0, left, right, views.back().first_px, views.back().step_px, points});
  last_count = count;
  LookFrom(views.back());
}

// By seeds, whatever the motion.
std::optional<PlacedBy> WheelChainBuilder::Impl::FindAnew(const GrayImage& left,
                                                          const GrayImage& right) {
  const StereoField found = sequence->Add(left, right, 0);
  return RobustMotion(views.back().point_in_rig_mm, PointsOf(rig, sequence->reference(), found),
                      LeastPoints());
}

// By turning the view about the axis: first near the expected turn, then farther around it.
std::optional<PlacedBy> WheelChainBuilder::Impl::FindTurned(const ViewMatcher& view,
                                                            const PreparedPair& pair,
                                                            double turn_rad, double near_rad,
                                                            double far_rad,
                                                            int least_points) const {
  // A pixel and a half, where the surface is nearest: speckles that are not finer overlap.
  constexpr double kStep_px = 1.5, kGood = 0.7, kFair = 0.4;
  double farthest_mm = 0, nearest_mm = std::numeric_limits<double>::infinity();
  for (const Eigen::Vector3d& p : view.view().point_in_rig_mm.values()) {
    if (!p.allFinite()) continue;
    const Eigen::Vector3d from_axis = p - axis->origin_in_rig_mm();
    farthest_mm = std::max(farthest_mm, from_axis.cross(axis->direction_in_rig()).norm());
    nearest_mm = std::min(nearest_mm, p.z());
  }
  const double step = kStep_px * nearest_mm / (rig.left.parameters()[0] * farthest_mm);
  double best = turn_rad, score = -1;
  for (const double reach : {near_rad, far_rad}) {
    const auto count = static_cast<int>(std::ceil(reach / step));
    std::vector<double> scores(static_cast<std::size_t>(2 * count + 1));
    tbb::parallel_for(std::size_t{0}, scores.size(), [&](std::size_t n) {
      scores[n] = view.Score(pair, TurnBy(turn_rad + (static_cast<double>(n) - count) * step));
    });
    const auto top = std::max_element(scores.begin(), scores.end());
    score = *top;
    best = turn_rad + static_cast<double>(top - scores.begin() - count) * step;
    if (score > kGood) break;
  }
  if (score < kFair) return std::nullopt;
  std::vector<internal::ExpectedPoint> expected = view.Expect(TurnBy(best), false);
  const std::size_t lefts = expected.size();
  const auto rights = view.Expect(TurnBy(best), true);
  expected.insert(expected.end(), rights.begin(), rights.end());
  Image<Eigen::Vector2d> places[2];
  const ImageSize size = view.view().point_in_rig_mm.size();
  for (auto& p : places) p = Image<Eigen::Vector2d>(size, Eigen::Vector2d::Constant(kNone));
  tbb::parallel_for(std::size_t{0}, expected.size(), [&](std::size_t n) {
    const internal::ExpectedPoint& e = expected[n];
    const SubsetMatch match = view.Match(pair, e);
    if (match.status != Status::kOk) return;
    places[n < lefts ? 0 : 1](e.row, e.column) =
        view.view().PixelOf(e.row, e.column).cast<double>() + match.warp.displacement_px();
  });
  Image<Eigen::Vector3d> now(size, Eigen::Vector3d::Zero());
  now.values() = TriangulatePoints(rig, places[0].values(), places[1].values());
  return RobustMotion(view.view().point_in_rig_mm, now, least_points);
}

// All motions so far share one axis; the angles follow.
void WheelChainBuilder::Impl::Estimate() {
  constexpr double kClear_rad = 0.05;
  std::vector<Rigid3> turns;
  double largest = 0;
  for (const Sighting& s : frames) {
    if (!s.placed) continue;
    turns.push_back(s.placed->motion);
    largest = std::max(largest, s.placed->motion.RotationVector().norm());
  }
  if (largest < kClear_rad) return;
  axis = AxisOfTurns(turns);
  angles.assign(frames.size(), kNone);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    const Sighting& s = frames[f];
    if (!s.placed) continue;
    const auto from = static_cast<std::size_t>(views[s.view].frame);
    // The view's own frame was placed from the one before.
    const double begin = from == f ? 0 : angles[from];
    angles[f] = begin + AngleAbout(*axis, s.placed->motion);
  }
}

void WheelChainBuilder::Impl::TryToClose(int frame, const PreparedPair& pair) {
  constexpr double kSeen_rad = 0.35, kMisclosure_rad = 0.04;
  if (closing || views.size() < 3 || !axis) return;
  const double left_rad = angles[static_cast<std::size_t>(frame)] - kTurn_rad;
  if (!(std::abs(left_rad) < kSeen_rad)) return;
  if (first == nullptr) {
    first = std::make_unique<ViewMatcher>(rig, views.front(), options.matching, mask);
  }
  const int least = static_cast<int>(first->Expect({}, false).size()) / 3;
  const auto placed =
      FindTurned(*first, pair, left_rad, kMisclosure_rad / 8, kMisclosure_rad, least);
  if (placed) closing = {frame, *placed};
}

WheelChainBuilder::WheelChainBuilder(const StereoRig& rig, const WheelChainOptions& options,
                                     const Image<std::uint8_t>& mask) {
  options.Check();
  impl_ = std::make_unique<Impl>(rig, options, mask);
}

WheelChainBuilder::~WheelChainBuilder() = default;

bool WheelChainBuilder::Add(const GrayImage& left, const GrayImage& right) {
  Impl& impl = *impl_;
  if (impl.views.empty()) return impl.Begin(left, right);
  const auto frame = static_cast<int>(impl.frames.size());
  const PreparedPair pair(left, right, impl.options.matching.field.image);
  std::optional<PlacedBy> placed;
  if (impl.axis) {
    // From where the wheel was last, at the speed that it had.
    double before = kNone, angle = kNone;
    for (const double a : impl.angles) {
      if (!std::isfinite(a)) continue;
      before = std::isfinite(angle) ? angle : a;
      angle = a;
    }
    constexpr double kNear_rad = 0.01, kFar_rad = 0.4;
    const double since_view =
        angle - impl.angles[static_cast<std::size_t>(impl.views.back().frame)];
    placed = impl.FindTurned(*impl.last, pair, since_view + angle - before, kNear_rad, kFar_rad,
                             impl.LeastPoints());
  } else {
    placed = impl.FindAnew(left, right);
  }
  impl.frames.push_back({impl.views.size() - 1, placed});
  if (!placed) return false;
  impl.Estimate();
  impl.TryToClose(frame, pair);
  if (impl.axis && placed->points < impl.options.least_seen_share * impl.last_inner) {
    impl.BeginView(frame, left, right, pair);
  }
  return true;
}

void WheelChainBuilder::AddMissing() { impl_->frames.emplace_back(); }

double WheelChainBuilder::turned_rad() const {
  for (std::size_t f = impl_->angles.size(); f-- > 0;) {
    if (std::isfinite(impl_->angles[f])) return impl_->angles[f];
  }
  return 0;
}

WheelChain WheelChainBuilder::Finish() {
  Impl& impl = *impl_;
  if (impl.views.empty()) {
    throw InputError(
        fmt::format("No pair of the recording shows a surface that both cameras see{}{}.",
                    impl.problem.empty() ? "" : ": ", impl.problem));
  }
  impl.Estimate();
  if (!impl.axis) {
    throw InputError(
        "The wheel does not turn in this recording (less than 3 degrees): record it lifted, "
        "turning slowly, a full turn or more.");
  }
  WheelChain chain;
  chain.axis = *impl.axis;
  chain.angles_rad = impl.angles;
  if (impl.closing) {
    const double there = impl.angles[static_cast<std::size_t>(impl.closing->first)];
    const double full = kTurn_rad + AngleAbout(*impl.axis, impl.closing->second.motion);
    chain.closed = true;
    chain.misclosure_rad = there - full;
    for (double& angle : chain.angles_rad) angle *= full / there;
  }
  impl.last.reset();
  impl.first.reset();
  for (WheelView& view : impl.views) {
    view.angle_rad = chain.angles_rad[static_cast<std::size_t>(view.frame)];
    // Once around: what comes after is seen from the first ones.
    constexpr double kNearFirst_rad = 0.03;
    if (chain.closed && view.angle_rad > kTurn_rad - kNearFirst_rad) continue;
    chain.views.push_back(std::move(view));
  }
  impl.views.clear();
  return chain;
}

}  // namespace plumbline
