#pragma once

#include "io/internal/series_layout.h"

// Which image of a SeriesFrame holds what of a field of points.
namespace plumbline::internal {

// Calls visit(image) with the image that the field is stored from; not where the field follows from
// others. Frame: SeriesFrame or const SeriesFrame.
template <typename Frame, typename Visit>
void VisitImage(Frame& frame, const PointField& field, const Visit& visit);

// Of a vector with its two sigmas; false: of none of these.
template <typename Vectors, typename Visit>
bool VisitVectors(Vectors& value, Vectors& random, Vectors& calibration, PointPart part,
                  const Visit& visit) {
  if (part == PointPart::kValue) visit(value);
  if (part == PointPart::kRandom) visit(random);
  if (part == PointPart::kCalibration) visit(calibration);
  return part == PointPart::kValue || part == PointPart::kRandom || part == PointPart::kCalibration;
}

template <typename S, typename Visit>
void VisitSurface(S& surface, PointPart part, const Visit& visit) {
  if (VisitVectors(surface.position_mm, surface.sigma_random_mm, surface.sigma_calibration_mm, part,
                   visit)) {
    return;
  }
  if (part == PointPart::kCorrelation) visit(surface.correlation);
  if (part == PointPart::kEpipolar) visit(surface.epipolar_px);
  if (part == PointPart::kCovariance) visit(surface.cov_random_mm2);
  if (part == PointPart::kStatus) visit(surface.status);
}

template <typename S, typename Visit>
void VisitStrain(S& strain, PointPart part, const Visit& visit) {
  if (VisitVectors(strain.value, strain.sigma_random, strain.sigma_calibration, part, visit)) {
    return;
  }
  switch (part) {
    case PointPart::kStatus:
      return visit(strain.status);
    case PointPart::kCovariance:
      return visit(strain.cov_random);
    case PointPart::kModel:
      return visit(strain.sigma_model);
    case PointPart::kWindow:
      return visit(strain.window_points);
    case PointPart::kPrincipalRandom:
      return visit(strain.sigma_random_principal);
    case PointPart::kPrincipalCalibration:
      return visit(strain.sigma_calibration_principal);
    case PointPart::kPrincipalAngleRandom:
      return visit(strain.sigma_random_angle_rad);
    case PointPart::kPrincipalAngleCalibration:
      return visit(strain.sigma_calibration_angle_rad);
    case PointPart::kMaxShearRandom:
      return visit(strain.sigma_random_max_shear);
    case PointPart::kMaxShearCalibration:
      return visit(strain.sigma_calibration_max_shear);
    case PointPart::kVonMisesRandom:
      return visit(strain.sigma_random_von_mises);
    case PointPart::kVonMisesCalibration:
      return visit(strain.sigma_calibration_von_mises);
    default:
      return;
  }
}

template <typename M, typename Visit>
void VisitMatch(M& match, PointPart part, const Visit& visit) {
  switch (part) {
    case PointPart::kValue:
      return visit(match.left_displacement_px);
    case PointPart::kRightValue:
      return visit(match.right_displacement_px);
    case PointPart::kGradient:
      return visit(match.left_gradient);
    case PointPart::kRightGradient:
      return visit(match.right_gradient);
    case PointPart::kCovariance:
      return visit(match.left_cov_px2);
    case PointPart::kRightCovariance:
      return visit(match.right_cov_px2);
    case PointPart::kShare:
      return visit(match.left_reference_share);
    case PointPart::kRightShare:
      return visit(match.right_reference_share);
    default:
      return;
  }
}

template <typename Frame, typename Visit>
void VisitImage(Frame& frame, const PointField& field, const Visit& visit) {
  switch (field.group) {
    case kDisplacement: {
      auto& u = frame.displacement;
      VisitVectors(u.value_mm, u.sigma_random_mm, u.sigma_calibration_mm, field.part, visit);
      return;
    }
    case kSlip: {
      auto& v = frame.slip;
      VisitVectors(v.velocity_mm_s, v.sigma_random_mm_s, v.sigma_calibration_mm_s, field.part,
                   visit);
      return;
    }
    case kVelocity: {
      auto& v = frame.velocity;
      VisitVectors(v.value_mm_s, v.sigma_random_mm_s, v.sigma_calibration_mm_s, field.part, visit);
      return;
    }
    case kMatch:
      return VisitMatch(frame.match, field.part, visit);
    case kSurvey:
      return VisitMatch(frame.survey.match, field.part, visit);
    case kMaterial:
      if (field.part == PointPart::kValue) visit(frame.material.position_mm);
      return;
    case kStrain:
      return VisitStrain(frame.strain, field.part, visit);
    default:
      return VisitSurface(frame.surface, field.part, visit);
  }
}

}  // namespace plumbline::internal
