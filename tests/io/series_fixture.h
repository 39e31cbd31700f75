#pragma once

#include <cmath>
#include <limits>
#include <random>

#include "io/series_writer.h"

namespace plumbline::testing {

inline StereoRig SmallRig() {
  LensModel model;
  Eigen::VectorXd left(9), right(9);
  left << 500.1, 501.2, 320.3, 240.4, -0.1, 0.01, 1e-3, -1e-3, 1.0 / 3;
  right << 502.1, 503.2, 321.3, 241.4, -0.2, 0.02, 2e-3, -2e-3, 1.0 / 7;
  StereoRig rig{Camera(model, {640, 480}, left),
                Camera(model, {640, 480}, right),
                Rigid3::FromRotationVector({0.01, -0.3, 0.02}, {-123.25, 0.5, 20.0 / 3}),
                {},
                "chessboard:9x6:10mm"};
  std::mt19937 rng(1);
  std::normal_distribution<double> noise;
  rig.modes.modes = Eigen::MatrixXd::NullaryExpr(5, 24, [&] { return 1e-3 * noise(rng); });
  rig.modes.has_scale_mode = true;
  return rig;
}

inline SeriesHeader SmallHeader(ImageSize grid = {7, 5}) {
  SeriesHeader header{.rig = SmallRig(),
                      .grid_px = Image<Eigen::Vector2f>(grid, Eigen::Vector2f::Zero()),
                      .step_px = 4,
                      .subset_px = 11,
                      .recipe_toml = "threads = 2\n",
                      .inputs = {},
                      .rig_extras = {}};
  for (int r = 0; r < grid.height; ++r) {
    for (int c = 0; c < grid.width; ++c) {
      header.grid_px(r, c) = Eigen::Vector2f(static_cast<float>(4 * c), static_cast<float>(4 * r));
    }
  }
  return header;
}

// A frame that depends on its number in every value; every fifth point holds none.
inline SeriesFrame SmallFrame(std::int64_t i, ImageSize grid = {7, 5}) {
  SeriesFrame frame;
  frame.index = 10 + i;
  frame.time_s = 0.05 * static_cast<double>(i);
  frame.left_id = "left" + std::to_string(i) + ".png";
  frame.right_id = "right" + std::to_string(i) + ".png";
  frame.dropped_before = static_cast<int>(i % 2);
  Surface& s = frame.surface;
  s.frame = SurfaceFrame::kGround;
  s.position_mm = s.sigma_random_mm = s.sigma_calibration_mm =
      Image<Eigen::Vector3f>(grid, Eigen::Vector3f::Zero());
  s.correlation = s.epipolar_px = Image<float>(grid);
  s.status = Image<Status>(grid);
  for (std::size_t k = 0; k < s.status.pixel_count(); ++k) {
    const bool ok = k % 5 != 3;
    const float v = ok ? static_cast<float>(i) + 0.1f * static_cast<float>(k)
                       : std::numeric_limits<float>::quiet_NaN();
    s.position_mm.data()[k] = Eigen::Vector3f(v, 2 * v, 3 * v);
    s.sigma_random_mm.data()[k] = Eigen::Vector3f(v, v, v).cwiseAbs() * 0.01f;
    s.sigma_calibration_mm.data()[k] = Eigen::Vector3f(v, v, v).cwiseAbs() * 0.02f;
    s.correlation.data()[k] = v;
    s.epipolar_px.data()[k] = -v;
    s.status.data()[k] = ok ? Status::kOk : Status::kOccluded;
  }
  GroundRecord& g = frame.ground;
  g.found = true;
  g.normal_in_rig = Eigen::Vector3d(0.1, -0.2, -1).normalized();
  g.offset_mm = -400 - static_cast<double>(i);
  g.e1_in_rig = g.normal_in_rig.unitOrthogonal();
  g.e2_in_rig = g.normal_in_rig.cross(g.e1_in_rig);
  g.centroid_in_rig_mm = g.offset_mm * g.normal_in_rig + 20 * g.e1_in_rig - 30 * g.e2_in_rig;
  g.cov_random << 4e-8, 1e-9, 2e-7, 1e-9, 3e-8, -1e-7, 2e-7, -1e-7, 1e-4;
  g.cov_calibration = 9 * g.cov_random;
  g.ground_from_rig = Rigid3::FromRotationVector({3, 0.1, 0.2}, {1, 2, 400});
  g.rms_mm = 0.03;
  g.inlier_fraction = 0.9;
  return frame;
}

// A header with every optional group.
inline SeriesHeader FullHeader(ImageSize grid = {7, 5}) {
  SeriesHeader header = SmallHeader(grid);
  header.contents = {true, true, true, true, true, true, true, true, true,
                     true, true, true, true, true, true, true, true};
  header.grid_points = "material";
  header.displacement_reference = "frame 10";
  header.rigid_motion_removed = true;
  header.surveyed_frames = 5;
  header.vsg_px = 27;
  header.vsg_mm = 5.5;
  header.channels = {
      {"Fz", "N", "vertical force", {-0.1, 0, 0.05, 0.1}, {1, 2, 3, 4}, 0.237, 0.001},
      {"empty", "", "", {}, {}}};
  return header;
}

// A frame that fills every optional group, from the values of SmallFrame(). The second point has a
// surface and neither displacement nor strain nor velocity.
inline SeriesFrame FullFrame(std::int64_t i, ImageSize grid = {7, 5}) {
  SeriesFrame frame = SmallFrame(i, grid);
  const Image<Eigen::Vector3f> none(
      grid, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
  frame.surface.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>(grid, Eigen::Matrix<float, 6, 1>::Ones());
  DisplacementField& u = frame.displacement;
  StrainField& e = frame.strain;
  SlipRecord& slip = frame.slip;
  MatchField& m = frame.match;
  VelocityField& v = frame.velocity;
  e.status = frame.surface.status;
  e.cov_random = Image<Eigen::Matrix<float, 6, 1>>(
      grid, Eigen::Matrix<float, 6, 1>::Constant(std::numeric_limits<float>::quiet_NaN()));
  e.sigma_random_principal = e.sigma_calibration_principal = m.left_displacement_px =
      m.right_displacement_px = Image<Eigen::Vector2f>(
          grid, Eigen::Vector2f::Constant(std::numeric_limits<float>::quiet_NaN()));
  e.sigma_random_von_mises = e.sigma_calibration_von_mises = m.left_reference_share =
      m.right_reference_share = Image<float>(grid, std::numeric_limits<float>::quiet_NaN());
  m.left_gradient = m.right_gradient = Image<Eigen::Matrix2f>(
      grid, Eigen::Matrix2f::Constant(std::numeric_limits<float>::quiet_NaN()));
  m.left_cov_px2 = m.right_cov_px2 = none;
  v.value_mm_s = v.sigma_random_mm_s = v.sigma_calibration_mm_s = none;
  u.value_mm = u.sigma_random_mm = u.sigma_calibration_mm = frame.material.position_mm = none;
  e.value = e.sigma_random = e.sigma_calibration = e.sigma_model = none;
  e.window_points = Image<float>(grid, std::numeric_limits<float>::quiet_NaN());
  slip.velocity_mm_s = slip.sigma_random_mm_s = slip.sigma_calibration_mm_s = none;
  for (std::size_t k = 0; k < none.pixel_count(); ++k) {
    if (k == 1) e.status.data()[k] = Status::kExtrapolated;
    if (k == 1 || frame.surface.status.data()[k] != Status::kOk) continue;
    const Eigen::Vector3f& p = frame.surface.position_mm.data()[k];
    u.value_mm.data()[k] = 0.1f * p;
    frame.material.position_mm.data()[k] = 0.9f * p;
    u.sigma_random_mm.data()[k] = Eigen::Vector3f(0.3f, 0.4f, 0.5f);
    u.sigma_calibration_mm.data()[k] = Eigen::Vector3f(0.4f, 0.3f, 1.2f);
    e.value.data()[k] = Eigen::Vector3f(1e-3f * p.x(), -2e-3f, 5e-4f * p.y());
    e.sigma_random.data()[k].setConstant(1e-4f);
    e.sigma_calibration.data()[k].setConstant(2e-4f);
    e.sigma_model.data()[k].setConstant(2e-4f);
    e.window_points.data()[k] = static_cast<float>(5 + 2 * k);
    e.cov_random.data()[k] << 1e-8f, 1e-9f, -1e-9f, 1e-8f, 2e-9f, 1e-8f;
    e.sigma_random_principal.data()[k] = Eigen::Vector2f(1e-4f, 2e-4f);
    e.sigma_calibration_principal.data()[k] = Eigen::Vector2f(3e-4f, 4e-4f);
    e.sigma_random_von_mises.data()[k] = 3e-4f;
    e.sigma_calibration_von_mises.data()[k] = 4e-4f;
    m.left_displacement_px.data()[k] = 0.5f * p.head<2>();
    m.right_displacement_px.data()[k] = 0.25f * p.tail<2>();
    m.left_gradient.data()[k] << 0.01f, 0.02f * p.x(), 0.03f, 0.04f;
    m.right_gradient.data()[k] << 0.05f, 0.06f, 0.07f * p.x(), 0.08f;
    m.left_cov_px2.data()[k] = Eigen::Vector3f(1e-4f, 2e-5f, 3e-4f);
    m.right_cov_px2.data()[k] = Eigen::Vector3f(4e-4f, 5e-5f, 6e-4f);
    m.left_reference_share.data()[k] = 0.5f;
    m.right_reference_share.data()[k] = 0.4f;
    v.value_mm_s.data()[k] = 2 * p;
    v.sigma_random_mm_s.data()[k].setConstant(0.3f);
    v.sigma_calibration_mm_s.data()[k].setConstant(0.4f);
    slip.velocity_mm_s.data()[k] = -p;
    slip.sigma_random_mm_s.data()[k].setConstant(0.5f);
    slip.sigma_calibration_mm_s.data()[k].setConstant(0.25f);
  }
  const auto t = static_cast<double>(i);
  WheelRecord& wheel = frame.wheel;
  wheel.found = true;
  wheel.axis = Eigen::Vector3d(0.01, 1, 0.02 * t).normalized();
  wheel.centre_mm = Eigen::Vector3d(t, 2, 300);
  wheel.radius_mm = 310.5;
  wheel.angle_rad = 0.1 * t;  // the speed is not known
  wheel.cov_axis_random << 1e-6, 1e-9, 2e-9, 1e-9, 4e-6, 3e-9, 2e-9, 3e-9, 9e-6;
  wheel.cov_axis_calibration = 4 * wheel.cov_axis_random;
  wheel.sigma_random_centre_mm = Eigen::Vector3d(0.1, 0.2, 0.3);
  wheel.sigma_calibration_centre_mm = Eigen::Vector3d(0.4, 0.5, 0.6);
  wheel.sigma_random_radius_mm = 0.03;
  wheel.sigma_calibration_radius_mm = 0.04;
  wheel.sigma_random_angle_rad = 0.001;
  wheel.sigma_calibration_angle_rad = 0.002;
  PatchRecord& patch = frame.patch;
  patch.found = i != 1;
  if (!patch.found) patch.problem = "the wheel is in the air";
  if (patch.found) {
    patch.area_mm2 = 12000 + t;
    patch.length_mm = 150;
    patch.width_mm = 80;
    patch.centroid_mm = Eigen::Vector2d(3, -4);
    patch.sigma_random_area_mm2 = 30;
    patch.sigma_calibration_area_mm2 = 40;
    patch.sigma_random_length_mm = 0.5;
    patch.sigma_calibration_length_mm = 0.7;
    patch.sigma_random_width_mm = 0.6;
    patch.sigma_calibration_width_mm = 0.8;
    patch.sigma_random_centroid_mm = Eigen::Vector2d(0.1, 0.2);
    patch.sigma_calibration_centroid_mm = Eigen::Vector2d(0.3, 0.4);
    patch.threshold_mm = 0.2;
    patch.d_area_d_threshold_mm = 900;
    for (int k = 0; k < 3 + static_cast<int>(i % 4); ++k) patch.contour_mm.emplace_back(t, k);
  }
  slip.found = i % 2 == 0;
  if (!slip.found) slip.problem = "the wheel does not turn";
  if (slip.found) {
    slip.ratio = 0.01 * t;
    slip.angle_rad = -0.02;
    slip.sigma_random_ratio = 0.003;
    slip.sigma_calibration_ratio = 0.004;
    slip.sigma_random_angle_rad = 0.005;
    slip.sigma_calibration_angle_rad = 0.012;
    slip.speed_mm_s = 1400 + t;  // and no channel
    slip.sigma_random_speed_mm_s = 0.3;
    slip.sigma_calibration_speed_mm_s = 0.4;
    slip.effective_radius_mm = 389;
    slip.sigma_random_effective_radius_mm = 0.03;
    slip.sigma_calibration_effective_radius_mm = 0.04;
    slip.sticking = 20 + t;
    slip.sliding = 5;
    slip.undecided = 3;
  }
  RigidMotionRecord& motion = frame.rigid_motion;
  motion.found = true;
  motion.rotation_rad = Eigen::Vector3d(0.01 * t, 0.02, -0.03);
  motion.translation_mm = Eigen::Vector3d(t, 5, 6);
  motion.sigma_random_rotation_rad.setConstant(3e-5);
  motion.sigma_calibration_rotation_rad.setConstant(4e-5);
  motion.sigma_random_translation_mm.setConstant(0.003);
  motion.sigma_calibration_translation_mm.setConstant(0.004);
  RigWatchRecord& watch = frame.rig_watch;
  watch.found = i != 1;
  if (!watch.found) watch.problem = "too few points";
  if (watch.found) {
    watch.epipolar_mean_px = 0.001 * t;
    watch.epipolar_rms_px = 0.03;
    watch.epipolar_sigma_px = 0.02;
    watch.chi2_calibration = 7;  // and none against the first frame
    watch.change << 1e-4, 2e-4, 3e-4, 0.01, 0.02, 0.03 * t;
    watch.sigma_random_change << 3e-5, 3e-5, 3e-5, 0.003, 0.003, 0.003;
    watch.sigma_calibration_change = watch.sigma_random_change * 4 / 3;
    watch.refined = i == 2;
    watch.alarm = i == 0;
    watch.right_from_left = Rigid3::FromRotationVector({0.01, -0.3, 0.02}, {-123, 0.5, 6});
  }
  RigRotationRecord& rotation = frame.rig_rotation;
  rotation.found = i != 1;
  if (!rotation.found) rotation.problem = "no flat ground";
  if (rotation.found) {
    rotation.pitch_rad = 0.01 * t;
    rotation.roll_rad = -0.02;
    rotation.height_mm = 386;
    rotation.lean = 0.3;
    rotation.sigma_random_pitch_rad = 3e-4;
    rotation.sigma_calibration_pitch_rad = 4e-4;
    rotation.sigma_random_roll_rad = 5e-4;
    rotation.sigma_calibration_roll_rad = 12e-4;
    rotation.sigma_random_height_mm = 0.03;
    rotation.sigma_calibration_height_mm = 0.04;
    if (i == 2) rotation.problem = "how high it is nobody knows";
  }
  frame.wheel_channel.found = i != 1;
  if (frame.wheel_channel.found) {
    frame.wheel_channel.lean = 0.9;
  } else {
    frame.wheel_channel.problem = "another unit";
  }
  PlacementRecord& placement = frame.placement;
  placement.found = i != 1;
  if (!placement.found) placement.problem = "its tags contradict each other";
  if (placement.found) {
    placement.placed_by = 2;
    placement.tags = 3;
    placement.rim_tags = 1;
    placement.unknown_tags = t;
    placement.tag_angle_rad = 0.5;
    placement.twist_rad = -0.008;
    placement.sigma_random_twist_rad = 3e-4;
    placement.sigma_calibration_twist_rad = 4e-4;
  }
  SurveyRecord& survey = frame.survey;
  survey.found = i != 1;
  survey.tags = i == 2 ? "" : R"({"tags":[],"twice":[3]})";
  if (survey.found) {
    survey.view = t;
    survey.near_rad = 0.1 * t;
    survey.spacing_px = 8;
    survey.match = m;  // also where the surface has no point
    survey.match.left_displacement_px.data()[3] = survey.match.right_displacement_px.data()[3] =
        Eigen::Vector2f(1.5F, -2.5F);
    survey.match.left_cov_px2.data()[3] = survey.match.right_cov_px2.data()[3] =
        Eigen::Vector3f(1e-4F, 2e-5F, 3e-4F);
  } else {
    survey.problem = "it is blurred";
  }
  DeformationRecord& deformation = frame.deformation;
  deformation.found = true;
  deformation.loaded_radius_mm = 386 + t;  // and no deflection
  deformation.longitudinal_mm = 0.5;
  deformation.lateral_mm = -0.5;
  deformation.radial_mm = 18.5;
  deformation.radial_at_mm = Eigen::Vector3d(1, 2, 20);
  deformation.sigma_random_loaded_radius_mm = 0.03;
  deformation.sigma_calibration_loaded_radius_mm = 0.04;
  deformation.sigma_random_longitudinal_mm = 0.05;
  deformation.sigma_calibration_longitudinal_mm = 0.12;
  deformation.sigma_random_lateral_mm = 0.06;
  deformation.sigma_calibration_lateral_mm = 0.08;
  deformation.sigma_random_radial_mm = 0.09;
  deformation.sigma_calibration_radial_mm = 0.12;
  return frame;
}

}  // namespace plumbline::testing
