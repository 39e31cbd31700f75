#include "apps/planar_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "calib/error.h"
#include "calib/median.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

double MedianOrNone(std::vector<double> values) {
  return values.empty() ? kNone : Median(std::move(values));
}

const char* PrefilterName(Prefilter filter) {
  return filter == Prefilter::kLowPass ? "low-pass"
         : filter == Prefilter::kNone  ? "none"
                                       : "gaussian";
}

}  // namespace

void PlanarRunOptions::Check() const {
  sequence.Check();
  strain_options.Check();
  if (strain && strain_options.window_points == 1 && sequence.field.correlator.order < 1) {
    throw UsageError(
        "A strain window of 1 point takes the gradient of the subset, and a shape function of "
        "order 0 has none; take a window of 3 points or more.");
  }
}

PlanarSummary Summarise(const PlanarSeriesFrame& frame) {
  PlanarSummary summary;
  std::vector<double> u, v, sigma, zncc;
  const PlanarField& field = frame.field;
  for (std::size_t i = 0; i < field.status.pixel_count(); ++i) {
    if (field.status.data()[i] != Status::kOk) continue;
    u.push_back(field.displacement_px.data()[i].x());
    v.push_back(field.displacement_px.data()[i].y());
    const Eigen::Vector3f& cov = field.cov_displacement_px2.data()[i];
    sigma.push_back(std::sqrt((cov[0] + cov[2]) / 2));
    zncc.push_back(field.zncc.data()[i]);
  }
  summary.least_px = summary.most_px = Eigen::Vector2d::Constant(kNone);
  if (!u.empty()) {
    summary.least_px = {*std::min_element(u.begin(), u.end()),
                        *std::min_element(v.begin(), v.end())};
    summary.most_px = {*std::max_element(u.begin(), u.end()),
                       *std::max_element(v.begin(), v.end())};
  }
  summary.median_px = {MedianOrNone(std::move(u)), MedianOrNone(std::move(v))};
  summary.median_sigma_px = MedianOrNone(std::move(sigma));
  summary.median_zncc = MedianOrNone(std::move(zncc));
  constexpr int kDiagonal[3] = {0, 3, 5};
  for (int k = 0; k < 3; ++k) {
    std::vector<double> value, error;
    for (std::size_t i = 0; i < frame.strain.status.pixel_count(); ++i) {
      if (frame.strain.status.data()[i] != Status::kOk) continue;
      value.push_back(frame.strain.strain.data()[i][k]);
      error.push_back(std::sqrt(frame.strain.covariance.data()[i][kDiagonal[k]]));
    }
    summary.strain_points = static_cast<std::int64_t>(value.size());
    summary.median_strain[k] = MedianOrNone(std::move(value));
    summary.median_sigma_strain[k] = MedianOrNone(std::move(error));
  }
  return summary;
}

PlanarStrainRecord RecordOf(PlanarStrain strain) {
  return {std::move(strain.strain), std::move(strain.cov_strain), std::move(strain.status)};
}

struct PlanarRun::Impl {
  PlanarRunOptions options;
  ImageSize size;
  int bits = 8;
  std::unique_ptr<PlanarSequence> sequence;
};

PlanarRun::PlanarRun(const GrayImage& reference, const PlanarRunOptions& options)
    : impl_(std::make_unique<Impl>(Impl{options, reference.size(), reference.bits, nullptr})) {
  options.Check();
  FieldOptions& field = impl_->options.sequence.field;
  if (field.correlator.subset_px > std::min(reference.width(), reference.height())) {
    throw InputError(fmt::format(
        "A subset of {} px does not fit into the reference image of {} x {} px; take a smaller "
        "--subset or larger images.",
        field.correlator.subset_px, reference.width(), reference.height()));
  }
  if (options.roi) PlaceGrid(*options.roi, reference.size(), field);
  impl_->sequence =
      std::make_unique<PlanarSequence>(reference, impl_->options.sequence,
                                       WantedPixels(reference.size(), options.roi, options.mask));
}

PlanarRun::~PlanarRun() = default;

PlanarSeriesHeader PlanarRun::Header() const {
  const FieldOptions& field = impl_->sequence->correlator().options();
  PlanarSeriesHeader header;
  header.grid = field.grid;
  header.first_px = field.first_px;
  header.step_px = field.step_px;
  header.subset_px = field.correlator.subset_px;
  header.order = field.correlator.order;
  header.subset_shape = field.correlator.shape == SubsetShape::kCircle ? "circle" : "square";
  header.interpolation = field.image.interpolation == Interpolation::kCubic ? "cubic" : "quintic";
  header.prefilter = PrefilterName(field.image.prefilter);
  if (field.image.prefilter == Prefilter::kGaussian) {
    header.prefilter_sigma_px = field.image.gaussian_sigma_px;
  }
  const PlanarStrainOptions& strain = impl_->options.strain_options;
  if (impl_->options.strain) {
    header.strain_measure = Name(strain.measure);
    header.window_points = strain.window_points;
    header.vsg_px = (strain.window_points - 1) * field.step_px + field.correlator.subset_px;
  }
  header.camera = {impl_->size, impl_->bits, {kNone, kNone}, "the residuals of each subset"};
  if (field.correlator.noise) {
    header.camera.noise = *field.correlator.noise;
    header.camera.noise_source = impl_->options.noise_source;
  }
  header.contents = {impl_->options.gradient_covariance, impl_->options.strain};
  return header;
}

CorrelatedFrame PlanarRun::Correlate(const SequenceImage& image) {
  CorrelatedFrame result;
  result.frame.index = image.index;
  result.frame.time_s = image.time_s;
  result.frame.id = image.id;
  result.frame.problem = image.problem;
  if (image.problem.empty()) {
    const auto begin = std::chrono::steady_clock::now();
    try {
      SequenceFrame matched = impl_->sequence->Add(image.image, image.index);
      result.frame.reference_index = matched.reference_frame;
      result.frame.field = std::move(matched.field);
      result.counts = matched.counts;
      result.lost_at_updates = matched.lost_at_updates;
    } catch (const InputError& error) {
      result.frame.problem = error.what();
    }
    if (impl_->options.strain && result.frame.problem.empty()) {
      result.frame.strain = RecordOf(ComputePlanarStrain(result.frame.field,
                                                         impl_->sequence->correlator().neighbours(),
                                                         impl_->options.strain_options));
    }
    result.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  }
  result.summary = Summarise(result.frame);
  return result;
}

}  // namespace plumbline
