#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"
#include "match/stereo_sequence.h"
#include "track/angle_smoother.h"
#include "track/camera_motion.h"
#include "track/rim_angles.h"
#include "track/rolling_angles.h"
#include "track/wheel_reference.h"
#include "track/wheel_tags.h"

namespace plumbline {

// Where a loaded, rolling wheel stands in every frame of a recording, against its reference: the
// first of two passes. The second measures each frame densely against the reference image that is
// nearest.

struct RollingSurveyOptions {
  bool images = true;  // false: all frames come by RollingSurvey::AddMatched()
  WheelLibraryOptions library;
  // How frames are matched with reference images, at the points that may be kept alone (half a
  // subset apart at most). Subsets are small: the wide view and the deformation bend them.
  StereoSequenceOptions matching;
  // A frame is placed by so many points that both cameras see, at least; and they must agree in the
  // wheel's angle, up to what deforms it (median deviation).
  int least_points = 30;
  double most_scatter_rad = 0.03;
  int most_points = 1500;  // kept of a frame, spread evenly
  int views_held = 4;      // reference images that are prepared at a time
  // Of the right camera's pose since the reference image was taken, frame by frame. A camera that
  // has moved beyond doubt in one frame shakes in the others too: kWhenSignificant then refines
  // all.
  PoseRefinement refinement = PoseRefinement::kOff;
  RollingAnglesOptions angles;
  AngleSmootherOptions smoother;

  RollingSurveyOptions() {
    matching.field.correlator.subset_px = 21;
    // Where the tyre is lifted towards the cameras its features seem turned. Over bars of 38 mm
    // half of them are off by 0.024 rad and more; most_scatter_rad looks at points in space again.
    library.most_scatter_rad = 0.06;
  }

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// A point of the surface, and which material it is.
struct RollingPoint {
  Eigen::Vector2d left_px, right_px;          // raw
  Eigen::Vector3d point_mm;                   // rig frame
  Eigen::Matrix<float, 6, 1> cov_random_mm2;  // rig frame; xx xy xz yy yz zz
  Eigen::Vector3d undeformed_mm;              // wheel frame
  Eigen::Vector2i at{0, 0};                   // (column, row) on RollingWheel::grid
  int place = 0;                              // row * columns + column, of those matched
  // How the right pixel goes as the wheel turns (RightFlow; px a radian).
  Eigen::Vector2d right_flow_px = Eigen::Vector2d::Zero();
  // The right pixel of what the view shows at left_px; NaN where it has no points around that.
  Eigen::Vector2d view_right_px = Eigen::Vector2d::Zero();
  // Of undeformed_mm, from the noise of the view's own match (wheel frame; xx xy xz yy yz zz).
  Eigen::Matrix<float, 6, 1> cov_undeformed_mm2 = Eigen::Matrix<float, 6, 1>::Zero();
};

// The angle about the wheel's axis of a place in the wheel frame, 0 at the bottom (-z), growing
// towards x: a material point at this angle is at the bottom when the wheel has turned by as much.
double MaterialAngle(const Eigen::Vector3d& in_wheel_mm);

enum class RollingFrameStatus : std::uint8_t { kPlaced = 0, kUnreadable, kNotFound };
inline constexpr std::array<std::string_view, 3> kRollingFrameStatusNames = {"placed", "unreadable",
                                                                             "not_found"};

// How a frame was found on the wheel: from the frames before, by its tags, by its features.
enum class PlacedBy : std::uint8_t { kNothing = 0, kFollowed, kTags, kFeatures };
inline constexpr std::array<std::string_view, 4> kPlacedByNames = {"nothing", "followed", "tags",
                                                                   "features"};

struct RollingFrame {
  std::int64_t index = 0;
  double time_s = kNone;  // NaN without a clock
  RollingFrameStatus status = RollingFrameStatus::kNotFound;
  std::string problem;  // not placed: why, in a sentence
  PlacedBy placed_by = PlacedBy::kNothing;
  StereoTags tags;       // that it shows; of a wheel whose reference has none: none
  TagPlace tag_place;    // what they say
  std::size_t view = 0;  // of the wheel, that it was matched with
  // Of the wheel, as the reference counts it (0 in its first frame), going on beyond a turn from
  // the first placed frame's, which is in 0 to 2 pi. Sigmas are of this frame; what is common to
  // all: RollingWheel::sigma_common_rad.
  double angle_rad = kNone, sigma_random_rad = kNone, sigma_calibration_rad = kNone;
  // Of the turn since the first placed frame: what both have in common drops out.
  double sigma_random_turn_rad = kNone, sigma_calibration_turn_rad = kNone;
  // NaN without a clock.
  double speed_rad_s = kNone, sigma_random_rad_s = kNone, sigma_calibration_rad_s = kNone;
  double measured_angle_rad = kNone, sigma_measured_rad = kNone;  // by this frame alone
  double lean = kNone;  // on the smoother, see SmoothedAngle
  // How much of the turn since the placed frame before (of the first one: to the next) follows a
  // channel of the wheel's speed, as ChannelLean::lean; NaN where none was used.
  double channel_lean = kNone;
  bool outlier = false;  // this frame's own angle contradicts the others and does not count
  // Where the right camera has moved and its pose is refined: the one used, and that with one
  // standard deviation of its errors along each of their independent directions.
  std::optional<Rigid3> right_from_left;
  std::vector<Rigid3> right_from_left_moved;
  // How the right pixels go beside the wheel's turn (FindRightDrift; px/s), on RollingWheel::grid;
  // empty where the frames beside do not tell it or it was not asked for.
  Image<Eigen::Vector2d> right_drift_px_s;
  double right_drift_left_out = 0;  // how much of it may be, one sigma (RightDriftLeftOutAt)
  // What all else of the frame follows from: the view's points in both images, on
  // RollingWheel::grid, with the displacements as floats hold them and before a delay of the right
  // camera is taken out; and the wheel's angle near which it was looked for. Of a frame that is
  // placed.
  StereoField matches;
  double near_rad = kNone;
  std::vector<RollingPoint> points;

  static constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
};

struct RollingWheel {
  std::vector<RollingFrame> frames;
  ImageSize grid;  // that the frames' points lie on, the same pixels in all reference images
  Eigen::Vector2i first_px{0, 0};
  int spacing_px = 0;         // of it
  RollingAngles deformation;  // its angles are those measured frame by frame
  // By which all angles may be off together, see RollingObservation. Angles and speeds relative to
  // each other do not depend on it.
  double sigma_common_rad = 0;
  // What one sigma of each calibration mode adds: (K, frames); NaN where a frame is not placed.
  Eigen::MatrixXd angle_along_modes_rad, speed_along_modes_rad_s;
  // What one sigma of each random error that frames have in common adds to the measured angles:
  // (errors, frames): of the reference (AnglesAlongReference), and of how far the deformation
  // follows the ground (RollingSurvey::HoldToGround).
  Eigen::MatrixXd angle_along_reference_rad;
  double jerk_rad_s25 = 0, scatter = 1;  // of the smoother
  // Known where tags on the rim are seen: then all angles are the rim's, and sigma_common_rad is of
  // the tags. `deformation` is as the surface alone tells it.
  CarcassTwist twist;
  RightDelay right_delay = {};  // that is taken out of the points, with its sigma
  // With which the frames were told: kAlways also for kWhenSignificant, where the camera has moved.
  PoseRefinement refinement = PoseRefinement::kOff;

  int placed() const;
};

// How the ground of a frame stands about the wheel's axis (the first entry of RigPose).
struct GroundPitch {
  double value_rad = 0, sigma_rad = 0;
};

// Takes the frames of a recording in order. Each is matched with the view nearest to its angle
// (StereoSequence), from where the frames before let expect it: the wheel turning on, the surface
// pressed in as it was. The first frame, and one that shows too few of the expected points, is
// found on the wheel by its tags (PlaceByTags), or where it shows none by its features
// (WheelLibrary), and, if need be, searched as a whole. So frames
// before only tell where to start: all points are matched with the view and verified by themselves.
// Their points give the angles (FindRollingAngles), these are smoothed (SmoothAngles). A frame that
// is not found on the wheel, or whose tags say something else than its points do, is marked and
// left out; its angle is not guessed, though the smoother could. Tags on the rim tell the wheel's
// own angle (HoldToRim).
//
// Memory: about 275 bytes a point kept and what the prepared views take.
// Calibration: along a mode the points of a frame, those of the reference image, the axis and the
// view's angle all change; with the weights held all steps are linear.
//
// Not thread-safe; uses all of TBB's threads, and the result does not depend on their number.
class RollingSurvey {
 public:
  // Keeps a reference to `wheel`. mask: of the left image; may be empty. Throws UsageError from the
  // options, InputError as WheelLibrary.
  RollingSurvey(const WheelReference& wheel, const RollingSurveyOptions& options,
                const Image<std::uint8_t>& mask = {});
  ~RollingSurvey();

  // The next frame; its angle is not known yet. Throws InputError where the images are not of the
  // rig's size.
  const RollingFrame& Add(std::int64_t index, double time_s, const GrayImage& left,
                          const GrayImage& right);
  // The next one without its images, from what an earlier survey with these options told of it:
  // index, time, status, problem, tags, and of one that is placed view, placed_by, near_rad and
  // matches. The rest follows, to the last bit as it did then. Throws InputError where view or
  // matches are not those of this wheel and these options.
  const RollingFrame& AddMatched(RollingFrame told);
  // One that could not be read.
  void AddUnreadable(std::int64_t index, double time_s, const std::string& problem);

  RollingWheel Finish();

  // After Finish(), once: right pixels, points and angles as they would be, had the right camera
  // exposed with the left one; and with a sigma what that does to the angles along
  // WheelReference::delay_mode. Throws UsageError from the delay, InputError where a frame that is
  // placed has no time.
  void MoveBack(const RightDelay& delay, RollingWheel* rolling);

  // After Finish(): the angles by a deformation that stays as it is over the ground, not under the
  // rig. pitch: one a frame. Where the rig turns by a degree against the ground, what the contact
  // draws along turns with it under the rig and would be taken for a twentieth of a degree of the
  // wheel's turn. Throws std::invalid_argument where the numbers differ.
  void HoldToGround(std::vector<GroundPitch> pitch, RollingWheel* rolling);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
