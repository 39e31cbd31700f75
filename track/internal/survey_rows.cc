#include "track/internal/survey_rows.h"

#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <optional>

#include "calib/error.h"
#include "calib/triangulate.h"
#include "track/internal/angles_along_reference.h"
#include "track/internal/frame_rig.h"
#include "track/internal/survey_tags.h"
#include "track/right_drift.h"
#include "track/right_flow.h"
#include "track/surface_state.h"

namespace plumbline::internal {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;

void AppendRow(const Eigen::RowVectorXd& row, Eigen::MatrixXd* rows) {
  rows->conservativeResize(rows->rows() + 1, row.size());
  rows->bottomRows<1>() = row;
}

// How much further ahead the surface is a radian on, in the mean over what a frame shows.
double MeanSlope(const RollingAngles& deformation, const std::vector<RollingObservation>& frame) {
  const double step_rad = deformation.knot_rad / 4;
  double sum = 0;
  int count = 0;
  for (const RollingObservation& o : frame) {
    const double slope = (deformation.Ahead(o.place_rad + step_rad, o.y_mm) -
                          deformation.Ahead(o.place_rad - step_rad, o.y_mm)) /
                         (2 * step_rad);
    if (!std::isfinite(slope)) continue;
    sum += slope;
    ++count;
  }
  return count == 0 ? 0 : sum / count;
}

}  // namespace

double TimeOf(const RollingFrame& frame) {
  return std::isfinite(frame.time_s) ? frame.time_s : static_cast<double>(frame.index);
}

Eigen::Vector2d RightPixelAt(const PlanarField& right, const Eigen::Vector2d& left_px) {
  const Eigen::Vector2d none = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  const Eigen::Vector2d at = (left_px - right.first_px.cast<double>()) / right.step_px;
  const int c = static_cast<int>(std::floor(at.x())), r = static_cast<int>(std::floor(at.y()));
  if (c < 0 || r < 0 || c + 1 >= right.size().width || r + 1 >= right.size().height) {
    return none;
  }
  Eigen::Vector2d seen_px = left_px;
  for (const int down : {0, 1}) {
    for (const int along : {0, 1}) {
      if (right.status(r + down, c + along) != Status::kOk) return none;
      const double share =
          (down == 1 ? at.y() - r : r + 1 - at.y()) * (along == 1 ? at.x() - c : c + 1 - at.x());
      // Half-way between the line through the values and those along the gradients lies what both
      // leave out of a curve.
      const Eigen::Vector2d from_corner(at.x() - c - along, at.y() - r - down);
      seen_px += share * (right.displacement_px(r + down, c + along) +
                          0.5 * right.step_px *
                              (right.gradient(r + down, c + along).cast<double>() * from_corner));
    }
  }
  return seen_px;
}

SurveyRows::PoseMatches SurveyRows::PoseMatches::Of(const RelativePose& view,
                                                    const StereoField& field,
                                                    const Image<Eigen::Vector3f>& unit_covariance,
                                                    const Image<Eigen::Vector2d>& flow_px,
                                                    double alike_points) {
  PoseMatches out;
  out.view = view;
  out.alike_points = alike_points;
  for (const std::size_t i : ObservedPlaces(field, unit_covariance)) {
    const Eigen::Vector2d& flow = flow_px.data()[i];
    if (!flow.allFinite()) continue;
    out.places.push_back(i);
    out.right_flow_px.push_back(flow);
  }
  out.observations = ObservationsAt(out.places, field, unit_covariance);
  return out;
}

void SurveyRows::Push(Eigen::Index modes) {
  observations.emplace_back();
  psi_along.emplace_back(0, modes);
  poses.emplace_back();
}

void SurveyRows::ClearLast() {
  observations.back().clear();
  psi_along.back().resize(0, psi_along.back().cols());
  poses.back() = {};
}

void SurveyRows::Unwrap(std::vector<RollingFrame>* frames) {
  double before_s = 0, now_s = 0, before = 0, now = 0;
  int placed = 0;
  for (std::size_t f = 0; f < frames->size(); ++f) {
    RollingFrame& frame = (*frames)[f];
    if (frame.status != RollingFrameStatus::kPlaced) continue;
    const double t = TimeOf(frame);
    double expected = now;
    if (placed > 1 && now_s > before_s) {
      expected += (now - before) / (now_s - before_s) * (t - now_s);
    }
    const double first = frame.measured_angle_rad;
    frame.measured_angle_rad = placed == 0 ? first - kTurn_rad * std::floor(first / kTurn_rad)
                                           : expected + std::remainder(first - expected, kTurn_rad);
    for (RollingObservation& o : observations[f]) o.psi_rad += frame.measured_angle_rad - first;
    before = now;
    before_s = now_s;
    now = frame.measured_angle_rad;
    now_s = t;
    ++placed;
  }
}

std::vector<std::vector<RollingObservation>> SurveyRows::OverGround() const {
  std::vector<std::vector<RollingObservation>> over_ground = observations;
  for (std::size_t f = 0; f < pitch.size(); ++f) {
    for (RollingObservation& o : over_ground[f]) o.place_rad += pitch[f].value_rad;
  }
  return over_ground;
}

Eigen::RowVectorXd SurveyRows::AlongPitch(const std::vector<double>& slope) const {
  // What turns with the ground is known so well. On the virtual rig it is off by 0.002 to 0.004 of
  // itself at 640 x 480 px and by 0.02 at 320 x 240.
  constexpr double kShare = 0.02;
  double mean_rad = 0;
  for (const GroundPitch& p : pitch) mean_rad += p.value_rad / static_cast<double>(pitch.size());
  Eigen::RowVectorXd along(static_cast<Eigen::Index>(pitch.size()));
  for (std::size_t f = 0; f < pitch.size(); ++f) {
    along[static_cast<Eigen::Index>(f)] = kShare * slope[f] * (pitch[f].value_rad - mean_rad);
  }
  return along;
}

void SurveyRows::FindAngles(const WheelReference& reference,
                            const RollingAnglesOptions& angles_options,
                            const AngleSmootherOptions& smoother, RollingWheel* wheel) const {
  const std::size_t n = wheel->frames.size();
  bool clock = true;
  for (const RollingFrame& frame : wheel->frames) clock = clock && std::isfinite(frame.time_s);
  std::vector<double> times, angles, sigmas;
  for (const RollingFrame& frame : wheel->frames) {
    times.push_back(clock ? frame.time_s : static_cast<double>(frame.index));
  }
  const std::vector<std::vector<RollingObservation>> over_ground = OverGround();
  wheel->deformation = FindRollingAngles(over_ground, psi_along, angles_options, times);
  wheel->sigma_common_rad = wheel->deformation.sigma_common_rad;
  std::vector<double> slope;
  for (const auto& frame : over_ground) slope.push_back(MeanSlope(wheel->deformation, frame));
  for (std::size_t f = 0; f < n; ++f) {
    RollingFrame& frame = wheel->frames[f];
    if (frame.status == RollingFrameStatus::kPlaced) {
      frame.measured_angle_rad = wheel->deformation.frames[f].angle_rad;
      frame.sigma_measured_rad = wheel->deformation.frames[f].sigma_rad;
      if (!pitch.empty()) {
        frame.sigma_measured_rad =
            std::hypot(frame.sigma_measured_rad, pitch[f].sigma_rad * slope[f]);
      }
    }
  }
  Eigen::MatrixXd along = HoldToTags(reference, *wheel);
  const Eigen::Index K = along.rows();
  wheel->angle_along_reference_rad = AnglesAlongReference(reference, *wheel);
  if (!pitch.empty()) AppendRow(AlongPitch(slope), &wheel->angle_along_reference_rad);
  along.conservativeResize(K + wheel->angle_along_reference_rad.rows(),
                           static_cast<Eigen::Index>(n));
  along.bottomRows(along.rows() - K) = wheel->angle_along_reference_rad;
  for (const RollingFrame& frame : wheel->frames) {
    angles.push_back(frame.measured_angle_rad);
    sigmas.push_back(frame.sigma_measured_rad);
  }
  const SmoothedAngles smooth = SmoothAngles(times, angles, sigmas, along, smoother);
  wheel->angle_along_modes_rad = smooth.angle_along_rad.topRows(K);
  wheel->speed_along_modes_rad_s = smooth.speed_along_rad_s.topRows(K);
  wheel->jerk_rad_s25 = smooth.jerk_rad_s25;
  wheel->scatter = smooth.scatter;
  const bool modes = wheel->angle_along_modes_rad.rows() > 0;
  std::optional<Eigen::Index> first;  // placed
  for (std::size_t f = 0; f < n; ++f) {
    RollingFrame& frame = wheel->frames[f];
    const auto column = static_cast<Eigen::Index>(f);
    if (frame.status != RollingFrameStatus::kPlaced) {
      wheel->angle_along_modes_rad.col(column).setConstant(RollingFrame::kNone);
      wheel->speed_along_modes_rad_s.col(column).setConstant(RollingFrame::kNone);
      continue;
    }
    const SmoothedAngle& s = smooth.frames[f];
    frame.angle_rad = s.angle_rad;
    if (!first) first = column;
    const auto turned = [&](const Eigen::MatrixXd& angle_along) -> Eigen::VectorXd {
      return angle_along.col(column) - angle_along.col(*first);
    };
    const Eigen::Index of_reference = along.rows() - K;
    frame.sigma_random_rad =
        std::hypot(s.sigma_angle_rad, smooth.angle_along_rad.col(column).tail(of_reference).norm());
    frame.sigma_random_turn_rad =
        std::hypot(s.sigma_turn_rad, turned(smooth.angle_along_rad).tail(of_reference).norm());
    if (modes) frame.sigma_calibration_turn_rad = turned(wheel->angle_along_modes_rad).norm();
    frame.lean = s.lean;
    frame.outlier = s.outlier;
    frame.sigma_measured_rad *= smooth.scatter;
    if (modes) frame.sigma_calibration_rad = wheel->angle_along_modes_rad.col(column).norm();
    if (!clock) continue;
    frame.speed_rad_s = s.speed_rad_s;
    const double since = f > 0 ? times[f] - times[f - 1] : 0;
    const double until = f + 1 < times.size() ? times[f + 1] - times[f] : 0;
    frame.sigma_random_rad_s =
        std::hypot(s.sigma_speed_rad_s, wheel->deformation.SpeedSpread(f, since, until),
                   smooth.speed_along_rad_s.col(column).tail(of_reference).norm());
    if (modes) frame.sigma_calibration_rad_s = wheel->speed_along_modes_rad_s.col(column).norm();
  }
}

StereoRig SurveyRows::TriangulateAnew(const WheelReference& reference, PoseRefinement refinement,
                                      std::size_t f, RollingFrame* frame) {
  const Rigid3 wheel_from_rig = reference.axis.RigFromWheel(0).Inverse();
  StereoRig rig = RigOfFrame(reference.rig, poses[f].view, poses[f].observations,
                             poses[f].right_common_px, poses[f].alike_points, refinement, frame);
  std::vector<Eigen::Vector2d> left, right;
  for (const RollingPoint& p : frame->points) {
    left.push_back(p.left_px);
    right.push_back(p.right_px);
  }
  const std::vector<Eigen::Vector3d> points = TriangulatePoints(rig, left, right);
  for (std::size_t i = 0; i < points.size(); ++i) {
    RollingPoint& p = frame->points[i];
    p.point_mm = points[i];
    const Eigen::Vector3d here = wheel_from_rig * p.point_mm;
    RollingObservation& o = observations[f][i];
    const double place_rad = MaterialAngle(here);
    o.psi_rad -= std::remainder(place_rad - o.place_rad, kTurn_rad);
    o.place_rad = place_rad;
    o.y_mm = here.y();
    o.radial_mm =
        std::hypot(here.x(), here.z()) - std::hypot(p.undeformed_mm.x(), p.undeformed_mm.z());
  }
  return rig;
}

void SurveyRows::RefineAll(const WheelReference& reference, std::vector<RollingFrame>* frames) {
  for (std::size_t f = 0; f < frames->size(); ++f) {
    RollingFrame& frame = (*frames)[f];
    if (frame.status != RollingFrameStatus::kPlaced || frame.right_from_left) continue;
    (void)TriangulateAnew(reference, PoseRefinement::kAlways, f, &frame);
  }
}

void SurveyRows::MoveBack(const WheelReference& reference, const RightDelay& delay,
                          PoseRefinement refinement, RollingWheel* wheel) {
  const Rigid3 wheel_from_rig = reference.axis.RigFromWheel(0).Inverse();
  const bool mode = delay.sigma_s > 0 && reference.delay_mode >= 0;
  FindRightDrift(reference, wheel);
  for (std::size_t f = 0; f < wheel->frames.size(); ++f) {
    RollingFrame& frame = wheel->frames[f];
    if (frame.status != RollingFrameStatus::kPlaced) continue;
    if (!std::isfinite(frame.speed_rad_s)) {
      throw InputError(
          "how far the wheel turns until the right camera exposes is not known: the frames need "
          "times (--timestamps or --fps)");
    }
    PoseMatches& pose = poses[f];
    pose.right_common_px.clear();
    for (std::size_t i = 0; i < pose.observations.size(); ++i) {
      pose.observations[i].right -=
          delay.value_s * RightVelocityAt(frame, pose.places[i], pose.right_flow_px[i]);
      if (frame.right_drift_px_s.empty()) continue;
      pose.right_common_px.push_back(delay.value_s * RightDriftLeftOutAt(frame, pose.places[i]));
    }
    for (RollingPoint& p : frame.points) p.right_px -= delay.value_s * RightVelocityOf(frame, p);
    const StereoRig rig = TriangulateAnew(reference, refinement, f, &frame);
    if (!mode) continue;
    std::vector<Eigen::Vector2d> left, right, right_px;
    for (const RollingPoint& p : frame.points) {
      left.push_back(p.left_px);
      right.push_back(p.right_px);
      right_px.push_back(-delay.sigma_s * RightVelocityOf(frame, p));
    }
    std::vector<Eigen::Vector3f> moved(frame.points.size());
    FillModeOfMatches(rig, left, right, right_px, 0, moved);
    for (std::size_t i = 0; i < moved.size(); ++i) {
      const double there_rad =
          MaterialAngle(wheel_from_rig * (frame.points[i].point_mm + moved[i].cast<double>()));
      psi_along[f](static_cast<Eigen::Index>(i), reference.delay_mode) -=
          static_cast<float>(std::remainder(there_rad - observations[f][i].place_rad, kTurn_rad));
    }
  }
  wheel->right_delay = delay;
}

}  // namespace plumbline::internal
