#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "io/internal/point_values.h"
#include "io/internal/series_contents.h"
#include "io/series_frame.h"

// What a series of a stereo rig holds, and how its frames lie in the journal.
namespace plumbline::internal {

using ContentFlag = bool SeriesContents::*;
template <>
struct OptionalContents<SeriesContents> {
  static constexpr std::array<OptionalContent<SeriesContents>, 17> list = {{
      {"covariance", "/surface/covariance", &SeriesContents::covariance},
      {"displacement", "/displacement", &SeriesContents::displacement},
      {"strain", "/strain", &SeriesContents::strain},
      {"wheel", "/wheel", &SeriesContents::wheel},
      {"patch", "/patch", &SeriesContents::patch},
      {"slip", "/slip", &SeriesContents::slip},
      {"matches", "/match", &SeriesContents::matches},
      {"velocity", "/velocity", &SeriesContents::velocity},
      {"rigid_motion", "/rigid_motion", &SeriesContents::rigid_motion},
      {"rig_watch", "/rig_watch", &SeriesContents::rig_watch},
      {"rig_rotation", "/rig_rotation", &SeriesContents::rig_rotation},
      {"deformation", "/deformation", &SeriesContents::deformation},
      {"material", "/material", &SeriesContents::material},
      {"strain_windows", "/strain/window_points", &SeriesContents::strain_windows},
      {"wheel_channel", "/wheel_channel", &SeriesContents::wheel_channel},
      {"placement", "/placement", &SeriesContents::placement},
      {"survey", "/survey", &SeriesContents::survey},
  }};
};

// needs: what has to be in the contents; null: every series holds it.
inline bool Holds(const SeriesContents& contents, ContentFlag needs) {
  return needs == nullptr || contents.*needs;
}

// Places of the groups in StereoPoints().groups.
enum PointGroup : std::uint8_t {
  kSurface,
  kDisplacement,
  kSlip,
  kVelocity,
  kMatch,
  kMaterial,
  kSurvey,
  kStrain,
  kPointGroupCount
};

// What a frame shows of tags: a text.
inline constexpr const char* kSurveyTags = "/survey/tags";

// Of points: /surface, /displacement, /slip, /velocity, /match, /material, /survey, /strain.
const PointLayout& StereoPoints();

SeriesShape StereoShape(ImageSize grid, const SeriesContents& contents);

// Compresses with all threads; the bytes do not depend on their number. Throws
// std::invalid_argument when the surface or another field does not fit the shape.
std::vector<std::uint8_t> EncodeFrame(const SeriesFrame& frame, const SeriesShape& shape);

// `chunks` point into `bytes`; of the surface the frame holds only `frame`. Throws
// std::runtime_error on what EncodeFrame() did not write.
FrameRecord<SeriesFrame> DecodeFrame(std::span<const std::uint8_t> bytes, const SeriesShape& shape);

}  // namespace plumbline::internal
