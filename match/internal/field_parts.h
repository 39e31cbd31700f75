#pragma once

#include <cstdint>
#include <vector>

#include "match/planar_field.h"

namespace plumbline::internal {

// A part of a field: points in connection, each moving as its neighbours' displacement and gradient
// let expect, with no jump of half a pixel between them.
struct FieldPart {
  std::vector<std::int64_t> points;
  double median_motion_px = 0;  // length of the displacement
  bool still = false;           // no motion that the correlator could tell from none
};

// All parts of the points that are kOk, in the order of their first points.
std::vector<FieldPart> PartsOf(const PlanarField& field);

// The parts, by place in the list, that stand still beside others that move: background. None where
// less than a tenth of the points moves.
std::vector<std::size_t> StillBackground(const std::vector<FieldPart>& parts);

// The parts of fewer than 5 points that lie beside a larger one: matches that every neighbour
// contradicts.
std::vector<std::size_t> IsolatedParts(const std::vector<FieldPart>& parts,
                                       const PlanarField& field);

}  // namespace plumbline::internal
