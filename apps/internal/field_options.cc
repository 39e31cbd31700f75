#include "apps/internal/field_options.h"

#include <fmt/format.h>

#include <charconv>

#include "calib/error.h"

namespace plumbline::internal {

void SetPrefilter(const std::string& text, CorrelationImageOptions& options) {
  if (text == "low-pass") {
    options.prefilter = Prefilter::kLowPass;
  } else if (text == "none") {
    options.prefilter = Prefilter::kNone;
  } else {
    const char* const end = text.data() + text.size();
    double& sigma = options.gaussian_sigma_px;
    const auto [at, error] = std::from_chars(text.data(), end, sigma);
    if (error != std::errc() || at != end || !(sigma > 0 && sigma <= 10)) {
      throw UsageError(fmt::format(
          "--prefilter takes low-pass, none, or the sigma of a Gaussian in px (up to 10), not "
          "'{}'.",
          text));
    }
    options.prefilter = Prefilter::kGaussian;
  }
}

void FieldOptionSet::Declare(OptionTable& options, bool noise_file) {
  options.Add({.name = "subset",
               .help = "side (diameter) of the subsets, odd; three speckles or more across",
               .unit = "px",
               .min = 5,
               .max = 255},
              &correlator_.subset_px);
  options.Add(
      {.name = "order",
       .help = "of the shape function: 0 shift, 1 affine, 2 quadratic; auto: 1, of a rolling "
               "tyre 2",
       .min = 0,
       .max = 2},
      &order_);
  options.Add({.name = "shape", .help = "of the subsets", .choices = {"square", "circle"}},
              &shape_);
  options.Add({.name = "interpolation",
               .help = "spline through the grey levels",
               .choices = {"quintic", "cubic"}},
              &interpolation_);
  options.Add(
      {.name = "prefilter",
       .help = "filter before correlation: low-pass, none, or the sigma of a Gaussian in px",
       .unit = "NAME|SIGMA"},
      &prefilter_);
  options.Add({.name = "min-zncc",
               .help = "correlation (ZNCC) below which a point is dropped",
               .min = 0,
               .max = 1},
              &correlator_.min_zncc);
  options.Add({.name = "max-sigma",
               .help = "sigma of the displacement above which a point has too little texture",
               .unit = "px",
               .min = 1e-6},
              &correlator_.max_sigma_px);
  options.Add({.name = "max-iterations", .help = "of a subset", .min = 1, .max = 255},
              &correlator_.max_iterations);
  if (noise_file) {
    options.Add(
        {.name = "noise",
         .help = "noise of the cameras, as plumbline noise writes it; empty: from the residual "
                 "of each subset",
         .unit = "FILE"},
        &noise_);
  }
  options.Add({.name = "no-verify",
               .help = "do not check points by a match backwards, nor against their neighbours"},
              &no_verify_);
  options.Add({.name = "keep-still-parts",
               .help = "keep parts of the view that stand still beside others that move, which "
                       "count as background"},
              &keep_still_parts_);
}

FieldOptions FieldOptionSet::Options(std::uint64_t seed) const {
  FieldOptions options;
  options.correlator = correlator_;
  options.correlator.order = order_.value_or(CorrelatorOptions().order);
  options.correlator.shape = shape_ == "circle" ? SubsetShape::kCircle : SubsetShape::kSquare;
  options.image.interpolation =
      interpolation_ == "cubic" ? Interpolation::kCubic : Interpolation::kQuintic;
  SetPrefilter(prefilter_, options.image);
  options.verify = !no_verify_;
  options.keep_still_parts = keep_still_parts_;
  options.seeds.features.random_seed = seed;
  return options;
}

}  // namespace plumbline::internal
