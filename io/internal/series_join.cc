#include "io/internal/series_join.h"

#include <hdf5_hl.h>

#include <algorithm>
#include <map>
#include <utility>

#include "io/internal/durable_file.h"
#include "io/internal/hdf5_tree.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_tables.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

using hdf5::Id;
using hdf5::Object;
using hdf5::Shape;
using hdf5::Values;

constexpr const char* kIndex = "/frames/index";
constexpr const char* kContourFirst = "/patch/contour_first";
const std::set<std::string> kContours = {"/patch/contour", "/patch/contour_frame"};

haddr_t AddressOf(hid_t object) {
  H5O_info_t info;
  hdf5::Check(H5Oget_info2(object, &info, H5O_INFO_BASIC), "inspecting an object");
  return info.addr;
}

// Addresses of the axes of each dimension; 0: it has none.
std::vector<haddr_t> AxesOf(const Id& dataset) {
  std::vector<haddr_t> axes(hdf5::ShapeOf(dataset).size(), 0);
  if (H5DSis_scale(dataset.get()) > 0) return axes;
  for (std::size_t d = 0; d < axes.size(); ++d) {
    const auto keep = [](hid_t, unsigned, hid_t scale, void* user) -> herr_t {
      *static_cast<haddr_t*>(user) = AddressOf(scale);
      return 1;
    };
    hdf5::Check(
        H5DSiterate_scales(dataset.get(), static_cast<unsigned>(d), nullptr, keep, &axes[d]),
        "reading axes");
  }
  return axes;
}

enum class Role : std::uint8_t {
  kHeader,  // the same in all sources
  kColumn,  // one row a frame
  kPoints,  // one row a frame, in chunks
  kContour  // rows of many frames
};

// A dataset that is being joined.
struct Joined {
  std::string path;
  Role role = Role::kHeader;
  std::vector<haddr_t> axes;
  Id type, create;  // the latter: how it is stored
  Shape shape;      // of one source; then of all
  Values column;
  Id out;
};

class Join {
 public:
  Join(const fs::path& file, const fs::path& folder, std::vector<SeriesSource> sources,
       const JoinOptions& options)
      : folder_(folder),
        sources_(std::move(sources)),
        options_(options),
        out_(hdf5::CreateFile(file, options.kind == JoinKind::kVirtual)) {}

  void Run() {
    for (std::size_t i = 0; i < sources_.size(); ++i) {
      if (options_.proceed) options_.proceed(i);
      const Id source = hdf5::OpenForeignFile(folder_ / sources_[i].name);
      if (i == 0) TakeHeader(source.get());
      sources_[i].frames =
          static_cast<std::int64_t>(hdf5::ShapeOf(hdf5::OpenDataset(source.get(), kIndex)).at(0));
      for (Joined& dataset : datasets_) {
        if (dataset.role != Role::kHeader) Append(source.get(), i == 0, sources_[i], &dataset);
      }
      frames_ += static_cast<hsize_t>(sources_[i].frames);
      if (hdf5::Exists(source.get(), "/patch/contour")) {
        contour_points_ += hdf5::ShapeOf(hdf5::OpenDataset(source.get(), "/patch/contour")).at(0);
      }
    }
    Finish();
  }

 private:
  // Groups, what is the same in all sources, and which datasets there are.
  void TakeHeader(hid_t source) {
    std::map<haddr_t, std::string> first_path;
    const haddr_t index = AddressOf(hdf5::OpenDataset(source, kIndex).get());
    for (const Object& object : hdf5::ObjectsOf(source)) {
      if (!object.is_dataset) {
        const Id from = hdf5::OpenGroup(source, object.path);
        const Id to = object.path == "/" ? hdf5::OpenGroup(out_.get(), "/")
                                         : hdf5::CreateGroup(out_.get(), object.path);
        CopyAttributes(from.get(), to.get());
        continue;
      }
      const auto [known, is_new] = first_path.emplace(object.address, object.path);
      if (!is_new) {
        links_.emplace_back(known->second, object.path);
        continue;
      }
      Joined dataset = Describe(source, object, index);
      if (dataset.role == Role::kHeader) {
        const Id from = hdf5::OpenDataset(source, object.path);
        Create(dataset.shape, &dataset);
        hdf5::Write(dataset.out, hdf5::ValuesOf(from));
        CopyAttributes(from.get(), dataset.out.get());
      } else {
        const Id from = hdf5::OpenDataset(source, object.path);
        for (const std::string& name : hdf5::AttributeNames(from.get())) {
          if (hdf5::IsOfAxes(name)) continue;
          attributes_[object.path].emplace_back(name, hdf5::AttributeOf(from.get(), name));
        }
      }
      datasets_.push_back(std::move(dataset));
    }
    axis_path_ = std::move(first_path);
  }

  static Joined Describe(hid_t source, const Object& object, haddr_t index) {
    const std::string& path = object.path;
    const Id from = hdf5::OpenDataset(source, path);
    Joined dataset;
    dataset.path = path;
    dataset.axes = AxesOf(from);
    dataset.type = Id(hdf5::Check(H5Dget_type(from.get()), "dataset type"));
    dataset.create = Id(hdf5::Check(H5Dget_create_plist(from.get()), "dataset layout"));
    dataset.shape = hdf5::ShapeOf(from);
    if (H5Pget_layout(dataset.create.get()) == H5D_VIRTUAL) {
      throw hdf5::Error(path + " is virtual: join the files that it is made of");
    }
    const bool is_of_frames =
        object.address == index || (!dataset.axes.empty() && dataset.axes[0] == index);
    const bool is_chunked = H5Pget_layout(dataset.create.get()) == H5D_CHUNKED;
    if (kContours.count(path) > 0) {
      dataset.role = Role::kContour;
    } else if (is_of_frames) {
      dataset.role = is_chunked ? Role::kPoints : Role::kColumn;
    }
    return dataset;
  }

  static void CopyAttributes(hid_t from, hid_t to) {
    for (const std::string& name : hdf5::AttributeNames(from)) {
      if (!hdf5::IsOfAxes(name)) hdf5::WriteAttribute(to, name, hdf5::AttributeOf(from, name));
    }
  }

  // Of this size, stored as in the first source.
  void Create(const Shape& shape, Joined* dataset) {
    Shape largest = shape;
    const bool grows = H5Pget_layout(dataset->create.get()) == H5D_CHUNKED;
    if (grows && !largest.empty()) largest[0] = H5S_UNLIMITED;
    const Id space(shape.empty() ? hdf5::Check(H5Screate(H5S_SCALAR), "dataset size")
                                 : hdf5::Check(H5Screate_simple(static_cast<int>(shape.size()),
                                                                shape.data(), largest.data()),
                                               "dataset size"));
    dataset->out =
        Id(hdf5::Check(H5Dcreate2(out_.get(), dataset->path.c_str(), dataset->type.get(),
                                  space.get(), H5P_DEFAULT, dataset->create.get(), H5P_DEFAULT),
                       ("creating " + dataset->path).c_str()));
  }

  void Append(hid_t source, bool is_first, const SeriesSource& facts, Joined* dataset) {
    const Id from = hdf5::OpenDataset(source, dataset->path);
    const Id type(hdf5::Check(H5Dget_type(from.get()), "dataset type"));
    Shape shape = hdf5::ShapeOf(from);
    const bool fits =
        shape.size() == dataset->shape.size() && !shape.empty() &&
        std::equal(shape.begin() + 1, shape.end(), dataset->shape.begin() + 1) &&
        H5Tequal(type.get(), dataset->type.get()) > 0 &&
        (dataset->role == Role::kContour || shape[0] == static_cast<hsize_t>(facts.frames));
    if (!fits) throw hdf5::Error(dataset->path + " of " + facts.name + " is of another kind");
    switch (dataset->role) {
      case Role::kColumn:
        return AppendColumn(from, is_first, dataset);
      case Role::kContour:
        return AppendContour(source, is_first, dataset);
      default:
        if (options_.kind == JoinKind::kCopy) AppendChunks(from, is_first, shape, dataset);
    }
  }

  void AppendColumn(const Id& from, bool is_first, Joined* dataset) {
    Values values = hdf5::ValuesOf(from);
    if (dataset->path == kContourFirst) {  // comes before /patch/contour is added to
      auto* first = reinterpret_cast<std::int64_t*>(values.bytes.data());
      if (H5Tequal(values.type.get(), H5T_NATIVE_INT64) <= 0) throw hdf5::Error("contour_first");
      for (std::size_t i = 0; i < values.bytes.size() / sizeof *first; ++i) {
        first[i] += static_cast<std::int64_t>(contour_points_);
      }
    }
    if (is_first) {
      dataset->column = std::move(values);
      return;
    }
    Values& all = dataset->column;
    all.shape[0] += values.shape[0];
    all.bytes.insert(all.bytes.end(), values.bytes.begin(), values.bytes.end());
    std::move(values.texts.begin(), values.texts.end(), std::back_inserter(all.texts));
  }

  void AppendContour(hid_t source, bool is_first, Joined* dataset) {
    if (is_first) {
      Shape none = dataset->shape;
      none[0] = 0;
      Create(none, dataset);
    }
    if (dataset->path == "/patch/contour") {
      hdf5::AppendRows<double>(dataset->out, hdf5::ReadArray<double>(source, dataset->path));
    } else {
      hdf5::AppendRows<std::int64_t>(dataset->out,
                                     hdf5::ReadArray<std::int64_t>(source, dataset->path));
    }
  }

  void AppendChunks(const Id& from, bool is_first, const Shape& shape, Joined* dataset) {
    if (is_first) {
      Shape none = shape;
      none[0] = 0;
      Create(none, dataset);
    }
    const Shape chunk = hdf5::ChunkOf(from);
    if (chunk != hdf5::ChunkOf(dataset->out) || chunk.at(0) != 1) {
      throw hdf5::Error(dataset->path + " is cut into other chunks");
    }
    Shape extent = shape;
    extent[0] += frames_;
    hdf5::Check(H5Dset_extent(dataset->out.get(), extent.data()), "adding frames");
    hsize_t chunks = 0, copied = 0;
    const Id all(hdf5::Check(H5Dget_space(from.get()), "dataset size"));
    hdf5::Check(H5Dget_num_chunks(from.get(), all.get(), &chunks), "counting chunks");
    std::vector<std::uint8_t> bytes;
    Shape at(shape.size(), 0);
    while (at[0] < shape[0] && copied < chunks) {
      hsize_t stored = 0;
      // A frame without points has no chunk: to HDF5 1.10 that is an error like any other.
      if (H5Dget_chunk_storage_size(from.get(), at.data(), &stored) >= 0 && stored > 0) {
        ++copied;
        bytes.resize(stored);
        std::uint32_t filters = 0;
        hdf5::Check(H5Dread_chunk(from.get(), H5P_DEFAULT, at.data(), &filters, bytes.data()),
                    "reading a chunk");
        Shape to = at;
        to[0] += frames_;
        hdf5::Check(H5Dwrite_chunk(dataset->out.get(), H5P_DEFAULT, filters, to.data(),
                                   bytes.size(), bytes.data()),
                    "writing a chunk");
      }
      for (std::size_t d = at.size(); d-- > 0;) {
        at[d] += chunk[d];
        if (d == 0 || at[d] < shape[d]) break;
        at[d] = 0;
      }
    }
    H5Eclear2(H5E_DEFAULT);
    if (copied != chunks) throw hdf5::Error(dataset->path + " has chunks that cannot be read");
  }

  // Points that lie in the sources; where one of these has none, what HDF5 gives there.
  void CreateVirtual(Joined* dataset) const {
    const Id create(hdf5::Check(H5Pcreate(H5P_DATASET_CREATE), "virtual dataset"));
    std::vector<std::uint8_t> fill(H5Tget_size(dataset->type.get()));
    hdf5::Check(H5Pget_fill_value(dataset->create.get(), dataset->type.get(), fill.data()), "fill");
    hdf5::Check(H5Pset_fill_value(create.get(), dataset->type.get(), fill.data()), "fill");
    H5Pset_attr_creation_order(create.get(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
    Shape shape = dataset->shape;
    shape[0] = frames_;
    const auto space_of = [&](const Shape& size) {
      return Id(hdf5::Check(H5Screate_simple(static_cast<int>(size.size()), size.data(), nullptr),
                            "dataset size"));
    };
    const Id space = space_of(shape);
    Shape start(shape.size(), 0), count = shape;
    for (const SeriesSource& source : sources_) {
      count[0] = static_cast<hsize_t>(source.frames);
      if (count[0] == 0) continue;
      hdf5::Check(H5Sselect_hyperslab(space.get(), H5S_SELECT_SET, start.data(), nullptr,
                                      count.data(), nullptr),
                  "virtual dataset");
      hdf5::Check(H5Pset_virtual(create.get(), space.get(), source.name.c_str(),
                                 dataset->path.c_str(), space_of(count).get()),
                  "virtual dataset");
      start[0] += count[0];
    }
    hdf5::Check(H5Sselect_all(space.get()), "virtual dataset");
    dataset->out = Id(hdf5::Check(H5Dcreate2(out_.get(), dataset->path.c_str(), dataset->type.get(),
                                             space.get(), H5P_DEFAULT, create.get(), H5P_DEFAULT),
                                  ("creating " + dataset->path).c_str()));
  }

  void Finish() {
    for (Joined& dataset : datasets_) {
      if (dataset.role == Role::kColumn) {
        Create(dataset.column.shape, &dataset);
        hdf5::Write(dataset.out, dataset.column);
      } else if (dataset.role == Role::kPoints && options_.kind == JoinKind::kVirtual) {
        CreateVirtual(&dataset);
      }
      for (const auto& [name, values] : attributes_[dataset.path]) {
        hdf5::WriteAttribute(dataset.out.get(), name, values);
      }
      dataset.out.Close("closing a dataset");
    }
    for (const auto& [existing, link] : links_) hdf5::HardLink(out_.get(), existing, link);
    for (const Joined& dataset : datasets_) {
      const Id id = hdf5::OpenDataset(out_.get(), dataset.path);
      for (std::size_t d = 0; d < dataset.axes.size(); ++d) {
        const auto axis = axis_path_.find(dataset.axes[d]);
        if (dataset.axes[d] == 0 || axis == axis_path_.end()) continue;
        const Id scale = hdf5::OpenDataset(out_.get(), axis->second);
        hdf5::Check(H5DSattach_scale(id.get(), scale.get(), static_cast<unsigned>(d)),
                    "attaching an axis");
      }
    }
    NameSurfaceFrame();
    hdf5::SetText(out_.get(), "created", TimestampNow());
    if (options_.kind == JoinKind::kVirtual) WriteSources(out_.get(), sources_);
    if (options_.finish) options_.finish(out_.get());
    out_.Close("closing the file");
  }

  // One source may have been in the frame of the ground, another one in that of the rig.
  void NameSurfaceFrame() const {
    if (!hdf5::Exists(out_.get(), "/frames/surface_frame")) return;
    const auto bytes = [&](const char* path) {
      return hdf5::ValuesOf(hdf5::OpenDataset(out_.get(), path)).bytes;
    };
    std::vector<std::uint8_t> has_surface = bytes("/frames/status");
    for (std::uint8_t& status : has_surface) status = status == 0 ? 1 : 0;
    WriteFrameOfPositions(out_.get(), bytes("/frames/surface_frame"), has_surface);
  }

  fs::path folder_;
  std::vector<SeriesSource> sources_;
  const JoinOptions& options_;
  Id out_;
  std::vector<Joined> datasets_;
  std::map<std::string, std::vector<std::pair<std::string, Values>>> attributes_;
  std::vector<std::pair<std::string, std::string>> links_;  // existing path, link
  std::map<haddr_t, std::string> axis_path_;
  hsize_t frames_ = 0, contour_points_ = 0;
};

}  // namespace

void JoinSeries(const fs::path& file, const fs::path& folder, std::vector<SeriesSource> sources,
                const JoinOptions& options) {
  Join(file, folder, std::move(sources), options).Run();
}

std::set<std::string> PathsOfFrames(hid_t file) {
  std::set<std::string> paths = kContours;
  const haddr_t index = AddressOf(hdf5::OpenDataset(file, kIndex).get());
  for (const Object& object : hdf5::ObjectsOf(file)) {
    if (!object.is_dataset) continue;
    const std::vector<haddr_t> axes = AxesOf(hdf5::OpenDataset(file, object.path));
    if (object.address == index || (!axes.empty() && axes[0] == index)) paths.insert(object.path);
  }
  return paths;
}

}  // namespace plumbline::internal
