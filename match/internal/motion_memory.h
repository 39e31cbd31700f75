#pragma once

#include <cstdint>
#include <optional>

#include "calib/image.h"
#include "match/planar_field.h"

namespace plumbline::internal {

// What the frames of a sequence so far let expect of the next one: every point where it was seen
// last, for a number of frames after that; and taken on by its last motion, as long as that would
// have led nearer to where the points were found in the last frame than no motion.
class MotionMemory {
 public:
  // A frame, its displacements counted as those of the frames before. One without any kOk point
  // says nothing when it is the first.
  void Take(const PlanarField& field);

  // Goes on from what is expected of the next frame, of another reference.
  void Replace(PlanarField expected);

  void Forget();

  // Null where nothing is known.
  const PlanarField* Expected() const { return expected_ ? &*expected_ : nullptr; }

 private:
  struct Motion {
    Image<Eigen::Vector2d> displacement_px;
    Image<Eigen::Matrix2f> gradient;
    Image<Status> status;
  };
  bool LastMotionWouldHaveHelped(const PlanarField& field) const;

  std::optional<PlanarField> expected_;
  Image<std::uint8_t> age_;                   // frames since a point was seen
  std::optional<Motion> last_, before_last_;  // as they were found
};

}  // namespace plumbline::internal
