#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/region.h"
#include "io/image_sequence.h"
#include "io/planar_series.h"
#include "match/planar_sequence.h"
#include "track/planar_strain.h"

namespace plumbline {

struct PlanarRunOptions {
  SequenceOptions sequence;
  std::optional<PixelRegion> roi;  // points whose subset fits into it; none: into the image
  Image<std::uint8_t> mask;        // of the reference image; empty: all of it
  bool strain = true;
  PlanarStrainOptions strain_options{.window_points = 9};
  bool gradient_covariance = false;  // also deliver all of it
  std::string noise_source;          // where sequence.field.correlator.noise came from, for people

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Numbers that sum one frame up, for people. Over the points that are kOk; NaN without any. Sigmas
// are one standard deviation.
struct PlanarSummary {
  Eigen::Vector2d least_px, median_px, most_px;  // of u and v
  double median_sigma_px = 0;                    // sqrt((var u + var v) / 2)
  double median_zncc = 0;
  std::int64_t strain_points = 0;
  Eigen::Vector3d median_strain, median_sigma_strain;  // xx, yy, xy
};
PlanarSummary Summarise(const PlanarSeriesFrame& frame);

struct CorrelatedFrame {
  PlanarSeriesFrame frame;
  FieldCounts counts;  // empty where there is a problem
  PlanarSummary summary;
  std::int64_t lost_at_updates = 0;  // SequenceFrame
  double seconds = 0;                // that correlation and strain took
};

// From the images of one camera to displacement and strain with error bars: the only place that
// wires the libraries together for 2D-DIC.
//
//   seeds or the frame before -> points -> verification -> displacement with covariance -> strain
//
// The covariance of neighbouring points is that of the reference image's texture (also where the
// reference is updated: the subsets are the same).
class PlanarRun {
 public:
  // Throws UsageError from the options; InputError when the reference does not hold the subset,
  // the mask has another size, or region and mask leave no point.
  PlanarRun(const GrayImage& reference, const PlanarRunOptions& options);
  ~PlanarRun();

  // All but the recipe, the inputs and what the reference is called.
  PlanarSeriesHeader Header() const;

  // A frame with a problem comes back with it; so does one of another size.
  CorrelatedFrame Correlate(const SequenceImage& image);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The strain as a series holds it.
PlanarStrainRecord RecordOf(PlanarStrain strain);

}  // namespace plumbline
