#include "io/virtual_rig/truth_series.h"

#include <fmt/format.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "io/virtual_rig/tyre_patch.h"

namespace plumbline {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr float kNaNf = std::numeric_limits<float>::quiet_NaN();
constexpr double kSensitivityRange_mm = 0.5;

Status StatusOf(const TruePoint& point) {
  if (!point.in_left || !point.in_right) return Status::kOutsideImage;
  if (point.hidden_in_left || point.hidden_in_right) return Status::kOccluded;
  return Status::kOk;
}

}  // namespace

TruthSeries::TruthSeries(const VirtualRig& rig)
    : rig_(rig), recorded_(rig.Recorded()), grid_px_(GridPixels()) {
  if (!rig.scenario().follow_material) return;
  material_ = Image<Eigen::Vector2d>(grid_px_.size(), Eigen::Vector2d::Constant(kNaN));
  const auto first = rig.Truth(recorded_.front());
  tbb::parallel_for(0, grid_px_.height(), [&](int r) {
    for (int c = 0; c < grid_px_.width(); ++c) {
      const auto point = first->UnderLeftPixel(grid_px_(r, c).cast<double>());
      if (point) material_(r, c) = point->material_mm;
    }
  });
}

Image<Eigen::Vector2f> TruthSeries::GridPixels() const {
  const ImageSize image = rig_.scenario().rig.left.size();
  const int step = rig_.scenario().step_px;
  const ImageSize size{(image.width + step - 1) / step, (image.height + step - 1) / step};
  Image<Eigen::Vector2f> grid(size, Eigen::Vector2f::Zero());
  for (int r = 0; r < grid.height(); ++r) {
    for (int c = 0; c < grid.width(); ++c) {
      grid(r, c) = Eigen::Vector2f(static_cast<float>(c * step), static_cast<float>(r * step));
    }
  }
  return grid;
}

SeriesHeader TruthSeries::Header(const std::vector<Channel>& channels) const {
  const Scenario& s = rig_.scenario();
  SeriesHeader header{.rig = s.rig,
                      .grid_px = grid_px_,
                      .step_px = s.step_px,
                      .subset_px = 0,
                      .recipe_toml = {},
                      .inputs = {},
                      .rig_extras = {},
                      .contents = {.covariance = false,
                                   .displacement = true,
                                   .strain = true,
                                   .wheel = s.HasTyre(),
                                   .patch = s.HasTyre(),
                                   .slip = s.HasTyre()}};
  header.grid_points = s.follow_material ? "material" : "image";
  header.displacement_reference = s.HasTyre() ? "wheel" : "frame 0";
  header.channels = channels;
  NamedArray poses{"right_from_left_of_frames",
                   "mm",
                   "true right_from_left of each frame: rotation (without unit), translation in mm",
                   {recorded_.size(), 4, 4},
                   {},
                   {}};
  for (const int frame : recorded_) {
    const Eigen::Matrix4d pose = rig_.RightFromLeft(rig_.FrameTime(frame)).Matrix();
    for (int r = 0; r < 4; ++r) {
      for (int c = 0; c < 4; ++c) poses.values.push_back(pose(r, c));
    }
  }
  header.rig_extras.arrays.push_back(std::move(poses));
  return header;
}

SeriesFrame TruthSeries::Frame(int frame) const {
  SeriesFrame out;
  out.index = std::find(recorded_.begin(), recorded_.end(), frame) - recorded_.begin();
  out.time_s = rig_.FrameTime(frame) - rig_.FrameTime(recorded_.front());
  for (int i = frame - 1; i >= 0 && rig_.IsDropped(i); --i) ++out.dropped_before;
  const auto truth = rig_.Truth(frame);
  FillPoints(*truth, &out);
  FillGround(*truth, &out);
  if (rig_.tyre() != nullptr) FillTyre(rig_.FrameTime(frame), &out);
  return out;
}

void TruthSeries::FillPoints(const TrueFrame& truth, SeriesFrame* frame) const {
  const ImageSize size = grid_px_.size();
  const Eigen::Vector3f nan = Eigen::Vector3f::Constant(kNaNf);
  Surface& surface = frame->surface;
  surface.frame = SurfaceFrame::kGround;
  surface.correlation = surface.epipolar_px = Image<float>(size, kNaNf);
  surface.status = Image<Status>(size, Status::kMasked);
  surface.position_mm = surface.sigma_random_mm = surface.sigma_calibration_mm =
      frame->displacement.value_mm = frame->strain.value = frame->slip.velocity_mm_s =
          Image<Eigen::Vector3f>(size, nan);
  tbb::parallel_for(0, size.height, [&](int r) {
    for (int c = 0; c < size.width; ++c) {
      std::optional<TruePoint> point;
      if (material_.empty()) {
        point = truth.UnderLeftPixel(grid_px_(r, c).cast<double>());
      } else if (material_(r, c).allFinite()) {
        point = truth.OfMaterial(material_(r, c));
      }
      if (!point) continue;
      surface.status(r, c) = StatusOf(*point);
      if (surface.status(r, c) != Status::kOk) continue;
      surface.position_mm(r, c) = point->position_mm.cast<float>();
      surface.sigma_random_mm(r, c) = surface.sigma_calibration_mm(r, c) = Eigen::Vector3f::Zero();
      frame->displacement.value_mm(r, c) = point->displacement_mm.cast<float>();
      frame->strain.value(r, c) = point->green_lagrange.cast<float>();
      frame->slip.velocity_mm_s(r, c) = point->velocity_mm_s.cast<float>();
    }
  });
  const Image<Eigen::Vector3f>& exact = surface.sigma_random_mm;
  frame->displacement.sigma_random_mm = frame->displacement.sigma_calibration_mm = exact;
  frame->strain.sigma_random = frame->strain.sigma_calibration = exact;
  frame->strain.status = surface.status;
  frame->slip.sigma_random_mm_s = frame->slip.sigma_calibration_mm_s = exact;
}

void TruthSeries::FillGround(const TrueFrame& truth, SeriesFrame* frame) const {
  const Rigid3 rig_from_ground = truth.ground_from_rig().Inverse();
  GroundRecord& ground = frame->ground;
  ground.found = true;
  ground.ground_from_rig = truth.ground_from_rig();
  ground.normal_in_rig = rig_from_ground.rotation.col(2);
  ground.e1_in_rig = rig_from_ground.rotation.col(0);
  ground.e2_in_rig = rig_from_ground.rotation.col(1);
  ground.centroid_in_rig_mm = rig_from_ground.translation_mm;
  ground.offset_mm = ground.normal_in_rig.dot(ground.centroid_in_rig_mm);
  ground.cov_random.setZero();
  ground.cov_calibration.setZero();
  ground.rms_mm = 0;
  ground.inlier_fraction = 1;
}

void TruthSeries::FillTyre(double time_s, SeriesFrame* frame) const {
  const TyreSurface& tyre = *rig_.tyre();
  const WheelState state = tyre.Wheel(time_s);
  WheelRecord& wheel = frame->wheel;
  wheel.found = true;
  wheel.axis = state.axis;
  wheel.centre_mm = {0, 0, state.centre_height_mm};
  wheel.radius_mm = tyre.options().section.crown_radius_mm;
  wheel.angle_rad = state.angle_rad;
  wheel.speed_rad_s = state.angular_speed_rad_s;
  wheel.cov_axis_random.setZero();
  wheel.cov_axis_calibration.setZero();
  wheel.sigma_random_centre_mm = wheel.sigma_calibration_centre_mm = Eigen::Vector3d::Zero();
  wheel.sigma_random_radius_mm = wheel.sigma_calibration_radius_mm = 0;
  wheel.sigma_random_angle_rad = wheel.sigma_calibration_angle_rad = 0;
  wheel.sigma_random_speed_rad_s = wheel.sigma_calibration_speed_rad_s = 0;

  const auto contact = FindPatch(tyre, time_s);
  PatchRecord& patch = frame->patch;
  SlipRecord& slip = frame->slip;
  if (!contact) {
    patch.problem = slip.problem = "the wheel does not touch the ground";
    return;
  }
  patch.found = true;
  patch.area_mm2 = contact->area_mm2;
  patch.length_mm = contact->length_mm;
  patch.width_mm = contact->width_mm;
  patch.centroid_mm = contact->centroid_mm;
  patch.sigma_random_area_mm2 = patch.sigma_calibration_area_mm2 = 0;
  patch.sigma_random_length_mm = patch.sigma_calibration_length_mm = 0;
  patch.sigma_random_width_mm = patch.sigma_calibration_width_mm = 0;
  patch.sigma_random_centroid_mm = patch.sigma_calibration_centroid_mm = Eigen::Vector2d::Zero();
  patch.threshold_mm = 0;
  if (const auto wider = FindPatch(tyre, time_s, kSensitivityRange_mm)) {
    patch.d_area_d_threshold_mm = (wider->area_mm2 - contact->area_mm2) / kSensitivityRange_mm;
  }
  for (const auto& outline : contact->contours_mm) {
    if (!patch.contour_mm.empty()) patch.contour_mm.emplace_back(kNaN, kNaN);
    patch.contour_mm.insert(patch.contour_mm.end(), outline.begin(), outline.end());
  }
  slip.found = true;
  slip.ratio = tyre.options().slip_ratio;
  slip.angle_rad = tyre.options().slip_angle_rad;
  slip.sigma_random_ratio = slip.sigma_calibration_ratio = 0;
  slip.sigma_random_angle_rad = slip.sigma_calibration_angle_rad = 0;
  slip.speed_mm_s = state.speed_mm_s;
  slip.sigma_random_speed_mm_s = slip.sigma_calibration_speed_mm_s = 0;
  slip.effective_radius_mm = tyre.options().free_rolling_radius_mm / (1 + slip.ratio);
  slip.sigma_random_effective_radius_mm = slip.sigma_calibration_effective_radius_mm = 0;
}

}  // namespace plumbline
