#include "track/planar_strain.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/error.h"
#include "track/internal/gauge_fit.h"

namespace plumbline {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Small enough that a tile's sums stay in the cache, large enough that what its windows reach
// around it does not count.
constexpr int kTileRows = 32, kTileColumns = 64;

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
  if (weights == GaugeWeights::kEqual) return 1;
  const double mean_px2 = 0.5 * (static_cast<double>(cov[0]) + cov[2]);
  return mean_px2 > 0 ? 1 / mean_px2 : 0;
}

float Sigma(double variance) { return static_cast<float>(std::sqrt(std::max(0.0, variance))); }

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
  out.cov_strain(row, column) << Eigen::Matrix<double, 6, 1>(cov(0, 0), cov(0, 1), cov(0, 2),
                                                             cov(1, 1), cov(1, 2), cov(2, 2))
                                     .cast<float>();
  out.rotation_rad(row, column) = static_cast<float>(measured.rotation_rad);
  out.sigma_rotation_rad(row, column) =
      Sigma(measured.d_rotation * cov_gradient * measured.d_rotation.transpose());
  const StrainInvariants invariants = InvariantsOf(measured.strain);
  const auto sigma = [&](const Eigen::RowVector3d& d) { return Sigma(d * cov * d.transpose()); };
  out.principal(row, column) = invariants.principal.cast<float>();
  out.sigma_principal(row, column) = {sigma(invariants.d_principal.row(0)),
                                      sigma(invariants.d_principal.row(1))};
  out.angle_rad(row, column) = static_cast<float>(invariants.angle_rad);
  out.sigma_angle_rad(row, column) = sigma(invariants.d_angle);
  out.max_shear(row, column) = static_cast<float>(invariants.max_shear);
  out.sigma_max_shear(row, column) = sigma(invariants.d_max_shear);
  out.von_mises(row, column) = static_cast<float>(invariants.von_mises);
  out.sigma_von_mises(row, column) = sigma(invariants.d_von_mises);
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

void OfGauges(const internal::GaugeData& data, const PlanarStrainOptions& options,
              PlanarStrain& out) {
  const ImageSize size = out.size();
  const int across = (size.width + kTileColumns - 1) / kTileColumns;
  const int down = (size.height + kTileRows - 1) / kTileRows;
  const int least = static_cast<int>(
      std::ceil(options.min_share * options.window_points * options.window_points));
  const double quarter = options.min_quarter_share * internal::QuarterPoints(data.half);
  tbb::parallel_for(0, across * down, [&](int i) {
    internal::GridTile tile{i / across * kTileRows, i % across * kTileColumns, kTileRows,
                            kTileColumns};
    tile.rows = std::min(tile.rows, size.height - tile.row);
    tile.columns = std::min(tile.columns, size.width - tile.column);
    const std::vector<internal::GaugeFit> fits = internal::FitGauges(data, tile, least);
    for (std::size_t cell = 0; cell < fits.size(); ++cell) {
      const int row = tile.row + static_cast<int>(cell) / tile.columns;
      const int column = tile.column + static_cast<int>(cell) % tile.columns;
      const internal::GaugeFit& fit = fits[cell];
      out.points(row, column) = static_cast<std::uint16_t>(fit.points);
      if (!(data.weight(row, column) > 0)) continue;
      const auto& quarters = fit.quarter_points;
      if (fit.solved && *std::min_element(quarters.begin(), quarters.end()) >= quarter) {
        SetPoint(fit.gradient, fit.cov_gradient, row, column, out);
      } else {
        out.status(row, column) = Status::kExtrapolated;
      }
    }
  });
}

}  // namespace

void PlanarStrainOptions::Check() const {
  if (window_points < 1 || window_points > 255 || window_points % 2 == 0)
    throw UsageError(
        fmt::format("window_points must be odd and between 1 and 255, not {}", window_points));
  if (order != 1 && order != 2)
    throw UsageError(fmt::format("the order of a strain gauge must be 1 or 2, not {}", order));
  if (!(min_share > 0 && min_share <= 1))
    throw UsageError(fmt::format("min_share must be above 0 and at most 1, not {}", min_share));
  if (!(min_quarter_share >= 0 && min_quarter_share <= 1))
    throw UsageError(
        fmt::format("min_quarter_share must be between 0 and 1, not {}", min_quarter_share));
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
  internal::GaugeData data{field,
                           correlation,
                           Image<double>(field.size()),
                           Image<Eigen::Vector2d>(field.size(), Eigen::Vector2d::Zero()),
                           options.window_points / 2,
                           options.order};
  for (int row = 0; row < field.size().height; ++row) {
    for (int column = 0; column < field.size().width; ++column) {
      data.weight(row, column) = WeightOf(field, row, column, options.weights);
      const Eigen::Vector3d cov = field.cov_displacement_px2(row, column).cast<double>();
      data.sigma_px(row, column) = {std::sqrt(cov[0]), std::sqrt(cov[2])};
      const Status status = field.status(row, column);
      out.status(row, column) = status == Status::kOk ? Status::kFailedVerification : status;
    }
  }
  if (of_subsets) {
    OfSubsets(field, data.weight, out);
  } else {
    OfGauges(data, options, out);
  }
  return out;
}

}  // namespace plumbline
