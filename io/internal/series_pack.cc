#include "io/internal/series_pack.h"

#include <fmt/format.h>

#include <limits>
#include <optional>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/journal.h"
#include "io/internal/patch_contours.h"
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

// The groups of fields of points, growing by one frame at a time.
class PointGroups {
 public:
  PointGroups(hid_t file, const SeriesShape& shape) : file_(file), shape_(shape) {
    for (const PointGroupFacts& group : kPointGroups) {
      if (!Holds(shape.contents(), group.needs)) continue;
      const Id id = hdf5::CreateGroup(file, std::string(group.path));
      hdf5::SetText(id.get(), "NX_class", "NXdata");
      hdf5::SetText(id.get(), "signal", std::string(group.signal));
      hdf5::SetTexts(id.get(), "axes", {"frame", "row", "col", "component"});
    }
    for (const PointField& field : PointFields()) {
      datasets_.push_back(Holds(shape.contents(), field.needs) ? Create(field) : Id());
    }
  }

  void Add(const FrameRecord& record) {
    for (std::size_t i = 0; i < datasets_.size(); ++i) {
      if (datasets_[i].get() < 0) continue;
      hdf5::Shape extent = Extent(PointFields()[i], frames_ + 1);
      hdf5::Check(H5Dset_extent(datasets_[i].get(), extent.data()), "adding a frame");
    }
    for (const FrameRecord::Chunk& chunk : record.chunks) {
      hdf5::Shape offset = Extent(PointFields()[chunk.field], frames_);
      std::fill(offset.begin() + 1, offset.end(), 0);
      offset[1] = static_cast<hsize_t>(chunk.band) * static_cast<hsize_t>(shape_.band_rows);
      hdf5::Check(H5Dwrite_chunk(datasets_[chunk.field].get(), H5P_DEFAULT, 0, offset.data(),
                                 chunk.bytes.size(), chunk.bytes.data()),
                  "writing a frame");
    }
    ++frames_;
  }

  // Once /frames is there: the axes, and what the vectors are given in.
  void Finish(const std::string& frame_of_positions) {
    for (const PointGroupFacts& group : kPointGroups) {
      if (!Holds(shape_.contents(), group.needs)) continue;
      const std::string path(group.path);
      hdf5::HardLink(file_, "/frames/index", path + "/frame");
      hdf5::HardLink(file_, "/grid/row", path + "/row");
      hdf5::HardLink(file_, "/grid/col", path + "/col");
      if (!group.in_surface_frame) continue;
      const std::string signal = path + "/" + std::string(group.signal);
      hdf5::SetText(hdf5::OpenGroup(file_, path).get(), "frame", frame_of_positions);
      hdf5::SetText(hdf5::OpenDataset(file_, signal).get(), "frame", frame_of_positions);
    }
    for (std::size_t i = 0; i < datasets_.size(); ++i) {
      if (datasets_[i].get() >= 0) Attach(PointFields()[i], &datasets_[i]);
    }
  }

 private:
  hdf5::Shape Extent(const PointField& field, hsize_t frames) const {
    hdf5::Shape extent = {frames, static_cast<hsize_t>(shape_.rows),
                          static_cast<hsize_t>(shape_.columns)};
    if (field.axis->count > 1) extent.push_back(static_cast<hsize_t>(field.axis->count));
    return extent;
  }

  Id Create(const PointField& field) {
    hdf5::DatasetSpec spec{field.Path(), std::string(field.units), std::string(field.long_name),
                           Extent(field, 0), Extent(field, 1)};
    spec.chunk[1] = static_cast<hsize_t>(shape_.band_rows);
    // In a frame without a surface every point is masked.
    if (field.is_status()) {
      return CreateEnumDataset(file_, spec, kStatusNames,
                               static_cast<std::uint8_t>(Status::kMasked));
    }
    const float fill = std::numeric_limits<float>::quiet_NaN();
    return hdf5::CreateDataset(file_, spec, H5T_NATIVE_FLOAT, &fill);
  }

  void Attach(const PointField& field, Id* dataset) {
    std::vector<std::string> scales = {"/frames/index", "/grid/row", "/grid/col"};
    const ComponentAxis& axis = *field.axis;
    if (axis.count > 1) {
      const std::string label(axis.name);
      scales.push_back(std::string(kPointGroups[field.group].path) + "/" + label);
      if (!hdf5::Exists(file_, scales.back())) {
        WriteNameAxis(file_, scales.back(), label, "component of the value",
                      {axis.labels.begin(), axis.labels.begin() + axis.count});
      }
    }
    hdf5::AttachScales(file_, *dataset, scales);
    dataset->Close("closing a dataset");
  }

  hid_t file_;
  SeriesShape shape_;
  std::vector<Id> datasets_;  // by the place in PointFields(); closed: not held
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
  const SeriesContents contents = start.shape.contents();
  PointGroups points(file.get(), start.shape);
  std::optional<PatchContours> contours;
  if (contents.patch) contours.emplace(file.get());
  while (const auto payload = journal.Next()) {
    FrameRecord record = DecodeFrame(*payload, start.shape);
    points.Add(record);
    if (contours) contours->Take(&record.frame);
    has_surface.push_back(record.has_surface ? 1 : 0);
    frames.push_back(std::move(record.frame));
  }
  WriteFrameTables(file.get(), contents, frames, has_surface);
  if (contours) contours->Finish();
  points.Finish(FrameOfPositions(frames, has_surface));
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
