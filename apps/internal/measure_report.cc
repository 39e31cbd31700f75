#include "apps/internal/measure_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>

#include "apps/internal/two_digits.h"
#include "calib/error.h"

namespace plumbline::internal {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;
constexpr int kExpanded = 2;  // the coverage factor that reports use

// A number or null: JSON has no NaN.
nlohmann::json Finite(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
}

// "+- 0.012 (random) +- 0.034 (calibration)", both expanded.
std::string PlusMinus(double sigma_random, double sigma_calibration, const char* unit) {
  std::string text = fmt::format("+- {} {} random", TwoDigits(kExpanded * sigma_random), unit);
  if (std::isfinite(sigma_calibration)) {
    text += fmt::format(", +- {} {} calibration", TwoDigits(kExpanded * sigma_calibration), unit);
  }
  return text;
}

double Share(std::int64_t part, std::int64_t whole) {
  return whole > 0 ? 100.0 * static_cast<double>(part) / static_cast<double>(whole) : 0.0;
}

double SigmaOf(const Eigen::Matrix3d& cov, int i) { return std::sqrt(cov(i, i)); }

}  // namespace

ImageSize ParseImageSize(const std::string& text) {
  ImageSize size;
  const char* const end = text.data() + text.size();
  const auto width = std::from_chars(text.data(), end, size.width);
  bool good = width.ec == std::errc() && width.ptr != end && *width.ptr == 'x';
  if (good) {
    const auto height = std::from_chars(width.ptr + 1, end, size.height);
    good = height.ec == std::errc() && height.ptr == end;
  }
  if (!good || size.width <= 0 || size.height <= 0) {
    throw UsageError(fmt::format("An image size is WxH in px, as 1920x1200, not '{}'.", text));
  }
  return size;
}

ReportedFrame Reported(StereoRunFrame measured) {
  FrameSummary summary;
  summary.grid_points = measured.summary.grid_points;
  summary.valid_points = measured.summary.valid_points;
  summary.plane_distance_mm = measured.summary.plane_distance_mm;
  return {std::move(measured.frame), summary, measured.summary,
          measured.match_s + measured.evaluate_s};
}

std::string AlarmText(std::int64_t frame, const RigWatchRecord& watch) {
  return fmt::format(
      "Frame {}: the cameras have moved against each other (turned by {:.3f} deg, {:.2f} mm; "
      "points "
      "lie {:.3f} px from their epipolar lines, where noise explains {:.3f} px).{}",
      frame, watch.change.head<3>().norm() * kDegrees, watch.change.tail<3>().norm(),
      watch.epipolar_rms_px, watch.epipolar_sigma_px,
      watch.refined ? " Their pose is refined for this frame."
                    : " Calibrate again, or measure with --refine-pose significant.");
}

std::string KeptText(std::int64_t frames, const std::filesystem::path& output) {
  return fmt::format(
      "the {} finished frames are kept in {}.parts. The same command with --resume goes on; "
      "plumbline recover {} makes a file of what is there.",
      frames, output.string(), output.string());
}

MeasureReport::MeasureReport(std::filesystem::path output, std::int64_t declared_frames,
                             bool has_calibration)
    : output_(std::move(output)),
      declared_frames_(declared_frames),
      has_calibration_(has_calibration) {}

void MeasureReport::Add(const ReportedFrame& measured) {
  frames_.push_back({measured.frame.index, measured.frame.left_id, measured.frame.problem,
                     measured.summary, measured.frame.ground, measured.frame.rig_watch,
                     measured.motion, RollingReportOf(measured.frame)});
}

std::string MeasureReport::ShareText() const {
  std::int64_t valid = 0, all = 0;
  for (const Row& row : frames_) {
    valid += row.summary.valid_points;
    all += row.problem.empty() ? row.summary.grid_points : 0;
  }
  return fmt::format("{:.1f} % valid", Share(valid, all));
}

std::int64_t MeasureReport::measured() const {
  return std::count_if(frames_.begin(), frames_.end(),
                       [](const Row& row) { return row.problem.empty(); });
}

std::string MeasureReport::FrameText(const Row& row) const {
  const FrameSummary& s = row.summary;
  std::string text = fmt::format("Frame {} ({}): ", row.index, row.left_id);
  if (!row.problem.empty()) return text + "bad. " + row.problem + "\n";
  text += fmt::format("{} of {} points measured ({:.1f} %).\n", s.valid_points, s.grid_points,
                      Share(s.valid_points, s.grid_points));
  if (row.motion) return text + MotionText(row);
  if (!row.ground.found) {
    return text +
           fmt::format("  {} Positions are in the rig frame (left camera).\n", row.ground.problem);
  }
  const GroundAngles angles = AnglesOf(row.ground);
  text += fmt::format("  Plane: {} points ({:.1f} %) with an rms distance of {:.1f} um from it.\n",
                      s.plane_points, 100 * row.ground.inlier_fraction, 1000 * row.ground.rms_mm);
  text += fmt::format(
      "  Distance from the left camera {:.3f} mm ({}).\n", s.plane_distance_mm,
      PlusMinus(SigmaOf(row.ground.cov_random, 2), SigmaOf(row.ground.cov_calibration, 2), "mm"));
  text += fmt::format("  Tilt against its axis {:.3f} deg ({}).\n", angles.angle_rad[2] * kDegrees,
                      PlusMinus(angles.sigma_random_rad[2] * kDegrees,
                                angles.sigma_calibration_rad[2] * kDegrees, "deg"));
  text += fmt::format("  Height of one point above it ({}), median.\n",
                      PlusMinus(s.median_sigma_random_mm, s.median_sigma_calibration_mm, "mm"));
  return text;
}

// Of stereo-DIC: three components with both parts of their uncertainty, the medians of the points.
std::string MeasureReport::MotionText(const Row& row) const {
  const SurfaceSummary& m = *row.motion;
  const auto three = [](const Eigen::Vector3d& value, const Eigen::Vector3d& random,
                        const Eigen::Vector3d& calibration, int fewest, double scale) {
    std::string text;
    for (int k = 0; k < 3; ++k) {
      if (k > 0) text += ", ";
      text += WithErrors(scale * value[k], kExpanded * scale * random[k],
                         kExpanded * scale * calibration[k], fewest);
    }
    return text;
  };
  std::string text;
  if (row.rolling) {
    text += TextOf(*row.rolling);
  } else if (row.ground.found) {
    text += fmt::format("  Plane: {:.1f} % of the points, rms distance {:.1f} um.\n",
                        100 * row.ground.inlier_fraction, 1000 * row.ground.rms_mm);
  }
  if (row.watch.found) {
    text += fmt::format("  Epipolar distance {:.3f} px rms; noise explains {:.3f} px.{}\n",
                        row.watch.epipolar_rms_px, row.watch.epipolar_sigma_px,
                        row.watch.alarm ? " ALARM: the cameras have moved." : "");
  }
  text += fmt::format("  Displacement (x, y, z), median: {} mm.\n",
                      three(m.displacement_mm, m.sigma_random_displacement_mm,
                            m.sigma_calibration_displacement_mm, 4, 1));
  if (m.strain_points > 0) {
    text += fmt::format("  Strain (xx, yy, xy), median of {} gauges: {} microstrain.\n",
                        m.strain_points,
                        three(m.strain, m.sigma_random_strain, m.sigma_calibration_strain, 0, 1e6));
  }
  return text;
}

nlohmann::json MeasureReport::MotionJson(const Row& row) const {
  const SurfaceSummary& m = *row.motion;
  const auto three = [](const Eigen::Vector3d& v) {
    return nlohmann::json{Finite(v[0]), Finite(v[1]), Finite(v[2])};
  };
  return {{"displacement_mm", three(m.displacement_mm)},
          {"sigma_random_displacement_mm", three(m.sigma_random_displacement_mm)},
          {"sigma_calibration_displacement_mm", three(m.sigma_calibration_displacement_mm)},
          {"strain_points", m.strain_points},
          {"strain", three(m.strain)},
          {"sigma_random_strain", three(m.sigma_random_strain)},
          {"sigma_calibration_strain", three(m.sigma_calibration_strain)},
          {"epipolar_rms_px", Finite(row.watch.epipolar_rms_px)},
          {"epipolar_sigma_px", Finite(row.watch.epipolar_sigma_px)},
          {"rig_moved", row.watch.alarm},
          {"pose_refined", row.watch.refined}};
}

std::string MeasureReport::Text() const {
  constexpr std::size_t kMostFrames = 6;
  std::string text;
  for (std::size_t i = 0; i < frames_.size(); ++i) {
    // A long run is told by its first and last frames; the file has them all.
    if (frames_.size() > kMostFrames && i >= kMostFrames / 2 &&
        i + kMostFrames / 2 < frames_.size()) {
      if (i == kMostFrames / 2) {
        text += fmt::format("... {} more frames ...\n", frames_.size() - kMostFrames);
      }
      continue;
    }
    text += FrameText(frames_[i]);
  }
  const std::int64_t bad = frames() - measured();
  text += fmt::format("{} of {} frames measured", measured(), std::max(declared_frames_, frames()));
  if (bad > 0) text += fmt::format(", {} marked as bad", bad);
  if (seconds_ > 0 && frames() > 1) {
    text += fmt::format(", {:.2g} a second", static_cast<double>(frames()) / seconds_);
  }
  text += ".\n" + VibrationText();
  if (interrupted_) text += "Stopped by Ctrl-C: " + kept_ + "\n";
  text += "All +- are expanded uncertainties (k = 2); the file holds standard deviations.\n";
  if (!has_calibration_) {
    text += "The calibration part is unknown: the rig file carries no uncertainty.\n";
  }
  if (!written_) return text;
  text += fmt::format(
      "Wrote {}. Look at it with: plumbline info {}, or plumbline export {} --format ply\n",
      output_.string(), output_.filename().string(), output_.filename().string());
  return text;
}

// Where the pose is refined in frames that are beyond doubt alone, and such frames come and go.
std::string MeasureReport::VibrationText() const {
  std::int64_t refined = 0, after_one = 0;
  for (const Row& row : frames_) {
    if (!row.watch.found) continue;
    refined += row.watch.refined ? 1 : 0;
    after_one += refined > 0 && !row.watch.refined ? 1 : 0;
  }
  if (after_one == 0) return "";
  return fmt::format(
      "The pose of the cameras is refined in {} of {} frames, and {} after one of these keep that "
      "of the calibration: cameras that vibrate move in those too, by less than is beyond doubt, "
      "which is in no sigma. Measure with --refine-pose always.\n",
      refined, measured(), after_one);
}

nlohmann::json MeasureReport::Json() const {
  nlohmann::json json;
  json["output"] = output_.string();
  json["frames_declared"] = declared_frames_;
  json["frames_read"] = frames();
  json["frames_measured"] = measured();
  json["interrupted"] = interrupted_;
  json["frames"] = nlohmann::json::array();
  for (const Row& row : frames_) {
    nlohmann::json frame = {{"index", row.index},
                            {"left", row.left_id},
                            {"problem", row.problem},
                            {"grid_points", row.summary.grid_points},
                            {"valid_points", row.summary.valid_points}};
    if (row.motion) frame["motion"] = MotionJson(row);
    if (row.rolling) frame["rolling"] = JsonOf(*row.rolling);
    if (row.ground.found) {
      const GroundAngles angles = AnglesOf(row.ground);
      frame["plane"] = {
          {"points", row.summary.plane_points},
          {"inlier_fraction", row.ground.inlier_fraction},
          {"rms_mm", row.ground.rms_mm},
          {"mean_distance_mm", row.summary.plane_distance_mm},
          {"sigma_distance_random_mm", Finite(SigmaOf(row.ground.cov_random, 2))},
          {"sigma_distance_calibration_mm", Finite(SigmaOf(row.ground.cov_calibration, 2))},
          {"normal_in_rig",
           {row.ground.normal_in_rig.x(), row.ground.normal_in_rig.y(),
            row.ground.normal_in_rig.z()}},
          {"offset_mm", row.ground.offset_mm},
          {"tilt_deg", angles.angle_rad[2] * kDegrees},
          {"sigma_tilt_random_deg", Finite(angles.sigma_random_rad[2] * kDegrees)},
          {"sigma_tilt_calibration_deg", Finite(angles.sigma_calibration_rad[2] * kDegrees)},
          {"median_sigma_height_random_mm", Finite(row.summary.median_sigma_random_mm)},
          {"median_sigma_height_calibration_mm", Finite(row.summary.median_sigma_calibration_mm)}};
    } else {
      frame["no_plane"] = row.ground.problem;
    }
    json["frames"].push_back(std::move(frame));
  }
  return json;
}

CommandReport MeasureReport::Make() const {
  CommandReport report;
  report.text = Text();
  report.json = Json();
  if (measured() == 0) report.exit_code = 3;
  if (interrupted_) report.exit_code = 130;
  return report;
}

}  // namespace plumbline::internal
