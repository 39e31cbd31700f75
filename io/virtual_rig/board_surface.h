#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>

#include "calib/board.h"
#include "calib/rigid3.h"
#include "io/virtual_rig/board_albedo.h"
#include "io/virtual_rig/material_surface.h"

namespace plumbline {

// How a board departs from its ideal shape. The same seed gives the same shapes, larger or smaller.
struct BoardFlaws {
  // Depth of the bend, from the nearest to the farthest of the board's points, out of their best
  // plane: a quadratic with a twist.
  double bend_mm = 0;
  // RMS over the board's points of their shift in the plane (length of the 2-D vector): unlike
  // scales across and down, shear, and slow waves. Without translation, rotation and overall scale.
  double misprint_mm = 0;
  // Relative error of the overall scale, about the middle of the points: +0.001 prints everything
  // 0.1 % too large. No calibration can see it.
  double scale_error = 0;
  std::uint64_t seed = 1;

  // Throws UsageError when a size is negative or not finite, or the bend or the misprint larger
  // than the board's pitch.
  void Check(const BoardSpec& spec) const;
};

// A calibration board at rest: P(q) = world_from_board * (q + misprint(q), bend(q)) with the
// material coordinates q = (u, v) = pattern coordinates of MakeBoardAlbedo(), mm.
//
// Normal: the z axis of a board points into it, away from the cameras. Therefore
// SurfacePoint::Normal() of a board points away from the side that carries the pattern.
// A positive bend lies deeper, away from the cameras. Lengths along a bent board are those of its
// ideal plane to first order of the slope (second order: slope^2 / 2).
//
// Domain: the sheet, with its margin. Both Reference() and At() are the board as it is; velocities
// are zero. Tangents are exact. Immutable and thread-safe; copies are cheap.
// Throws UsageError as BoardFlaws::Check() and BoardPrint::Check().
class BoardSurface : public MaterialSurface {
 public:
  BoardSurface(const BoardSpec& spec, const BoardPrint& print, const BoardFlaws& flaws,
               const Rigid3& world_from_board);

  // The same board, flaws included, somewhere else.
  BoardSurface MovedTo(const Rigid3& world_from_board) const;

  // Where a point of the board really is, in the board frame (mm): the truth for what a calibration
  // finds of its target. Throws std::out_of_range on an id that the board does not have.
  Eigen::Vector3d PointAsMade(int id) const;

  const Rigid3& world_from_board() const { return world_from_board_; }

  MaterialDomain Domain() const override;
  std::unique_ptr<const SurfaceInstant> At(double time_s) const override;
  std::unique_ptr<const SurfaceInstant> Reference(double time_s) const override;

 private:
  struct Shape;
  class Instant;

  std::shared_ptr<const Shape> shape_;
  Rigid3 world_from_board_;
};

}  // namespace plumbline
