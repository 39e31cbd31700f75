#pragma once

#include <Eigen/Core>
#include <span>

namespace plumbline {

// How bright the material is: a function of material coordinates (mm), given by formulas, so that
// there is nothing to interpolate. 0 is black, 1 white. Immutable and thread-safe.
class Albedo {
 public:
  virtual ~Albedo() = default;

  // albedo[i] at material_mm[i]; the spans are of one size. Neighbours in the span are neighbours
  // on the surface more often than not.
  virtual void Evaluate(std::span<const Eigen::Vector2d> material_mm,
                        std::span<float> albedo) const = 0;
};

}  // namespace plumbline
