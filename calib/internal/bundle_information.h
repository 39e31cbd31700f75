#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "calib/bundle_adjustment.h"

namespace plumbline {

// The normal equations of a bundle, reduced to what is not a point ("core": free cameras, free
// motions, and free points that stand in a known distance).
struct BundleResult::Information {
  // Where each block starts in the core, or -1: fixed, or eliminated.
  std::vector<int> camera_start, motion_start, point_start;
  std::vector<int> camera_size;
  std::vector<bool> point_free;
  int core_size = 0;

  // A free point that is eliminated: its information, and W' (3 x k) on the core entries `core`.
  struct Eliminated {
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    std::vector<int> core;
    Eigen::Matrix<double, 3, Eigen::Dynamic> coupling;
  };
  std::vector<Eliminated> eliminated;  // one a point; unused for others
  Eigen::MatrixXd reduced;             // H_c - sum W H_p^-1 W'
  Eigen::MatrixXd core_covariance;
  double sigma0 = 1;

  explicit Information(const BundleProblem& problem);

  bool IsEliminated(int point) const {
    const auto p = static_cast<std::size_t>(point);
    return point_free[p] && point_start[p] < 0;
  }
  // What a core entry is, in words: "rotation of motion 3".
  std::string NameOf(int core_entry) const;

  // Adds J'J of one observation: rows 2, one Jacobian a block (empty where fixed or absent).
  struct Term {
    int start;  // in the core; -1: the eliminated point
    Eigen::MatrixXd J;
  };
  void Add(const std::vector<Term>& terms, int eliminated_point);

  // Eliminates the points. Throws InputError naming a point that its observations do not determine.
  void Reduce();

  // Directions of the core (columns, in its units) that nothing determines.
  struct NullSpace {
    Eigen::MatrixXd scaled;  // orthonormal, in units of the entries' own information
    Eigen::VectorXd scale;   // core entry = scaled / scale
  };
  NullSpace Undetermined() const;

  void Invert();

  Eigen::MatrixXd Joint(const std::vector<BundleBlock>& blocks) const;
};

}  // namespace plumbline
