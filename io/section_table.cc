#include "io/section_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "calib/error.h"
#include "io/internal/table_file.h"
#include "io/series_points.h"

namespace plumbline {

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
                          const CutPlane& plane, const NeighbourCorrelation& neighbours) {
  const std::vector<SectionPoint> section = CutSurface(PointsOf(frame), plane, neighbours);
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
