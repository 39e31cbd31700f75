#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "calib/image.h"
#include "calib/stereo_rig.h"

namespace plumbline {

struct WheelReference;

// AprilTags on a wheel: where its reference recording shows them, and what they say of where the
// wheel stands. Tags on the tyre go where the tyre is drawn: they tell which part of the wheel is
// seen, and no angle of the rim. Those on the rim are rigid: see RimAngles in track/rim_angles.h.

// A tag that both cameras see at one moment. Corners in the order of DetectedTag; raw px.
struct StereoTag {
  int id = 0;
  std::array<Eigen::Vector2d, 4> left_px, right_px;
};

struct StereoTags {
  std::vector<StereoTag> tags;  // by id, each once
  std::vector<int> twice;       // ids that an image shows more than once: they are not in `tags`
};

// The tags of a family (TagFamilyOf()) that both images of a pair show, with all corners within
// 2 px of their epipolar lines: others are misread. Throws std::invalid_argument as DetectTags().
[[nodiscard]] StereoTags FindStereoTags(const StereoRig& rig, const GrayImage& left,
                                        const GrayImage& right, const std::string& family);

// A tag of a wheel. Wheel frame, mm.
struct WheelTag {
  using Covariance = Eigen::Matrix<double, 12, 12>;

  int id = 0;
  bool on_rim = false;  // rigid, by the word of who put it there
  int frames = 0;       // of the reference recording that its place is from
  std::array<Eigen::Vector3d, 4> corner_mm;
  // Random, of all four corners, x y z each; with the frames' angles and what straight lines leave
  // out of curved edges, without the axis.
  Covariance cov_random_mm2 = Covariance::Zero();
  Eigen::MatrixXd along_modes_mm;  // (K, 12): what one sigma of each calibration mode adds

  Eigen::Vector3d Centre() const;
  double SideMm() const;  // mean
};

struct WheelTags {
  std::string family;  // empty: none were looked for
  // One standard deviation of a coordinate of a corner, from how the tags' places scatter over the
  // frames. NaN where there are none.
  double sigma_px = std::numeric_limits<double>::quiet_NaN();
  std::vector<WheelTag> tags;  // by id

  const WheelTag* Find(int id) const;  // null: there is none
};

// What one frame of a reference recording shows.
struct TagSighting {
  std::size_t frame = 0;  // place in WheelReference::frames
  StereoTags seen;
};

struct WheelTagsFound {
  WheelTags tags;
  std::vector<std::string> problems;  // tags that are left out, a sentence each without full stop
};

// The tags of a wheel out of all frames that are placed: the corners are triangulated, turned back
// by the frame's angle and averaged, weighted by the inverse of the triangulation's covariance;
// sightings further off than 4.7 sigmas do not count. sigma_px from the residuals of all tags,
//   sigma_px^2 = sum r' C^-1 r / (12 (sightings - tags)),   C: triangulated from corners of 1 px.
// Neighbouring frames see a tag from nearly the same side and share some of their errors, so that
// the mean's covariance is counted (1 + rho) / (1 - rho) times, rho the residuals' correlation from
// one sighting to the next (first-order autoregressive noise, as in Box and Jenkins, "Time Series
// Analysis", 1976), 0 to 0.9.
//
// Left out with a sentence: ids that are on the wheel twice, or that say that their tag is in two
// places (sightings half a tag and more from the others', more than one of them); tags that are
// seen in one frame alone; rim_ids that are not seen.
[[nodiscard]] WheelTagsFound MakeWheelTags(const WheelReference& wheel, const std::string& family,
                                           std::span<const int> rim_ids,
                                           std::span<const TagSighting> sightings);

// The wheel's angle at which one of its tags is seen where it is, by the tag's middle. NaN where it
// cannot be triangulated.
[[nodiscard]] double AngleOfTag(const WheelReference& wheel, const WheelTag& tag,
                                const StereoTag& seen);

// Where a wheel stands, by the tags that a pair of images shows: 0 to 2 pi, of their median; of
// those on the rim alone where there are any. A tyre is not drawn along by more than
// kMostDrawn_rad: where its tags are further apart than that, nothing is found.
struct TagPlace {
  bool found = false;
  double angle_rad = std::numeric_limits<double>::quiet_NaN();
  int known = 0, rim = 0;    // tags of the wheel in both images, those on the rim among them
  std::vector<int> unknown;  // ids that the wheel does not have
  std::string why;  // they contradict each other or the surface: a sentence without full stop

  static constexpr double kMostDrawn_rad = 0.0873;  // 5 degrees

  // Whether the wheel may stand at this angle: not further from that of the tags. True where no tag
  // tells.
  bool Allows(double wheel_angle_rad) const;
  // Where they do not: what is wrong, a sentence without full stop.
  std::string Contradiction(double wheel_angle_rad) const;
};
[[nodiscard]] TagPlace PlaceByTags(const WheelReference& wheel, const StereoTags& seen);

}  // namespace plumbline
