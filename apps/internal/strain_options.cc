#include "apps/internal/strain_options.h"

#include <fmt/format.h>

#include "calib/error.h"

namespace plumbline::internal {

void StrainOptionSet::Declare(OptionTable& options, Of of) {
  const std::string window =
      "side of the virtual strain gauge, odd; its size in px (VSG) is (window - 1) * step + "
      "subset; auto: 9" +
      std::string(of == Of::kSurface ? ", of a rolling tyre 21" : "");
  options.Add(
      {.name = "strain-window",
       .help = of == Of::kSurface  ? window
               : of == Of::kPlanar ? window + "; 1: the subset's own gradient"
                                   : window + "; 1, of one camera only: the subset's own gradient",
       .unit = "points",
       .min = of == Of::kSurface ? 3.0 : 1.0,
       .max = 255},
      &window_points_);
  if (of != Of::kPlanar) {
    options.Add({.name = "strain-smallest-window",
                 .help = "side down to which a gauge gets smaller where strain varies within it; "
                         "0: all have strain-window; auto: 0, of a rolling tyre 5 unless "
                         "strain-window is given",
                 .unit = "points",
                 .min = 0,
                 .max = 255},
                &smallest_window_points_);
  }
  options.Add({.name = "strain-measure",
               .help = "which strain; all but small hold for any rotation",
               .choices = {"green_lagrange", "small", "hencky", "almansi"}},
              &measure_);
  options.Add({.name = "strain-order",
               .help = std::string("order of the polynomial fitted to the gauge's displacements; "
                                   "auto: 1") +
                       (of == Of::kSurface ? ", of a rolling tyre 3" : ""),
               .min = 1,
               .max = 3},
              &order_);
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
  options.window_points = window_points_.value_or(9);
  options.order = order_.value_or(1);
  for (std::size_t i = 0; i < kStrainMeasureNames.size(); ++i) {
    if (measure_ == kStrainMeasureNames[i]) options.measure = static_cast<StrainMeasure>(i);
  }
  options.weights = weights_ == "equal" ? GaugeWeights::kEqual : GaugeWeights::kInverseVariance;
  options.Check();
  return options;
}

AdaptiveGaugesOptions StrainOptionSet::OptionsOfSurface(bool rolling_tyre) const {
  const PlanarStrainOptions planar = Options();
  AdaptiveGaugesOptions adaptive;
  SurfaceStrainOptions& options = adaptive.gauge;
  options.measure = planar.measure;
  options.window_points = window_points_.value_or(rolling_tyre ? 21 : planar.window_points);
  options.order = order_.value_or(rolling_tyre ? 3 : planar.order);
  options.weights = planar.weights;
  options.min_share = planar.min_share;
  options.min_quarter_share = planar.min_quarter_share;
  const bool by_itself = rolling_tyre && !window_points_;
  adaptive.smallest_window_points = smallest_window_points_.value_or(by_itself ? 5 : 0);
  adaptive.Check();
  return adaptive;
}

}  // namespace plumbline::internal
