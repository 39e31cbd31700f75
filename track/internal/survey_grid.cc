#include "track/internal/survey_grid.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "calib/error.h"
#include "match/correlation_area.h"
#include "match/neighbour_correlation.h"
#include "track/stored_matches.h"

namespace plumbline::internal {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;

PlanarField EveryMatchOf(const PlanarField& field, const PlanarField& other, int stride) {
  PlanarField out;
  out.first_px = field.first_px;
  out.step_px = stride * field.step_px;
  out.subset_px = field.subset_px;
  out.order = field.order;
  out.displacement_px = EveryOf(field.displacement_px, stride);
  out.gradient = EveryOf(field.gradient, stride);
  out.cov_displacement_px2 = EveryOf(field.cov_displacement_px2, stride);
  out.reference_share = EveryOf(field.reference_share, stride);
  out.status = EveryOf(field.status, stride);
  const Image<Status> beside = EveryOf(other.status, stride);
  for (std::size_t i = 0; i < out.status.pixel_count(); ++i) {
    if (beside.data()[i] != Status::kOk) out.status.data()[i] = beside.data()[i];
  }
  return out;
}

}  // namespace

void CheckSize(const WheelReference& wheel, const GrayImage& left, const GrayImage& right) {
  for (const auto& [image, camera] :
       {std::pair(&left, &wheel.rig.left), std::pair(&right, &wheel.rig.right)}) {
    if (image->size() == camera->size()) continue;
    throw InputError(fmt::format(
        "the image has {} x {} px and the wheel's reference images {} x {}: it is of another rig",
        image->width(), image->height(), camera->size().width, camera->size().height));
  }
}

std::size_t NearestView(const WheelReference& wheel, double angle_rad) {
  std::size_t nearest = 0;
  double least = kTurn_rad;
  for (std::size_t v = 0; v < wheel.views.size(); ++v) {
    const double off = std::abs(std::remainder(angle_rad - wheel.views[v].angle_rad, kTurn_rad));
    if (off < least) {
      least = off;
      nearest = v;
    }
  }
  return nearest;
}

int StrideFor(int points, int most) {
  int stride = 1;
  while (points > most * stride * stride) ++stride;
  return stride;
}

StereoField EveryMatch(const StereoField& field, int stride) {
  StereoField out;
  out.left = EveryMatchOf(field.left, field.right, stride);
  out.right = EveryMatchOf(field.right, field.left, stride);
  RoundAsStored(&out);
  return out;
}

double AlikePoints(const PlanarField& grid, const CorrelatorOptions& correlator) {
  const NeighbourCorrelation neighbours =
      NeighbourCorrelation::OfOverlap(grid.size(), grid.step_px, correlator.subset_px,
                                      correlator.order, correlator.shape == SubsetShape::kCircle);
  return CorrelationArea(neighbours, grid.size());
}

RollingSurveyOptions Coarser(RollingSurveyOptions options, ImageSize image) {
  FieldOptions& field = options.matching.field;
  const bool placed = field.first_px.x() >= 0;
  const int points = placed ? field.grid.width * field.grid.height
                            : image.width / field.step_px * (image.height / field.step_px);
  const int by = std::min(StrideFor(points, options.most_points),
                          std::max(1, field.correlator.radius_px() / field.step_px));
  field.step_px *= by;
  if (placed) field.grid = {(field.grid.width - 1) / by + 1, (field.grid.height - 1) / by + 1};
  return options;
}

}  // namespace plumbline::internal
