#include "track/surface_strain.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "match/planar_field.h"
#include "track/internal/gauge_fit.h"
#include "track/internal/tangent_deformation.h"

namespace plumbline {
namespace {

using internal::Tangents;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

void CheckSizes(const SurfaceState& instant, ImageSize grid) {
  bool differ = instant.d_left.size() != grid || instant.d_right.size() != grid ||
                instant.scale_left.size() != grid || instant.scale_right.size() != grid ||
                instant.share_left.size() != grid || instant.share_right.size() != grid ||
                instant.point_mm.size() != grid;
  for (const auto& mode : instant.along_modes_mm) differ = differ || mode.size() != grid;
  if (differ)
    throw InputError(
        fmt::format("the strain of a surface needs points, derivatives, scales and shares at all "
                    "of its points, but their images differ in size from the grid of {} x {}",
                    grid.width, grid.height));
}

// At the solved gauges of a tile.
struct TileGradients {
  std::vector<Tangents> tangents;
  // By gauge, then mode: what one sigma does to the tangents, row by row.
  Eigen::Matrix<float, 6, Eigen::Dynamic> modes;
};

// The points are fitted as seen from one of them, so that no digits are lost.
TileGradients GradientsOf(const SurfaceState& instant, const Image<double>& weight,
                          const internal::GaugeData& data, const internal::GridTile& tile,
                          const std::vector<internal::GaugeFit>& fits) {
  const auto modes = static_cast<Eigen::Index>(instant.along_modes_mm.size());
  TileGradients out{std::vector<Tangents>(fits.size()), {}};
  out.modes.resize(6, modes * static_cast<Eigen::Index>(fits.size()));
  const auto solved =
      std::find_if(fits.begin(), fits.end(), [](const auto& f) { return f.solved; });
  if (solved == fits.end()) return out;
  const int first = static_cast<int>(solved - fits.begin());
  const Eigen::Vector3d origin =
      instant.point_mm(tile.row + first / tile.columns, tile.column + first % tile.columns);
  internal::GradientFilter filter(weight, tile, data.half, data.order);
  for (int i = 0; i < 3; ++i) {
    filter.Apply(
        fits, [&](int r, int c) { return instant.point_mm(r, c)[i] - origin[i]; },
        [&](std::size_t cell, const Eigen::RowVector2d& gradient) {
          out.tangents[cell].row(i) = gradient;
        });
    for (Eigen::Index k = 0; k < modes; ++k) {
      const Image<Eigen::Vector3f>& mode = instant.along_modes_mm[static_cast<std::size_t>(k)];
      filter.Apply(
          fits, [&](int r, int c) { return static_cast<double>(mode(r, c)[i]); },
          [&](std::size_t cell, const Eigen::RowVector2d& gradient) {
            out.modes.col(static_cast<Eigen::Index>(cell) * modes + k).segment<2>(2 * i) =
                gradient.cast<float>().transpose();
          });
    }
  }
  return out;
}

// sum_mn rho_mn B_m C B_n' of the matches, B_m = s_m d strain / d Gamma_m: the noise of the
// reference image is common to all, the rest of each match its own.
class RandomCovariance {
 public:
  explicit RandomCovariance(const Eigen::Matrix4d& cov_gradient) : C_(cov_gradient) {}

  // by_tangents: d strain / d tangents; the match reaches these by D Gamma.
  void Add(const Eigen::Matrix<double, 3, 6>& by_tangents, const Eigen::Matrix<float, 3, 2>& D,
           float scale, float share) {
    By B = By::Zero();
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 2; ++k)
        B.middleCols<2>(2 * k) += by_tangents.middleCols<2>(2 * i) * static_cast<double>(D(i, k));
    }
    B *= scale;
    common_ += std::sqrt(static_cast<double>(share)) * B;
    own_ += (1 - static_cast<double>(share)) * B * C_ * B.transpose();
  }

  Eigen::Matrix3d Sum() const { return common_ * C_ * common_.transpose() + own_; }

 private:
  using By = Eigen::Matrix<double, 3, 4>;
  const Eigen::Matrix4d& C_;
  By common_ = By::Zero();
  Eigen::Matrix3d own_ = Eigen::Matrix3d::Zero();
};

}  // namespace

void SurfaceStrainOptions::Check() const {
  internal::CheckGauge(window_points, 3, order, min_share, min_quarter_share);
  if (x_direction && !(x_direction->allFinite() && x_direction->norm() > 0))
    throw UsageError("the x direction of a surface's strain must be a finite vector, not zero");
  if (x_around && !(x_around->point_mm.allFinite() && x_around->direction.allFinite() &&
                    x_around->direction.norm() > 0))
    throw UsageError("the line that a surface's strain goes around must be finite and directed");
  if (x_direction && x_around)
    throw UsageError("a surface's strain has one x axis: along a direction or around a line");
}

SurfaceStrain::SurfaceStrain(ImageSize size)
    : strain(size, Eigen::Vector3f::Constant(kNan)),
      cov_strain(size, Eigen::Matrix<float, 6, 1>::Constant(kNan)),
      sigma_calibration(size, Eigen::Vector3f::Constant(kNan)),
      principal(size, Eigen::Vector2f::Constant(kNan)),
      sigma_principal_random(size, Eigen::Vector2f::Constant(kNan)),
      sigma_principal_calibration(size, Eigen::Vector2f::Constant(kNan)),
      angle_rad(size, kNan),
      sigma_angle_random_rad(size, kNan),
      sigma_angle_calibration_rad(size, kNan),
      max_shear(size, kNan),
      sigma_max_shear_random(size, kNan),
      sigma_max_shear_calibration(size, kNan),
      von_mises(size, kNan),
      sigma_von_mises_random(size, kNan),
      sigma_von_mises_calibration(size, kNan),
      points(size, 0),
      status(size, Status::kExtrapolated) {}

struct SurfaceGauges::State {
  struct Tile {
    internal::TileGauges gauges;
    TileGradients gradients;
  };

  State(SurfaceState at_reference, Image<Eigen::Vector3f> covariances_px2,
        NeighbourCorrelation neighbour_correlation, int step_px, int subset_px,
        const SurfaceStrainOptions& strain_options)
      : options(strain_options),
        reference(std::move(at_reference)),
        cov_px2(std::move(covariances_px2)),
        neighbours(std::move(neighbour_correlation)),
        rule(options.window_points, options.min_share, options.min_quarter_share),
        data(neighbours, cov_px2, Weights(), step_px, options.window_points / 2, options.order),
        vsg_px((options.window_points - 1) * step_px + subset_px) {
    const std::vector<internal::GridTile> areas = internal::TilesOf(data.weight.size());
    tiles.resize(areas.size());
    tbb::parallel_for(std::size_t{0}, areas.size(), [&](std::size_t i) {
      tiles[i].gauges = internal::FitGauges(data, areas[i], rule.min_points);
      tiles[i].gradients =
          GradientsOf(reference, data.weight, data, areas[i], tiles[i].gauges.fits);
    });
    vsg_mm = VsgMm();
  }

  // Of the reference's points; 0 without a point or its covariance.
  Image<double> Weights() const {
    Image<double> weight(cov_px2.size(), 0.0);
    for (std::size_t i = 0; i < weight.pixel_count(); ++i) {
      const Eigen::Vector3f& cov = cov_px2.data()[i];
      const bool usable =
          reference.point_mm.data()[i].allFinite() && cov.allFinite() && cov[0] >= 0 && cov[2] >= 0;
      if (usable) weight.data()[i] = internal::WeightOf(cov, options.weights);
    }
    return weight;
  }

  // What e1 of a gauge follows; nothing: growing columns of the grid.
  std::optional<Eigen::Vector3d> XDirection(int row, int column) const {
    if (!options.x_around) return options.x_direction;
    const LineInSpace& line = *options.x_around;
    return line.direction.cross(reference.point_mm(row, column) - line.point_mm);
  }

  // Calls visit(row, column, tangents) at the gauges of the reference.
  template <typename Visit>
  void ForEachGauge(const Visit& visit) const {
    for (const Tile& tile : tiles) {
      const internal::GridTile& area = tile.gauges.tile;
      for (std::size_t cell = 0; cell < area.cells(); ++cell) {
        if (!rule.IsMetBy(tile.gauges.fits[cell])) continue;
        visit(area.RowOf(cell), area.ColumnOf(cell), tile.gradients.tangents[cell]);
      }
    }
  }

  // Of the median gauge; NaN without one.
  double VsgMm() const {
    std::vector<double> mm_per_px;
    ForEachGauge([&](int, int, const Tangents& tangents) {
      mm_per_px.push_back(std::sqrt(tangents.col(0).cross(tangents.col(1)).norm()));
    });
    return mm_per_px.empty() ? kNan : vsg_px * Median(std::move(mm_per_px));
  }

  // Whether a gauge of the tile has lost a point of the reference. present: the weights of those
  // that are there, 0 for others.
  bool IsTouched(const internal::GridTile& tile, const Image<double>& present) const {
    const ImageSize size = present.size();
    const int h = data.half;
    for (int r = std::max(0, tile.row - h); r < std::min(size.height, tile.row + tile.rows + h);
         ++r) {
      for (int c = std::max(0, tile.column - h);
           c < std::min(size.width, tile.column + tile.columns + h); ++c) {
        if (data.weight(r, c) > 0 && !(present(r, c) > 0)) return true;
      }
    }
    return false;
  }

  void SetTile(const Tile& tile, const SurfaceState& now, const Image<double>& present,
               SurfaceStrain& out) const;
  void SetPoint(const internal::GaugeFit& fit, const TileGradients& before,
                const TileGradients& after, std::size_t cell, int row, int column,
                const SurfaceState& now, SurfaceStrain& out) const;

  SurfaceStrainOptions options;
  SurfaceState reference;
  Image<Eigen::Vector3f> cov_px2;
  NeighbourCorrelation neighbours;
  internal::GaugeRule rule;
  internal::GaugeData data;  // refers to those above
  int vsg_px;
  double vsg_mm;
  std::vector<Tile> tiles;
};

// The status of a point that is there has been set to kFailedVerification.
void SurfaceGauges::State::SetPoint(const internal::GaugeFit& fit, const TileGradients& before,
                                    const TileGradients& after, std::size_t cell, int row,
                                    int column, const SurfaceState& now, SurfaceStrain& out) const {
  const internal::TangentDeformation deformation =
      internal::DeformationOf(before.tangents[cell], after.tangents[cell], XDirection(row, column));
  const GradientStrain measured =
      StrainOf(deformation.F - Eigen::Matrix2d::Identity(), options.measure);
  const Eigen::Matrix<double, 3, 6> by_reference = measured.d_strain * deformation.d_reference;
  const Eigen::Matrix<double, 3, 6> by_now = measured.d_strain * deformation.d_now;
  RandomCovariance random(fit.cov_gradient);
  const auto add = [&](const Eigen::Matrix<double, 3, 6>& by, const SurfaceState& instant) {
    random.Add(by, instant.d_left(row, column), instant.scale_left(row, column),
               instant.share_left(row, column));
    random.Add(by, instant.d_right(row, column), instant.scale_right(row, column),
               instant.share_right(row, column));
  };
  add(by_reference, reference);
  add(by_now, now);
  const Eigen::Matrix3d cov = random.Sum();
  if (!measured.strain.allFinite() || !cov.allFinite()) return;

  const auto modes = static_cast<Eigen::Index>(
      std::min(reference.along_modes_mm.size(), now.along_modes_mm.size()));
  Eigen::Matrix3d cov_calibration = Eigen::Matrix3d::Constant(modes > 0 ? 0 : kNan);
  for (Eigen::Index k = 0; k < modes; ++k) {
    const Eigen::Index at = static_cast<Eigen::Index>(cell) * modes + k;
    const Eigen::Vector3d change = by_reference * before.modes.col(at).cast<double>() +
                                   by_now * after.modes.col(at).cast<double>();
    cov_calibration += change * change.transpose();
  }

  out.status(row, column) = Status::kOk;
  out.strain(row, column) = measured.strain.cast<float>();
  out.cov_strain(row, column) = TriangleOf(cov);
  out.sigma_calibration(row, column) = cov_calibration.diagonal().cwiseSqrt().cast<float>();
  const StrainInvariants invariants = InvariantsOf(measured.strain);
  out.principal(row, column) = invariants.principal.cast<float>();
  out.angle_rad(row, column) = static_cast<float>(invariants.angle_rad);
  out.max_shear(row, column) = static_cast<float>(invariants.max_shear);
  out.von_mises(row, column) = static_cast<float>(invariants.von_mises);
  const InvariantSigmas noise = SigmasOf(invariants, cov);
  out.sigma_principal_random(row, column) = noise.principal.cast<float>();
  out.sigma_angle_random_rad(row, column) = static_cast<float>(noise.angle_rad);
  out.sigma_max_shear_random(row, column) = static_cast<float>(noise.max_shear);
  out.sigma_von_mises_random(row, column) = static_cast<float>(noise.von_mises);
  const InvariantSigmas rig = SigmasOf(invariants, cov_calibration);
  out.sigma_principal_calibration(row, column) = rig.principal.cast<float>();
  out.sigma_angle_calibration_rad(row, column) = static_cast<float>(rig.angle_rad);
  out.sigma_max_shear_calibration(row, column) = static_cast<float>(rig.max_shear);
  out.sigma_von_mises_calibration(row, column) = static_cast<float>(rig.von_mises);
}

void SurfaceGauges::State::SetTile(const Tile& tile, const SurfaceState& now,
                                   const Image<double>& present, SurfaceStrain& out) const {
  const internal::GridTile& area = tile.gauges.tile;
  std::vector<internal::GaugeFit> fits_left;
  TileGradients gradients_left;
  const bool touched = IsTouched(area, present);
  if (touched) {
    fits_left = internal::FitsWithoutMissing(data, tile.gauges, present, rule.min_points);
    gradients_left = GradientsOf(reference, present, data, area, fits_left);
  }
  const std::vector<internal::GaugeFit>& fits = touched ? fits_left : tile.gauges.fits;
  const TileGradients& before = touched ? gradients_left : tile.gradients;
  const TileGradients after = GradientsOf(now, present, data, area, fits);
  for (std::size_t cell = 0; cell < fits.size(); ++cell) {
    const int row = area.RowOf(cell), column = area.ColumnOf(cell);
    out.points(row, column) = static_cast<std::uint16_t>(fits[cell].points);
    if (!(present(row, column) > 0)) continue;
    if (rule.IsMetBy(fits[cell])) {
      SetPoint(fits[cell], before, after, cell, row, column, now, out);
    } else {
      out.status(row, column) = Status::kExtrapolated;
    }
  }
}

SurfaceGauges::SurfaceGauges(SurfaceState reference, Image<Eigen::Vector3f> cov_px2,
                             NeighbourCorrelation neighbours, int step_px, int subset_px,
                             const SurfaceStrainOptions& options) {
  options.Check();
  if (cov_px2.empty()) throw InputError("the strain of a surface needs points, and there are none");
  CheckSizes(reference, cov_px2.size());
  if (step_px < 1 || subset_px < 1)
    throw InputError(fmt::format(
        "the step and the subset of a surface's points must be at least 1 px, not {} and {}",
        step_px, subset_px));
  state_ = std::make_shared<const State>(std::move(reference), std::move(cov_px2),
                                         std::move(neighbours), step_px, subset_px, options);
}

SurfaceStrain SurfaceGauges::Strain(const SurfaceState& now, const Image<Status>& status) const {
  const State& state = *state_;
  const ImageSize size = state.data.weight.size();
  CheckSizes(now, size);
  if (status.size() != size)
    throw InputError("the strain of a surface needs the status of all of its points");
  const std::size_t modes = state.reference.along_modes_mm.size();
  if (modes > 0 && !now.along_modes_mm.empty() && now.along_modes_mm.size() != modes)
    throw InputError(fmt::format(
        "the points move along {} calibration modes, but those of the reference along {}; take "
        "both from one rig",
        now.along_modes_mm.size(), modes));
  SurfaceStrain out(size);
  out.measure = state.options.measure;
  out.window_points = state.options.window_points;
  out.order = state.options.order;
  out.vsg_px = state.vsg_px;
  out.vsg_mm = state.vsg_mm;
  Image<double> present(size, 0.0);
  for (std::size_t i = 0; i < present.pixel_count(); ++i) {
    const bool ok = status.data()[i] == Status::kOk;
    out.status.data()[i] = ok ? Status::kFailedVerification : status.data()[i];
    if (ok && now.point_mm.data()[i].allFinite()) present.data()[i] = state.data.weight.data()[i];
  }
  tbb::parallel_for(std::size_t{0}, state.tiles.size(),
                    [&](std::size_t i) { state.SetTile(state.tiles[i], now, present, out); });
  return out;
}

Image<Eigen::Matrix3f> SurfaceGauges::axes() const {
  Image<Eigen::Matrix3f> out(state_->data.weight.size(), Eigen::Matrix3f::Constant(kNan));
  state_->ForEachGauge([&](int row, int column, const Tangents& tangents) {
    out(row, column) = internal::DeformationOf(tangents, tangents, state_->XDirection(row, column))
                           .axes.cast<float>();
  });
  return out;
}

}  // namespace plumbline
