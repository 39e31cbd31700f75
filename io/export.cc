#include "io/export.h"

#include <fmt/format.h>

#include <array>
#include <bit>
#include <cerrno>
#include <cmath>
#include <fstream>

#include "io/internal/durable_file.h"

namespace plumbline {
namespace {

namespace fs = std::filesystem;
static_assert(std::endian::native == std::endian::little, "PLY is written as it lies in memory");

using PointValues = std::array<float, 11>;

PointValues ValuesOf(const Surface& s, int r, int c) {
  const auto& p = s.position_mm(r, c);
  const auto& a = s.sigma_random_mm(r, c);
  const auto& b = s.sigma_calibration_mm(r, c);
  return {p.x(),
          p.y(),
          p.z(),
          a.x(),
          a.y(),
          a.z(),
          b.x(),
          b.y(),
          b.z(),
          s.correlation(r, c),
          s.epipolar_px(r, c)};
}

template <typename Use>
void ForEachPoint(const Surface& surface, const Use& use, bool all = false) {
  for (int r = 0; r < surface.status.height(); ++r) {
    for (int c = 0; c < surface.status.width(); ++c) {
      if (all || surface.status(r, c) == Status::kOk) use(r, c);
    }
  }
}

template <typename Write>
void WriteStream(const fs::path& file, const Write& write) {
  internal::WriteDurably(file, [&](const fs::path& temporary) {
    std::ofstream out(temporary, std::ios::binary);
    if (out) write(out);
    out.close();
    if (!out) internal::ThrowSystemError("cannot write", file, errno);
  });
}

}  // namespace

void ExportPly(const fs::path& file, const SeriesFrame& frame) {
  std::size_t count = 0;
  ForEachPoint(frame.surface, [&](int, int) { ++count; });
  WriteStream(file, [&](std::ofstream& out) {
    out << "ply\nformat binary_little_endian 1.0\ncomment plumbline: lengths in mm, sigmas are one "
           "standard deviation\n"
        << "element vertex " << count << '\n';
    for (const char* name : {"x", "y", "z", "sigma_random_x", "sigma_random_y", "sigma_random_z",
                             "sigma_calibration_x", "sigma_calibration_y", "sigma_calibration_z",
                             "correlation", "epipolar_px"}) {
      out << "property float " << name << '\n';
    }
    out << "end_header\n";
    ForEachPoint(frame.surface, [&](int r, int c) {
      const PointValues values = ValuesOf(frame.surface, r, c);
      out.write(reinterpret_cast<const char*>(values.data()), sizeof values);
    });
  });
}

void ExportCsv(const fs::path& file, const SeriesFrame& frame, CsvPoints points) {
  const bool all = points == CsvPoints::kAll;
  WriteStream(file, [&](std::ofstream& out) {
    out << "row,col,x_mm,y_mm,z_mm,sigma_random_x_mm,sigma_random_y_mm,sigma_random_z_mm,"
           "sigma_calibration_x_mm,sigma_calibration_y_mm,sigma_calibration_z_mm,correlation,"
           "epipolar_px"
        << (all ? ",status\n" : "\n");
    const auto write = [&](int r, int c) {
      out << r << ',' << c;
      for (const float v : ValuesOf(frame.surface, r, c)) {
        out << (std::isnan(v) ? ",nan" : fmt::format(",{:.9g}", v));  // never -nan
      }
      if (all) out << ',' << Name(frame.surface.status(r, c));
      out << '\n';
    };
    ForEachPoint(frame.surface, write, all);
  });
}

}  // namespace plumbline
