#include "io/bump_table.h"

#include <cmath>
#include <limits>

#include "calib/error.h"
#include "io/internal/table_file.h"
#include "io/series_points.h"

namespace plumbline {
namespace {

// NaN where a point has no place on the undeformed wheel.
Image<double> ThicknessOf(const CarcassThickness& carcass, const SeriesFrame& frame) {
  Image<double> thickness(frame.surface.status.size(), carcass.thickness_mm.front());
  if (carcass.y_mm.empty()) return thickness;
  for (std::size_t i = 0; i < thickness.pixel_count(); ++i) {
    const Eigen::Vector3d undeformed =
        (frame.surface.position_mm.data()[i] - frame.displacement.value_mm.data()[i])
            .cast<double>();
    const double y_mm = frame.wheel.axis.dot(undeformed - frame.wheel.centre_mm);
    thickness.data()[i] =
        std::isfinite(y_mm) ? carcass.At(y_mm) : std::numeric_limits<double>::quiet_NaN();
  }
  return thickness;
}

std::string Cells(const MeasuredScalar& scalar) {
  return internal::Cell(scalar.value) + internal::Cell(scalar.sigma_random) +
         internal::Cell(scalar.sigma_calibration());
}

}  // namespace

std::vector<FrameBumps> FindBumpsOf(const SeriesReader& series, const CarcassThickness& carcass,
                                    const BumpOptions& options) {
  carcass.Check();
  options.Check();
  const bool map = !carcass.y_mm.empty();
  if (map && !(series.contents().wheel && series.contents().displacement)) {
    throw InputError(
        "The run has no wheel from whose middle a map of the carcass could count: give one "
        "thickness for all.");
  }
  const std::vector<double> travel_mm = TravelOf(series);
  const NeighbourCorrelation neighbours = NeighboursOf(series);
  std::vector<FrameBumps> frames;
  for (std::int64_t i = 0; i < series.frame_count(); ++i) {
    const SeriesFrame frame = series.Frame(i);
    FrameBumps found{
        frame.index, frame.time_s, travel_mm[static_cast<std::size_t>(i)], frame.problem, {}};
    if (found.problem.empty() && frame.surface.frame != SurfaceFrame::kGround) {
      found.problem = "its positions are not in a ground frame";
    }
    if (found.problem.empty()) {
      found.bumps = FindBumps(PointsOf(frame), ThicknessOf(carcass, frame), neighbours, options);
    }
    frames.push_back(std::move(found));
  }
  return frames;
}

void ExportBumps(const std::filesystem::path& file, const std::vector<FrameBumps>& frames) {
  internal::WriteTableFile(file, [&](std::ostream& out) {
    out << "index,time_s,travel_mm,x_mm,y_mm,height_mm,sigma_random_height_mm,"
           "sigma_calibration_height_mm,clearance_mm,sigma_random_clearance_mm,"
           "sigma_calibration_clearance_mm,width_mm\n";
    for (const FrameBumps& frame : frames) {
      for (const Bump& bump : frame.bumps) {
        out << frame.index << internal::Cell(frame.time_s) << internal::Cell(frame.travel_mm)
            << internal::Cell(bump.at_mm.x()) << internal::Cell(bump.at_mm.y())
            << Cells(bump.height_mm) << Cells(bump.clearance_mm) << internal::Cell(bump.width_mm)
            << '\n';
      }
    }
  });
}

}  // namespace plumbline
