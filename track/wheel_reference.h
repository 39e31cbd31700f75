#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"
#include "calib/stereo_rig.h"
#include "fit/wheel_axis.h"
#include "match/feature_index.h"
#include "track/right_delay.h"
#include "track/wheel_adjustment.h"
#include "track/wheel_profile.h"
#include "track/wheel_tags.h"
#include "track/wheel_tracks.h"

namespace plumbline {

// What a lifted, slowly turning wheel looks like at every angle, and its undeformed shape: what
// frames of the rolling wheel are measured against.

enum class WheelFrameStatus : std::uint8_t {
  kPlaced = 0,
  kUnreadable,
  kNotFound,  // shows too little of what the frames before showed: blurred, dark, covered
};
inline constexpr std::array<std::string_view, 3> kWheelFrameStatusNames = {"placed", "unreadable",
                                                                           "not_found"};

// A frame of the recording. NaN where it is not placed.
struct WheelFrame {
  std::int64_t index = 0;                                    // in the recording
  double time_s = std::numeric_limits<double>::quiet_NaN();  // NaN without a clock
  WheelFrameStatus status = WheelFrameStatus::kNotFound;
  double angle_rad = 0;  // from the first placed frame; goes on beyond a turn
  double sigma_random_rad = 0, sigma_calibration_rad = 0;  // of the angle
  int matches = 0;                                         // of points in both images
};

// A reference image with the points of its grid in the undeformed state; all images of them have
// the size of the grid, NaN where there is no point.
struct WheelReferenceView {
  int frame = 0;  // place in WheelReference::frames
  double angle_rad = 0;
  GrayImage left, right;
  Eigen::Vector2i first_px{0, 0};
  int step_px = 1;
  Image<Eigen::Vector3d> point_mm;                   // wheel frame
  Image<Eigen::Matrix<float, 6, 1>> cov_random_mm2;  // xx xy xz yy yz zz
  Image<Eigen::Vector3f> sigma_calibration_mm;
};

struct WheelReference {
  StereoRig rig;
  WheelAxis axis = {};
  // Rotation about the wheel's x, y, z (rad) and distance (mm): see WheelAdjustment.
  Eigen::Matrix4d cov_axis_random = Eigen::Matrix4d::Zero();
  Eigen::Matrix4d cov_axis_calibration = Eigen::Matrix4d::Zero();
  std::vector<WheelFrame> frames = {};
  Eigen::MatrixXd cov_angles_random_rad2 = {};  // joint, of all frames
  // Of the axis with the angles (4, frames): over an arc a distance that is wrong makes all angles
  // wrong in proportion. Empty: unknown, taken for nothing.
  Eigen::MatrixXd cov_axis_angles_random = {};
  // What one sigma of each calibration mode adds to the axis (modes, 4) and to the angles (modes,
  // frames): what is measured against the wheel moves with the mode in all of its parts at once.
  Eigen::MatrixXd axis_along_modes = {}, angles_along_modes_rad = {};
  bool closed = false;        // over a full turn
  double misclosure_rad = 0;  // of the chain, before it was closed
  double sigma0 = 0;          // of the adjustment
  std::int64_t observations = 0, outliers = 0;
  WheelProfile profile = {};
  std::vector<WheelReferenceView> views = {};  // by angle
  WheelTags tags = {};
  // Of the recording, where it was said; it is taken out of the points, not of the images.
  std::optional<RightDelay> right_delay = {};
  int delay_mode = -1;  // the mode of rig.modes that is one sigma of the delay; -1: there is none

  double largest_angle_rad() const;
  // Of the wheel in a frame, from the frames beside it (rad/s); NaN where these are not placed or
  // have no time.
  double SpeedOf(int frame) const;
  // How far the wheel turned from the left exposure of a view to the right one, by the delay that
  // was said, and the sigma of that; 0 where none was.
  double LateTurnOf(const WheelReferenceView& view) const;
  double SigmaLateTurnOf(const WheelReferenceView& view) const;
};

// What the adjustment of a recording says. matches: of each frame, in order. The frames' index is
// their place; they have no time.
WheelReference MakeWheelReference(const StereoRig& rig, const WheelTracks& tracks,
                                  const std::vector<WheelFrameMatches>& matches,
                                  const WheelAdjustment& adjusted);

struct WheelLibraryOptions {
  FeatureIndexOptions index;
  // A frame is on the wheel where so many features of a view agree in one motion. On the virtual
  // rig at 640 x 480 px 129 and more do in a view's place, 70 once the tyre is loaded, 53 when that
  // is blurred by 7 px besides, and none of another tyre or when it is blurred by 15 px.
  int least_agreeing = 15;
  // And they must agree in how far the wheel has turned, to this (median deviation).
  double most_scatter_rad = 0.02;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Where a frame may be on the wheel.
struct WheelCandidate {
  std::size_t view = 0;
  double angle_rad = 0;    // of the wheel, about; 0 to 2 pi
  double scatter_rad = 0;  // median deviation of what each feature says
  int agreeing = 0;        // features
};

struct WheelPlace {
  bool found = false;
  std::vector<WheelCandidate> candidates;  // the best first; all that were looked at
  std::string why;                         // not found: in a sentence
};

// The reference images of a wheel with an index of their features: finds a frame on the wheel
// without an encoder. Built anew from the images, in some 0.1 s an image of 640 x 480 px.
class WheelLibrary {
 public:
  // Keeps a reference to `wheel`. Throws UsageError from the options, InputError where the images
  // show no features.
  explicit WheelLibrary(const WheelReference& wheel, const WheelLibraryOptions& options = {});

  // Where a left image of the same rig is on the wheel: never guessed. The surface may be deformed;
  // the angle is then that of the deformed surface, about.
  [[nodiscard]] WheelPlace Find(const GrayImage& left) const;

 private:
  const WheelReference& wheel_;
  WheelLibraryOptions options_;
  FeatureIndex index_;
};

}  // namespace plumbline
