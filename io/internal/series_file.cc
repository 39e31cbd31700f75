#include "io/internal/series_file.h"

#include "io/internal/rig_group.h"
#include "io/internal/series_parts.h"
#include "io/internal/series_sources.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

SeriesFile::SeriesFile(const fs::path& path, Kind kind) : path_(path) {
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) {
    throw InputError(fmt::format("there is no series {}", path.string()));
  }
  Reading([&] { Open(kind); });
}

void SeriesFile::Open(Kind kind) {
  file_ = hdf5::OpenForeignFile(path_);
  const std::string format = hdf5::GetText(id(), "format");
  if (format != "plumbline-series") {
    throw hdf5::Error(format.empty() ? "it has no attribute `format`"
                                     : fmt::format("it is of the format {}", format));
  }
  const double version = hdf5::GetNumber(id(), "format_version", 0);
  if (!(version >= 1 && version <= static_cast<double>(kFormatVersion))) {
    throw hdf5::Error(
        fmt::format("it is of version {}; this program reads up to {}", version, kFormatVersion));
  }
  if (IsPlanar(id()) != (kind == Kind::kPlanar)) {
    throw hdf5::Error(kind == Kind::kPlanar
                          ? "it is of a stereo rig, and one of a single camera is wanted"
                          : "it is of a single camera, and one of a stereo rig is wanted");
  }
  facts_ = {hdf5::GetText(id(), "created"), hdf5::GetText(id(), "software"),
            hdf5::GetText(id(), "recipe"),  hdf5::GetText(id(), "inputs"),
            ReadShardAttributes(id()),      hdf5::GetNumber(id(), kGoesOn, 0) != 0};
  const auto problems = ProblemsOfSources(path_, ReadSources(id()), false);
  if (!problems.empty()) throw hdf5::Error(problems[0]);
}

GridFacts SeriesFile::ReadGrid() const {
  hdf5::Shape shape;
  const auto values = hdf5::ReadArray<float>(id(), "/grid/pixel", &shape, kMaxFrameElements);
  if (shape.size() != 3 || shape[2] != 2) throw hdf5::Error("/grid/pixel is not (row, col, 2)");
  const auto one = [&](const char* name) {
    return hdf5::ReadArray<std::int32_t>(id(), name, nullptr, 1).at(0);
  };
  return {
      ToImage<Eigen::Vector2f>({static_cast<int>(shape[1]), static_cast<int>(shape[0])}, values),
      one("/grid/step_px"), one("/grid/subset_px")};
}

std::vector<std::uint8_t> SeriesFile::ReadEnum(const std::string& name) const {
  const hdf5::Id dataset = hdf5::OpenDataset(id(), name);
  const hdf5::Id type(hdf5::Check(H5Dget_type(dataset.get()), "dataset type"));
  const hsize_t n = hdf5::ElementCount(hdf5::ShapeOf(dataset));
  if (H5Tget_size(type.get()) != 1 || n > kMaxFrames) throw hdf5::Error(name + " holds no bytes");
  std::vector<std::uint8_t> values(n);
  if (n > 0) {
    hdf5::Check(H5Dread(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
                "reading a column");
  }
  return values;
}

void SeriesFile::CheckLengths(const std::string& group, std::size_t n,
                              std::initializer_list<std::size_t> lengths) {
  for (const std::size_t length : lengths) {
    if (length == n) continue;
    throw hdf5::Error(group == "/frames"
                          ? "the columns of /frames differ in length"
                          : "the columns of " + group + " and /frames differ in length");
  }
}

Image<std::uint8_t> SeriesFile::Bytes(const std::string& name, std::optional<std::size_t> i,
                                      ImageSize size) const {
  return ToImage<std::uint8_t>(
      size, i ? hdf5::ReadSlabBytes(hdf5::OpenDataset(id(), name), *i, kMaxFrameElements)
              : ReadEnum(name));
}

Image<Status> SeriesFile::Statuses(const std::string& name, std::optional<std::size_t> i,
                                   ImageSize size) const {
  const Image<std::uint8_t> codes = Bytes(name, i, size);
  Image<Status> statuses(size);
  for (std::size_t k = 0; k < codes.pixel_count(); ++k) {
    if (codes.data()[k] >= kStatusNames.size()) throw hdf5::Error(name + " holds unknown codes");
    statuses.data()[k] = static_cast<Status>(codes.data()[k]);
  }
  return statuses;
}

}  // namespace plumbline::internal
