#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "calib/image.h"
#include "match/stereo_sequence.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// What the frames of a rolling wheel so far let expect of the next one: where the wheel stands, if
// it goes on turning as it did, and how its surface is pressed in, if that stays as it was seen
// last at each place under the rig. Only ever a start.
//
// Its angles are such that this stays as it was, in the median over a frame's points; they may be
// off all together.
class SurfaceMemory {
 public:
  // Keeps a reference.
  explicit SurfaceMemory(const WheelReference& wheel) : wheel_(&wheel) {}

  // The next frame, by its points; time_s: of it, by any clock.
  void Take(const RollingFrame& frame, double time_s);

  bool empty() const { return frames_ == 0; }
  double angle_rad() const { return now_rad_; }  // of the last frame
  // The wheel's angle then; nothing before two frames are known.
  std::optional<double> AngleAt(double time_s) const;

  // Where the points of a grid should be seen: those that both images should show, `room_px` away
  // from their edges. material_mm: where each is on the undeformed wheel; NaN: nowhere.
  StereoField Expect(double angle_rad, const PlanarField& grid,
                     const Image<Eigen::Vector3d>& material_mm, double room_px) const;

 private:
  // A point, by its place on the undeformed surface as it stands under the rig.
  struct Moved {
    double place_rad = 0, y_mm = 0;
    Eigen::Vector3d by;  // along the circumference (rad) and the axis (mm), outwards (mm)
  };
  // How far the surface was off the undeformed one; NaN where nothing was seen near.
  Eigen::Vector3d DeformationAt(double place_rad, double y_mm) const;
  void MakeLattice(const std::vector<Moved>& points, double radius_mm);
  void Remember(const std::vector<Moved>& points);

  const WheelReference* wheel_;
  double before_s_ = 0, now_s_ = 0, before_rad_ = 0, now_rad_ = 0;
  int frames_ = 0;
  // Over the undeformed surface; NaN where nothing was seen.
  double first_place_rad_ = 0, first_y_mm_ = 0, pitch_rad_ = 1, pitch_mm_ = 1;
  Image<Eigen::Vector3d> deformation_;  // row: y, column: place
};

// Of the points that were expected, how many were found in both images.
double ShareFound(const StereoField& expected, const StereoField& field);

}  // namespace plumbline::internal
