#include "apps/internal/surface_records.h"

#include <cmath>
#include <limits>
#include <utility>

#include "calib/parallel.h"

namespace plumbline::internal {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
const Eigen::Vector3f kNoVector = Eigen::Vector3f::Constant(kNone);
using Vector6f = Eigen::Matrix<float, 6, 1>;

Eigen::Vector3f SigmaOf(const Vector6f& cov) {
  return Eigen::Vector3f(cov[0], cov[3], cov[5]).cwiseMax(0).cwiseSqrt();
}

Eigen::Vector3d SigmaOf(const Eigen::Matrix<double, 6, 6>& cov, int first) {
  return cov.diagonal().segment<3>(first).cwiseMax(0).cwiseSqrt();
}

}  // namespace

Surface SurfaceRecordOf(const StereoSurface& surface, const SurfaceState& instant,
                        const Image<Vector6f>& cov_mm2, const StereoField& field,
                        SurfaceFrame frame, bool with_covariance) {
  Surface out;
  const ImageSize size = surface.status.size();
  out.position_mm = Image<Eigen::Vector3f>(size, kNoVector);
  out.sigma_random_mm = Image<Eigen::Vector3f>(size, kNoVector);
  out.sigma_calibration_mm = CalibrationSigma(instant);
  out.correlation = Image<float>(size, kNone);
  out.epipolar_px = surface.epipolar_px;
  out.status = surface.status;
  out.frame = frame;
  if (with_covariance) out.cov_random_mm2 = cov_mm2;
  ForEachIndex(out.status.pixel_count(), [&](std::size_t i) {
    if (out.status.data()[i] != Status::kOk) return;
    out.position_mm.data()[i] = instant.point_mm.data()[i].cast<float>();
    out.sigma_random_mm.data()[i] = SigmaOf(cov_mm2.data()[i]);
    out.correlation.data()[i] = std::min(field.left.zncc.data()[i], field.right.zncc.data()[i]);
  });
  return out;
}

MatchField MatchRecordOf(const StereoField& field) {
  MatchField record;
  const ImageSize size = field.left.size();
  // Of points that both images were matched at.
  const auto displacements = [&](const PlanarField& match) {
    Image<Eigen::Vector2f> out(size, Eigen::Vector2f::Constant(kNone));
    for (std::size_t i = 0; i < out.pixel_count(); ++i) {
      if (field.left.status.data()[i] != Status::kOk) continue;
      if (field.right.status.data()[i] != Status::kOk) continue;
      out.data()[i] = match.displacement_px.data()[i].cast<float>();
    }
    return out;
  };
  record.left_displacement_px = displacements(field.left);
  record.right_displacement_px = displacements(field.right);
  record.left_gradient = field.left.gradient;
  record.right_gradient = field.right.gradient;
  record.left_cov_px2 = field.left.cov_displacement_px2;
  record.right_cov_px2 = field.right.cov_displacement_px2;
  record.left_reference_share = field.left.reference_share;
  record.right_reference_share = field.right.reference_share;
  return record;
}

void NameAs(const SeriesFrame& frame, SeriesFrame* same) {
  same->index = frame.index;
  same->time_s = frame.time_s;
  same->left_id = frame.left_id;
  same->right_id = frame.right_id;
  same->dropped_before = frame.dropped_before;
}

StereoField FieldOf(const MatchField& record, const Image<Status>& status,
                    const PlanarField& like) {
  Image<Status> matched = status;
  for (std::size_t i = 0; i < matched.pixel_count(); ++i) {
    if (record.left_displacement_px.data()[i].allFinite() &&
        record.right_displacement_px.data()[i].allFinite()) {
      matched.data()[i] = Status::kOk;
    }
  }
  const auto match = [&](const Image<Eigen::Vector2f>& displacement,
                         const Image<Eigen::Matrix2f>& gradient, const Image<Eigen::Vector3f>& cov,
                         const Image<float>& share) {
    PlanarField field(status.size(), like.first_px, like.step_px);
    field.subset_px = like.subset_px;
    field.order = like.order;
    field.status = matched;
    for (std::size_t i = 0; i < status.pixel_count(); ++i) {
      field.displacement_px.data()[i] = displacement.data()[i].cast<double>();
    }
    field.gradient = gradient;
    field.cov_displacement_px2 = cov;
    field.reference_share = share;
    return field;
  };
  StereoField field;
  field.left = match(record.left_displacement_px, record.left_gradient, record.left_cov_px2,
                     record.left_reference_share);
  field.right = match(record.right_displacement_px, record.right_gradient, record.right_cov_px2,
                      record.right_reference_share);
  return field;
}

DisplacementField DisplacementRecordOf(const SurfaceMotion& motion) {
  DisplacementField out;
  const ImageSize size = motion.value_mm.size();
  out.value_mm = Image<Eigen::Vector3f>(size, kNoVector);
  out.sigma_random_mm = Image<Eigen::Vector3f>(size, kNoVector);
  out.sigma_calibration_mm = motion.sigma_calibration_mm;
  ForEachIndex(out.value_mm.pixel_count(), [&](std::size_t i) {
    out.value_mm.data()[i] = motion.value_mm.data()[i].cast<float>();
    out.sigma_random_mm.data()[i] = SigmaOf(motion.cov_random_mm2.data()[i]);
  });
  return out;
}

VelocityField VelocityRecordOf(const SurfaceMotion& motion, double seconds) {
  DisplacementField moved = DisplacementRecordOf(motion);
  const auto per_second = static_cast<float>(1 / seconds);
  VelocityField out{std::move(moved.value_mm), std::move(moved.sigma_random_mm),
                    std::move(moved.sigma_calibration_mm)};
  for (auto* image : {&out.value_mm_s, &out.sigma_random_mm_s, &out.sigma_calibration_mm_s}) {
    ForEachIndex(image->pixel_count(), [&](std::size_t i) { image->data()[i] *= per_second; });
  }
  return out;
}

RigidMotionRecord RigidRecordOf(const SurfaceRigidMotion& rigid) {
  RigidMotionRecord record;
  record.found = rigid.found;
  if (!rigid.found) {
    record.problem = "too few points, or all of them on a line";
    return record;
  }
  record.rotation_rad = rigid.motion.RotationVector();
  record.translation_mm = rigid.motion * rigid.about_mm - rigid.about_mm;
  record.sigma_random_rotation_rad = SigmaOf(rigid.cov_random, 0);
  record.sigma_random_translation_mm = SigmaOf(rigid.cov_random, 3);
  record.sigma_calibration_rotation_rad = SigmaOf(rigid.cov_calibration, 0);
  record.sigma_calibration_translation_mm = SigmaOf(rigid.cov_calibration, 3);
  return record;
}

StrainField StrainRecordOf(AdaptiveStrain adaptive) {
  StrainField out;
  SurfaceStrain& strain = adaptive.strain;
  out.window_points = std::move(adaptive.window_points);
  out.sigma_model = std::move(adaptive.sigma_model);
  out.sigma_random = Image<Eigen::Vector3f>(strain.size(), kNoVector);
  ForEachIndex(strain.strain.pixel_count(), [&](std::size_t i) {
    out.sigma_random.data()[i] = SigmaOf(strain.cov_strain.data()[i]);
  });
  out.value = std::move(strain.strain);
  out.status = std::move(strain.status);
  out.cov_random = std::move(strain.cov_strain);
  out.sigma_calibration = std::move(strain.sigma_calibration);
  out.sigma_random_principal = std::move(strain.sigma_principal_random);
  out.sigma_calibration_principal = std::move(strain.sigma_principal_calibration);
  out.sigma_random_angle_rad = std::move(strain.sigma_angle_random_rad);
  out.sigma_calibration_angle_rad = std::move(strain.sigma_angle_calibration_rad);
  out.sigma_random_max_shear = std::move(strain.sigma_max_shear_random);
  out.sigma_calibration_max_shear = std::move(strain.sigma_max_shear_calibration);
  out.sigma_random_von_mises = std::move(strain.sigma_von_mises_random);
  out.sigma_calibration_von_mises = std::move(strain.sigma_von_mises_calibration);
  return out;
}

DisplacementField AtRest(const Image<Status>& status) {
  Image<Eigen::Vector3f> zero(status.size(), kNoVector);
  for (std::size_t i = 0; i < status.pixel_count(); ++i) {
    if (status.data()[i] == Status::kOk) zero.data()[i].setZero();
  }
  return {zero, zero, zero};
}

void ForgetNoise(StrainField& strain) {
  for (std::size_t i = 0; i < strain.status.pixel_count(); ++i) {
    if (strain.status.data()[i] != Status::kOk) continue;
    strain.value.data()[i].setZero();
    strain.sigma_random.data()[i].setZero();
    strain.sigma_calibration.data()[i].setZero();
    strain.cov_random.data()[i].setZero();
    if (!strain.sigma_model.empty()) strain.sigma_model.data()[i].setZero();
  }
  const auto none = [](auto&... images) { ((images = {}), ...); };
  none(strain.sigma_random_principal, strain.sigma_calibration_principal,
       strain.sigma_random_angle_rad, strain.sigma_calibration_angle_rad,
       strain.sigma_random_max_shear, strain.sigma_calibration_max_shear,
       strain.sigma_random_von_mises, strain.sigma_calibration_von_mises);
}

}  // namespace plumbline::internal
