#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/region.h"
#include "io/image_source.h"
#include "track/wheel_reference.h"

namespace plumbline {

struct WheelReferenceRunOptions {
  WheelChainOptions chain;
  WheelAdjustmentOptions adjustment;
  std::optional<RightDelay> right_delay;  // nothing: not said, and none
  std::optional<PixelRegion> roi;         // of the left image: where the wheel is seen
  Image<std::uint8_t> mask;               // of the left image; empty: all of it
  std::string tag_family;     // of the AprilTags on the wheel (TagFamilyOf); empty: none
  std::vector<int> rim_tags;  // ids of those that are on the rim

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Told before each frame of a stage; returning false ends the run without a result.
using WheelReferenceProgress =
    std::function<bool(const std::string& stage, std::int64_t done, std::int64_t total)>;

struct WheelReferenceRun {
  std::optional<WheelReference> wheel;  // nothing: stopped
  std::vector<std::string> problems;    // frames that could not be read, one sentence each
  // What the user should know, a sentence each without its full stop.
  std::vector<std::string> notes;
};

// From a recording of a lifted, slowly turning wheel to its reference. The recording is read twice:
// first to see how the wheel turns, then to find all points in all frames that may show them; so
// that no more than the reference images is held.
//
// open: opens the recording at its beginning. Throws InputError where the wheel is not found in it
// or does not turn, and as the source.
[[nodiscard]] WheelReferenceRun MeasureWheelReference(
    const StereoRig& rig, const std::function<std::unique_ptr<ImageSource>()>& open,
    const WheelReferenceRunOptions& options, const WheelReferenceProgress& progress);

}  // namespace plumbline
