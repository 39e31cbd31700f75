#include "track/wheel_reference.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "calib/error.h"
#include "calib/median.h"
#include "match/planar_field.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr Eigen::Index kAxis = WheelAdjustment::kAxis;

WheelReferenceView ViewOf(const WheelView& view, const WheelAdjustment& adjusted, int first_point,
                          int modes) {
  WheelReferenceView out;
  out.frame = view.frame;
  out.angle_rad = adjusted.angles_rad[static_cast<std::size_t>(view.frame)];
  out.left = view.left;
  out.right = view.right;
  out.first_px = view.first_px;
  out.step_px = view.step_px;
  const ImageSize size = view.point_in_rig_mm.size();
  out.point_mm = Image<Eigen::Vector3d>(size, Eigen::Vector3d::Constant(kNone));
  const auto none = std::numeric_limits<float>::quiet_NaN();
  out.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>(size, Eigen::Matrix<float, 6, 1>::Constant(none));
  out.sigma_calibration_mm = Image<Eigen::Vector3f>(size, Eigen::Vector3f::Constant(none));
  for (std::size_t i = 0; i < out.point_mm.pixel_count(); ++i) {
    const std::size_t p = static_cast<std::size_t>(first_point) + i;
    if (!adjusted.points_mm[p].allFinite()) continue;
    out.point_mm.data()[i] = adjusted.points_mm[p];
    out.cov_random_mm2.data()[i] = TriangleOf(adjusted.cov_points_mm2[p]);
    if (modes == 0) continue;
    out.sigma_calibration_mm.data()[i] =
        adjusted.points_along_modes_mm[p].rowwise().norm().cast<float>();
  }
  return out;
}

// The point of a view that is nearest to a pixel, of the nine around it.
struct NearPoint {
  Eigen::Vector3d point_mm;
  Eigen::Vector2d pixel;
};

std::optional<NearPoint> NearestPoint(const WheelReferenceView& view, const Eigen::Vector2d& px) {
  const Eigen::Vector2d cell = (px - view.first_px.cast<double>()) / view.step_px;
  const auto column = static_cast<int>(std::lround(cell.x()));
  const auto row = static_cast<int>(std::lround(cell.y()));
  std::optional<NearPoint> nearest;
  for (int r = std::max(0, row - 1); r <= std::min(view.point_mm.height() - 1, row + 1); ++r) {
    for (int c = std::max(0, column - 1); c <= std::min(view.point_mm.width() - 1, column + 1);
         ++c) {
      const Eigen::Vector2d at =
          (view.first_px + view.step_px * Eigen::Vector2i(c, r)).cast<double>();
      if (!view.point_mm(r, c).allFinite() ||
          (nearest && (nearest->pixel - px).norm() <= (at - px).norm())) {
        continue;
      }
      nearest = {view.point_mm(r, c), at};
    }
  }
  return nearest;
}

// How far the wheel has turned since a view, by one feature of it that is now elsewhere: the
// nearest point of the grid is turned until it is where the feature is, as near as it gets. NaN
// where no point is near: the feature is not of the wheel, but of what a mask left out.
double TurnOf(const WheelReference& wheel, const WheelReferenceView& view,
              const CorrelationSeed& seed) {
  const std::optional<NearPoint> near = NearestPoint(view, seed.reference_px);
  if (!near) return kNone;
  const Eigen::Vector3d& point = near->point_mm;
  const Eigen::Vector2d from_point = seed.reference_px - near->pixel;
  const Eigen::Vector2d goal = seed.reference_px + seed.displacement_px -
                               (Eigen::Matrix2d::Identity() + seed.gradient) * from_point;
  constexpr int kSteps = 15;
  constexpr double kLongest_rad = 0.2, kEnough_rad = 1e-6;
  double turn = 0;
  for (int step = 0; step < kSteps; ++step) {
    Eigen::Matrix3d d_turn;
    const Eigen::Matrix3d R = TurnAboutY(view.angle_rad + turn, &d_turn);
    const Camera::Projection seen = wheel.rig.left.ProjectWithJacobians(
        wheel.axis.rotation * R * point + wheel.axis.origin_in_rig_mm());
    if (!seen.pixel.allFinite()) return kNone;
    const Eigen::Vector2d J = seen.d_pixel_d_point * wheel.axis.rotation * d_turn * point;
    const double change = J.dot(goal - seen.pixel) / J.squaredNorm();
    turn += std::clamp(change, -kLongest_rad, kLongest_rad);
    if (std::abs(change) < kEnough_rad) return turn;
  }
  return kNone;
}

WheelCandidate CandidateOf(const WheelReference& wheel, const IndexMatch& match) {
  const WheelReferenceView& view = wheel.views[match.image];
  WheelCandidate candidate;
  candidate.view = match.image;
  std::vector<double> turns;
  for (const CorrelationSeed& seed : match.agreeing) {
    const double turn = TurnOf(wheel, view, seed);
    if (std::isfinite(turn)) turns.push_back(turn);
  }
  candidate.agreeing = static_cast<int>(turns.size());
  candidate.angle_rad = candidate.scatter_rad = kNone;
  if (turns.empty()) return candidate;
  const double turn = Median(turns);
  for (double& t : turns) t = std::abs(t - turn);
  candidate.scatter_rad = Median(std::move(turns));
  constexpr double kTurn_rad = 2 * std::numbers::pi;
  const double angle = view.angle_rad + turn;
  candidate.angle_rad = angle - kTurn_rad * std::floor(angle / kTurn_rad);
  return candidate;
}

FeatureIndex IndexOf(const WheelReference& wheel, const FeatureIndexOptions& options) {
  std::vector<const GrayImage*> images;
  for (const WheelReferenceView& view : wheel.views) images.push_back(&view.left);
  return FeatureIndex(images, options);
}

}  // namespace

double WheelReference::largest_angle_rad() const {
  double largest = 0;
  for (const WheelFrame& frame : frames) {
    if (frame.angle_rad > largest) largest = frame.angle_rad;
  }
  return largest;
}

double WheelReference::SpeedOf(int frame) const {
  std::vector<double> angles, times;
  for (const WheelFrame& f : frames) {
    angles.push_back(f.angle_rad);
    times.push_back(f.time_s);
  }
  return TurningSpeeds(angles, times)[static_cast<std::size_t>(frame)];
}

double WheelReference::LateTurnOf(const WheelReferenceView& view) const {
  if (!right_delay || right_delay->value_s == 0) return 0;
  return SpeedOf(view.frame) * right_delay->value_s;
}

double WheelReference::SigmaLateTurnOf(const WheelReferenceView& view) const {
  if (!right_delay || right_delay->sigma_s == 0) return 0;
  return SpeedOf(view.frame) * right_delay->sigma_s;
}

WheelReference MakeWheelReference(const StereoRig& rig, const WheelTracks& tracks,
                                  const std::vector<WheelFrameMatches>& matches,
                                  const WheelAdjustment& adjusted) {
  WheelReference wheel{.rig = rig, .axis = adjusted.axis};
  wheel.cov_axis_random = adjusted.cov_random.topLeftCorner<kAxis, kAxis>();
  const auto n = static_cast<Eigen::Index>(adjusted.angles_rad.size());
  wheel.cov_angles_random_rad2 = adjusted.cov_random.bottomRightCorner(n, n);
  wheel.cov_axis_angles_random = adjusted.cov_random.topRightCorner(kAxis, n);
  const int modes = rig.modes.count();
  wheel.cov_axis_calibration.setConstant(kNone);
  wheel.axis_along_modes = adjusted.along_modes.leftCols<kAxis>();
  wheel.angles_along_modes_rad = adjusted.along_modes.rightCols(n);
  if (modes > 0) {
    wheel.cov_axis_calibration = wheel.axis_along_modes.transpose() * wheel.axis_along_modes;
  }
  for (Eigen::Index f = 0; f < n; ++f) {
    WheelFrame frame;
    const Eigen::Index at = kAxis + f;
    frame.index = f;
    frame.angle_rad = adjusted.angles_rad[static_cast<std::size_t>(f)];
    frame.sigma_random_rad = std::sqrt(adjusted.cov_random(at, at));
    frame.sigma_calibration_rad = modes > 0 ? adjusted.along_modes.col(at).norm() : kNone;
    frame.matches = matches[static_cast<std::size_t>(f)].found;
    if (std::isfinite(frame.angle_rad)) frame.status = WheelFrameStatus::kPlaced;
    wheel.frames.push_back(frame);
  }
  const WheelChain& chain = tracks.chain();
  wheel.closed = chain.closed;
  wheel.misclosure_rad = chain.misclosure_rad;
  wheel.sigma0 = adjusted.sigma0;
  wheel.outliers = adjusted.outliers;
  wheel.observations = static_cast<std::int64_t>(adjusted.used.size());
  wheel.profile = ProfileOf(adjusted);
  for (std::size_t v = 0; v < chain.views.size(); ++v) {
    const WheelView& view = chain.views[v];
    if (!std::isfinite(adjusted.angles_rad[static_cast<std::size_t>(view.frame)])) continue;
    wheel.views.push_back(ViewOf(view, adjusted, tracks.FirstPoint(v), modes));
  }
  return wheel;
}

void WheelLibraryOptions::Check() const {
  index.Check();
  if (least_agreeing < 6) {
    throw UsageError("A frame is found on the wheel by 6 agreeing features or more.");
  }
  if (!(most_scatter_rad > 0)) {
    throw UsageError("What features say of the wheel's angle may scatter by more than 0.");
  }
}

WheelLibrary::WheelLibrary(const WheelReference& wheel, const WheelLibraryOptions& options)
    : wheel_(wheel), options_(options), index_(IndexOf(wheel, options.index)) {
  options.Check();
}

WheelPlace WheelLibrary::Find(const GrayImage& left) const {
  if (left.size() != wheel_.rig.left.size()) {
    throw InputError(fmt::format(
        "the image has {} x {} px and the wheel's reference images {} x {}: it is of another rig",
        left.width(), left.height(), wheel_.rig.left.size().width, wheel_.rig.left.size().height));
  }
  WheelPlace place;
  for (const IndexMatch& match : index_.Find(left)) {
    place.candidates.push_back(CandidateOf(wheel_, match));
  }
  std::erase_if(place.candidates, [](const WheelCandidate& c) { return c.agreeing == 0; });
  std::stable_sort(
      place.candidates.begin(), place.candidates.end(),
      [](const WheelCandidate& a, const WheelCandidate& b) { return a.agreeing > b.agreeing; });
  if (place.candidates.empty()) {
    place.why = "no features of the wheel's reference images are in it";
    return place;
  }
  const WheelCandidate& best = place.candidates.front();
  if (best.agreeing < options_.least_agreeing) {
    place.why = fmt::format(
        "{} features agree with a reference image and {} must: it is blurred, dark or covered, or "
        "of another wheel",
        best.agreeing, options_.least_agreeing);
  } else if (!(best.scatter_rad <= options_.most_scatter_rad)) {
    place.why = fmt::format(
        "its features do not agree on an angle of the wheel (they scatter by {:.2g} degrees): the "
        "cameras have moved, or it is of another wheel",
        best.scatter_rad * 180 / std::numbers::pi);
  } else {
    place.found = true;
  }
  return place;
}

}  // namespace plumbline
