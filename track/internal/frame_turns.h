#pragma once

#include <span>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// How far a wheel has turned from frame to frame, told by those places of its surface where the
// deformation has not changed. What passes under the wheel deforms what is near it, wherever that
// is by then; before and behind it the surface stands as it did, and most of it says the same.

// What points of a frame say of the wheel's angle (rad, about some model of it), at places of the
// surface that are fixed in the rig.
struct PlacedAngle {
  double place_rad = 0, y_mm = 0;
  double angle_rad = 0;
  double sigma_rad = 0;  // of noise
};

// A lattice over the places that frames show.
struct PlaceLattice {
  double first_rad = 0, first_mm = 0;
  double spacing_rad = 0, spacing_mm = 0;
  ImageSize size;
};

// Means over the lattice: planes fitted to what lies within a spacing and a half. NaN where a place
// is not surrounded by points.
struct AngleField {
  Image<double> angle_rad, sigma_rad;
};

[[nodiscard]] AngleField FieldOf(std::span<const PlacedAngle> points, const PlaceLattice& lattice);

// A turn between two frames that places agree on.
struct FrameTurn {
  double turn_rad = 0;
  double sigma_rad = 0;  // from how the places that agree scatter, clusters of them counting as one
  double support = 0;    // places that say so
  double spread_rad = 0;  // median deviation from it of all places that both frames show
  int places = 0;
};

// The turns from a to b that most places agree on, the best supported first, a dozen at most; none:
// nothing is seen in both frames.
[[nodiscard]] std::vector<FrameTurn> TurnsBetween(const AngleField& a, const AngleField& b);

// The turns through all frames (one less than fields) that go best together: each is among those of
// TurnsBetween(), and the speed changes little from one to the next. Where a turn has no place to
// tell it, its support is 0 and the turn that of the model.
//
// model_rad: the angle that each field is about. times: growing, in any unit.
[[nodiscard]] std::vector<FrameTurn> SteadyTurns(std::span<const AngleField> fields,
                                                 std::span<const double> model_rad,
                                                 std::span<const double> times);

// The support of a turn between two fields, as FrameTurn has it.
[[nodiscard]] double SupportOf(const AngleField& a, const AngleField& b, double turn_rad);

}  // namespace plumbline::internal
