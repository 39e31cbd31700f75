#include "track/rolling_contact.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "match/correlation_area.h"
#include "match/neighbour_correlation.h"
#include "track/internal/axis_along_modes.h"
#include "track/internal/finite_differences.h"
#include "track/internal/frame_points.h"
#include "track/internal/turning_over_ground.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

using internal::FramePoints;

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
        axes_(internal::AxesAlongModes(reference)),
        points_(reference, rolling, axes_),
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
  FramePoints PointsOf(std::size_t f) const {
    FramePoints points = points_.Of(f, options_.carcass);
    points.time_s = TimeOf(f);
    return points;
  }
  GroundObservation Observe(std::size_t f) const;
  std::vector<PoseObservation> ObserveAll() const;
  void TurnByHand(RollingContact* contact) const;
  void FindGround(RollingContact* contact) const;
  std::vector<PatchFrame> PatchFramesOf(const RollingContact& contact) const;
  void CorrectCarcass(RollingContact* contact);
  void FindPatchesOf(RollingContact* contact) const;
  void SetSigma();
  bool KnownOverGround(std::size_t f, const RollingContact& contact) const {
    return f < rolling_.frames.size() && Placed(f) && contact.frames[f].rotation.found;
  }
  std::optional<FrameOverGround> OverGround(std::size_t f, const RollingContact& contact) const;
  Image<std::uint8_t> InContact(const FramePoints& points, const RollingContactFrame& frame) const;
  void Deform(std::size_t f, const FrameOverGround& now, RollingContactFrame* out) const;
  void Slip(std::size_t f, FrameTriple frames, RollingContact* contact) const;
  void MoveToEnd(std::size_t first, std::size_t f, std::size_t last, RollingContact* contact) const;
  bool Placed(std::size_t f) const {
    return rolling_.frames[f].status == RollingFrameStatus::kPlaced;
  }
  double TimeOf(std::size_t f) const {
    const RollingFrame& frame = rolling_.frames[f];
    return clock_ ? frame.time_s : static_cast<double>(frame.index);
  }
  void CountChangesOfSpeed(RollingContact* contact) const;
  void CountTurnsAtEnds(RollingContact* contact) const;
  double SigmaOf(std::size_t f) const;

  const WheelReference& reference_;
  const RollingWheel& rolling_;
  RollingContactOptions options_;
  std::vector<WheelAxis> axes_;  // along the modes
  internal::PointsOfFrames points_;
  NeighbourCorrelation neighbours_;
  bool clock_ = true;
};

// Of the points, along the ground's normal: about along the rig's z.
double ContactOfRun::SigmaOf(std::size_t f) const {
  std::vector<double> sigmas;
  for (const RollingPoint& p : rolling_.frames[f].points) {
    if (p.cov_random_mm2.allFinite()) sigmas.push_back(std::sqrt(p.cov_random_mm2[5]));
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
                        .sigma_mm = SigmaOf(f),
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

void ContactOfRun::FindGround(RollingContact* contact) const {
  const RigRotation rotation =
      SmoothRigRotation(ObserveAll(), reference_.axis, axes_, options_.rotation);
  contact->found = rotation.found;
  contact->problem = rotation.problem;
  for (std::size_t f = 0; f < contact->frames.size(); ++f) {
    contact->frames[f].rotation = rotation.frames[f];
  }
}

// Of those that are placed.
std::vector<PatchFrame> ContactOfRun::PatchFramesOf(const RollingContact& contact) const {
  std::vector<PatchFrame> frames;
  for (std::size_t f = 0; f < rolling_.frames.size(); ++f) {
    if (!Placed(f)) continue;
    FramePoints points = PointsOf(f);
    frames.push_back({.point_mm = std::move(points.now.point_mm),
                      .undeformed_mm = std::move(points.undeformed.point_mm),
                      .thickness_mm = std::move(points.thickness_mm),
                      .cov_mm2 = std::move(points.cov_mm2),
                      .along_modes_mm = std::move(points.now.along_modes_mm),
                      .rotation = contact.frames[f].rotation,
                      .thickness_along_modes = std::move(points.thickness_along_modes),
                      .along_pose_mm = std::move(points.along_pose_mm)});
  }
  return frames;
}

// By what touches the ground; the ground is then found anew.
void ContactOfRun::CorrectCarcass(RollingContact* contact) {
  const std::vector<PatchFrame> frames = PatchFramesOf(*contact);
  contact->carcass_check = CheckCarcass(frames, reference_.axis, options_.carcass, options_.patch);
  if (!options_.carcass.uncertain_map()) return;
  options_.carcass = EstimateCarcass(frames, reference_.axis, options_.carcass, options_.patch);
  if (options_.carcass.modes_mm.size() > 0) FindGround(contact);
}

void ContactOfRun::FindPatchesOf(RollingContact* contact) const {
  const std::vector<PatchFrame> frames = PatchFramesOf(*contact);
  if (frames.empty()) return;
  PatchSeriesOptions options = options_.patch;
  options.carcass = options_.carcass;
  PatchSeries series = FindPatches(frames, reference_.axis, neighbours_, options);
  contact->law = series.law;
  std::size_t i = 0;
  for (std::size_t f = 0; f < rolling_.frames.size(); ++f) {
    if (Placed(f)) contact->frames[f].patch = std::move(series.frames[i++]);
  }
}

// Of all frames.
void ContactOfRun::SetSigma() {
  std::vector<double> sigmas;
  for (std::size_t f = 0; f < rolling_.frames.size(); ++f) {
    if (Placed(f)) sigmas.push_back(SigmaOf(f));
  }
  if (!sigmas.empty()) options_.patch.sigma_mm = Median(std::move(sigmas));
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
  if (!KnownOverGround(f, contact)) return std::nullopt;
  FramePoints points = PointsOf(f);
  FrameOverGround out;
  MaterialFrame& frame = out.material;
  frame.time_s = points.time_s;
  frame.contact = InContact(points, contact.frames[f]);
  frame.points = std::move(points.now);
  frame.along_own_mm = std::move(points.along_pose_mm);
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

// Of the frames from `first` to `last`, with it.
std::vector<RigRotationFrame> PosesOf(std::size_t first, std::size_t last,
                                      const RollingContact& contact) {
  std::vector<RigRotationFrame> poses;
  for (std::size_t k = first; k <= last; ++k) poses.push_back(contact.frames[k].rotation);
  return poses;
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
  const std::vector<RigRotationFrame> grounds = PosesOf(first, last, *contact);
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
  std::vector<double> times;
  for (const RigRotationFrame& ground : grounds) times.push_back(ground.time_s);
  const std::vector<double> weights = internal::SlopeWeights(times, f - first);
  wheel.speed_rad_s = internal::TurningOverGround(rolling_, first, f, grounds, weights);
  wheel.speed_along_common_rad_s =
      Eigen::RowVectorXd::Zero(static_cast<Eigen::Index>(velocity.along_common_mm_s.size()));
  for (std::size_t k = 0; k < weights.size(); ++k) {
    wheel.speed_along_common_rad_s.head(root.cols()) -=
        weights[k] * root.row(3 * static_cast<Eigen::Index>(k));
  }
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
  if (first == f || last == f) MoveToEnd(first, f, last, contact);
}

// From one neighbour alone the velocity is that of half-way to it.
void ContactOfRun::MoveToEnd(std::size_t first, std::size_t f, std::size_t last,
                             RollingContact* contact) const {
  const std::size_t from = last == f && first > 0 ? first - 1 : first;
  const std::size_t to = first == f && last + 1 < contact->frames.size() ? last + 1 : last;
  const internal::SpeedRatio then =
      internal::SpeedAtEnd(rolling_, first, f, last, PosesOf(from, to, *contact));
  RollingSlip& slip = contact->frames[f].slip;
  slip.speed_mm_s.value *= then.value;
  slip.speed_mm_s.sigma_random =
      std::hypot(slip.speed_mm_s.sigma_random, slip.speed_mm_s.value * then.sigma);
  slip.velocity_mm_s *= then.value;
}

// What a parabola through three places leaves out of the speed at the middle one: the second
// derivative of the speed, as the frames beside tell it, times the product of both intervals over
// six. Counted as an error: how the speed changes is known no better.
void ContactOfRun::CountChangesOfSpeed(RollingContact* contact) const {
  std::vector<double> left_out(contact->frames.size(), 0);
  for (std::size_t f = 1; f + 1 < contact->frames.size(); ++f) {
    const RollingSlip &before = contact->frames[f - 1].slip, &now = contact->frames[f].slip,
                      &after = contact->frames[f + 1].slip;
    if (!before.found || !now.found || !after.found) continue;
    const std::array<double, 3> bend =
        internal::BendWeights({TimeOf(f - 1), TimeOf(f), TimeOf(f + 1)});
    left_out[f] = (bend[0] * before.speed_mm_s.value + bend[1] * now.speed_mm_s.value +
                   bend[2] * after.speed_mm_s.value) *
                  (TimeOf(f) - TimeOf(f - 1)) * (TimeOf(f + 1) - TimeOf(f)) / 6;
  }
  for (std::size_t f = 0; f < left_out.size(); ++f) {
    double& sigma = contact->frames[f].slip.speed_mm_s.sigma_random;
    sigma = std::hypot(sigma, left_out[f]);
  }
}

// From one neighbour alone the direction of the velocity, too, is that of half-way to it. By how
// much the neighbour's is another counts as an error.
void ContactOfRun::CountTurnsAtEnds(RollingContact* contact) const {
  std::vector<double> turned(contact->frames.size(), 0);
  for (std::size_t f = 0; f < turned.size(); ++f) {
    const bool before = f > 0 && KnownOverGround(f - 1, *contact);
    if (before == KnownOverGround(f + 1, *contact)) continue;
    const RollingSlip &here = contact->frames[f].slip,
                      &beside = contact->frames[before ? f - 1 : f + 1].slip;
    if (!here.found || !beside.found) continue;
    turned[f] = beside.slip_angle_rad.value - here.slip_angle_rad.value;
  }
  for (std::size_t f = 0; f < turned.size(); ++f) {
    double& sigma = contact->frames[f].slip.slip_angle_rad.sigma_random;
    sigma = std::hypot(sigma, turned[f]);
  }
}

RollingContact ContactOfRun::Find() {
  const std::size_t count = rolling_.frames.size();
  RollingContact contact;
  contact.frames.resize(count);
  for (const RollingFrame& frame : rolling_.frames) clock_ = clock_ && std::isfinite(frame.time_s);
  SetSigma();
  if (options_.manual_turns_deg) {
    TurnByHand(&contact);
  } else {
    FindGround(&contact);
    CorrectCarcass(&contact);
  }
  contact.carcass = options_.carcass;
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
  if (clock_) {
    CountChangesOfSpeed(&contact);
    CountTurnsAtEnds(&contact);
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

std::vector<GroundPitch> GroundPitchesOf(const RollingContact& contact) {
  constexpr double kStill_rad = 0.01 * std::numbers::pi / 180;
  double low = std::numeric_limits<double>::infinity(), high = -low;
  std::vector<std::size_t> known;
  for (std::size_t f = 0; f < contact.frames.size(); ++f) {
    const RigRotationFrame& rotation = contact.frames[f].rotation;
    if (!rotation.found || !rotation.known[0]) continue;
    known.push_back(f);
    low = std::min(low, rotation.pose[0]);
    high = std::max(high, rotation.pose[0]);
  }
  if (!(high - low > kStill_rad)) return {};
  std::vector<GroundPitch> pitch;
  for (std::size_t f = 0; f < contact.frames.size(); ++f) {
    const auto next = std::lower_bound(known.begin(), known.end(), f);
    std::size_t nearest = next == known.end() ? known.back() : *next;
    if (next != known.begin() && f - *(next - 1) < nearest - f) nearest = *(next - 1);
    const RigRotationFrame& rotation = contact.frames[nearest].rotation;
    pitch.push_back(
        {rotation.pose[0], nearest == f ? std::sqrt(rotation.cov_random(0, 0)) : high - low});
  }
  return pitch;
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
