#include "apps/internal/strain_options.h"

#include <fmt/format.h>

#include "calib/error.h"

namespace plumbline::internal {

void StrainOptionSet::Declare(OptionTable& options, Of of) {
  const std::string window =
      "side of the virtual strain gauge, odd; its size in px (VSG) is (window - 1) * step + subset";
  options.Add(
      {.name = "strain-window",
       .help = of == Of::kSurface  ? window
               : of == Of::kPlanar ? window + "; 1: the subset's own gradient"
                                   : window + "; 1, of one camera only: the subset's own gradient",
       .unit = "points",
       .min = of == Of::kSurface ? 3.0 : 1.0,
       .max = 255},
      &options_.window_points);
  options.Add({.name = "strain-measure",
               .help = "which strain; all but small hold for any rotation",
               .choices = {"green_lagrange", "small", "hencky", "almansi"}},
              &measure_);
  options.Add({.name = "strain-order",
               .help = "order of the polynomial fitted to the gauge's displacements",
               .min = 1,
               .max = 2},
              &options_.order);
  options.Add({.name = "strain-min-share",
               .help = "share of the gauge's points that have to be there",
               .min = 0.01,
               .max = 1},
              &options_.min_share);
  options.Add({.name = "strain-weights",
               .help = "weights of the gauge's points",
               .choices = {"equal", "inverse-variance"}},
              &weights_);
}

PlanarStrainOptions StrainOptionSet::Options() const {
  PlanarStrainOptions options = options_;
  for (std::size_t i = 0; i < kStrainMeasureNames.size(); ++i) {
    if (measure_ == kStrainMeasureNames[i]) options.measure = static_cast<StrainMeasure>(i);
  }
  options.weights = weights_ == "equal" ? GaugeWeights::kEqual : GaugeWeights::kInverseVariance;
  options.Check();
  return options;
}

SurfaceStrainOptions StrainOptionSet::OptionsOfSurface() const {
  const PlanarStrainOptions planar = Options();
  SurfaceStrainOptions options;
  options.measure = planar.measure;
  options.window_points = planar.window_points;
  options.order = planar.order;
  options.weights = planar.weights;
  options.min_share = planar.min_share;
  options.min_quarter_share = planar.min_quarter_share;
  options.Check();
  return options;
}

}  // namespace plumbline::internal
