#include "io/frame_table.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <string>
#include <vector>

#include "io/internal/table_file.h"

namespace plumbline {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

struct Column {
  std::string name;
  std::function<double(const SeriesFrame&)> value;
};

// A record of the frame and one of its members, as columns: value, random and calibration sigma.
class Columns {
 public:
  void Plain(const std::string& name, std::function<double(const SeriesFrame&)> value) {
    columns_.push_back({name, std::move(value)});
  }

  template <typename Record>
  void Measured(const std::string& name, Record SeriesFrame::*record, double Record::*value,
                double Record::*random, double Record::*calibration, double scale = 1) {
    const auto of = [=](double Record::*member) {
      return [=](const SeriesFrame& frame) { return scale * ((frame.*record).*member); };
    };
    Triple(name, of(value), of(random), of(calibration));
  }

  template <typename Record, typename Vector>
  void Measured(const std::vector<std::string>& names, Record SeriesFrame::*record,
                Vector Record::*value, Vector Record::*random, Vector Record::*calibration,
                double scale = 1) {
    for (std::size_t k = 0; k < names.size(); ++k) {
      const auto of = [=](Vector Record::*member) {
        return [=](const SeriesFrame& frame) {
          return scale * ((frame.*record).*member)[static_cast<Eigen::Index>(k)];
        };
      };
      Triple(names[k], of(value), of(random), of(calibration));
    }
  }

  void Triple(const std::string& name, std::function<double(const SeriesFrame&)> value,
              std::function<double(const SeriesFrame&)> random,
              std::function<double(const SeriesFrame&)> calibration) {
    Plain(name, std::move(value));
    Plain("sigma_random_" + name, std::move(random));
    Plain("sigma_calibration_" + name, std::move(calibration));
  }

  const std::vector<Column>& all() const { return columns_; }

 private:
  std::vector<Column> columns_;
};

void AddGround(Columns& columns) {
  const char* const names[3] = {"ground_tilt_x_deg", "ground_tilt_y_deg", "ground_tilt_deg"};
  for (int k = 0; k < 3; ++k) {
    const auto of = [k](Eigen::Vector3d GroundAngles::*member) {
      return
          [=](const SeriesFrame& frame) { return kDegrees * (AnglesOf(frame.ground).*member)[k]; };
    };
    columns.Triple(names[k], of(&GroundAngles::angle_rad), of(&GroundAngles::sigma_random_rad),
                   of(&GroundAngles::sigma_calibration_rad));
  }
  // As plumbline measure --ground-turns takes them: ground_from_rig = Rz Ry Rx.
  const auto turn = [&](const char* name, double (*angle)(const Eigen::Matrix3d&)) {
    columns.Plain(name, [=](const SeriesFrame& frame) {
      return frame.ground.found ? kDegrees * angle(frame.ground.ground_from_rig.rotation)
                                : GroundRecord::kNotMeasured;
    });
  };
  turn("ground_turn_x_deg", [](const Eigen::Matrix3d& R) { return std::atan2(R(2, 1), R(2, 2)); });
  turn("ground_turn_y_deg",
       [](const Eigen::Matrix3d& R) { return std::asin(std::clamp(-R(2, 0), -1.0, 1.0)); });
  turn("ground_turn_z_deg", [](const Eigen::Matrix3d& R) { return std::atan2(R(1, 0), R(0, 0)); });
  columns.Plain("ground_inlier_fraction",
                [](const SeriesFrame& frame) { return frame.ground.inlier_fraction; });
}

void AddWheel(Columns& columns) {
  using R = WheelRecord;
  columns.Measured("wheel_angle_deg", &SeriesFrame::wheel, &R::angle_rad,
                   &R::sigma_random_angle_rad, &R::sigma_calibration_angle_rad, kDegrees);
  columns.Measured("wheel_speed_rad_s", &SeriesFrame::wheel, &R::speed_rad_s,
                   &R::sigma_random_speed_rad_s, &R::sigma_calibration_speed_rad_s);
  columns.Measured<R, Eigen::Vector3d>(
      {"wheel_centre_x_mm", "wheel_centre_y_mm", "wheel_centre_z_mm"}, &SeriesFrame::wheel,
      &R::centre_mm, &R::sigma_random_centre_mm, &R::sigma_calibration_centre_mm);
  columns.Measured("wheel_radius_mm", &SeriesFrame::wheel, &R::radius_mm,
                   &R::sigma_random_radius_mm, &R::sigma_calibration_radius_mm);
}

void AddPatch(Columns& columns) {
  using R = PatchRecord;
  columns.Measured("patch_area_mm2", &SeriesFrame::patch, &R::area_mm2, &R::sigma_random_area_mm2,
                   &R::sigma_calibration_area_mm2);
  columns.Measured("patch_length_mm", &SeriesFrame::patch, &R::length_mm,
                   &R::sigma_random_length_mm, &R::sigma_calibration_length_mm);
  columns.Measured("patch_width_mm", &SeriesFrame::patch, &R::width_mm, &R::sigma_random_width_mm,
                   &R::sigma_calibration_width_mm);
  columns.Measured<R, Eigen::Vector2d>(
      {"patch_centroid_x_mm", "patch_centroid_y_mm"}, &SeriesFrame::patch, &R::centroid_mm,
      &R::sigma_random_centroid_mm, &R::sigma_calibration_centroid_mm);
  columns.Plain("patch_threshold_mm",
                [](const SeriesFrame& frame) { return frame.patch.threshold_mm; });
  columns.Plain("patch_d_area_d_threshold_mm",
                [](const SeriesFrame& frame) { return frame.patch.d_area_d_threshold_mm; });
}

void AddSlip(Columns& columns) {
  using R = SlipRecord;
  columns.Measured("slip_ratio", &SeriesFrame::slip, &R::ratio, &R::sigma_random_ratio,
                   &R::sigma_calibration_ratio);
  columns.Measured("slip_angle_deg", &SeriesFrame::slip, &R::angle_rad, &R::sigma_random_angle_rad,
                   &R::sigma_calibration_angle_rad, kDegrees);
  columns.Measured("speed_mm_s", &SeriesFrame::slip, &R::speed_mm_s, &R::sigma_random_speed_mm_s,
                   &R::sigma_calibration_speed_mm_s);
  columns.Measured("effective_radius_mm", &SeriesFrame::slip, &R::effective_radius_mm,
                   &R::sigma_random_effective_radius_mm, &R::sigma_calibration_effective_radius_mm);
  columns.Measured("slip_ratio_by_channel", &SeriesFrame::slip, &R::ratio_by_channel,
                   &R::sigma_random_ratio_by_channel, &R::sigma_calibration_ratio_by_channel);
  columns.Plain("sticking_points", [](const SeriesFrame& frame) { return frame.slip.sticking; });
  columns.Plain("sliding_points", [](const SeriesFrame& frame) { return frame.slip.sliding; });
  columns.Plain("undecided_points", [](const SeriesFrame& frame) { return frame.slip.undecided; });
}

void AddRigRotation(Columns& columns) {
  using R = RigRotationRecord;
  columns.Measured("rig_pitch_deg", &SeriesFrame::rig_rotation, &R::pitch_rad,
                   &R::sigma_random_pitch_rad, &R::sigma_calibration_pitch_rad, kDegrees);
  columns.Measured("rig_roll_deg", &SeriesFrame::rig_rotation, &R::roll_rad,
                   &R::sigma_random_roll_rad, &R::sigma_calibration_roll_rad, kDegrees);
  columns.Measured("rig_height_mm", &SeriesFrame::rig_rotation, &R::height_mm,
                   &R::sigma_random_height_mm, &R::sigma_calibration_height_mm);
  columns.Plain("rig_lean", [](const SeriesFrame& frame) { return frame.rig_rotation.lean; });
}

void AddDeformation(Columns& columns) {
  using D = DeformationRecord;
  const auto add = [&](const char* name, double D::*value, double D::*random,
                       double D::*calibration) {
    columns.Measured(name, &SeriesFrame::deformation, value, random, calibration);
  };
  add("loaded_radius_mm", &D::loaded_radius_mm, &D::sigma_random_loaded_radius_mm,
      &D::sigma_calibration_loaded_radius_mm);
  add("deflection_mm", &D::deflection_mm, &D::sigma_random_deflection_mm,
      &D::sigma_calibration_deflection_mm);
  add("longitudinal_mm", &D::longitudinal_mm, &D::sigma_random_longitudinal_mm,
      &D::sigma_calibration_longitudinal_mm);
  add("lateral_mm", &D::lateral_mm, &D::sigma_random_lateral_mm, &D::sigma_calibration_lateral_mm);
  add("radial_mm", &D::radial_mm, &D::sigma_random_radial_mm, &D::sigma_calibration_radial_mm);
}

void AddRigidMotion(Columns& columns) {
  using R = RigidMotionRecord;
  columns.Measured<R, Eigen::Vector3d>({"rotation_x_deg", "rotation_y_deg", "rotation_z_deg"},
                                       &SeriesFrame::rigid_motion, &R::rotation_rad,
                                       &R::sigma_random_rotation_rad,
                                       &R::sigma_calibration_rotation_rad, kDegrees);
  columns.Measured<R, Eigen::Vector3d>(
      {"translation_x_mm", "translation_y_mm", "translation_z_mm"}, &SeriesFrame::rigid_motion,
      &R::translation_mm, &R::sigma_random_translation_mm, &R::sigma_calibration_translation_mm);
}

void AddRigWatch(Columns& columns) {
  columns.Plain("epipolar_rms_px",
                [](const SeriesFrame& frame) { return frame.rig_watch.epipolar_rms_px; });
  columns.Plain("camera_alarm",
                [](const SeriesFrame& frame) { return frame.rig_watch.alarm ? 1.0 : 0.0; });
}

void AddPlacement(Columns& columns) {
  using P = PlacementRecord;
  columns.Plain("placed_by", [](const SeriesFrame& frame) { return frame.placement.placed_by; });
  columns.Plain("tags", [](const SeriesFrame& frame) { return frame.placement.tags; });
  columns.Plain("rim_tags", [](const SeriesFrame& frame) { return frame.placement.rim_tags; });
  columns.Plain("unknown_tags",
                [](const SeriesFrame& frame) { return frame.placement.unknown_tags; });
  columns.Measured("carcass_twist_deg", &SeriesFrame::placement, &P::twist_rad,
                   &P::sigma_random_twist_rad, &P::sigma_calibration_twist_rad, kDegrees);
}

Columns ColumnsOf(const SeriesContents& contents) {
  Columns columns;
  AddGround(columns);
  if (contents.wheel) AddWheel(columns);
  if (contents.wheel_channel) {
    columns.Plain("wheel_channel_lean",
                  [](const SeriesFrame& frame) { return frame.wheel_channel.lean; });
  }
  if (contents.patch) AddPatch(columns);
  if (contents.slip) AddSlip(columns);
  if (contents.rig_rotation) AddRigRotation(columns);
  if (contents.deformation) AddDeformation(columns);
  if (contents.placement) AddPlacement(columns);
  if (contents.rigid_motion) AddRigidMotion(columns);
  if (contents.rig_watch) AddRigWatch(columns);
  return columns;
}

std::string Quoted(const std::string& text) {
  std::string quoted;
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return text.empty() ? "" : '"' + quoted + '"';
}

}  // namespace

void ExportFrameTable(const std::filesystem::path& file, const SeriesReader& series) {
  const Columns columns = ColumnsOf(series.contents());
  internal::WriteTableFile(file, [&](std::ostream& out) {
    out << "index,time_s,problem,valid_points";
    for (const Column& column : columns.all()) out << ',' << column.name;
    out << '\n';
    for (std::int64_t i = 0; i < series.frame_count(); ++i) {
      const SeriesFrame frame = series.Frame(i);
      const auto& statuses = frame.surface.status.values();
      out << frame.index << internal::Cell(frame.time_s) << ',' << Quoted(frame.problem) << ','
          << std::count(statuses.begin(), statuses.end(), Status::kOk);
      for (const Column& column : columns.all()) out << internal::Cell(column.value(frame));
      out << '\n';
    }
  });
}

}  // namespace plumbline
