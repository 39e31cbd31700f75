#include "track/internal/patch_in_ground.h"

#include <algorithm>

namespace plumbline::internal {

InGround::InGround(const PatchFrame& frame, const Rigid3& ground_from_rig,
                   const Image<Eigen::Vector3f>* along)
    : position_mm(frame.point_mm),
      undeformed_mm(frame.undeformed_mm),
      thickness_mm(&frame.thickness_mm) {
  for (std::size_t i = 0; i < position_mm.pixel_count(); ++i) {
    const Eigen::Vector3d change =
        along == nullptr ? Eigen::Vector3d::Zero().eval() : along->data()[i].cast<double>().eval();
    position_mm.data()[i] = ground_from_rig * (position_mm.data()[i] + change);
    undeformed_mm.data()[i] = ground_from_rig * (undeformed_mm.data()[i] + change);
  }
}

FramesOnGround::FramesOnGround(std::span<const PatchFrame> frames, const WheelAxis& axis,
                               const CarcassThickness& carcass)
    : axis_(axis) {
  for (const PatchFrame& frame : frames) {
    if (frame.rotation.from != RigRotationFrame::From::kPlane || !frame.rotation.found) continue;
    frames_.push_back(&frame);
    in_ground_.emplace_back(frame, frame.rotation.ground.frame_from_rig);
  }
  if (carcass.uncertain_map()) SetCarcass(carcass);
}

void FramesOnGround::SetCarcass(const CarcassThickness& carcass) {
  thickness_mm_.clear();
  shares_.clear();
  for (const PatchFrame* frame : frames_) {
    thickness_mm_.push_back(ThicknessOver(carcass, frame->undeformed_mm, axis_));
    shares_.push_back(ThicknessSharesOver(carcass, frame->undeformed_mm, axis_));
  }
}

bool FramesOnGround::Holds(const LiftOffLaw& law, const PatchSeriesOptions& options) const {
  const std::vector<LiftOffFrame> all = ForLiftOff();
  return std::any_of(all.begin(), all.end(), [&](const LiftOffFrame& frame) {
    return FindLiftOffLine(frame, law, options.sigma_mm, options.correlation_area_points,
                           options.lift_off)
        .has_value();
  });
}

std::vector<LiftOffFrame> FramesOnGround::ForLiftOff() const {
  std::vector<LiftOffFrame> all;
  for (std::size_t f = 0; f < in_ground_.size(); ++f) {
    LiftOffFrame& frame = all.emplace_back(in_ground_[f].ForLiftOff());
    if (shares_.empty()) continue;
    frame.thickness_mm = &thickness_mm_[f];
    frame.shares = &shares_[f];
  }
  return all;
}

}  // namespace plumbline::internal
