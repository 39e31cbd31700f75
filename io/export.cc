#include "io/export.h"

#include <array>
#include <bit>
#include <cmath>
#include <ostream>

#include "io/internal/table_file.h"

namespace plumbline {
namespace {

namespace fs = std::filesystem;
using internal::Cell;
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
void ForEachPoint(const Image<Status>& status, const Use& use, bool all = false) {
  for (int r = 0; r < status.height(); ++r) {
    for (int c = 0; c < status.width(); ++c) {
      if (all || status(r, c) == Status::kOk) use(r, c);
    }
  }
}

}  // namespace

void ExportPly(const fs::path& file, const SeriesFrame& frame) {
  std::size_t count = 0;
  ForEachPoint(frame.surface.status, [&](int, int) { ++count; });
  internal::WriteTableFile(file, [&](std::ostream& out) {
    out << "ply\nformat binary_little_endian 1.0\ncomment plumbline: lengths in mm, sigmas are one "
           "standard deviation\n"
        << "element vertex " << count << '\n';
    for (const char* name : {"x", "y", "z", "sigma_random_x", "sigma_random_y", "sigma_random_z",
                             "sigma_calibration_x", "sigma_calibration_y", "sigma_calibration_z",
                             "correlation", "epipolar_px"}) {
      out << "property float " << name << '\n';
    }
    out << "end_header\n";
    ForEachPoint(frame.surface.status, [&](int r, int c) {
      const PointValues values = ValuesOf(frame.surface, r, c);
      out.write(reinterpret_cast<const char*>(values.data()), sizeof values);
    });
  });
}

void ExportCsv(const fs::path& file, const SeriesFrame& frame, CsvPoints points) {
  const bool all = points == CsvPoints::kAll;
  const DisplacementField& moved = frame.displacement;
  const StrainField& strain = frame.strain;
  const bool has_displacement = !moved.value_mm.empty(), has_strain = !strain.value.empty();
  internal::WriteTableFile(file, [&](std::ostream& out) {
    out << "row,col,x_mm,y_mm,z_mm,sigma_random_x_mm,sigma_random_y_mm,sigma_random_z_mm,"
           "sigma_calibration_x_mm,sigma_calibration_y_mm,sigma_calibration_z_mm,correlation,"
           "epipolar_px"
        << (has_displacement ? ",u_mm,v_mm,w_mm,sigma_random_u_mm,sigma_random_v_mm,"
                               "sigma_random_w_mm,sigma_calibration_u_mm,sigma_calibration_v_mm,"
                               "sigma_calibration_w_mm"
                             : "")
        << (has_strain ? ",strain_xx,strain_yy,strain_xy,sigma_random_strain_xx,"
                         "sigma_random_strain_yy,sigma_random_strain_xy,"
                         "sigma_calibration_strain_xx,sigma_calibration_strain_yy,"
                         "sigma_calibration_strain_xy,strain_status"
                       : "")
        << (all ? ",status\n" : "\n");
    const auto cells = [&out](const Eigen::Vector3f& vector) {
      for (const float v : vector) out << Cell(v);
    };
    const auto write = [&](int r, int c) {
      out << r << ',' << c;
      for (const float v : ValuesOf(frame.surface, r, c)) out << Cell(v);
      if (has_displacement) {
        cells(moved.value_mm(r, c));
        cells(moved.sigma_random_mm(r, c));
        cells(moved.sigma_calibration_mm(r, c));
      }
      if (has_strain) {
        cells(strain.value(r, c));
        cells(strain.sigma_random(r, c));
        cells(strain.sigma_calibration(r, c));
        out << ',' << Name(strain.status(r, c));
      }
      if (all) out << ',' << Name(frame.surface.status(r, c));
      out << '\n';
    };
    ForEachPoint(frame.surface.status, write, all);
  });
}

void ExportCsv(const fs::path& file, const PlanarSeriesFrame& frame, CsvPoints points) {
  const bool all = points == CsvPoints::kAll;
  const PlanarField& field = frame.field;
  const PlanarStrainRecord& strain = frame.strain;
  const bool has_strain = !strain.status.empty();
  internal::WriteTableFile(file, [&](std::ostream& out) {
    out << "row,col,x_px,y_px,u_px,v_px,sigma_u_px,sigma_v_px,zncc"
        << (has_strain ? ",strain_xx,strain_yy,strain_xy,sigma_strain_xx,sigma_strain_yy,"
                         "sigma_strain_xy,strain_status"
                       : "")
        << (all ? ",status\n" : "\n");
    const auto write = [&](int r, int c) {
      const Eigen::Vector2d pixel = field.PixelOf(r, c);
      const Eigen::Vector2d& u = field.displacement_px(r, c);
      const Eigen::Vector3f& cov = field.cov_displacement_px2(r, c);
      out << r << ',' << c << ',' << pixel.x() << ',' << pixel.y() << Cell(u.x()) << Cell(u.y())
          << Cell(std::sqrt(cov[0])) << Cell(std::sqrt(cov[2])) << Cell(field.zncc(r, c));
      if (has_strain) {
        for (const float v : strain.strain(r, c)) out << Cell(v);
        for (const int k : {0, 3, 5}) out << Cell(std::sqrt(strain.covariance(r, c)[k]));
        out << ',' << Name(strain.status(r, c));
      }
      if (all) out << ',' << Name(field.status(r, c));
      out << '\n';
    };
    ForEachPoint(field.status, write, all);
  });
}

}  // namespace plumbline
