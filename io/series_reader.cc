#include "io/series_reader.h"

#include <fmt/format.h>

#include <cstring>
#include <stdexcept>
#include <type_traits>

#include "calib/error.h"
#include "io/internal/hdf5.h"
#include "io/internal/patch_contours.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_records.h"
#include "io/internal/series_tables.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;

namespace {

// A frame of 16 384 by 16 384 points, three numbers each, is the largest that is read.
constexpr hsize_t kMaxFrameElements = hsize_t{3} << 28;
constexpr hsize_t kMaxFrames = 100'000'000;
constexpr hsize_t kMaxSamples = hsize_t{1} << 28;  // of a channel

template <typename Element, typename Scalar>
Image<Element> ToImage(ImageSize size, const std::vector<Scalar>& values) {
  Element zero{};
  if constexpr (std::is_class_v<Element>) zero.setZero();
  Image<Element> image(size, zero);
  if (values.size() * sizeof(Scalar) != image.pixel_count() * sizeof(Element)) {
    throw hdf5::Error("a dataset of points is not of the grid's size");
  }
  if (!values.empty()) {
    std::memcpy(static_cast<void*>(image.data()), values.data(), values.size() * sizeof(Scalar));
  }
  return image;
}

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
  fs::path path;
  hdf5::Id file;
  SeriesFacts facts;
  Image<Eigen::Vector2f> grid;
  int step_px = 0;
  int subset_px = 0;
  SeriesContents contents;
  Attributes attributes;
  std::vector<std::int64_t> index;
  std::vector<double> time_s;
  std::vector<std::string> left_id, right_id, problem;
  std::vector<std::uint8_t> status, surface_frame;
  std::vector<std::int32_t> dropped_before;
  std::vector<RecordColumns> records;

  // Runs a reader, and says which file it was where something is wrong.
  template <typename Read>
  auto Reading(const Read& read) const {
    const auto refuse = [&](const char* reason) {
      return InputError(fmt::format("{} cannot be read as a series: {}", path.string(), reason));
    };
    try {
      return read();
    } catch (const hdf5::Error& error) {
      throw refuse(error.what());
    } catch (const std::invalid_argument& error) {  // impossible camera parameters
      throw refuse(error.what());
    }
  }

  void Open() {
    file = hdf5::OpenForeignFile(path);
    const std::string format = hdf5::GetText(file.get(), "format");
    if (format != "plumbline-series") {
      throw hdf5::Error(format.empty() ? "it has no attribute `format`"
                                       : fmt::format("it is of the format {}", format));
    }
    const double version = hdf5::GetNumber(file.get(), "format_version", 0);
    if (!(version >= 1 && version <= static_cast<double>(internal::kFormatVersion))) {
      throw hdf5::Error(fmt::format("it is of version {}; this program reads up to {}", version,
                                    internal::kFormatVersion));
    }
    facts = {hdf5::GetText(file.get(), "created"), hdf5::GetText(file.get(), "software"),
             hdf5::GetText(file.get(), "recipe"), hdf5::GetText(file.get(), "inputs")};
    contents = internal::ContentsOf(file.get());
    ReadGrid();
    ReadAttributes();
    ReadFrames();
    ReadRecordColumns();
  }

  void ReadAttributes() {
    const auto text = [&](const char* path, const char* name, const char* otherwise) {
      if (!hdf5::Exists(file.get(), path)) return std::string(otherwise);
      return hdf5::GetText(hdf5::OpenGroup(file.get(), path).get(), name, otherwise);
    };
    attributes.grid_points = text("/grid", "points", "image");
    attributes.displacement_reference = text("/displacement", "reference", "frame 0");
    attributes.strain_measure = text("/strain", "measure", "green_lagrange");
    attributes.strain_axes = text("/strain", "strain_axes", "material");
    attributes.slip_convention = text("/slip", "convention", "ISO 8855");
    if (!contents.strain) return;
    const hdf5::Id strain = hdf5::OpenGroup(file.get(), "/strain");
    const double vsg_px = hdf5::GetNumber(strain.get(), "vsg_px", 0);
    if (!(vsg_px >= 0 && vsg_px <= 1e6)) throw hdf5::Error("vsg_px of /strain is out of range");
    attributes.vsg_px = static_cast<int>(vsg_px);
    attributes.vsg_mm = hdf5::GetNumber(strain.get(), "vsg_mm", 0);
  }

  void ReadGrid() {
    hdf5::Shape shape;
    const auto values =
        hdf5::ReadArray<float>(file.get(), "/grid/pixel", &shape, kMaxFrameElements);
    if (shape.size() != 3 || shape[2] != 2) throw hdf5::Error("/grid/pixel is not (row, col, 2)");
    grid =
        ToImage<Eigen::Vector2f>({static_cast<int>(shape[1]), static_cast<int>(shape[0])}, values);
    const auto one = [&](const char* name) {
      return hdf5::ReadArray<std::int32_t>(file.get(), name, nullptr, 1).at(0);
    };
    step_px = one("/grid/step_px");
    subset_px = one("/grid/subset_px");
  }

  void ReadFrames() {
    const hid_t f = file.get();
    index = hdf5::ReadArray<std::int64_t>(f, "/frames/index", nullptr, kMaxFrames);
    time_s = hdf5::ReadArray<double>(f, "/frames/time_s", nullptr, kMaxFrames);
    left_id = hdf5::ReadTexts(f, "/frames/left_id");
    right_id = hdf5::ReadTexts(f, "/frames/right_id");
    problem = hdf5::ReadTexts(f, "/frames/problem");
    status = ReadEnum("/frames/status");
    surface_frame = ReadEnum("/frames/surface_frame");
    dropped_before =
        hdf5::ReadArray<std::int32_t>(f, "/frames/dropped_before", nullptr, kMaxFrames);
    const std::size_t n = index.size();
    for (const std::size_t size : {time_s.size(), left_id.size(), right_id.size(), problem.size(),
                                   status.size(), surface_frame.size(), dropped_before.size()}) {
      if (size != n) throw hdf5::Error("the columns of /frames differ in length");
    }
  }

  void ReadRecordColumns() {
    for (const internal::RecordGroup& group : internal::RecordGroups()) {
      if (!internal::Holds(contents, group.needs)) continue;
      records.push_back({&group, ReadEnum(group.path + "/status"),
                         hdf5::ReadTexts(file.get(), group.path + "/problem")});
      if (records.back().status.size() != index.size() ||
          records.back().problem.size() != index.size()) {
        throw hdf5::Error("the columns of " + group.path + " and /frames differ in length");
      }
    }
  }

  std::vector<Channel> ReadChannels() const {
    std::vector<Channel> channels;
    if (!hdf5::Exists(file.get(), "/channels")) return channels;
    const hdf5::Id group = hdf5::OpenGroup(file.get(), "/channels");
    for (const std::string& name : hdf5::LinkNames(group.get())) {
      const hdf5::Id own = hdf5::OpenGroup(group.get(), name);
      const hdf5::Id value = hdf5::OpenDataset(own.get(), "value");
      channels.push_back({name, hdf5::GetText(value.get(), "units"),
                          hdf5::GetText(value.get(), "long_name"),
                          hdf5::ReadArray<double>(own.get(), "time_s", nullptr, kMaxSamples),
                          hdf5::ReadArray<double>(own.get(), "value", nullptr, kMaxSamples)});
      if (channels.back().time_s.size() != channels.back().value.size()) {
        throw hdf5::Error("the channel " + name + " has not as many times as values");
      }
    }
    return channels;
  }

  std::vector<std::uint8_t> ReadEnum(const std::string& name) const {
    const hdf5::Id dataset = hdf5::OpenDataset(file.get(), name);
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

  template <typename T>
  std::vector<T> Slab(const std::string& name, std::size_t i) const {
    return hdf5::ReadSlab<T>(hdf5::OpenDataset(file.get(), name), i, kMaxFrameElements);
  }

  void ReadPoints(std::size_t i, SeriesFrame* frame) const {
    using internal::PointPart;
    const ImageSize size = grid.size();
    const auto read = [&](internal::PointGroup group, PointPart part, auto* image) {
      using Element = std::decay_t<decltype(*image->data())>;
      *image = ToImage<Element>(size, Slab<float>(internal::FieldOf(group, part).Path(), i));
    };
    for (int g = 0; g < internal::kPointGroupCount; ++g) {
      const auto group = static_cast<internal::PointGroup>(g);
      if (!internal::Holds(contents, internal::kPointGroups[group].needs)) continue;
      const auto images = internal::VectorImages(*frame, group);
      read(group, PointPart::kValue, images[0]);
      read(group, PointPart::kRandom, images[1]);
      read(group, PointPart::kCalibration, images[2]);
    }
    Surface& s = frame->surface;
    read(internal::kSurface, PointPart::kCorrelation, &s.correlation);
    read(internal::kSurface, PointPart::kEpipolar, &s.epipolar_px);
    if (contents.covariance) read(internal::kSurface, PointPart::kCovariance, &s.cov_random_mm2);
    const auto codes =
        hdf5::ReadSlabBytes(hdf5::OpenDataset(file.get(), "/surface/status"), i, kMaxFrameElements);
    for (const std::uint8_t code : codes) {
      if (code >= kStatusNames.size()) throw hdf5::Error("/surface/status holds unknown codes");
    }
    s.status = ToImage<Status>(size, codes);
  }

  void ReadRecord(const RecordColumns& columns, std::size_t i, SeriesFrame* frame) const {
    const internal::RecordGroup& group = *columns.group;
    const bool found = columns.status[i] == 0;
    group.set_found(found, columns.problem[i], frame);
    if (!found) return;
    for (const internal::RecordField& field : group.fields) {
      if (!field.set) continue;
      field.set(ToMatrix(field, Slab<double>(group.path + "/" + field.name, i)), frame);
    }
  }
};

SeriesReader::SeriesReader(const fs::path& file) : impl_(std::make_unique<Impl>()) {
  std::error_code ignored;
  if (!fs::is_regular_file(file, ignored)) {
    throw InputError(fmt::format("there is no series {}", file.string()));
  }
  impl_->path = file;
  impl_->Reading([&] { impl_->Open(); });
}

SeriesReader::~SeriesReader() = default;

const SeriesFacts& SeriesReader::facts() const { return impl_->facts; }
StereoRig SeriesReader::rig() const {
  return impl_->Reading([&] { return internal::ReadRigGroup(impl_->file.get()); });
}
Image<Eigen::Vector2f> SeriesReader::grid_px() const { return impl_->grid; }
int SeriesReader::step_px() const { return impl_->step_px; }
int SeriesReader::subset_px() const { return impl_->subset_px; }
const SeriesContents& SeriesReader::contents() const { return impl_->contents; }
const std::string& SeriesReader::grid_points() const { return impl_->attributes.grid_points; }
const std::string& SeriesReader::displacement_reference() const {
  return impl_->attributes.displacement_reference;
}
const std::string& SeriesReader::strain_measure() const { return impl_->attributes.strain_measure; }
const std::string& SeriesReader::strain_axes() const { return impl_->attributes.strain_axes; }
int SeriesReader::vsg_px() const { return impl_->attributes.vsg_px; }
double SeriesReader::vsg_mm() const { return impl_->attributes.vsg_mm; }
const std::string& SeriesReader::slip_convention() const {
  return impl_->attributes.slip_convention;
}
std::vector<Channel> SeriesReader::channels() const {
  return impl_->Reading([&] { return impl_->ReadChannels(); });
}
std::int64_t SeriesReader::frame_count() const {
  return static_cast<std::int64_t>(impl_->index.size());
}

SeriesFrame SeriesReader::Frame(std::int64_t i) const {
  if (i < 0 || i >= frame_count()) throw std::out_of_range("SeriesReader::Frame");
  const auto k = static_cast<std::size_t>(i);
  SeriesFrame frame;
  frame.index = impl_->index[k];
  frame.time_s = impl_->time_s[k];
  frame.left_id = impl_->left_id[k];
  frame.right_id = impl_->right_id[k];
  frame.problem = impl_->problem[k];
  frame.dropped_before = impl_->dropped_before[k];
  impl_->Reading([&] {
    if (impl_->status[k] == 0) impl_->ReadPoints(k, &frame);
    for (const RecordColumns& columns : impl_->records) impl_->ReadRecord(columns, k, &frame);
    if (frame.patch.found) {
      frame.patch.contour_mm = internal::ReadPatchContour(impl_->file.get(), k);
    }
  });
  frame.surface.frame = impl_->surface_frame[k] == 0 ? SurfaceFrame::kRig : SurfaceFrame::kGround;
  return frame;
}

}  // namespace plumbline
