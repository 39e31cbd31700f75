#include "apps/wheel_reference_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>

#include "calib/error.h"
#include "track/right_flow.h"

namespace plumbline {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

void CheckSize(const StereoRig& rig, const StereoFrame& pair) {
  for (const auto& [image, camera, name] :
       {std::tuple(&pair.left, &rig.left, "left"), std::tuple(&pair.right, &rig.right, "right")}) {
    if (image->size() == camera->size()) continue;
    throw InputError(
        fmt::format("The {} image {} has {} x {} px and the rig's camera {} x {}: the rig file is "
                    "that of other "
                    "cameras.",
                    name, name == std::string("left") ? pair.left_id : pair.right_id,
                    image->width(), image->height(), camera->size().width, camera->size().height));
  }
}

// Frames of the recording in order; nothing: stopped.
template <typename Use>
bool ForEachFrame(const std::function<std::unique_ptr<ImageSource>()>& open,
                  const std::string& stage, const WheelReferenceProgress& progress,
                  const Use& use) {
  const auto source = open();
  const std::int64_t total = source->DeclaredCount();
  for (std::int64_t done = 0;; ++done) {
    if (!progress(stage, done, total)) return false;
    const std::optional<StereoFrame> pair = source->Next();
    if (!pair) return true;
    use(*pair, done);
  }
}

std::vector<std::string> NotesOf(const WheelReference& wheel) {
  std::vector<std::string> notes;
  if (!wheel.closed) {
    notes.push_back(fmt::format(
        "the wheel turned by {:.0f} degrees and no full turn closes: angles and axis are less sure "
        "than after a full turn, and frames beyond this arc cannot be found on the wheel",
        wheel.largest_angle_rad() / kDegree));
  }
  const auto unplaced = std::count_if(
      wheel.frames.begin(), wheel.frames.end(),
      [](const WheelFrame& frame) { return frame.status == WheelFrameStatus::kNotFound; });
  if (unplaced > 0) {
    notes.push_back(fmt::format(
        "{} of {} frames show too little of what the frames before showed (blurred, dark, covered, "
        "or the wheel turned too far between frames) and are left out",
        unplaced, wheel.frames.size()));
  }
  if (wheel.rig.modes.count() == 0) {
    notes.push_back(
        "the rig file does not say how sure its calibration is, so that sigmas from it are not "
        "known");
  }
  constexpr double kTooMuch = 1.5;
  if (wheel.sigma0 > kTooMuch) {
    notes.push_back(fmt::format(
        "points are {:.1f} times as far off as their noise lets expect: the wheel is not round to "
        "its axis while it turns (play, a loose rig), the calibration does not fit, or subsets are "
        "too large",
        wheel.sigma0));
  }
  return notes;
}

}  // namespace

void WheelReferenceRunOptions::Check() const {
  chain.Check();
  adjustment.Check();
  if (tag_family.empty() && !rim_tags.empty()) {
    throw UsageError("Tags on the rim are tags: name their family with --tags.");
  }
  if (right_delay) right_delay->Check();
}

WheelReferenceRun MeasureWheelReference(const StereoRig& rig,
                                        const std::function<std::unique_ptr<ImageSource>()>& open,
                                        const WheelReferenceRunOptions& options,
                                        const WheelReferenceProgress& progress) {
  options.Check();
  const RightDelay delay = options.right_delay.value_or(RightDelay{});
  const WheelReference late = WithDelayMode({.rig = rig}, delay);
  WheelReferenceRun run;
  const Image<std::uint8_t> wanted = WantedPixels(rig.left.size(), options.roi, options.mask);
  WheelChainBuilder builder(rig, options.chain, wanted);
  std::vector<WheelFrame> frames;
  const auto place = [&](const StereoFrame& pair, std::int64_t) {
    frames.push_back({});
    frames.back().index = pair.index;
    frames.back().time_s = pair.time_s;
    if (!pair.problem.empty()) {
      frames.back().status = WheelFrameStatus::kUnreadable;
      run.problems.push_back(pair.problem);
      builder.AddMissing();
      return;
    }
    CheckSize(rig, pair);
    builder.Add(pair.left, pair.right);
  };
  if (!ForEachFrame(open, "placing frames", progress, place)) return run;
  if (frames.empty()) throw InputError("There are no frames to measure.");
  WheelTracks tracks(rig, builder.Finish(), options.chain, wanted);
  std::vector<WheelFrameMatches> matches(frames.size());
  std::vector<TagSighting> sightings;
  const auto follow = [&](const StereoFrame& pair, std::int64_t at) {
    if (!pair.problem.empty() || at >= static_cast<std::int64_t>(frames.size())) return;
    matches[static_cast<std::size_t>(at)] = tracks.Add(static_cast<int>(at), pair.left, pair.right);
    if (options.tag_family.empty()) return;
    sightings.push_back({static_cast<std::size_t>(at),
                         FindStereoTags(rig, pair.left, pair.right, options.tag_family)});
  };
  if (!ForEachFrame(open, "following points", progress, follow)) return run;
  std::vector<double> times;
  for (const WheelFrame& frame : frames) times.push_back(frame.time_s);
  const WheelAdjustment adjusted = AdjustLateWheel(late.rig, tracks.Problem(), times, delay,
                                                   late.delay_mode, options.adjustment);
  run.wheel = MakeWheelReference(late.rig, tracks, matches, adjusted);
  run.wheel->right_delay = options.right_delay;
  run.wheel->delay_mode = late.delay_mode;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    WheelFrame& frame = run.wheel->frames[f];
    frame.index = frames[f].index;
    frame.time_s = frames[f].time_s;
    if (frames[f].status == WheelFrameStatus::kUnreadable) frame.status = frames[f].status;
  }
  run.notes = NotesOf(*run.wheel);
  if (!options.tag_family.empty()) {
    WheelTagsFound found =
        MakeWheelTags(*run.wheel, options.tag_family, options.rim_tags, sightings);
    run.wheel->tags = std::move(found.tags);
    run.notes.insert(run.notes.end(), found.problems.begin(), found.problems.end());
  }
  if (!adjusted.converged) {
    run.notes.push_back("the adjustment did not settle, so that its sigmas may be too small");
  }
  return run;
}

}  // namespace plumbline
