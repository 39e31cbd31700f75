#pragma once

#include <span>
#include <string>

#include "fit/carcass_thickness.h"
#include "fit/lift_off.h"
#include "fit/wheel_axis.h"
#include "track/patch_series.h"

namespace plumbline {

// What is known of the errors of a map's entries before the contact tells more: as it was said.
[[nodiscard]] ThicknessPrior PriorOf(const CarcassThickness& carcass);

// A map of the carcass with a sigma, corrected by what touches flat ground in all frames
// (FitLawAndThickness), with the modes of what is left to be wrong with it: those of its posterior
// covariance. Its constant and its slope across the tread are the ground's height and tilt too, so
// that they stay as they were said; so do places beside what touches.
//
// The thickness as it was said is the prior, however often the map was corrected before. The
// calibration's errors are not told from those of the map: a bow of the points by them is taken for
// one of the carcass, and is counted along the calibration's modes as if it were not. The same map
// where it has no sigma or no places, or where no frame shows enough; the reason is then in *why,
// if given. options.carcass is not looked at. Accuracy: tests/track/carcass_estimate_test.cc.
[[nodiscard]] CarcassThickness EstimateCarcass(std::span<const PatchFrame> frames,
                                               const WheelAxis& axis,
                                               const CarcassThickness& carcass,
                                               const PatchSeriesOptions& options,
                                               std::string* why = nullptr);

// What touches flat ground against the map: where the tyre touches, its gap to the ground is 0, but
// for a constant and a slope across it.
struct CarcassCheck {
  // Beyond the sigmas of noise, calibration, map and the curve between its entries (chi-square of
  // 1e-6), and by more than those of a good map ever were (0.03 mm).
  bool contradicts = false;
  double most_mm = 0, at_y_mm = 0;  // by how much the thickness is off there (wheel frame), signed
  double chi_square = 0;
  int freedom = 0;
};

// Of the gap of all that touches in all frames, by strips of 10 mm across the tread: the median of
// each. carcass: that of the frames. No contradiction where too little touches.
[[nodiscard]] CarcassCheck CheckCarcass(std::span<const PatchFrame> frames, const WheelAxis& axis,
                                        const CarcassThickness& carcass,
                                        const PatchSeriesOptions& options);

}  // namespace plumbline
