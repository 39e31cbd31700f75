#include "io/internal/series_pack.h"

#include <fmt/format.h>

#include <limits>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/journal.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_tables.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

using hdf5::Id;

struct JournalStart {
  SeriesShape shape;
  std::vector<fs::path> inputs;
};

JournalStart DecodeStart(std::span<const std::uint8_t> bytes) {
  ByteReader in(bytes);
  JournalStart start;
  start.shape = in.Get<SeriesShape>();
  const auto count = in.Get<std::uint64_t>();
  for (std::uint64_t i = 0; i < count; ++i) start.inputs.emplace_back(in.GetText());
  return start;
}

// /surface, growing by one frame at a time.
class SurfaceGroup {
 public:
  SurfaceGroup(hid_t file, const SeriesShape& shape) : file_(file), shape_(shape) {
    const Id group = hdf5::CreateGroup(file, "/surface");
    hdf5::SetText(group.get(), "NX_class", "NXdata");
    hdf5::SetText(group.get(), "signal", "position");
    hdf5::SetTexts(group.get(), "axes", {"frame", "row", "col", "component"});
    for (int field = 0; field < shape.fields(); ++field) datasets_.push_back(Create(field));
  }

  void Add(const FrameRecord& record) {
    for (std::size_t field = 0; field < datasets_.size(); ++field) {
      hdf5::Shape extent = Extent(static_cast<int>(field), frames_ + 1);
      hdf5::Check(H5Dset_extent(datasets_[field].get(), extent.data()), "adding a frame");
    }
    for (const FrameRecord::Chunk& chunk : record.chunks) {
      hdf5::Shape offset = Extent(chunk.field, frames_);
      std::fill(offset.begin() + 1, offset.end(), 0);
      offset[1] = static_cast<hsize_t>(chunk.band) * static_cast<hsize_t>(shape_.band_rows);
      hdf5::Check(
          H5Dwrite_chunk(datasets_[static_cast<std::size_t>(chunk.field)].get(), H5P_DEFAULT, 0,
                         offset.data(), chunk.bytes.size(), chunk.bytes.data()),
          "writing a frame");
    }
    ++frames_;
  }

  // Once /frames is there: the axes, and what the positions are given in.
  void Finish(const std::string& frame_of_positions) {
    hdf5::HardLink(file_, "/frames/index", "/surface/frame");
    hdf5::HardLink(file_, "/grid/row", "/surface/row");
    hdf5::HardLink(file_, "/grid/col", "/surface/col");
    Labels("/surface/component", "component", {"x", "y", "z"});
    if (shape_.has_covariance != 0) {
      Labels("/surface/covariance_component", "covariance_component",
             {"xx", "xy", "xz", "yy", "yz", "zz"});
    }
    for (std::size_t field = 0; field < datasets_.size(); ++field) {
      std::vector<std::string> scales = {"/frames/index", "/grid/row", "/grid/col"};
      const int components = kPointFields[field].components;
      if (components == 3) scales.push_back("/surface/component");
      if (components == 6) scales.push_back("/surface/covariance_component");
      hdf5::AttachScales(file_, datasets_[field], scales);
      datasets_[field].Close("closing a dataset");
    }
    const Id group = hdf5::OpenGroup(file_, "/surface");
    hdf5::SetText(group.get(), "frame", frame_of_positions);
    hdf5::SetText(hdf5::OpenDataset(file_, "/surface/position").get(), "frame", frame_of_positions);
  }

 private:
  hdf5::Shape Extent(int field, hsize_t frames) const {
    hdf5::Shape extent = {frames, static_cast<hsize_t>(shape_.rows),
                          static_cast<hsize_t>(shape_.columns)};
    const int components = kPointFields[static_cast<std::size_t>(field)].components;
    if (components > 1) extent.push_back(static_cast<hsize_t>(components));
    return extent;
  }

  Id Create(int field) {
    const PointField& facts = kPointFields[static_cast<std::size_t>(field)];
    hdf5::DatasetSpec spec{"/surface/" + std::string(facts.name), std::string(facts.units),
                           std::string(facts.long_name), Extent(field, 0), Extent(field, 1)};
    spec.chunk[1] = static_cast<hsize_t>(shape_.band_rows);
    // In a frame without a surface every point is masked.
    if (facts.is_status) {
      return CreateEnumDataset(file_, spec, kStatusNames,
                               static_cast<std::uint8_t>(Status::kMasked));
    }
    const float fill = std::numeric_limits<float>::quiet_NaN();
    return hdf5::CreateDataset(file_, spec, H5T_NATIVE_FLOAT, &fill);
  }

  void Labels(const std::string& path, const std::string& label,
              const std::vector<std::string>& names) {
    hdf5::MakeScale(
        hdf5::WriteTexts(file_, {path, "1", "component of the value", {names.size()}, {}}, names),
        label);
  }

  hid_t file_;
  SeriesShape shape_;
  std::vector<Id> datasets_;
  hsize_t frames_ = 0;
};

std::string FrameOfPositions(const std::vector<SeriesFrame>& frames,
                             const std::vector<std::uint8_t>& has_surface) {
  std::string name;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (has_surface[i] == 0) continue;
    const std::string own(kSurfaceFrameNames[static_cast<std::size_t>(frames[i].surface.frame)]);
    if (name.empty()) name = own;
    if (name != own) return "mixed: see /frames/surface_frame";
  }
  return name.empty() ? "rig" : name;
}

std::int64_t WritePacked(const fs::path& file_name, JournalReader& journal,
                         const JournalStart& start, const std::string& inputs) {
  Id file = hdf5::OpenFile(file_name, true);
  std::vector<SeriesFrame> frames;
  std::vector<std::uint8_t> has_surface;
  SurfaceGroup surface(file.get(), start.shape);
  while (const auto payload = journal.Next()) {
    FrameRecord record = DecodeFrame(*payload, start.shape);
    surface.Add(record);
    has_surface.push_back(record.has_surface ? 1 : 0);
    frames.push_back(std::move(record.frame));
  }
  WriteFrameTables(file.get(), frames, has_surface);
  surface.Finish(FrameOfPositions(frames, has_surface));
  hdf5::SetText(file.get(), "inputs", inputs.empty() ? DescribeInputs(start.inputs) : inputs);
  file.Close("closing the file");
  return static_cast<std::int64_t>(frames.size());
}

}  // namespace

fs::path PartsFolder(const fs::path& series) { return series.string() + ".parts"; }
fs::path JournalFile(const fs::path& series) { return PartsFolder(series) / "journal"; }
fs::path HeaderFile(const fs::path& series) { return PartsFolder(series) / "header.h5"; }

RecoveredSeries PackSeries(const fs::path& series, const std::string& inputs, bool lock) {
  const fs::path packed = PartsFolder(series) / "packed.h5";
  RecoveredSeries result;
  try {
    JournalReader journal(JournalFile(series), lock);
    const auto first = journal.Next();
    if (!first || !fs::exists(HeaderFile(series))) {
      throw InputError(
          fmt::format("{} holds no frames: that run ended before its first one; delete "
                      "the folder",
                      PartsFolder(series).string()));
    }
    const JournalStart start = DecodeStart(*first);
    fs::copy_file(HeaderFile(series), packed, fs::copy_options::overwrite_existing);
    result.frames = WritePacked(packed, journal, start, inputs);
    result.bytes_dropped = journal.size() - journal.position();
    SyncPath(packed);
    fs::rename(packed, series);
    SyncPath(series.parent_path());
    fs::remove_all(PartsFolder(series));
  } catch (const hdf5::Error& error) {
    throw EnvironmentError(fmt::format("cannot write {}: {}; its frames are kept in {}",
                                       series.string(), error.what(),
                                       PartsFolder(series).string()));
  } catch (const fs::filesystem_error& error) {
    throw EnvironmentError(fmt::format("cannot write {}: {}; its frames are kept in {}",
                                       series.string(), error.code().message(),
                                       PartsFolder(series).string()));
  }
  return result;
}

}  // namespace plumbline::internal
