#include "io/virtual_rig/render.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

#include "calib/error.h"
#include "io/virtual_rig/internal/material_map.h"
#include "io/virtual_rig/surface_view.h"

namespace plumbline {
namespace {

using internal::MaterialMap;

// Weights of the samples about a pixel's centre in one direction: a box of one pixel convolved with
// a normal distribution, at offsets (k - reach + 1/2) / samples - 1/2... in pixels.
struct Kernel {
  int reach_px = 0;  // whole pixels beyond the pixel itself
  std::vector<float> weights;

  Kernel(double sigma_px, int samples) {
    reach_px = static_cast<int>(std::ceil(4 * sigma_px));
    const int count = (2 * reach_px + 1) * samples;
    const auto below = [&](double x) {
      if (sigma_px == 0) return x < 0 ? 0.0 : 1.0;
      return 0.5 * std::erfc(-x / (sigma_px * std::numbers::sqrt2));
    };
    double sum = 0;
    std::vector<double> exact;
    for (int k = 0; k < count; ++k) {
      const double d = (k + 0.5) / samples - 0.5 - reach_px;
      exact.push_back(below(d + 0.5) - below(d - 0.5));
      sum += exact.back();
    }
    for (const double w : exact) weights.push_back(static_cast<float>(w / sum));
  }
};

// Moments of the exposure (0 to 1) at which each sample is taken, of equal weight: two
// Gauss-Legendre points for each pixel that the material moves.
std::vector<double> Moments(double motion_px) {
  if (motion_px == 0) return {0};
  const int pieces = std::max(1, static_cast<int>(std::ceil(motion_px)));
  std::vector<double> moments;
  for (int k = 0; k < pieces; ++k) {
    for (const double x : {-1 / std::numbers::sqrt3, 1 / std::numbers::sqrt3}) {
      moments.push_back((k + 0.5 + 0.5 * x) / pieces);
    }
  }
  return moments;
}

// Light of one row of samples.
class RowSampler {
 public:
  RowSampler(const MaterialMap& map, const Albedo& albedo, const RenderOptions& options,
             std::size_t count)
      : map_(map),
        albedo_(albedo),
        background_(static_cast<float>(options.background_albedo)),
        moments_(Moments(map.LargestMotion_px())),
        samples_(count),
        places_(count),
        at_moment_(count),
        values_(count) {}

  const std::vector<float>& Row(double y, double x0, double dx) {
    map_.EvaluateRow(y, x0, dx, samples_);
    std::fill(values_.begin(), values_.end(), 0.f);
    for (const double t : moments_) {
      for (std::size_t i = 0; i < samples_.size(); ++i) {
        const MaterialMap::Sample& s = samples_[i];
        places_[i] = {s[0] + t * (s[2] - s[0]), s[1] + t * (s[3] - s[1])};
        if (std::isnan(s[0])) places_[i].setZero();  // somewhere finite: it is not used
      }
      albedo_.Evaluate(places_, at_moment_);
      for (std::size_t i = 0; i < samples_.size(); ++i) values_[i] += at_moment_[i];
    }
    const float share = 1 / static_cast<float>(moments_.size());
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      values_[i] = std::isnan(samples_[i][0])
                       ? background_
                       : values_[i] * share * static_cast<float>(samples_[i][4]);
    }
    return values_;
  }

 private:
  const MaterialMap& map_;
  const Albedo& albedo_;
  float background_;
  std::vector<double> moments_;
  std::vector<MaterialMap::Sample> samples_;
  std::vector<Eigen::Vector2d> places_;
  std::vector<float> at_moment_, values_;
};

// Rows of samples, each already summed along x into pixels.
Image<float> SampleRows(const MaterialMap& map, const Albedo& albedo, const RenderOptions& options,
                        const Kernel& kernel, ImageSize size) {
  const int S = options.samples_per_px, reach = kernel.reach_px;
  const int rows = (size.height + 2 * reach) * S;
  const auto count = static_cast<std::size_t>((size.width + 2 * reach) * S);
  Image<float> summed({size.width, rows});
  const int places = size.width + 2 * reach;
  tbb::parallel_for(tbb::blocked_range<int>(0, rows), [&](const tbb::blocked_range<int>& range) {
    RowSampler sampler(map, albedo, options, count);
    std::vector<float> of_phase(count);  // all first samples of a pixel, all second ones ...
    for (int j = range.begin(); j < range.end(); ++j) {
      const auto place = [&](int k) { return (k + 0.5) / S - 0.5 - reach; };
      const std::vector<float>& values = sampler.Row(place(j), place(0), 1.0 / S);
      for (int phase = 0; phase < S; ++phase) {
        float* out = of_phase.data() + static_cast<std::size_t>(phase * places);
        const float* in = values.data() + phase;
        for (int x = 0; x < places; ++x) out[x] = in[static_cast<std::size_t>(x * S)];
      }
      float* out = summed.row(j);
      for (int k = 0; k < static_cast<int>(kernel.weights.size()); ++k) {
        const float weight = kernel.weights[static_cast<std::size_t>(k)];
        const float* in = of_phase.data() + static_cast<std::size_t>(k % S * places + k / S);
        for (int x = 0; x < size.width; ++x) out[x] += weight * in[x];
      }
    }
  });
  return summed;
}

}  // namespace

void RenderOptions::Check() const {
  if (samples_per_px < 1 || samples_per_px > 32) {
    throw UsageError("Samples a pixel must lie in 1 to 32 in each direction.");
  }
  if (!(psf_sigma_px >= 0 && psf_sigma_px <= 5)) {
    throw UsageError("The sigma of the point-spread function must lie in 0 to 5 px.");
  }
  if (!(full_scale_grey > 0)) throw UsageError("The full-scale grey level must be positive.");
}

Image<float> Render(const Camera& camera, const Exposure& exposure, const Albedo& albedo,
                    const Light& light, const RenderOptions& options) {
  options.Check();
  const SurfaceView opening(camera, exposure.camera_from_world_opening, *exposure.opening);
  std::optional<SurfaceView> later;
  if (exposure.closing != exposure.opening) {
    later.emplace(
        SurfaceView::WithoutDepth(camera, exposure.camera_from_world_closing, *exposure.closing));
  }
  const Kernel kernel(options.psf_sigma_px, options.samples_per_px);
  const MaterialMap::Light light_of = [&](const SeenPoint& seen, const Eigen::Vector2d& pixel) {
    return light(seen.surface.position_mm, seen.surface.Normal(), pixel);
  };
  const MaterialMap map(opening, later ? *later : opening, light_of, kernel.reach_px);
  const Image<float> rows = SampleRows(map, albedo, options, kernel, camera.size());
  Image<float> image(camera.size());
  const int S = options.samples_per_px;
  tbb::parallel_for(0, image.height(), [&](int y) {
    float* out = image.row(y);
    for (std::size_t k = 0; k < kernel.weights.size(); ++k) {
      const float* in = rows.row(y * S + static_cast<int>(k));
      for (int x = 0; x < image.width(); ++x) out[x] += kernel.weights[k] * in[x];
    }
    for (int x = 0; x < image.width(); ++x) out[x] *= static_cast<float>(options.full_scale_grey);
  });
  return image;
}

}  // namespace plumbline
