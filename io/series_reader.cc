#include "io/series_reader.h"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "io/internal/hdf5.h"
#include "io/internal/patch_contours.h"
#include "io/internal/reference_group.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_file.h"
#include "io/internal/series_images.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_records.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;

namespace {

constexpr hsize_t kMaxSamples = hsize_t{1} << 28;  // of a channel

// The value of one record, which the file holds row by row.
Eigen::MatrixXd ToMatrix(const internal::RecordField& field, const std::vector<double>& values) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  if (values.size() != static_cast<std::size_t>(field.rows() * field.columns())) {
    throw hdf5::Error("a dataset " + field.name + " has the wrong size");
  }
  return Eigen::Map<const RowMajor>(values.data(), field.rows(), field.columns());
}

// What SeriesHeader has of the same names.
struct Attributes {
  std::string grid_points, displacement_reference, strain_measure, strain_axes, slip_convention;
  std::optional<RightDelay> right_delay, estimated_right_delay;
  std::int64_t surveyed_frames = 0;
  bool rigid_motion_removed = false;
  int vsg_px = 0;
  double vsg_mm = 0;
};

// Of a group of records that the file holds, one entry a frame.
struct RecordColumns {
  const internal::RecordGroup* group = nullptr;
  std::vector<std::uint8_t> status;
  std::vector<std::string> problem;
};

}  // namespace

struct SeriesReader::Impl {
  internal::SeriesFile file;
  internal::GridFacts grid;
  SeriesContents contents;
  std::int64_t version = 1;
  Attributes attributes;
  std::vector<std::int64_t> index;
  std::vector<double> time_s;
  std::vector<std::string> left_id, right_id, problem;
  std::vector<std::uint8_t> status, surface_frame;
  std::vector<std::int32_t> dropped_before;
  std::vector<std::string> survey_tags;
  std::vector<RecordColumns> records;

  explicit Impl(const fs::path& path) : file(path, internal::SeriesFile::Kind::kStereo) {
    file.Reading([&] {
      contents = internal::ContentsOf<SeriesContents>(file.id());
      version = internal::VersionOf(file.id());
      grid = file.ReadGrid();
      ReadAttributes();
      ReadFrames();
      ReadRecordColumns();
    });
  }

  void ReadAttributes() {
    const auto text = [&](const char* path, const char* name, const char* otherwise) {
      if (!hdf5::Exists(file.id(), path)) return std::string(otherwise);
      return hdf5::GetText(hdf5::OpenGroup(file.id(), path).get(), name, otherwise);
    };
    attributes.grid_points = text("/grid", "points", "image");
    attributes.displacement_reference = text("/displacement", "reference", "frame 0");
    attributes.strain_measure = text("/strain", "measure", "green_lagrange");
    attributes.strain_axes = text("/strain", "strain_axes", "material");
    attributes.slip_convention = text("/slip", "convention", "ISO 8855");
    if (contents.displacement) {
      const hdf5::Id displacement = hdf5::OpenGroup(file.id(), "/displacement");
      attributes.rigid_motion_removed =
          hdf5::GetNumber(displacement.get(), "rigid_motion_removed", 0) != 0;
    }
    attributes.right_delay = ReadDelay("");
    attributes.estimated_right_delay = ReadDelay("estimated_");
    if (contents.survey) {
      const double frames =
          hdf5::GetNumber(hdf5::OpenGroup(file.id(), "/survey").get(), "frames", 0);
      if (!(frames >= 0 && frames <= static_cast<double>(internal::kMaxFrames))) {
        throw hdf5::Error("frames of /survey is out of range");
      }
      attributes.surveyed_frames = static_cast<std::int64_t>(frames);
    }
    if (!contents.strain) return;
    const hdf5::Id strain = hdf5::OpenGroup(file.id(), "/strain");
    const double vsg_px = hdf5::GetNumber(strain.get(), "vsg_px", 0);
    if (!(vsg_px >= 0 && vsg_px <= 1e6)) throw hdf5::Error("vsg_px of /strain is out of range");
    attributes.vsg_px = static_cast<int>(vsg_px);
    attributes.vsg_mm = hdf5::GetNumber(strain.get(), "vsg_mm", 0);
  }

  std::optional<RightDelay> ReadDelay(const std::string& which) const {
    if (!contents.wheel) return std::nullopt;
    const hdf5::Id wheel = hdf5::OpenGroup(file.id(), "/wheel");
    constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
    const auto number = [&](const std::string& name) {
      return hdf5::GetNumber(wheel.get(), name, kNone);
    };
    const RightDelay delay{number(which + "right_delay_s"),
                           number("sigma_" + which + "right_delay_s")};
    if (!std::isfinite(delay.value_s) || !(delay.sigma_s >= 0)) return std::nullopt;
    return delay;
  }

  void ReadFrames() {
    const hid_t f = file.id();
    index = hdf5::ReadArray<std::int64_t>(f, "/frames/index", nullptr, internal::kMaxFrames);
    time_s = hdf5::ReadArray<double>(f, "/frames/time_s", nullptr, internal::kMaxFrames);
    left_id = hdf5::ReadTexts(f, "/frames/left_id");
    right_id = hdf5::ReadTexts(f, "/frames/right_id");
    problem = hdf5::ReadTexts(f, "/frames/problem");
    status = file.ReadEnum("/frames/status");
    surface_frame = file.ReadEnum("/frames/surface_frame");
    dropped_before =
        hdf5::ReadArray<std::int32_t>(f, "/frames/dropped_before", nullptr, internal::kMaxFrames);
    file.CheckLengths("/frames", index.size(),
                      {time_s.size(), left_id.size(), right_id.size(), problem.size(),
                       status.size(), surface_frame.size(), dropped_before.size()});
  }

  void ReadRecordColumns() {
    for (const internal::RecordGroup& group : internal::RecordGroups()) {
      if (!internal::Holds(contents, group.needs)) continue;
      records.push_back({&group, file.ReadEnum(group.path + "/status"),
                         hdf5::ReadTexts(file.id(), group.path + "/problem")});
      file.CheckLengths(group.path, index.size(),
                        {records.back().status.size(), records.back().problem.size()});
    }
    if (!contents.survey) return;
    survey_tags = hdf5::ReadTexts(file.id(), internal::kSurveyTags);
    file.CheckLengths("/survey", index.size(), {survey_tags.size()});
  }

  std::vector<Channel> ReadChannels() const {
    constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
    std::vector<Channel> channels;
    if (!hdf5::Exists(file.id(), "/channels")) return channels;
    const hdf5::Id group = hdf5::OpenGroup(file.id(), "/channels");
    for (const std::string& name : hdf5::LinkNames(group.get())) {
      const hdf5::Id own = hdf5::OpenGroup(group.get(), name);
      const hdf5::Id value = hdf5::OpenDataset(own.get(), "value");
      channels.push_back({name, hdf5::GetText(value.get(), "units"),
                          hdf5::GetText(value.get(), "long_name"),
                          hdf5::ReadArray<double>(own.get(), "time_s", nullptr, kMaxSamples),
                          hdf5::ReadArray<double>(own.get(), "value", nullptr, kMaxSamples),
                          hdf5::GetNumber(own.get(), "clock_offset_s", kUnknown),
                          hdf5::GetNumber(own.get(), "sigma_clock_offset_s", kUnknown)});
      if (channels.back().time_s.size() != channels.back().value.size()) {
        throw hdf5::Error("the channel " + name + " has not as many times as values");
      }
    }
    return channels;
  }

  // What there is of the groups that `wanted` says.
  template <typename Wanted>
  void ReadGroups(std::size_t i, const Wanted& wanted, SeriesFrame* frame) const {
    const std::uint32_t bits = internal::BitsOf(contents);
    for (const internal::PointField& field : internal::StereoPoints().fields) {
      const std::string path = field.PathIn(version);
      if (!wanted(field.group) || !internal::Holds(bits, field.needs) || path.empty()) continue;
      internal::VisitImage(*frame, field, [&](auto& image) { ReadImage(path, i, &image); });
    }
  }

  void ReadPoints(std::size_t i, SeriesFrame* frame) const {
    ReadGroups(
        i, [](std::uint8_t group) { return group != internal::kSurvey; }, frame);
    if (contents.strain && frame->strain.status.empty()) {
      frame->strain.status = StatusOfOldStrain(*frame);
    }
  }

  std::optional<ReferenceMatches> ReadReference() const {
    if (!hdf5::Exists(file.id(), internal::kReferenceStatus)) return std::nullopt;
    ReferenceMatches reference;
    reference.left_id = hdf5::GetText(hdf5::OpenGroup(file.id(), "/reference").get(), "left_id");
    ReadImage(internal::kReferenceStatus, std::nullopt, &reference.status);
    SeriesFrame frame;
    for (const internal::PointField& field : internal::StereoPoints().fields) {
      if (field.group != internal::kMatch) continue;
      internal::VisitImage(frame, field, [&](auto& image) {
        ReadImage(internal::PathInReference(field), std::nullopt, &image);
      });
    }
    reference.match = std::move(frame.match);
    return reference;
  }

  // i: the frame; nothing: the dataset has none.
  using FrameOf = std::optional<std::size_t>;
  template <typename Element>
  void ReadImage(const std::string& path, FrameOf i, Image<Element>* image) const {
    *image = file.Points<Element, float>(path, i, grid.pixel.size());
  }
  void ReadImage(const std::string& path, FrameOf i, Image<Status>* image) const {
    *image = file.Statuses(path, i, grid.pixel.size());
  }
  void ReadImage(const std::string& path, FrameOf i, Image<Eigen::Matrix2f>* image) const {
    *image = file.Points<Eigen::Matrix2f, float>(path, i, grid.pixel.size());
    for (Eigen::Matrix2f& matrix : image->values()) matrix.transposeInPlace();  // row by row there
  }

  // Version 1 of the format has none: a strain could be missing where there is a surface, at an
  // edge.
  static Image<Status> StatusOfOldStrain(const SeriesFrame& frame) {
    Image<Status> status = frame.surface.status;
    for (std::size_t k = 0; k < status.pixel_count(); ++k) {
      const bool there = frame.strain.value.data()[k].allFinite();
      if (status.data()[k] == Status::kOk && !there) status.data()[k] = Status::kExtrapolated;
    }
    return status;
  }

  void ReadSurvey(std::size_t i, SeriesFrame* frame) const {
    if (!contents.survey) return;
    frame->survey.tags = survey_tags[i];
    if (!frame->survey.found) return;
    ReadGroups(
        i, [](std::uint8_t group) { return group == internal::kSurvey; }, frame);
  }

  SeriesFrame ReadFacts(std::size_t i) const {
    SeriesFrame frame;
    frame.index = index[i];
    frame.time_s = time_s[i];
    frame.left_id = left_id[i];
    frame.right_id = right_id[i];
    frame.problem = problem[i];
    frame.dropped_before = dropped_before[i];
    return frame;
  }

  void ReadRecord(const RecordColumns& columns, std::size_t i, SeriesFrame* frame) const {
    const internal::RecordGroup& group = *columns.group;
    const bool found = columns.status[i] == 0;
    group.set_found(found, columns.problem[i], frame);
    if (!found) return;
    for (const internal::RecordField& field : group.fields) {
      if (!field.set) continue;
      field.set(ToMatrix(field, file.Slab<double>(group.path + "/" + field.name, i)), frame);
    }
  }
};

SeriesReader::SeriesReader(const fs::path& file) : impl_(std::make_unique<Impl>(file)) {}

SeriesReader::~SeriesReader() = default;

const SeriesFacts& SeriesReader::facts() const { return impl_->file.facts(); }
StereoRig SeriesReader::rig() const {
  return impl_->file.Reading([&] { return internal::ReadRigGroup(impl_->file.id()); });
}
Image<Eigen::Vector2f> SeriesReader::grid_px() const { return impl_->grid.pixel; }
int SeriesReader::step_px() const { return impl_->grid.step_px; }
int SeriesReader::subset_px() const { return impl_->grid.subset_px; }
const SeriesContents& SeriesReader::contents() const { return impl_->contents; }
const std::string& SeriesReader::grid_points() const { return impl_->attributes.grid_points; }
const std::string& SeriesReader::displacement_reference() const {
  return impl_->attributes.displacement_reference;
}
std::optional<ReferenceMatches> SeriesReader::reference() const {
  return impl_->file.Reading([&] { return impl_->ReadReference(); });
}
bool SeriesReader::rigid_motion_removed() const { return impl_->attributes.rigid_motion_removed; }
const std::string& SeriesReader::strain_measure() const { return impl_->attributes.strain_measure; }
const std::string& SeriesReader::strain_axes() const { return impl_->attributes.strain_axes; }
int SeriesReader::vsg_px() const { return impl_->attributes.vsg_px; }
double SeriesReader::vsg_mm() const { return impl_->attributes.vsg_mm; }
const std::string& SeriesReader::slip_convention() const {
  return impl_->attributes.slip_convention;
}
const std::optional<RightDelay>& SeriesReader::right_delay() const {
  return impl_->attributes.right_delay;
}
const std::optional<RightDelay>& SeriesReader::estimated_right_delay() const {
  return impl_->attributes.estimated_right_delay;
}
std::int64_t SeriesReader::surveyed_frames() const { return impl_->attributes.surveyed_frames; }
std::vector<Channel> SeriesReader::channels() const {
  return impl_->file.Reading([&] { return impl_->ReadChannels(); });
}
std::int64_t SeriesReader::frame_count() const {
  return static_cast<std::int64_t>(impl_->index.size());
}

SeriesFrame SeriesReader::Frame(std::int64_t i) const {
  if (i < 0 || i >= frame_count()) throw std::out_of_range("SeriesReader::Frame");
  const auto k = static_cast<std::size_t>(i);
  SeriesFrame frame = impl_->ReadFacts(k);
  impl_->file.Reading([&] {
    if (impl_->status[k] == 0) impl_->ReadPoints(k, &frame);
    for (const RecordColumns& columns : impl_->records) impl_->ReadRecord(columns, k, &frame);
    impl_->ReadSurvey(k, &frame);
    if (frame.patch.found) {
      frame.patch.contour_mm = internal::ReadPatchContour(impl_->file.id(), k);
    }
  });
  frame.surface.frame = impl_->surface_frame[k] == 0 ? SurfaceFrame::kRig : SurfaceFrame::kGround;
  return frame;
}

SeriesFrame SeriesReader::SurveyedFrame(std::int64_t i) const {
  if (i < 0 || i >= frame_count()) throw std::out_of_range("SeriesReader::SurveyedFrame");
  const auto k = static_cast<std::size_t>(i);
  SeriesFrame frame = impl_->ReadFacts(k);
  impl_->file.Reading([&] {
    for (const RecordColumns& columns : impl_->records) {
      const internal::ContentFlag holds = columns.group->needs;
      if (holds != &SeriesContents::survey && holds != &SeriesContents::placement) continue;
      impl_->ReadRecord(columns, k, &frame);
    }
    impl_->ReadSurvey(k, &frame);
  });
  return frame;
}

}  // namespace plumbline
