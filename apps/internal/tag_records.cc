#include "apps/internal/tag_records.h"

#include <fmt/format.h>

#include <array>
#include <map>
#include <numbers>

#include "apps/internal/two_digits.h"

namespace plumbline::internal {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

std::string TwistNote(const CarcassTwist& twist, double calibration_known) {
  std::string note = fmt::format(
      "Wheel angles are those of the rim, by its tags in {} frames. The inner surface is turned "
      "against it by {:.4f} degrees in the mean, sigma {} (noise){}.",
      twist.frames, twist.angle_rad * kDegrees, TwoDigits(twist.sigma_random_rad * kDegrees),
      calibration_known > 0
          ? fmt::format(", {} (calibration)", TwoDigits(twist.sigma_calibration_rad * kDegrees))
          : "");
  if (!twist.steady) {
    note +=
        " That changes from frame to frame, so that the angle of a frame is that of its own tags "
        "where it shows any on the rim.";
  }
  return note;
}

}  // namespace

PlacementRecord PlacementRecordOf(const RollingWheel& rolling, std::size_t frame) {
  const RollingFrame& from = rolling.frames[frame];
  PlacementRecord record;
  record.found = from.status == RollingFrameStatus::kPlaced;
  record.problem = from.problem;
  if (!record.found) return record;
  record.placed_by = static_cast<double>(from.placed_by);
  record.tags = from.tag_place.known;
  record.rim_tags = from.tag_place.rim;
  record.unknown_tags = static_cast<double>(from.tag_place.unknown.size());
  record.tag_angle_rad = from.tag_place.angle_rad;
  if (!rolling.twist.known) return record;
  record.twist_rad = rolling.twist.angle_rad;
  record.sigma_random_twist_rad = rolling.twist.sigma_random_rad;
  if (rolling.angle_along_modes_rad.rows() > 0) {
    record.sigma_calibration_twist_rad = rolling.twist.sigma_calibration_rad;
  }
  return record;
}

std::vector<std::string> TagNotes(const WheelReference& wheel, const RollingWheel& rolling) {
  if (wheel.tags.family.empty()) return {};
  std::array<int, kPlacedByNames.size()> placed{};
  std::map<int, int> unknown;
  int with_tags = 0, contradicting = 0;
  for (const RollingFrame& frame : rolling.frames) {
    ++placed[static_cast<std::size_t>(frame.placed_by)];
    with_tags += frame.tag_place.known > 0 ? 1 : 0;
    contradicting += frame.tag_place.why.empty() ? 0 : 1;
    for (const int id : frame.tag_place.unknown) ++unknown[id];
  }
  std::vector<std::string> notes = {fmt::format(
      "Tags of the wheel are seen in {} of {} frames. {} were found on the wheel by their tags, {} "
      "by their features, {} follow the frames before them.",
      with_tags, rolling.frames.size(), placed[static_cast<std::size_t>(PlacedBy::kTags)],
      placed[static_cast<std::size_t>(PlacedBy::kFeatures)],
      placed[static_cast<std::size_t>(PlacedBy::kFollowed)])};
  if (contradicting > 0) {
    notes.push_back(
        fmt::format("In {} frames the tags contradict each other or the surface; they are marked.",
                    contradicting));
  }
  if (!unknown.empty()) {
    std::string ids;
    for (const auto& [id, frames] : unknown) ids += fmt::format(" {} ({} frames)", id, frames);
    notes.push_back(fmt::format(
        "Tags that the wheel's reference does not have are seen:{}. They say nothing of the wheel; "
        "make the reference anew if they were added to it.",
        ids));
  }
  if (rolling.twist.known) {
    notes.push_back(
        TwistNote(rolling.twist, static_cast<double>(rolling.angle_along_modes_rad.rows())));
    constexpr double kTooFar = 3;
    const double times = rolling.twist.corner_sigma_px / wheel.tags.sigma_px;
    if (times > kTooFar) {
      notes.push_back(fmt::format(
          "The tags on the rim are seen {} px off where the wheel's reference has them, {:.0f} "
          "times what its own frames differ by: they are on the tyre, or the cameras have moved.",
          TwoDigits(rolling.twist.corner_sigma_px), times));
    }
  }
  return notes;
}

}  // namespace plumbline::internal
