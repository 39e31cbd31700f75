#include "track/rolling_contact.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/mode_triangulation.h"
#include "match/correlation_area.h"
#include "match/neighbour_correlation.h"
#include "track/internal/axis_along_modes.h"
#include "track/internal/turning_over_ground.h"
#include "track/right_flow.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
const Eigen::Vector3d kNowhere = Eigen::Vector3d::Constant(kNone);

// The points of one frame on the survey's grid, in the rig frame.
struct FramePoints {
  double time_s = 0;
  SurfacePoints now, undeformed;
  Image<Eigen::Vector3d> material;  // angle (rad), place along the axis (mm), radius (mm)
  Image<Eigen::Matrix3d> cov_mm2;
  Image<double> thickness_mm;
  std::vector<Image<double>> thickness_along_modes;  // of the carcass: the last ones of all modes
  // What one standard deviation of the frame's own pose of the cameras does to the points, along
  // each of its directions; none where it was not refined.
  std::vector<Image<Eigen::Vector3f>> along_pose_mm;
};

// A frame that is placed, in its ground frame.
struct FrameOverGround {
  MaterialFrame material;
  SurfacePoints undeformed;
};

// Even-odd rule over all outlines: holes are outside.
bool Inside(const std::vector<Polygon>& outlines, const Eigen::Vector2d& p) {
  bool inside = false;
  for (const Polygon& outline : outlines) {
    for (std::size_t i = 0, j = outline.size() - 1; i < outline.size(); j = i++) {
      const Eigen::Vector2d &a = outline[i], &b = outline[j];
      if ((a.y() > p.y()) != (b.y() > p.y()) &&
          p.x() < a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x())) {
        inside = !inside;
      }
    }
  }
  return inside;
}

class ContactOfRun {
 public:
  ContactOfRun(const WheelReference& reference, const RollingWheel& rolling,
               const RollingContactOptions& options)
      : reference_(reference),
        rolling_(rolling),
        options_(options),
        modes_(reference.rig),
        axes_(internal::AxesAlongModes(reference)),
        neighbours_(NeighbourCorrelation::OfOverlap(
            rolling.grid, rolling.spacing_px, options.subset_px, options.order, options.circular)) {
    const double area = CorrelationArea(neighbours_, rolling.grid);
    options_.ground.flat.correlation_area_points = area;
    options_.ground.levels.correlation_area_points = area;
    options_.ground.symmetry.correlation_area_points = area;
    options_.patch.correlation_area_points = area;
    options_.deformation.centre_y_mm =
        std::isfinite(reference.profile.crown_y_mm) ? reference.profile.crown_y_mm : 0;
  }

  RollingContact Find();

 private:
  FramePoints PointsOf(std::size_t f) const;
  void AddPoseErrors(const RollingFrame& frame, const std::vector<Eigen::Vector2d>& left,
                     const std::vector<Eigen::Vector2d>& right, FramePoints* out) const;
  void AddModes(std::size_t f, const std::vector<Eigen::Vector2d>& left,
                const std::vector<Eigen::Vector2d>& right, FramePoints* out) const;
  GroundObservation Observe(std::size_t f) const;
  std::vector<PoseObservation> ObserveAll() const;
  void TurnByHand(RollingContact* contact) const;
  void FindPatchesOf(RollingContact* contact) const;
  std::optional<FrameOverGround> OverGround(std::size_t f, const RollingContact& contact) const;
  Image<std::uint8_t> InContact(const FramePoints& points, const RollingContactFrame& frame) const;
  void Deform(std::size_t f, const FrameOverGround& now, RollingContactFrame* out) const;
  void Slip(std::size_t f, FrameTriple frames, RollingContact* contact) const;
  bool Placed(std::size_t f) const {
    return rolling_.frames[f].status == RollingFrameStatus::kPlaced;
  }
  double TimeOf(std::size_t f) const {
    const RollingFrame& frame = rolling_.frames[f];
    return clock_ ? frame.time_s : static_cast<double>(frame.index);
  }
  double SigmaOf(const FramePoints& points) const;

  const WheelReference& reference_;
  const RollingWheel& rolling_;
  RollingContactOptions options_;
  ModeTriangulation modes_;
  std::vector<WheelAxis> axes_;  // along the modes
  NeighbourCorrelation neighbours_;
  bool clock_ = true;
};

FramePoints ContactOfRun::PointsOf(std::size_t f) const {
  const RollingFrame& frame = rolling_.frames[f];
  const ImageSize size = rolling_.grid;
  FramePoints out;
  out.time_s = TimeOf(f);
  out.now.point_mm = out.undeformed.point_mm = out.material =
      Image<Eigen::Vector3d>(size, kNowhere);
  out.now.cov_random_mm2 = out.undeformed.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>(size, Eigen::Matrix<float, 6, 1>::Zero());
  out.cov_mm2 = Image<Eigen::Matrix3d>(size, Eigen::Matrix3d::Constant(kNone));
  const Rigid3 rig_from_wheel = reference_.axis.RigFromWheel(frame.angle_rad);
  std::vector<Eigen::Vector2d> left, right;
  for (const RollingPoint& p : frame.points) {
    const int r = p.at.y(), c = p.at.x();
    out.now.point_mm(r, c) = p.point_mm;
    out.now.cov_random_mm2(r, c) = p.cov_random_mm2;
    out.cov_mm2(r, c) = CovarianceOf(p.cov_random_mm2);
    out.undeformed.point_mm(r, c) = rig_from_wheel * p.undeformed_mm;
    out.undeformed.cov_random_mm2(r, c) =
        TriangleOf(Eigen::Matrix3d(rig_from_wheel.rotation * CovarianceOf(p.cov_undeformed_mm2) *
                                   rig_from_wheel.rotation.transpose()));
    out.material(r, c) = {MaterialAngle(p.undeformed_mm), p.undeformed_mm.y(),
                          std::hypot(p.undeformed_mm.x(), p.undeformed_mm.z())};
    left.push_back(p.left_px);
    right.push_back(p.right_px);
  }
  const CarcassThickness& carcass = options_.carcass;
  const Image<Eigen::Vector3d>& undeformed = out.undeformed.point_mm;
  out.thickness_mm = ThicknessOver(carcass, undeformed, reference_.axis);
  for (int k = 0; k < carcass.mode_count(); ++k) {
    out.thickness_along_modes.push_back(
        ThicknessOver(carcass.AlongMode(k), undeformed, reference_.axis));
  }
  AddModes(f, left, right, &out);
  AddPoseErrors(frame, left, right, &out);
  return out;
}

void ContactOfRun::AddPoseErrors(const RollingFrame& frame,
                                 const std::vector<Eigen::Vector2d>& left,
                                 const std::vector<Eigen::Vector2d>& right,
                                 FramePoints* out) const {
  StereoRig rig = reference_.rig;
  for (const Rigid3& pose : frame.right_from_left_moved) {
    rig.right_from_left = pose;
    const std::vector<Eigen::Vector3d> points = TriangulatePoints(rig, left, right);
    Image<Eigen::Vector3f> moved(rolling_.grid, Eigen::Vector3f::Zero());
    for (std::size_t i = 0; i < points.size(); ++i) {
      const RollingPoint& p = frame.points[i];
      moved(p.at.y(), p.at.x()) = (points[i] - p.point_mm).cast<float>();
    }
    out->along_pose_mm.push_back(std::move(moved));
  }
}

// Along a mode the points of the frame and of its view are both elsewhere, and so are the axis and
// the angles of both.
void ContactOfRun::AddModes(std::size_t f, const std::vector<Eigen::Vector2d>& left,
                            const std::vector<Eigen::Vector2d>& right, FramePoints* out) const {
  const RollingFrame& frame = rolling_.frames[f];
  const WheelReferenceView& view = reference_.views[frame.view];
  const std::size_t K = axes_.size(), n = frame.points.size();
  if (K == 0) return;
  const Rigid3 rig_from_view = reference_.axis.RigFromWheel(view.angle_rad);
  std::vector<Eigen::Vector2d> view_left, view_right;
  for (const RollingPoint& p : frame.points) {
    const Eigen::Vector3d there = rig_from_view * p.undeformed_mm;
    view_left.push_back(reference_.rig.left.Project(there));
    view_right.push_back(reference_.rig.right.Project(reference_.rig.right_from_left * there));
  }
  std::vector<Eigen::Vector3f> moved(n * K), view_moved(n * K);
  modes_.Differences(left, right, moved);
  modes_.Differences(view_left, view_right, view_moved);
  if (reference_.delay_mode >= 0) {
    const auto mode = static_cast<std::size_t>(reference_.delay_mode);
    const double sigma_s = rolling_.right_delay.sigma_s;
    const double late_rad = sigma_s > 0 ? frame.speed_rad_s * sigma_s : 0;
    const double view_late_rad = reference_.SigmaLateTurnOf(view);
    std::vector<Eigen::Vector2d> right_px, view_right_px;
    for (const RollingPoint& p : frame.points) {
      const Eigen::Vector3d there = rig_from_view * p.undeformed_mm;
      right_px.push_back(-late_rad * p.right_flow_px);
      view_right_px.push_back(-view_late_rad * RigidRightFlow(reference_, there));
    }
    FillModeOfMatches(reference_.rig, left, right, right_px, mode, moved);
    FillModeOfMatches(reference_.rig, view_left, view_right, view_right_px, mode, view_moved);
  }
  const ImageSize size = rolling_.grid;
  for (std::size_t k = 0; k < K; ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    Image<Eigen::Vector3f> now(size, Eigen::Vector3f::Zero()), undeformed = now;
    const double then = view.angle_rad + reference_.angles_along_modes_rad(row, view.frame);
    const double angle =
        frame.angle_rad + rolling_.angle_along_modes_rad(row, static_cast<Eigen::Index>(f));
    const Rigid3 turn = axes_[k].RigFromWheel(angle) * axes_[k].RigFromWheel(then).Inverse();
    for (std::size_t i = 0; i < n; ++i) {
      const RollingPoint& p = frame.points[i];
      const int r = p.at.y(), c = p.at.x();
      now(r, c) = moved[i * K + k];
      const Eigen::Vector3d there =
          turn * (rig_from_view * p.undeformed_mm + view_moved[i * K + k].cast<double>());
      undeformed(r, c) = (there - out->undeformed.point_mm(r, c)).cast<float>();
    }
    out->now.along_modes_mm.push_back(std::move(now));
    out->undeformed.along_modes_mm.push_back(std::move(undeformed));
  }
}

// Of the points, along the ground's normal: about along the rig's z.
double ContactOfRun::SigmaOf(const FramePoints& points) const {
  std::vector<double> sigmas;
  for (const Eigen::Matrix3d& cov : points.cov_mm2.values()) {
    if (cov.allFinite()) sigmas.push_back(std::sqrt(cov(2, 2)));
  }
  return sigmas.empty() ? kNone : Median(std::move(sigmas));
}

GroundObservation ContactOfRun::Observe(std::size_t f) const {
  const FramePoints points = PointsOf(f);
  return ObserveGround({.time_s = points.time_s,
                        .point_mm = points.now.point_mm,
                        .cov_mm2 = points.cov_mm2,
                        .thickness_mm = points.thickness_mm,
                        .left_out_mm = ThicknessLeftOutOver(
                            options_.carcass, points.undeformed.point_mm, reference_.axis),
                        .sigma_mm = SigmaOf(points),
                        .along_modes_mm = points.now.along_modes_mm,
                        .thickness_along_modes = points.thickness_along_modes,
                        .along_pose_mm = points.along_pose_mm},
                       reference_.axis, axes_, neighbours_, options_.ground);
}

std::vector<PoseObservation> ContactOfRun::ObserveAll() const {
  std::vector<GroundObservation> frames(rolling_.frames.size());
  std::vector<double> travel_mm;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    const double angle_rad = rolling_.frames[f].angle_rad;
    // About as far as the wheel turns: what slip and load make of it is little between two frames.
    travel_mm.push_back(angle_rad * reference_.profile.crown_radius_mm);
    if (Placed(f)) {
      frames[f] = Observe(f);
    } else {
      frames[f].pose.time_s = TimeOf(f);
      frames[f].pose.why = rolling_.frames[f].problem;
    }
  }
  LinkTops(travel_mm, frames);
  std::vector<PoseObservation> observations;
  for (GroundObservation& frame : frames) observations.push_back(std::move(frame.pose));
  return observations;
}

// The same pose in all frames, without error: that is what the user says.
void ContactOfRun::TurnByHand(RollingContact* contact) const {
  for (std::size_t f = 0; f < rolling_.frames.size(); ++f) {
    RigRotationFrame& rotation = contact->frames[f].rotation;
    rotation.time_s = TimeOf(f);
    if (!Placed(f)) continue;
    const Rigid3 ground =
        ManualGround(*options_.manual_turns_deg, PointsOf(f).undeformed.point_mm, reference_.axis);
    GroundPlane plane;
    plane.normal = ground.rotation.row(2);
    plane.offset_mm = -ground.translation_mm.z();
    rotation.found = true;
    rotation.known.fill(true);
    rotation.from = RigRotationFrame::From::kPlane;
    rotation.pose = PoseOf(plane, reference_.axis);
    rotation.lean = 0;
    rotation.ground.frame_from_rig = ground;
    rotation.ground.along_modes.assign(axes_.size(), ground);
    rotation.along_modes.assign(axes_.size(), RigPose::Zero());
    contact->found = true;
  }
}

void ContactOfRun::FindPatchesOf(RollingContact* contact) const {
  std::vector<PatchFrame> frames;
  std::vector<std::size_t> places;
  PatchSeriesOptions options = options_.patch;
  std::vector<double> sigmas;
  for (std::size_t f = 0; f < rolling_.frames.size(); ++f) {
    if (!Placed(f)) continue;
    FramePoints points = PointsOf(f);
    sigmas.push_back(SigmaOf(points));
    frames.push_back({.point_mm = std::move(points.now.point_mm),
                      .undeformed_mm = std::move(points.undeformed.point_mm),
                      .thickness_mm = std::move(points.thickness_mm),
                      .cov_mm2 = std::move(points.cov_mm2),
                      .along_modes_mm = std::move(points.now.along_modes_mm),
                      .rotation = contact->frames[f].rotation,
                      .thickness_along_modes = std::move(points.thickness_along_modes),
                      .along_pose_mm = std::move(points.along_pose_mm)});
    places.push_back(f);
  }
  if (frames.empty()) return;
  options.sigma_mm = Median(std::move(sigmas));
  PatchSeries series = FindPatches(frames, reference_.axis, neighbours_, options);
  contact->law = series.law;
  for (std::size_t i = 0; i < places.size(); ++i) {
    contact->frames[places[i]].patch = std::move(series.frames[i]);
  }
}

Image<std::uint8_t> ContactOfRun::InContact(const FramePoints& points,
                                            const RollingContactFrame& frame) const {
  Image<std::uint8_t> contact(rolling_.grid, 0);
  for (std::size_t i = 0; i < contact.pixel_count(); ++i) {
    const Eigen::Vector3d& p = points.now.point_mm.data()[i];
    if (!p.allFinite() || frame.patch.by == FramePatch::By::kNothing) continue;
    const Eigen::Vector3d there = frame.rotation.ground.frame_from_rig * p;
    contact.data()[i] = Inside(frame.patch.patch.contours_mm, there.head<2>()) ? 1 : 0;
  }
  return contact;
}

// Nothing where there is no such frame, or it was not placed over the ground.
std::optional<FrameOverGround> ContactOfRun::OverGround(std::size_t f,
                                                        const RollingContact& contact) const {
  if (f >= rolling_.frames.size() || !Placed(f) || !contact.frames[f].rotation.found) {
    return std::nullopt;
  }
  FramePoints points = PointsOf(f);
  FrameOverGround out;
  MaterialFrame& frame = out.material;
  frame.time_s = points.time_s;
  frame.contact = InContact(points, contact.frames[f]);
  frame.points = std::move(points.now);
  frame.material = std::move(points.material);
  frame.ground = GroundFrameOf(contact.frames[f].rotation, reference_.axis);
  out.undeformed = std::move(points.undeformed);
  return out;
}

void ContactOfRun::Deform(std::size_t f, const FrameOverGround& now,
                          RollingContactFrame* out) const {
  LoadedWheel wheel;
  wheel.contact = now.material.contact;
  wheel.loaded = now.material.points;
  wheel.undeformed = now.undeformed;
  wheel.sigma_angle_rad =
      std::hypot(rolling_.frames[f].sigma_random_rad, rolling_.sigma_common_rad);
  wheel.axis = reference_.axis;
  wheel.cov_axis_random = reference_.cov_axis_random;
  wheel.axis_along_modes = reference_.axis_along_modes;
  wheel.ground = now.material.ground;
  out->deformation = MeasureDeformation(wheel, neighbours_, options_.deformation);
}

void ContactOfRun::Slip(std::size_t f, FrameTriple frames, RollingContact* contact) const {
  RollingContactFrame* out = &contact->frames[f];
  if (!clock_) {
    out->slip.problem = "the frames have no times";
    return;
  }
  if (frames.before == nullptr && frames.after == nullptr) {
    out->slip.problem = "no frame beside this one is placed over the ground";
    return;
  }
  const std::size_t first = frames.before != nullptr ? f - 1 : f;
  const std::size_t last = frames.after != nullptr ? f + 1 : f;
  std::vector<RigRotationFrame> grounds;
  for (std::size_t k = first; k <= last; ++k) grounds.push_back(contact->frames[k].rotation);
  const Eigen::MatrixXd root = RandomRoot(grounds);
  for (std::size_t k = 0; k < grounds.size(); ++k) {
    frames.ground_errors[first + k + 1 - f] = GroundJacobian(grounds[k].pose, reference_.axis) *
                                              root.middleRows(3 * static_cast<Eigen::Index>(k), 3);
  }
  const MaterialVelocity velocity = VelocityOfMaterial(frames, neighbours_);
  WheelTurning wheel;
  wheel.axis = reference_.axis;
  wheel.cov_axis_random = reference_.cov_axis_random;
  wheel.axis_along_modes = reference_.axis_along_modes;
  wheel.speed_rad_s =
      internal::TurningOverGround(rolling_, first, f, last, grounds.front(), grounds.back());
  wheel.speed_along_common_rad_s =
      (root.row(0) - root.row(root.rows() - 3)) / (grounds.back().time_s - grounds.front().time_s);
  std::optional<MeasuredScalar> channel;
  if (options_.vehicle_speed_mm_s) {
    const double from_s = TimeOf(first), to_s = TimeOf(last);
    const double middle_s = first < f && f < last ? TimeOf(f) : (from_s + to_s) / 2;
    channel = SpeedFromChannel(*options_.vehicle_speed_mm_s, middle_s, to_s - from_s,
                               options_.channel_clock, options_.sigma_vehicle_speed_mm_s);
  }
  const Eigen::Vector3f none = Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN());
  out->sigma_random_mm_s = out->sigma_calibration_mm_s =
      Image<Eigen::Vector3f>(velocity.size(), none);
  for (std::size_t i = 0; i < velocity.value_mm_s.pixel_count(); ++i) {
    const Eigen::Matrix<float, 6, 1>& cov = velocity.cov_random_mm2_s2.data()[i];
    out->sigma_random_mm_s.data()[i] = Eigen::Vector3f(cov[0], cov[3], cov[5]).cwiseSqrt();
    if (velocity.along_modes_mm_s.empty()) continue;
    Eigen::Vector3f variance = Eigen::Vector3f::Zero();
    for (const auto& mode : velocity.along_modes_mm_s) variance += mode.data()[i].cwiseAbs2();
    out->sigma_calibration_mm_s.data()[i] = variance.cwiseSqrt();
  }
  out->slip = MeasureSlip(velocity, frames, wheel, frames.now->contact, neighbours_,
                          options_.free_rolling_radius_mm, channel, options_.slip);
  // From one neighbour alone the velocity is that of half-way to it, where the wheel turned faster
  // or slower in the same proportion.
  const internal::SpeedRatio since = internal::SpeedSince(rolling_, first, f, last);
  MeasuredScalar& speed = out->slip.speed_mm_s;
  speed.value *= since.value;
  speed.sigma_random = std::hypot(speed.sigma_random, speed.value * since.sigma);
  out->slip.velocity_mm_s *= since.value;
}

RollingContact ContactOfRun::Find() {
  const std::size_t count = rolling_.frames.size();
  RollingContact contact;
  contact.frames.resize(count);
  for (const RollingFrame& frame : rolling_.frames) clock_ = clock_ && std::isfinite(frame.time_s);
  if (options_.manual_turns_deg) {
    TurnByHand(&contact);
  } else {
    const RigRotation rotation =
        SmoothRigRotation(ObserveAll(), reference_.axis, axes_, options_.rotation);
    contact.found = rotation.found;
    contact.problem = rotation.problem;
    for (std::size_t f = 0; f < count; ++f) contact.frames[f].rotation = rotation.frames[f];
  }
  FindPatchesOf(&contact);
  std::optional<FrameOverGround> before, now = OverGround(0, contact);
  for (std::size_t f = 0; f < count; ++f) {
    RollingContactFrame& frame = contact.frames[f];
    std::optional<FrameOverGround> after = OverGround(f + 1, contact);
    if (now) {
      const auto material = [](const std::optional<FrameOverGround>& beside) {
        return beside ? &beside->material : nullptr;
      };
      Deform(f, *now, &frame);
      Slip(f, {material(before), &now->material, material(after)}, &contact);
    } else {
      frame.patch.problem = frame.slip.problem = frame.deformation.problem =
          Placed(f) ? frame.rotation.problem : rolling_.frames[f].problem;
    }
    before = std::exchange(now, std::move(after));
  }
  return contact;
}

}  // namespace

UncertainFrame GroundFrameOf(const RigRotationFrame& rotation, const WheelAxis& axis) {
  UncertainFrame ground;
  ground.frame_from_rig = rotation.ground.frame_from_rig;
  ground.along_modes = rotation.ground.along_modes;
  const Eigen::Matrix<double, 6, 3> J = GroundJacobian(rotation.pose, axis);
  ground.cov_random = J * rotation.cov_random * J.transpose();
  return ground;
}

void RollingContactOptions::Check() const {
  carcass.Check();
  ground.Check();
  rotation.Check();
  patch.Check();
  slip.Check();
  deformation.Check();
  if (subset_px < 3) throw UsageError("The survey's subset has to be known.");
}

RollingContact FindRollingContact(const WheelReference& reference, const RollingWheel& rolling,
                                  const RollingContactOptions& options) {
  options.Check();
  if (reference.rig.modes.count() < options.carcass.mode_count()) {
    throw std::invalid_argument("FindRollingContact: a carcass with a sigma, a wheel without it");
  }
  return ContactOfRun(reference, rolling, options).Find();
}

}  // namespace plumbline
