#include "io/section_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "calib/error.h"
#include "io/internal/table_file.h"
#include "match/neighbour_correlation.h"

namespace plumbline {
namespace {

SurfacePoints PointsOf(const Surface& surface) {
  const ImageSize size = surface.status.size();
  SurfacePoints points;
  points.point_mm = Image<Eigen::Vector3d>(size, Eigen::Vector3d::Zero());
  points.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>(size, Eigen::Matrix<float, 6, 1>::Zero());
  Image<Eigen::Vector3f> calibration(size, Eigen::Vector3f::Zero());
  bool known = false;
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    points.point_mm.data()[i] = surface.position_mm.data()[i].cast<double>();
    const Eigen::Vector3f variance = surface.sigma_random_mm.data()[i].cwiseAbs2();
    points.cov_random_mm2.data()[i] << variance.x(), 0, 0, variance.y(), 0, variance.z();
    const Eigen::Vector3f& common = surface.sigma_calibration_mm.data()[i];
    if (!common.allFinite()) continue;
    known = true;
    calibration.data()[i] = common;
  }
  if (known) points.along_modes_mm.push_back(std::move(calibration));
  return points;
}

}  // namespace

CutPlane ParseSection(const std::string& text) {
  double at_mm = 0;
  const char* const end = text.data() + text.size();
  const bool named = text.size() > 2 && (text[0] == 'x' || text[0] == 'y') && text[1] == '=';
  if (named) {
    const auto [next, error] = std::from_chars(text.data() + 2, end, at_mm);
    if (error == std::errc() && next == end && std::isfinite(at_mm)) {
      return text[0] == 'x' ? CutPlane::AtX(at_mm) : CutPlane::AtY(at_mm);
    }
  }
  throw UsageError(
      fmt::format("A section is x=150 (lateral) or y=0 (longitudinal), in mm of the frame of the "
                  "positions, not "
                  "'{}'.",
                  text));
}

std::size_t ExportSection(const std::filesystem::path& file, const SeriesFrame& frame,
                          const CutPlane& plane, int step_px, int subset_px) {
  const SurfacePoints points = PointsOf(frame.surface);
  const auto neighbours =
      NeighbourCorrelation::OfOverlap(points.size(), step_px, std::max(subset_px | 1, 3), 1);
  const std::vector<SectionPoint> section = CutSurface(points, plane, neighbours);
  internal::WriteTableFile(file, [&](std::ostream& out) {
    out << "along_mm,up_mm,x_mm,y_mm,z_mm,sigma_random_mm,sigma_calibration_mm\n";
    for (const SectionPoint& point : section) {
      const double values[] = {point.along_mm,
                               point.up_mm,
                               point.position_mm.x(),
                               point.position_mm.y(),
                               point.position_mm.z(),
                               point.sigma_random_mm,
                               point.sigma_calibration_mm};
      std::string line;
      for (const double value : values) line += internal::Cell(point.gap() ? NAN : value);
      out << line.substr(1) << '\n';
    }
  });
  return static_cast<std::size_t>(std::count_if(
      section.begin(), section.end(), [](const SectionPoint& point) { return !point.gap(); }));
}

}  // namespace plumbline
