#include "io/disparity_hdf5.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/rig_group.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;
namespace {

void WriteHdf5(const fs::path& path, const DisparityMap& map, const std::string& recipe_toml,
               const std::string& inputs) {
  hdf5::Id file = hdf5::CreateFile(path);
  internal::WriteRootAttributes(file.get(), "plumbline-disparity", recipe_toml, inputs);
  hdf5::SetText(file.get(), "default", "disparity");
  const hdf5::Id group = hdf5::CreateGroup(file.get(), "/disparity");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "value");
  hdf5::SetTexts(group.get(), "axes", {"row", "col"});
  hdf5::SetInteger(group.get(), "searched_min_px", map.min_disparity_px);
  hdf5::SetInteger(group.get(), "searched_max_px", map.max_disparity_px);
  const auto rows = static_cast<hsize_t>(map.value_px.height());
  const auto columns = static_cast<hsize_t>(map.value_px.width());
  for (const auto& [name, size] : {std::pair{"row", rows}, std::pair{"col", columns}}) {
    std::vector<std::int32_t> values(size);
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<std::int32_t>(i);
    hdf5::MakeScale(
        hdf5::WriteArray<std::int32_t>(
            file.get(),
            {std::string("/disparity/") + name, "pixel", "pixel of the left image", {size}, {}},
            values),
        name);
  }
  const std::vector<std::string> axes = {"/disparity/row", "/disparity/col"};
  const hdf5::Shape shape = {rows, columns};
  const hdf5::Shape chunk = {
      std::max<hsize_t>(1, std::min(rows, (hsize_t{1} << 18) / std::max<hsize_t>(1, columns))),
      columns};
  const auto floats = [&](const char* name, const char* long_name, const Image<float>& image) {
    const hdf5::Id dataset =
        hdf5::WriteArray<float>(file.get(), {name, "pixel", long_name, shape, chunk},
                                std::span<const float>(image.values()));
    hdf5::AttachScales(file.get(), dataset, axes);
  };
  floats("/disparity/value", "left pixel (x, y) is seen at (x - value, y) on the right",
         map.value_px);
  floats("/disparity/value_errors", "standard deviation of the disparity", map.sigma_px);
  const hdf5::Id type = hdf5::EnumType(kStatusNames);
  const hdf5::Id status = hdf5::CreateDataset(
      file.get(), {"/disparity/status", "1", "why there is no value here, or ok", shape, chunk},
      type.get());
  hdf5::Check(H5Dwrite(status.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, map.status.data()),
              "writing the status");
  hdf5::AttachScales(file.get(), status, axes);
  file.Close("closing the file");
}

}  // namespace

void WriteDisparityHdf5(const fs::path& file, const DisparityMap& map,
                        const std::string& recipe_toml, const std::vector<fs::path>& inputs) {
  try {
    internal::WriteDurably(file, [&](const fs::path& temporary) {
      WriteHdf5(temporary, map, recipe_toml, internal::DescribeInputs(inputs));
    });
  } catch (const hdf5::Error& error) {
    throw EnvironmentError(fmt::format("cannot write {}: {}", file.string(), error.what()));
  }
}

}  // namespace plumbline
