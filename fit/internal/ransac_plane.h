#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>

namespace plumbline::internal {

struct PlaneCandidate {
  Eigen::Vector3d normal;
  double offset = 0;  // normal . point = offset
};

// The plane within `threshold` of the most points (PCL's RANSAC, its random numbers from `seed`),
// or nothing where no three points span one. Points are handed over in single precision relative to
// their mean.
std::optional<PlaneCandidate> RansacPlane(std::span<const Eigen::Vector3d> points, double threshold,
                                          std::uint64_t seed);

}  // namespace plumbline::internal
