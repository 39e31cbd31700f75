#include <array>
#include <numeric>

#include "io/internal/hdf5.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_pack.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;

void WriteIndexAxis(hid_t file, const std::string& path, const std::string& label, int n,
                    const std::string& long_name) {
  std::vector<std::int32_t> values(static_cast<std::size_t>(n));
  std::iota(values.begin(), values.end(), 0);
  hdf5::MakeScale(hdf5::WriteArray<std::int32_t>(
                      file, {path, "1", long_name, {static_cast<hsize_t>(n)}, {}}, values),
                  label);
}

void WriteGrid(hid_t file, const SeriesHeader& header) {
  const Id group = hdf5::CreateGroup(file, "/grid");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "pixel");
  hdf5::SetTexts(group.get(), "axes", {"row", "col", "component"});
  WriteIndexAxis(file, "/grid/row", "row", header.grid_px.height(), "row of the grid");
  WriteIndexAxis(file, "/grid/col", "col", header.grid_px.width(), "column of the grid");
  hdf5::MakeScale(
      hdf5::WriteTexts(file, {"/grid/component", "1", "pixel coordinate", {2}, {}}, {"x", "y"}),
      "component");
  const auto rows = static_cast<hsize_t>(header.grid_px.height());
  const auto columns = static_cast<hsize_t>(header.grid_px.width());
  const std::span<const float> pixels(header.grid_px.data()->data(), rows * columns * 2);
  const hsize_t band = std::max<hsize_t>(1, std::min(rows, (hsize_t{1} << 17) / columns));
  const Id dataset = hdf5::WriteArray<float>(
      file,
      {"/grid/pixel",
       "pixel",
       "where the points sit in the left image; (0, 0) is the centre of the top-left pixel",
       {rows, columns, 2},
       {band, columns, 2}},
      pixels);
  hdf5::AttachScales(file, dataset, {"/grid/row", "/grid/col", "/grid/component"});
  const auto scalar = [&](const char* name, const char* long_name, int value) {
    const std::int32_t v = value;
    hdf5::WriteArray<std::int32_t>(file, {name, "pixel", long_name, {}, {}}, {&v, 1});
  };
  scalar("/grid/step_px", "distance between neighbouring points", header.step_px);
  scalar("/grid/subset_px", "width of the matcher's window; 0 if it has none", header.subset_px);
}

}  // namespace

void WriteSeriesHeader(const std::filesystem::path& path, const SeriesHeader& header) {
  Id file = hdf5::CreateFile(path);
  WriteRootAttributes(file.get(), "plumbline-series", header.recipe_toml, "");
  hdf5::SetText(file.get(), "default", "surface");
  WriteRigGroup(file.get(), header.rig, header.rig_extras);
  WriteGrid(file.get(), header);
  file.Close("closing the file");
}

}  // namespace plumbline::internal
