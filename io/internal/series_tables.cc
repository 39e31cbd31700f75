#include "io/internal/series_tables.h"

#include <cctype>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "io/internal/patch_contours.h"
#include "io/internal/point_groups.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_records.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;
using Frames = std::vector<SeriesFrame>;

void WriteFrames(hid_t file, const Frames& frames, const std::vector<std::uint8_t>& has_surface) {
  WriteFrameIndex(file, Column<std::int64_t>(frames, [](const auto& f) { return f.index; }));
  WriteNumberColumn(file, "/frames/time_s", "s", "time of the frame",
                    Column<double>(frames, [](const auto& f) { return f.time_s; }));
  const auto texts = [&](const char* path, const char* long_name, auto get) {
    WriteTextColumn(file, path, long_name, Column<std::string>(frames, get));
  };
  texts("/frames/left_id", "left image", [](const auto& f) { return f.left_id; });
  texts("/frames/right_id", "right image", [](const auto& f) { return f.right_id; });
  texts("/frames/problem", "why there is no surface; empty if there is one",
        [](const auto& f) { return f.problem; });
  WriteNumberColumn(file, "/frames/dropped_before", "1", "frames lost just before this one",
                    Column<std::int32_t>(frames, [](const auto& f) { return f.dropped_before; }));
  std::vector<std::uint8_t> status;
  for (const std::uint8_t has : has_surface) status.push_back(has != 0 ? 0 : 1);
  WriteEnumColumn(file, "/frames/status", "whether the frame holds a surface", kFrameStatusNames,
                  status);
  WriteEnumColumn(file, "/frames/surface_frame", "frame that the positions are given in",
                  kSurfaceFrameNames,
                  Column<std::uint8_t>(frames, [](const auto& f) { return f.surface.frame; }));
}

void WriteField(hid_t file, const RecordGroup& group, const RecordField& field,
                const Frames& frames) {
  hdf5::Shape shape = {frames.size()};
  std::vector<std::string> scales = {"/frames/index"};
  for (std::size_t d = 0; d < field.axes.size(); ++d) {
    shape.push_back(static_cast<hsize_t>(field.shape[d]));
    const bool is_index = std::isdigit(static_cast<unsigned char>(field.axes[d][0])) != 0;
    scales.push_back(is_index ? hdf5::IndexScale(file, shape.back())
                              : group.path + "/" + field.axes[d]);
  }
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> values;
  for (const SeriesFrame& frame : frames) {
    const Eigen::MatrixXd value = field.get(frame);
    const bool found = group.found(frame);
    for (Eigen::Index r = 0; r < value.rows(); ++r) {
      for (Eigen::Index c = 0; c < value.cols(); ++c) {
        values.push_back(found && std::isfinite(value(r, c)) ? value(r, c) : kNaN);
      }
    }
  }
  hdf5::AttachScales(
      file,
      hdf5::WriteArray<double>(
          file, {group.path + "/" + field.name, field.units, field.long_name, shape, {}}, values),
      scales);
}

void WriteRecords(hid_t file, const RecordGroup& group, const Frames& frames) {
  const Id id = hdf5::CreateGroup(file, group.path);
  if (!group.signal.empty()) {
    hdf5::SetText(id.get(), "NX_class", "NXdata");
    hdf5::SetText(id.get(), "signal", group.signal);
    std::vector<std::string> axes = {"frame"};
    for (const RecordField& field : group.fields) {
      if (field.name == group.signal) axes.insert(axes.end(), field.axes.begin(), field.axes.end());
    }
    hdf5::SetTexts(id.get(), "axes", axes);
    hdf5::HardLink(file, "/frames/index", group.path + "/frame");
  }
  for (const RecordAxis& axis : group.axes) {
    WriteNameAxis(file, group.path + "/" + axis.name, axis.name, axis.long_name, axis.labels);
  }
  for (const RecordField& field : group.fields) WriteField(file, group, field, frames);
  WriteEnumColumn(
      file, group.path + "/status", "whether a " + group.what + " was found", kFoundNames,
      Column<std::uint8_t>(frames, [&](const auto& f) { return group.found(f) ? 0 : 1; }));
  WriteTextColumn(file, group.path + "/problem",
                  "why there is no " + group.what + "; empty if there is one",
                  Column<std::string>(frames, group.problem));
}

void WriteFrameTables(hid_t file, const SeriesContents& contents, const Frames& frames,
                      const std::vector<std::uint8_t>& has_surface) {
  WriteFrames(file, frames, has_surface);
  for (const RecordGroup& group : RecordGroups()) {
    if (Holds(contents, group.needs)) WriteRecords(file, group, frames);
  }
}

std::string FrameOfPositions(const std::vector<std::uint8_t>& surface_frame,
                             const std::vector<std::uint8_t>& has_surface) {
  std::string name;
  for (std::size_t i = 0; i < surface_frame.size(); ++i) {
    if (has_surface[i] == 0) continue;
    const std::string own(kSurfaceFrameNames.at(surface_frame[i]));
    if (name.empty()) name = own;
    if (name != own) return "mixed: see /frames/surface_frame";
  }
  return name.empty() ? "rig" : name;
}

class StereoPacker : public FramePacker {
 public:
  StereoPacker(hid_t file, const SeriesShape& shape)
      : file_(file),
        shape_(shape),
        contents_(FromBits<SeriesContents>(shape.content_bits)),
        points_(file, StereoPoints(), shape) {
    if (contents_.patch) contours_.emplace(file);
  }

  void Add(std::span<const std::uint8_t> payload) override {
    FrameRecord<SeriesFrame> record = DecodeFrame(payload, shape_);
    points_.Add(record.chunks);
    if (contours_) contours_->Take(&record.frame);
    has_surface_.push_back(record.has_points ? 1 : 0);
    frames_.push_back(std::move(record.frame));
  }

  void Finish() override {
    WriteFrameTables(file_, contents_, frames_, has_surface_);
    if (contours_) contours_->Finish();
    if (contents_.survey) {
      WriteTextColumn(file_, kSurveyTags, "tags that the frame shows, as JSON; empty: none",
                      Column<std::string>(frames_, [](const auto& f) { return f.survey.tags; }));
    }
    WriteFrameOfPositions(
        file_, Column<std::uint8_t>(frames_, [](const auto& f) { return f.surface.frame; }),
        has_surface_);
    points_.Finish();
    if (contents_.strain) LinkStrainByMeasure();
  }

 private:
  // The strain goes by the name of its measure too.
  void LinkStrainByMeasure() {
    const std::string measure = hdf5::GetText(hdf5::OpenGroup(file_, "/strain").get(), "measure");
    for (const char* end : {"", "_errors_random", "_errors_calibration", "_errors"}) {
      hdf5::HardLink(file_, std::string("/strain/value") + end, "/strain/" + measure + end);
    }
  }

  hid_t file_;
  SeriesShape shape_;
  SeriesContents contents_;
  PointGroups points_;
  std::optional<PatchContours> contours_;
  Frames frames_;
  std::vector<std::uint8_t> has_surface_;
};

}  // namespace

void WriteFrameOfPositions(hid_t file, const std::vector<std::uint8_t>& surface_frame,
                           const std::vector<std::uint8_t>& has_surface) {
  const std::string name = FrameOfPositions(surface_frame, has_surface);
  for (const PointGroupFacts& group : StereoPoints().groups) {
    const std::string path(group.path);
    if (!group.in_surface_frame || !hdf5::Exists(file, path)) continue;
    hdf5::SetText(hdf5::OpenGroup(file, path).get(), "frame", name);
    hdf5::SetText(hdf5::OpenDataset(file, path + "/" + std::string(group.signal)).get(), "frame",
                  name);
  }
  for (const RecordGroup& group : RecordGroups()) {
    if (!group.in_surface_frame || !hdf5::Exists(file, group.path)) continue;
    hdf5::SetText(hdf5::OpenGroup(file, group.path).get(), "frame", name);
  }
}

std::unique_ptr<FramePacker> MakeStereoPacker(hid_t file, const SeriesShape& shape) {
  return std::make_unique<StereoPacker>(file, shape);
}

}  // namespace plumbline::internal
