#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "calib/camera.h"

namespace plumbline::internal {

// A vector for each of four calibration modes: one lane a mode.
struct ModeVectors {
  using Lanes = Eigen::Array<float, 4, 1>;
  static constexpr int kLanes = 4;

  Lanes x, y, z;
};

// A camera in the rig's frame.
struct TurnedCamera {
  Camera camera;
  Eigen::Matrix3d rig_from_camera = Eigen::Matrix3d::Identity();
};

// The viewing rays of a camera, and what K other states of it change about them, tabulated once
// over its image so that a look-up costs no inversion of a lens.
//
// A lattice over the whole image holds rig_from_camera * ray(q) and, for each state k, that of the
// state less it: the rotation is in the table because lens and pose of a calibration mode largely
// cancel. Between the nodes, cubic Lagrange interpolation over 4 x 4 of them (at the border of the
// image over the 4 x 4 nearest inside). The lattice is the coarsest of 40, 80 and 160 cells across
// the longer side that serves 98 % of the cells, else the finest. A cell is served where in its
// middle the ray is good to 1e-5, and each change to 1e-4 of its size there plus 1e-4 of the rms
// over the image of all states together, which is what a sum of squares over the states sees.
// Linear interpolation would need cells of an eighth the size for that. Rounding (floats) is 1e-7.
class RayTable {
 public:
  RayTable(const TurnedCamera& nominal, std::span<const TurnedCamera> states);

  int block_count() const { return blocks_; }  // of four states; the lanes past the last are zero

  // Ray and changes at a pixel, blocks first_block ... first_block + changes.size() - 1. False
  // where the table does not serve: outside the image, without a ray, or in a cell that failed its
  // check. Pure.
  bool Look(const Eigen::Vector2d& pixel, int first_block, std::span<ModeVectors> changes,
            Eigen::Vector3d* ray) const;

  double step_px() const { return step_.maxCoeff(); }
  double ServedShare() const;  // of the cells

 private:
  void Fill(const TurnedCamera& nominal, std::span<const TurnedCamera> states, double step_px);
  // Without asking whether the cell is served.
  void Interpolate(const Eigen::Vector2d& position, int first_block, std::span<ModeVectors> changes,
                   Eigen::Vector3d* ray) const;
  const float* Node(int row, int column) const {
    return values_.data() + (static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
                             static_cast<std::size_t>(column)) *
                                stride_;
  }

  int blocks_ = 0;
  int rows_ = 0, columns_ = 0;  // of nodes
  Eigen::Vector2d step_ = Eigen::Vector2d::Zero();
  std::size_t stride_ = 0;  // floats a node: the ray and a zero, then x, y, z of each block
  std::vector<float> values_;
  std::vector<std::uint8_t> served_;  // (rows - 1) x (columns - 1)
};

}  // namespace plumbline::internal
