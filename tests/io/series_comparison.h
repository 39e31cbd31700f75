#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "io/series_writer.h"

namespace plumbline::testing {

template <typename Element>
void ExpectSameBits(const Image<Element>& a, const Image<Element>& b) {
  ASSERT_EQ(a.size(), b.size());
  if (a.empty()) return;  // nothing there: memcmp may not be given null
  EXPECT_EQ(std::memcmp(a.data(), b.data(), a.pixel_count() * sizeof(Element)), 0);
}

// Equal, or both no number: NaN patterns may differ.
inline void ExpectSame(double a, double b) {
  if (std::isnan(a) && std::isnan(b)) return;
  EXPECT_EQ(a, b);
}
template <typename A, typename B>
void ExpectSame(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
  for (Eigen::Index i = 0; i < a.size(); ++i) {
    ExpectSame(static_cast<double>(a.derived().data()[i]),
               static_cast<double>(b.derived().data()[i]));
  }
}
template <typename Element>
void ExpectSamePoints(const Image<Element>& a, const Image<Element>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.pixel_count(); ++i) ExpectSame(a.data()[i], b.data()[i]);
}

inline void ExpectSameGround(const GroundRecord& a, const GroundRecord& b) {
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  if (!a.found) return;
  EXPECT_EQ(a.normal_in_rig, b.normal_in_rig);
  EXPECT_EQ(a.offset_mm, b.offset_mm);
  EXPECT_EQ(a.cov_random, b.cov_random);
  ExpectSame(a.cov_calibration, b.cov_calibration);
  EXPECT_EQ(a.ground_from_rig.Matrix(), b.ground_from_rig.Matrix());
  ExpectSame(a.rms_mm, b.rms_mm);
  ExpectSame(a.inlier_fraction, b.inlier_fraction);
  EXPECT_EQ(a.e1_in_rig, b.e1_in_rig);
  EXPECT_EQ(a.e2_in_rig, b.e2_in_rig);
  EXPECT_EQ(a.centroid_in_rig_mm, b.centroid_in_rig_mm);
}

inline void ExpectSameWheel(const WheelRecord& a, const WheelRecord& b) {
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  ExpectSame(a.axis, b.axis);
  ExpectSame(a.centre_mm, b.centre_mm);
  ExpectSame(a.radius_mm, b.radius_mm);
  ExpectSame(a.angle_rad, b.angle_rad);
  ExpectSame(a.speed_rad_s, b.speed_rad_s);
  ExpectSame(a.cov_axis_random, b.cov_axis_random);
  ExpectSame(a.cov_axis_calibration, b.cov_axis_calibration);
  ExpectSame(a.sigma_random_centre_mm, b.sigma_random_centre_mm);
  ExpectSame(a.sigma_calibration_centre_mm, b.sigma_calibration_centre_mm);
  ExpectSame(a.sigma_random_radius_mm, b.sigma_random_radius_mm);
  ExpectSame(a.sigma_calibration_radius_mm, b.sigma_calibration_radius_mm);
  ExpectSame(a.sigma_random_angle_rad, b.sigma_random_angle_rad);
  ExpectSame(a.sigma_calibration_angle_rad, b.sigma_calibration_angle_rad);
  ExpectSame(a.sigma_random_speed_rad_s, b.sigma_random_speed_rad_s);
  ExpectSame(a.sigma_calibration_speed_rad_s, b.sigma_calibration_speed_rad_s);
}

inline void ExpectSamePatch(const PatchRecord& a, const PatchRecord& b) {
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  ExpectSame(a.area_mm2, b.area_mm2);
  ExpectSame(a.length_mm, b.length_mm);
  ExpectSame(a.width_mm, b.width_mm);
  ExpectSame(a.centroid_mm, b.centroid_mm);
  ExpectSame(a.sigma_random_area_mm2, b.sigma_random_area_mm2);
  ExpectSame(a.sigma_calibration_area_mm2, b.sigma_calibration_area_mm2);
  ExpectSame(a.sigma_random_length_mm, b.sigma_random_length_mm);
  ExpectSame(a.sigma_calibration_length_mm, b.sigma_calibration_length_mm);
  ExpectSame(a.sigma_random_width_mm, b.sigma_random_width_mm);
  ExpectSame(a.sigma_calibration_width_mm, b.sigma_calibration_width_mm);
  ExpectSame(a.sigma_random_centroid_mm, b.sigma_random_centroid_mm);
  ExpectSame(a.sigma_calibration_centroid_mm, b.sigma_calibration_centroid_mm);
  ExpectSame(a.threshold_mm, b.threshold_mm);
  ExpectSame(a.d_area_d_threshold_mm, b.d_area_d_threshold_mm);
  EXPECT_EQ(a.contour_mm, b.contour_mm);
}

inline void ExpectSameSlip(const SlipRecord& a, const SlipRecord& b) {
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  ExpectSame(a.ratio, b.ratio);
  ExpectSame(a.angle_rad, b.angle_rad);
  ExpectSame(a.sigma_random_ratio, b.sigma_random_ratio);
  ExpectSame(a.sigma_calibration_ratio, b.sigma_calibration_ratio);
  ExpectSame(a.sigma_random_angle_rad, b.sigma_random_angle_rad);
  ExpectSame(a.sigma_calibration_angle_rad, b.sigma_calibration_angle_rad);
  for (const auto member :
       {&SlipRecord::speed_mm_s, &SlipRecord::effective_radius_mm, &SlipRecord::ratio_by_channel,
        &SlipRecord::sigma_random_speed_mm_s, &SlipRecord::sigma_calibration_speed_mm_s,
        &SlipRecord::sigma_random_effective_radius_mm,
        &SlipRecord::sigma_calibration_effective_radius_mm,
        &SlipRecord::sigma_random_ratio_by_channel, &SlipRecord::sigma_calibration_ratio_by_channel,
        &SlipRecord::sticking, &SlipRecord::sliding, &SlipRecord::undecided}) {
    ExpectSame(a.*member, b.*member);
  }
  ExpectSamePoints(a.velocity_mm_s, b.velocity_mm_s);
  ExpectSamePoints(a.sigma_random_mm_s, b.sigma_random_mm_s);
  ExpectSamePoints(a.sigma_calibration_mm_s, b.sigma_calibration_mm_s);
}

inline void ExpectSameRigRotation(const RigRotationRecord& a, const RigRotationRecord& b) {
  using R = RigRotationRecord;
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  for (const auto member :
       {&R::pitch_rad, &R::roll_rad, &R::height_mm, &R::lean, &R::sigma_random_pitch_rad,
        &R::sigma_calibration_pitch_rad, &R::sigma_random_roll_rad, &R::sigma_calibration_roll_rad,
        &R::sigma_random_height_mm, &R::sigma_calibration_height_mm}) {
    ExpectSame(a.*member, b.*member);
  }
}

inline void ExpectSameDeformation(const DeformationRecord& a, const DeformationRecord& b) {
  using D = DeformationRecord;
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  for (const auto member :
       {&D::loaded_radius_mm, &D::deflection_mm, &D::longitudinal_mm, &D::lateral_mm, &D::radial_mm,
        &D::sigma_random_loaded_radius_mm, &D::sigma_calibration_loaded_radius_mm,
        &D::sigma_random_deflection_mm, &D::sigma_calibration_deflection_mm,
        &D::sigma_random_longitudinal_mm, &D::sigma_calibration_longitudinal_mm,
        &D::sigma_random_lateral_mm, &D::sigma_calibration_lateral_mm, &D::sigma_random_radial_mm,
        &D::sigma_calibration_radial_mm}) {
    ExpectSame(a.*member, b.*member);
  }
  ExpectSame(a.radial_at_mm, b.radial_at_mm);
}

inline void ExpectSamePlacement(const PlacementRecord& a, const PlacementRecord& b) {
  using P = PlacementRecord;
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  for (const auto member :
       {&P::placed_by, &P::tags, &P::rim_tags, &P::unknown_tags, &P::tag_angle_rad, &P::twist_rad,
        &P::sigma_random_twist_rad, &P::sigma_calibration_twist_rad}) {
    ExpectSame(a.*member, b.*member);
  }
}

inline void ExpectSameRigidMotion(const RigidMotionRecord& a, const RigidMotionRecord& b) {
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  ExpectSame(a.rotation_rad, b.rotation_rad);
  ExpectSame(a.translation_mm, b.translation_mm);
  ExpectSame(a.sigma_random_rotation_rad, b.sigma_random_rotation_rad);
  ExpectSame(a.sigma_calibration_rotation_rad, b.sigma_calibration_rotation_rad);
  ExpectSame(a.sigma_random_translation_mm, b.sigma_random_translation_mm);
  ExpectSame(a.sigma_calibration_translation_mm, b.sigma_calibration_translation_mm);
}

inline void ExpectSameRigWatch(const RigWatchRecord& a, const RigWatchRecord& b) {
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  ExpectSame(a.epipolar_mean_px, b.epipolar_mean_px);
  ExpectSame(a.epipolar_rms_px, b.epipolar_rms_px);
  ExpectSame(a.epipolar_sigma_px, b.epipolar_sigma_px);
  ExpectSame(a.chi2_calibration, b.chi2_calibration);
  ExpectSame(a.chi2_first, b.chi2_first);
  ExpectSame(a.change, b.change);
  ExpectSame(a.sigma_random_change, b.sigma_random_change);
  ExpectSame(a.sigma_calibration_change, b.sigma_calibration_change);
  EXPECT_EQ(a.refined, b.refined);
  EXPECT_EQ(a.alarm, b.alarm);
  EXPECT_EQ(a.right_from_left.Matrix(), b.right_from_left.Matrix());
}

// An optional image that is empty reads back as NaN.
template <typename Element>
void ExpectSameOrNaN(const Image<Element>& a, const Image<Element>& b) {
  if (!a.empty()) return ExpectSamePoints(a, b);
  for (const Element& value : b.values()) EXPECT_NE(value, value);
}

inline void ExpectSameStrain(const StrainField& a, const StrainField& b) {
  ExpectSamePoints(a.value, b.value);
  ExpectSamePoints(a.sigma_random, b.sigma_random);
  ExpectSamePoints(a.sigma_calibration, b.sigma_calibration);
  ExpectSamePoints(a.sigma_model, b.sigma_model);
  ExpectSameOrNaN(a.window_points, b.window_points);
  ExpectSamePoints(a.cov_random, b.cov_random);
  ExpectSameBits(a.status, b.status);
  ExpectSameOrNaN(a.sigma_random_principal, b.sigma_random_principal);
  ExpectSameOrNaN(a.sigma_calibration_principal, b.sigma_calibration_principal);
  ExpectSameOrNaN(a.sigma_random_angle_rad, b.sigma_random_angle_rad);
  ExpectSameOrNaN(a.sigma_calibration_angle_rad, b.sigma_calibration_angle_rad);
  ExpectSameOrNaN(a.sigma_random_max_shear, b.sigma_random_max_shear);
  ExpectSameOrNaN(a.sigma_calibration_max_shear, b.sigma_calibration_max_shear);
  ExpectSameOrNaN(a.sigma_random_von_mises, b.sigma_random_von_mises);
  ExpectSameOrNaN(a.sigma_calibration_von_mises, b.sigma_calibration_von_mises);
}

inline void ExpectSameMatch(const MatchField& a, const MatchField& b) {
  ExpectSamePoints(a.left_displacement_px, b.left_displacement_px);
  ExpectSamePoints(a.right_displacement_px, b.right_displacement_px);
  ExpectSamePoints(a.left_gradient, b.left_gradient);
  ExpectSamePoints(a.right_gradient, b.right_gradient);
  ExpectSamePoints(a.left_cov_px2, b.left_cov_px2);
  ExpectSamePoints(a.right_cov_px2, b.right_cov_px2);
  ExpectSamePoints(a.left_reference_share, b.left_reference_share);
  ExpectSamePoints(a.right_reference_share, b.right_reference_share);
}

inline void ExpectSameSurvey(const SurveyRecord& a, const SurveyRecord& b) {
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.problem, b.problem);
  EXPECT_EQ(a.tags, b.tags);
  for (const auto member :
       {&SurveyRecord::view, &SurveyRecord::near_rad, &SurveyRecord::spacing_px}) {
    ExpectSame(a.*member, b.*member);
  }
  ExpectSameMatch(a.match, b.match);
}

// That b is what a reads back as: points without a value are NaN in all.
inline void ExpectSameFrame(const SeriesFrame& a, const SeriesFrame& b) {
  EXPECT_EQ(a.index, b.index);
  EXPECT_EQ(a.time_s, b.time_s);
  EXPECT_EQ(a.left_id, b.left_id);
  EXPECT_EQ(a.right_id, b.right_id);
  EXPECT_EQ(a.problem, b.problem);
  EXPECT_EQ(a.dropped_before, b.dropped_before);
  EXPECT_EQ(a.surface.frame, b.surface.frame);
  ExpectSameBits(a.surface.status, b.surface.status);
  ASSERT_EQ(a.surface.position_mm.size(), b.surface.position_mm.size());
  for (std::size_t i = 0; i < a.surface.status.pixel_count(); ++i) {
    if (a.surface.status.data()[i] != Status::kOk) {
      EXPECT_TRUE(b.surface.position_mm.data()[i].array().isNaN().all());
      EXPECT_TRUE(b.surface.sigma_random_mm.data()[i].array().isNaN().all());
      continue;
    }
    EXPECT_EQ(a.surface.position_mm.data()[i], b.surface.position_mm.data()[i]);
    EXPECT_EQ(a.surface.sigma_random_mm.data()[i], b.surface.sigma_random_mm.data()[i]);
    EXPECT_EQ(a.surface.sigma_calibration_mm.data()[i], b.surface.sigma_calibration_mm.data()[i]);
    EXPECT_EQ(a.surface.correlation.data()[i], b.surface.correlation.data()[i]);
    EXPECT_EQ(a.surface.epipolar_px.data()[i], b.surface.epipolar_px.data()[i]);
  }
  ExpectSamePoints(a.displacement.value_mm, b.displacement.value_mm);
  ExpectSamePoints(a.displacement.sigma_random_mm, b.displacement.sigma_random_mm);
  ExpectSamePoints(a.displacement.sigma_calibration_mm, b.displacement.sigma_calibration_mm);
  ExpectSameStrain(a.strain, b.strain);
  ExpectSameMatch(a.match, b.match);
  ExpectSamePoints(a.velocity.value_mm_s, b.velocity.value_mm_s);
  ExpectSamePoints(a.material.position_mm, b.material.position_mm);
  ExpectSamePoints(a.velocity.sigma_random_mm_s, b.velocity.sigma_random_mm_s);
  ExpectSamePoints(a.velocity.sigma_calibration_mm_s, b.velocity.sigma_calibration_mm_s);
  ExpectSameGround(a.ground, b.ground);
  ExpectSameWheel(a.wheel, b.wheel);
  ExpectSamePatch(a.patch, b.patch);
  ExpectSameSlip(a.slip, b.slip);
  ExpectSameRigidMotion(a.rigid_motion, b.rigid_motion);
  ExpectSameRigWatch(a.rig_watch, b.rig_watch);
  ExpectSameRigRotation(a.rig_rotation, b.rig_rotation);
  ExpectSameDeformation(a.deformation, b.deformation);
  ExpectSameSurvey(a.survey, b.survey);
  EXPECT_EQ(a.wheel_channel.found, b.wheel_channel.found);
  EXPECT_EQ(a.wheel_channel.problem, b.wheel_channel.problem);
  ExpectSame(a.wheel_channel.lean, b.wheel_channel.lean);
  ExpectSamePlacement(a.placement, b.placement);
}

}  // namespace plumbline::testing
