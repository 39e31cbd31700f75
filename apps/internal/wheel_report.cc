#include "apps/internal/wheel_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>

#include "apps/internal/two_digits.h"

namespace plumbline::internal {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

// Both sigmas of the angles, the largest over the frames.
struct AngleSigmas {
  double random_rad = 0, calibration_rad = 0;
};

AngleSigmas LargestOf(const WheelReference& wheel) {
  AngleSigmas largest;
  for (const WheelFrame& frame : wheel.frames) {
    if (frame.status != WheelFrameStatus::kPlaced) continue;
    largest.random_rad = std::max(largest.random_rad, frame.sigma_random_rad);
    largest.calibration_rad = std::max(largest.calibration_rad, frame.sigma_calibration_rad);
  }
  if (wheel.rig.modes.count() == 0) {
    largest.calibration_rad = std::numeric_limits<double>::quiet_NaN();
  }
  return largest;
}

std::int64_t PlacedFrames(const WheelReference& wheel) {
  return std::count_if(wheel.frames.begin(), wheel.frames.end(), [](const WheelFrame& frame) {
    return frame.status == WheelFrameStatus::kPlaced;
  });
}

// "0.012 (noise), 0.3 (calibration)".
std::string SigmaText(double random, double calibration) {
  return fmt::format("{} (noise), {}", TwoDigits(random),
                     std::isfinite(calibration) ? TwoDigits(calibration) + " (calibration)"
                                                : "calibration unknown");
}

// The largest of a tag's corners' coordinates.
double LargestSigma(const WheelTag& tag) {
  return std::sqrt(tag.cov_random_mm2.diagonal().maxCoeff());
}

std::string TextOf(const WheelTags& tags) {
  if (tags.family.empty()) return "";
  if (tags.tags.empty()) return fmt::format("Tags ({}): none is found.\n", tags.family);
  std::string on_tyre, on_rim;
  double worst = 0;
  for (const WheelTag& tag : tags.tags) {
    (tag.on_rim ? on_rim : on_tyre) += fmt::format(" {}", tag.id);
    worst = std::max(worst, LargestSigma(tag));
  }
  return fmt::format(
      "Tags ({}): on the tyre{}; on the rim{}. Corners: noise of {} px, sigma of a place up to {} "
      "mm.\n",
      tags.family, on_tyre.empty() ? " none" : on_tyre, on_rim.empty() ? " none" : on_rim,
      TwoDigits(tags.sigma_px), TwoDigits(worst));
}

nlohmann::json JsonOf(const WheelTags& tags) {
  nlohmann::json list = nlohmann::json::array();
  for (const WheelTag& tag : tags.tags) {
    const Eigen::Vector3d centre = tag.Centre();
    list.push_back({{"id", tag.id},
                    {"on_rim", tag.on_rim},
                    {"frames", tag.frames},
                    {"centre_mm", {centre.x(), centre.y(), centre.z()}},
                    {"side_mm", tag.SideMm()},
                    {"largest_sigma_random_mm", LargestSigma(tag)}});
  }
  return {{"family", tags.family}, {"corner_sigma_px", tags.sigma_px}, {"found", list}};
}

}  // namespace

std::string TextOf(const WheelReference& wheel) {
  const auto axis_sigma = [&](const Eigen::Matrix4d& cov, Eigen::Index i) {
    return std::sqrt(cov(i, i));
  };
  const auto tilt = [&](const Eigen::Matrix4d& cov) {
    return std::hypot(axis_sigma(cov, 0), axis_sigma(cov, 2)) / kDegree;
  };
  const Eigen::Vector3d axis = wheel.axis.direction_in_rig();
  const AngleSigmas sigmas = LargestOf(wheel);
  std::string text = fmt::format(
      "Wheel axis: along ({:.5f}, {:.5f}, {:.5f}) in the rig frame, sigma {} degrees;\n"
      "  {:.3f} mm from the left camera, sigma {} mm.\n",
      axis.x(), axis.y(), axis.z(),
      SigmaText(tilt(wheel.cov_axis_random), tilt(wheel.cov_axis_calibration)),
      wheel.axis.distance_mm,
      SigmaText(axis_sigma(wheel.cov_axis_random, 3), axis_sigma(wheel.cov_axis_calibration, 3)));
  text += fmt::format(
      "Turned by {:.2f} degrees, {} of {} frames placed; {}.\n"
      "Wheel angle: sigma up to {} degrees.\n",
      wheel.largest_angle_rad() / kDegree, PlacedFrames(wheel), wheel.frames.size(),
      wheel.closed ? fmt::format("the turn closes ({:.3f} degrees off before it was closed)",
                                 wheel.misclosure_rad / kDegree)
                   : "no full turn",
      SigmaText(sigmas.random_rad / kDegree, sigmas.calibration_rad / kDegree));
  const WheelProfile& profile = wheel.profile;
  if (std::isfinite(profile.crown_radius_mm)) {
    text += fmt::format(
        "Inner surface: largest radius {:.3f} mm, sigma {} mm.\n", profile.crown_radius_mm,
        SigmaText(profile.sigma_crown_random_mm, profile.sigma_crown_calibration_mm));
  }
  text += TextOf(wheel.tags);
  return text + fmt::format(
                    "{} reference images; {} matches, {} of them outliers, scatter {:.2f} "
                    "of what noise lets expect.\n",
                    wheel.views.size(), wheel.observations, wheel.outliers, wheel.sigma0);
}

nlohmann::json JsonOf(const WheelReference& wheel) {
  const Eigen::Vector3d axis = wheel.axis.direction_in_rig();
  const AngleSigmas sigmas = LargestOf(wheel);
  const auto both = [](double value, double random, double calibration) {
    return nlohmann::json{
        {"value", value}, {"sigma_random", random}, {"sigma_calibration", calibration}};
  };
  nlohmann::json angles = nlohmann::json::array();
  for (const WheelFrame& frame : wheel.frames) {
    angles.push_back({{"frame", frame.index},
                      {"status", kWheelFrameStatusNames[static_cast<std::size_t>(frame.status)]},
                      {"angle_rad", frame.angle_rad},
                      {"sigma_random_rad", frame.sigma_random_rad},
                      {"sigma_calibration_rad", frame.sigma_calibration_rad}});
  }
  const WheelProfile& profile = wheel.profile;
  nlohmann::json json = {
      {"axis_in_rig", {axis.x(), axis.y(), axis.z()}},
      {"axis_distance_mm", both(wheel.axis.distance_mm, std::sqrt(wheel.cov_axis_random(3, 3)),
                                std::sqrt(wheel.cov_axis_calibration(3, 3)))},
      {"crown_radius_mm", both(profile.crown_radius_mm, profile.sigma_crown_random_mm,
                               profile.sigma_crown_calibration_mm)},
      {"closed", wheel.closed},
      {"misclosure_rad", wheel.misclosure_rad},
      {"turned_rad", wheel.largest_angle_rad()},
      {"largest_sigma_random_rad", sigmas.random_rad},
      {"largest_sigma_calibration_rad", sigmas.calibration_rad},
      {"placed_frames", PlacedFrames(wheel)},
      {"frames", angles},
      {"reference_images", wheel.views.size()},
      {"matches", wheel.observations},
      {"outliers", wheel.outliers},
      {"sigma0", wheel.sigma0}};
  if (!wheel.tags.family.empty()) json["tags"] = JsonOf(wheel.tags);
  return json;
}

}  // namespace plumbline::internal
