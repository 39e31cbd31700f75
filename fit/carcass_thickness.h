#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "calib/image.h"
#include "fit/wheel_axis.h"

namespace plumbline {

// How a thickness between the entries of a map goes with them: with `count` of them from `first`
// on.
struct ThicknessShares {
  std::size_t first = 0;
  int count = 0;
  std::array<double, 4> share{};
};

// How thick a tyre's carcass is, tread included, by the place along the wheel's axis at which it
// lies undeformed: one value for all, or a map. Between the entries of a map runs the monotone
// piecewise cubic of Fritsch and Butland (SIAM J. Sci. Stat. Comput. 5, 1984, eq. 10), which never
// leaves the range of the two entries beside it.
struct CarcassThickness {
  std::vector<double> y_mm;          // ascending, wheel frame; empty where thickness_mm has one
  std::vector<double> thickness_mm;  // measured along the normal of the surface
  double sigma_mm = 0;               // of each entry as it was said, independent of the others

  // Where the contact has told more of the map (EstimateCarcass): the entries as they were said,
  // and what is left to be wrong with thickness_mm, a column for what one sigma of each mode does
  // to the entries. Empty: the entries are as they were said.
  std::vector<double> said_mm = {};
  Eigen::MatrixXd modes_mm = {};

  // NaN beyond the ends of a map: nothing is known there.
  double At(double y_mm) const;
  // What the curve may leave out there, one sigma: a quarter of what straight lines between the
  // entries would. 0 for one value, NaN where At() is.
  double LeftOutAt(double y_mm) const;

  // None where nothing is known, as beyond the ends of a map.
  ThicknessShares SharesAt(double y_mm) const;
  // Whether there are entries by place, with a sigma: the contact may tell more of them.
  bool uncertain_map() const { return sigma_mm > 0 && !y_mm.empty(); }

  // What one sigma does, an entry at a time (or by modes_mm): a mode of the carcass is common to
  // all frames, as one of the calibration is. As many as entries; none without a sigma.
  int mode_count() const { return sigma_mm > 0 ? static_cast<int>(thickness_mm.size()) : 0; }
  CarcassThickness AlongMode(int mode) const;
  Eigen::VectorXd OfMode(int mode) const;  // AlongMode() less this, at each entry

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The thickness over each point of a grid, from where the point lies on the undeformed wheel (rig
// frame). NaN where there is no such place. Throws UsageError from CarcassThickness::Check.
[[nodiscard]] Image<double> ThicknessOver(const CarcassThickness& carcass,
                                          const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                                          const WheelAxis& axis);

// Of a quantity along `modes` modes, of which the carcass's are the last ones: the thickness along
// one of them. along_carcass: ThicknessOver() of each AlongMode().
[[nodiscard]] const Image<double>& ThicknessAlong(std::size_t mode, std::size_t modes,
                                                  const Image<double>& thickness_mm,
                                                  std::span<const Image<double>> along_carcass);

// CarcassThickness::SharesAt() over each point, likewise.
[[nodiscard]] Image<ThicknessShares> ThicknessSharesOver(
    const CarcassThickness& carcass, const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
    const WheelAxis& axis);

// CarcassThickness::LeftOutAt() over each point, likewise.
[[nodiscard]] Image<double> ThicknessLeftOutOver(const CarcassThickness& carcass,
                                                 const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                                                 const WheelAxis& axis);

}  // namespace plumbline
