#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/region.h"
#include "apps/stereo_run.h"
#include "apps/surface_evaluation.h"
#include "io/image_source.h"
#include "io/series_writer.h"
#include "track/right_delay.h"
#include "track/right_delay_estimate.h"
#include "track/rolling_contact.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"
#include "track/wheel_speed_channel.h"

namespace plumbline {

struct RollingRunOptions {
  RollingSurveyOptions survey;
  StereoSequenceOptions sequence;  // of the second pass
  std::optional<PixelRegion> roi;  // points whose subset fits into it; none: into the image
  Image<std::uint8_t> mask;        // of the left image; empty: all of it
  // known_frame is set from the wheel; strain_axes "material" means around the wheel.
  SurfaceEvaluationOptions evaluation;
  // Of the recording; nothing: that of the wheel's, which the same cameras have recorded. Where it
  // has a sigma the wheel is that of WithDelayMode().
  std::optional<RightDelay> right_delay;
  // By what the images say (EstimateRightDelay) in place of that.
  bool estimate_right_delay = false;
  int views_held = 3;  // reference images that are prepared at a time for the second pass

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// A frame of a run that was measured before, by its place in it.
using MeasuredFrames = std::function<SeriesFrame(std::int64_t position)>;

// Told before each frame of the first pass; returning false ends it.
using RollingProgress = std::function<bool(std::int64_t done, std::int64_t total)>;

// From a recording of a loaded, rolling tyre to its shape, deformation and strain against the
// undeformed wheel, with error bars.
//
//   all pairs -> place on the wheel, sparse points -> wheel angles, smoothed           (Survey)
//   each pair -> matches with the nearest view -> points in space
//             -> displacement from the undeformed wheel turned to the same angle, strain  (Measure)
//
// What needs all frames, as how the rig turns over the ground, follows from the sparse points
// (FindContact).
//
// What both passes match is rounded as files hold it before anything is made of it, so that a run
// is told again from its file (SurveyAgain, MeasureAgain), with other settings or the same to the
// last bit. The options that say how images are matched have to be those of then.
//
// Frame:  the ground's, where it was found in the frame; else the rig's, as the wheel's axis holds
//         it: along a calibration mode the axis stays where it is.
// Grid:   the same pixels in the left image of every view; the point of a frame is the material
//         that is there in the view, and seen within half a view's spacing of it.
// Frames are independent of each other once the survey is done: a recording can be cut anywhere.
class RollingRun {
 public:
  // Throws UsageError from the options, InputError as WheelLibrary and where region and mask leave
  // nothing.
  RollingRun(WheelReference wheel, const RollingRunOptions& options);
  ~RollingRun();

  // By what the images say; after FindContact().
  const RightDelayEstimate& right_delay() const;
  // That is taken out of what is measured.
  const RightDelay& right_delay_used() const;

  // The first pass. False: stopped. Throws InputError where no frame is on the wheel, saying why,
  // and as the source.
  bool Survey(ImageSource& source, const RollingProgress& progress);

  // The first pass over a run that was measured before: of each frame its survey is needed
  // (SeriesReader::SurveyedFrame). Throws as Survey(), and InputError where the matches are not
  // those of this wheel and these options.
  bool SurveyAgain(std::int64_t count, const MeasuredFrames& frames,
                   const RollingProgress& progress);

  // After Survey(): the ground under the tyre, its contact and its slip in every frame; positions
  // are then told in the ground frame of their moment. What depends on the survey's points in
  // `options` is set here. Once the angles have changed (LeanOn) it may follow anew; the right
  // camera's delay is told the first time. Throws as FindRollingContact(), and InputError where
  // that delay is to be estimated and cannot be.
  void FindContact(RollingContactOptions options);

  // The wheel's speed by the images, after Survey(); over the ground after FindContact().
  SampledSignal WheelSpeeds(bool over_ground) const;
  // Smooths the wheel's angle again with a channel of its speed, see LeanOnChannel(); after
  // FindContact(), which has to follow anew.
  // Without a channel the notes say that it is not used, for this problem. Throws as
  // LeanOnChannel().
  void LeanOn(const std::optional<WheelSpeedChannel>& channel, bool over_ground,
              const std::string& problem);

  // After Survey().
  const RollingWheel& wheel() const;
  const WheelReference& reference() const;
  // What the user should know, a sentence each.
  std::vector<std::string> Notes() const;
  // All but the recipe, the inputs and the channels.
  SeriesHeader Header();
  // The pair at this place of the recording, from 0. Throws InputError when the images are not of
  // the rig's size.
  StereoRunFrame Measure(const StereoFrame& pair, std::int64_t position);
  // The frame at this place of a run that was measured before, all of it, in place of its images.
  StereoRunFrame MeasureAgain(const SeriesFrame& before, std::int64_t position);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
