#include "track/planar_strain.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "track/internal/gauge_fit.h"

namespace plumbline {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

void CheckSizes(const PlanarField& field, bool gradients) {
  const ImageSize size = field.size();
  const bool differ =
      size.width < 1 || size.height < 1 || field.displacement_px.size() != size ||
      field.cov_displacement_px2.size() != size ||
      (gradients && (field.gradient.size() != size || field.cov_gradient.size() != size));
  if (differ)
    throw InputError(fmt::format(
        "the strain of a field needs displacement, covariance and status at all of its points, but "
        "their images differ in size from its {} x {} points; correlate again",
        size.width, size.height));
  if (field.step_px < 1)
    throw InputError(
        fmt::format("the step of a field must be at least 1 px, not {}", field.step_px));
}

// The weight of a point in its gauges; 0 where it has nothing to give.
double WeightOf(const PlanarField& field, int row, int column, GaugeWeights weights) {
  const Eigen::Vector3f& cov = field.cov_displacement_px2(row, column);
  if (field.status(row, column) != Status::kOk || !field.displacement_px(row, column).allFinite() ||
      !cov.allFinite() || cov[0] < 0 || cov[2] < 0)
    return 0;
  return internal::WeightOf(cov, weights);
}

// Strain and all that follows from it at one point. Its status becomes kFailedVerification where
// there is none.
void SetPoint(const Eigen::Matrix2d& gradient, const Eigen::Matrix4d& cov_gradient, int row,
              int column, PlanarStrain& out) {
  const GradientStrain measured = StrainOf(gradient, out.measure);
  const Eigen::Matrix3d cov = measured.d_strain * cov_gradient * measured.d_strain.transpose();
  if (!measured.strain.allFinite() || !cov.allFinite()) {
    out.status(row, column) = Status::kFailedVerification;
    return;
  }
  out.status(row, column) = Status::kOk;
  out.strain(row, column) = measured.strain.cast<float>();
  out.cov_strain(row, column) = TriangleOf(cov);
  out.rotation_rad(row, column) = static_cast<float>(measured.rotation_rad);
  const double rotation_variance =
      measured.d_rotation * cov_gradient * measured.d_rotation.transpose();
  out.sigma_rotation_rad(row, column) =
      static_cast<float>(std::sqrt(std::max(rotation_variance, 0.0)));
  const StrainInvariants invariants = InvariantsOf(measured.strain);
  const InvariantSigmas sigmas = SigmasOf(invariants, cov);
  out.principal(row, column) = invariants.principal.cast<float>();
  out.sigma_principal(row, column) = sigmas.principal.cast<float>();
  out.angle_rad(row, column) = static_cast<float>(invariants.angle_rad);
  out.sigma_angle_rad(row, column) = static_cast<float>(sigmas.angle_rad);
  out.max_shear(row, column) = static_cast<float>(invariants.max_shear);
  out.sigma_max_shear(row, column) = static_cast<float>(sigmas.max_shear);
  out.von_mises(row, column) = static_cast<float>(invariants.von_mises);
  out.sigma_von_mises(row, column) = static_cast<float>(sigmas.von_mises);
}

void OfSubsets(const PlanarField& field, const Image<double>& weight, PlanarStrain& out) {
  tbb::parallel_for(0, field.size().height, [&](int row) {
    for (int column = 0; column < field.size().width; ++column) {
      if (!(weight(row, column) > 0)) continue;
      SetPoint(field.gradient(row, column).cast<double>(),
               CovarianceOf(field.cov_gradient(row, column)), row, column, out);
      out.points(row, column) = 1;
    }
  });
}

void OfGauges(const PlanarField& field, const internal::GaugeData& data,
              const PlanarStrainOptions& options, PlanarStrain& out) {
  const std::vector<internal::GridTile> tiles = internal::TilesOf(out.size());
  const internal::GaugeRule rule(options.window_points, options.min_share,
                                 options.min_quarter_share);
  tbb::parallel_for(std::size_t{0}, tiles.size(), [&](std::size_t i) {
    const internal::GridTile& tile = tiles[i];
    const auto fits = internal::FitGauges(data, tile, rule.min_points).fits;
    internal::GradientFilter filter(data.weight, tile, data.half, data.order);
    std::vector<Eigen::Matrix2d> gradients(fits.size());
    for (int component = 0; component < 2; ++component)
      filter.Apply(
          fits, [&](int r, int c) { return field.displacement_px(r, c)[component]; },
          [&](std::size_t cell, const Eigen::RowVector2d& gradient) {
            gradients[cell].row(component) = gradient;
          });
    for (std::size_t cell = 0; cell < fits.size(); ++cell) {
      const int row = tile.RowOf(cell), column = tile.ColumnOf(cell);
      out.points(row, column) = static_cast<std::uint16_t>(fits[cell].points);
      if (!(data.weight(row, column) > 0)) continue;
      if (rule.IsMetBy(fits[cell])) {
        SetPoint(gradients[cell], fits[cell].cov_gradient, row, column, out);
      } else {
        out.status(row, column) = Status::kExtrapolated;
      }
    }
  });
}

}  // namespace

void PlanarStrainOptions::Check() const {
  internal::CheckGauge(window_points, 1, order, min_share, min_quarter_share);
}

PlanarStrain::PlanarStrain(ImageSize size)
    : strain(size, Eigen::Vector3f::Constant(kNan)),
      cov_strain(size, Eigen::Matrix<float, 6, 1>::Constant(kNan)),
      rotation_rad(size, kNan),
      sigma_rotation_rad(size, kNan),
      principal(size, Eigen::Vector2f::Constant(kNan)),
      sigma_principal(size, Eigen::Vector2f::Constant(kNan)),
      angle_rad(size, kNan),
      sigma_angle_rad(size, kNan),
      max_shear(size, kNan),
      sigma_max_shear(size, kNan),
      von_mises(size, kNan),
      sigma_von_mises(size, kNan),
      points(size, 0),
      status(size, Status::kExtrapolated) {}

PlanarStrain ComputePlanarStrain(const PlanarField& field, const NeighbourCorrelation& correlation,
                                 const PlanarStrainOptions& options) {
  options.Check();
  const bool of_subsets = options.window_points == 1;
  CheckSizes(field, of_subsets);
  if (of_subsets && field.order < 1)
    throw UsageError(
        "a strain gauge of one point needs the gradient of its subset, and shape functions of "
        "order "
        "0 have none; take a window of 3 points or more");
  PlanarStrain out(field.size());
  out.measure = options.measure;
  out.window_points = options.window_points;
  out.order = options.order;
  out.vsg_px = (options.window_points - 1) * field.step_px + field.subset_px;
  Image<double> weight(field.size());
  for (int row = 0; row < field.size().height; ++row) {
    for (int column = 0; column < field.size().width; ++column) {
      weight(row, column) = WeightOf(field, row, column, options.weights);
      const Status status = field.status(row, column);
      out.status(row, column) = status == Status::kOk ? Status::kFailedVerification : status;
    }
  }
  if (of_subsets) {
    OfSubsets(field, weight, out);
  } else {
    const internal::GaugeData data(correlation, field.cov_displacement_px2, std::move(weight),
                                   field.step_px, options.window_points / 2, options.order);
    OfGauges(field, data, options, out);
  }
  return out;
}

}  // namespace plumbline
