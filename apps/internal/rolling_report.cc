#include "apps/internal/rolling_report.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "apps/internal/two_digits.h"
#include "track/rolling_survey.h"

namespace plumbline::internal {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi, kExpanded = 2;

// With expanded uncertainties (k = 2); fewest: decimals where none is known.
std::string Measured(double value, double random, double calibration, int fewest,
                     double scale = 1) {
  return WithErrors(scale * value, kExpanded * scale * random, kExpanded * scale * calibration,
                    fewest);
}

nlohmann::json Numbers(double value, double random, double calibration, double scale = 1) {
  const auto finite = [](double number) {
    return std::isfinite(number) ? nlohmann::json(number) : nlohmann::json();
  };
  return {{"value", finite(scale * value)},
          {"sigma_random", finite(scale * random)},
          {"sigma_calibration", finite(scale * calibration)}};
}

// How the frame was found, where that is known.
std::string PlacementText(const PlacementRecord& placement) {
  if (!placement.found) return "";
  const std::string seen =
      placement.tags > 0 ? fmt::format("; tags: {:.0f}", placement.tags) : std::string();
  return fmt::format(" (found by: {}{})",
                     kPlacedByNames[static_cast<std::size_t>(placement.placed_by)], seen);
}

}  // namespace

nlohmann::json JsonOf(const RightDelay& used, const RightDelayEstimate& estimate) {
  constexpr double kMs = 1e3;
  nlohmann::json json{{"used", kMs * used.value_s}, {"sigma", kMs * used.sigma_s}};
  if (estimate.found) {
    json["estimated"] = kMs * estimate.value_s;
    json["sigma_estimated"] = kMs * estimate.sigma_s;
    json["frames"] = estimate.frames;
  } else {
    json["problem"] = estimate.problem;
  }
  return json;
}

std::optional<RollingReport> RollingReportOf(const SeriesFrame& frame) {
  if (!frame.rig_rotation.found && frame.rig_rotation.problem.empty()) return std::nullopt;
  RollingReport report{frame.wheel,       frame.placement, frame.rig_rotation,
                       frame.deformation, frame.patch,     frame.slip};
  report.patch.contour_mm.clear();
  report.slip.velocity_mm_s = report.slip.sigma_random_mm_s =
      report.slip.sigma_calibration_mm_s = {};
  return report;
}

std::string TextOf(const RollingReport& report) {
  const WheelRecord& w = report.wheel;
  const RigRotationRecord& r = report.rotation;
  const DeformationRecord& d = report.deformation;
  const PatchRecord& p = report.patch;
  const SlipRecord& s = report.slip;
  std::string text = fmt::format(
      "  Wheel: angle {} deg, speed {} rad/s{}.\n",
      Measured(w.angle_rad, w.sigma_random_angle_rad, w.sigma_calibration_angle_rad, 4, kDegrees),
      Measured(w.speed_rad_s, w.sigma_random_speed_rad_s, w.sigma_calibration_speed_rad_s, 5),
      PlacementText(report.placement));
  if (!r.found) return text + fmt::format("  Ground: not found: {}.\n", r.problem);
  text += fmt::format(
      "  Rig over the ground: pitch {}, roll {} deg, axis {}; {:.0f} % from other frames.\n",
      Measured(r.pitch_rad, r.sigma_random_pitch_rad, r.sigma_calibration_pitch_rad, 3, kDegrees),
      Measured(r.roll_rad, r.sigma_random_roll_rad, r.sigma_calibration_roll_rad, 3, kDegrees),
      std::isfinite(r.height_mm)
          ? Measured(r.height_mm, r.sigma_random_height_mm, r.sigma_calibration_height_mm, 2) +
                " mm high"
          : "at a height not known",
      100 * r.lean);
  if (!std::isfinite(r.height_mm))
    return text + fmt::format("  Ground: not found: {}.\n", r.problem);
  if (d.found) {
    text += fmt::format(
        "  Deflection under the axis {}; carcass shifted by {} mm along, {} mm across.\n",
        std::isfinite(d.deflection_mm) ? Measured(d.deflection_mm, d.sigma_random_deflection_mm,
                                                  d.sigma_calibration_deflection_mm, 2) +
                                             " mm"
                                       : "not known (it is not seen there)",
        Measured(d.longitudinal_mm, d.sigma_random_longitudinal_mm,
                 d.sigma_calibration_longitudinal_mm, 2),
        Measured(d.lateral_mm, d.sigma_random_lateral_mm, d.sigma_calibration_lateral_mm, 2));
  } else {
    text += fmt::format("  Deformation: {}.\n", d.problem);
  }
  if (p.found) {
    text += fmt::format(
        "  Contact patch {} mm2, {} mm long, {} mm wide{}.\n",
        Measured(p.area_mm2, p.sigma_random_area_mm2, p.sigma_calibration_area_mm2, 0),
        Measured(p.length_mm, p.sigma_random_length_mm, p.sigma_calibration_length_mm, 1),
        Measured(p.width_mm, p.sigma_random_width_mm, p.sigma_calibration_width_mm, 1),
        p.threshold_mm > 0 ? fmt::format(" (within {:g} mm of the ground)", p.threshold_mm) : "");
  } else {
    text += fmt::format("  Contact patch: {}.\n", p.problem);
  }
  if (!s.found) return text + fmt::format("  Slip: {}.\n", s.problem);
  text += fmt::format(
      "  Over the ground {} mm/s; slip ratio {}, angle {} deg; travel {} mm/rad; {:.0f} points "
      "stick, {:.0f} slide.\n",
      Measured(s.speed_mm_s, s.sigma_random_speed_mm_s, s.sigma_calibration_speed_mm_s, 1),
      Measured(s.ratio, s.sigma_random_ratio, s.sigma_calibration_ratio, 5),
      Measured(s.angle_rad, s.sigma_random_angle_rad, s.sigma_calibration_angle_rad, 3, kDegrees),
      Measured(s.effective_radius_mm, s.sigma_random_effective_radius_mm,
               s.sigma_calibration_effective_radius_mm, 2),
      s.sticking, s.sliding);
  return text;
}

nlohmann::json JsonOf(const RollingReport& report) {
  const WheelRecord& w = report.wheel;
  const RigRotationRecord& r = report.rotation;
  const DeformationRecord& d = report.deformation;
  const PatchRecord& p = report.patch;
  const SlipRecord& s = report.slip;
  nlohmann::json json;
  json["wheel_angle_deg"] =
      Numbers(w.angle_rad, w.sigma_random_angle_rad, w.sigma_calibration_angle_rad, kDegrees);
  json["wheel_speed_rad_s"] =
      Numbers(w.speed_rad_s, w.sigma_random_speed_rad_s, w.sigma_calibration_speed_rad_s);
  json["rig_pitch_deg"] =
      Numbers(r.pitch_rad, r.sigma_random_pitch_rad, r.sigma_calibration_pitch_rad, kDegrees);
  json["rig_roll_deg"] =
      Numbers(r.roll_rad, r.sigma_random_roll_rad, r.sigma_calibration_roll_rad, kDegrees);
  json["deflection_mm"] =
      Numbers(d.deflection_mm, d.sigma_random_deflection_mm, d.sigma_calibration_deflection_mm);
  json["patch_area_mm2"] =
      Numbers(p.area_mm2, p.sigma_random_area_mm2, p.sigma_calibration_area_mm2);
  json["slip_ratio"] = Numbers(s.ratio, s.sigma_random_ratio, s.sigma_calibration_ratio);
  json["slip_angle_deg"] =
      Numbers(s.angle_rad, s.sigma_random_angle_rad, s.sigma_calibration_angle_rad, kDegrees);
  json["speed_mm_s"] =
      Numbers(s.speed_mm_s, s.sigma_random_speed_mm_s, s.sigma_calibration_speed_mm_s);
  if (report.placement.found) {
    const PlacementRecord& t = report.placement;
    json["placement"] = {{"placed_by", kPlacedByNames[static_cast<std::size_t>(t.placed_by)]},
                         {"tags", t.tags},
                         {"rim_tags", t.rim_tags},
                         {"unknown_tags", t.unknown_tags},
                         {"carcass_twist_deg", Numbers(t.twist_rad, t.sigma_random_twist_rad,
                                                       t.sigma_calibration_twist_rad, kDegrees)}};
  }
  json["problems"] = {
      {"ground", r.problem}, {"deformation", d.problem}, {"patch", p.problem}, {"slip", s.problem}};
  return json;
}

}  // namespace plumbline::internal
