#include "io/internal/hdf5.h"

#include <fmt/format.h>
#include <hdf5_hl.h>

#include <cmath>
#include <cstring>
#include <mutex>
#include <numeric>

namespace plumbline::internal::hdf5 {
namespace fs = std::filesystem;
namespace {

herr_t KeepInnermost(unsigned, const H5E_error2_t* entry, void* user) {
  if (entry->desc != nullptr) *static_cast<std::string*>(user) = entry->desc;
  return 0;
}

std::vector<std::string> TakeTexts(hid_t type, hid_t space, std::vector<char*>& raw) {
  std::vector<std::string> texts;
  for (const char* text : raw) texts.emplace_back(text != nullptr ? text : "");
  H5Dvlen_reclaim(type, space, H5P_DEFAULT, raw.data());
  return texts;
}

std::vector<const char*> Pointers(const std::vector<std::string>& values) {
  std::vector<const char*> pointers;
  for (const std::string& value : values) pointers.push_back(value.c_str());
  return pointers;
}

Id CreateAttribute(hid_t object, const std::string& name, hid_t type, hid_t space) {
  if (HasAttribute(object, name)) Check(H5Adelete(object, name.c_str()), "replacing an attribute");
  return Id(Check(H5Acreate2(object, name.c_str(), type, space, H5P_DEFAULT, H5P_DEFAULT),
                  "creating an attribute"));
}

// How a group is stored: listings follow the order of writing, and its links lie in its header,
// which has a checksum as soon as it keeps the order of attributes. Elsewhere nothing tells
// HDF5 1.10 of damaged links, and it may free what it never made (H5G__link_release_table).
void DescribeGroup(hid_t create) {
  const unsigned in_order = H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED;
  Check(H5Pset_link_creation_order(create, in_order), "creating a group");
  Check(H5Pset_attr_creation_order(create, in_order), "creating a group");
  Check(H5Pset_link_phase_change(create, 64, 32), "creating a group");
}

// Makes the groups that lead to `name`. The library's own way would not describe them.
void CreateGroupOf(hid_t parent, const std::string& name) {
  const std::size_t end = name.rfind('/');
  if (end != std::string::npos && end > 0) CreateGroup(parent, name.substr(0, end));
}

}  // namespace

void Initialise() {
  static std::once_flag once;
  std::call_once(once, [] {
    H5dont_atexit();
    H5open();
    H5PLset_loading_state(0);
  });
  // The thread-safe build keeps one error stack a thread.
  thread_local const bool silent = H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr) >= 0;
  static_cast<void>(silent);
}

hid_t Check(hid_t result, const char* doing) {
  if (result >= 0) return result;
  std::string reason;
  H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, KeepInnermost, &reason);
  H5Eclear2(H5E_DEFAULT);
  throw Error(reason.empty() ? std::string(doing) : fmt::format("{}: {}", doing, reason));
}

void Id::Close(const char* doing) {
  const hid_t id = std::exchange(id_, -1);
  if (id >= 0) Check(H5Idec_ref(id), doing);
}

hsize_t ElementCount(const Shape& shape) {
  hsize_t count = 1;
  for (const hsize_t n : shape) {
    if (n != 0 && count > (hsize_t{1} << 60) / n) throw Error("a dataset's size overflows");
    count *= n;
  }
  return count;
}

Id CreateFile(const fs::path& file, bool has_virtual) {
  Initialise();
  const Id create(Check(H5Pcreate(H5P_FILE_CREATE), "creating a file"));
  DescribeGroup(create.get());
  const Id access(Check(H5Pcreate(H5P_FILE_ACCESS), "creating a file"));
  Check(H5Pset_libver_bounds(access.get(), H5F_LIBVER_EARLIEST,
                             has_virtual ? H5F_LIBVER_V110 : H5F_LIBVER_V18),
        "format version");
  return Id(Check(H5Fcreate(file.c_str(), H5F_ACC_TRUNC, create.get(), access.get()),
                  "creating the file"));
}

Id OpenFile(const fs::path& file, bool writable) {
  Initialise();
  const Id access(Check(H5Pcreate(H5P_FILE_ACCESS), "opening the file"));
  Check(H5Pset_libver_bounds(access.get(), H5F_LIBVER_EARLIEST, H5F_LIBVER_V18), "format version");
  return Id(Check(H5Fopen(file.c_str(), writable ? H5F_ACC_RDWR : H5F_ACC_RDONLY, access.get()),
                  "opening the file"));
}

Id CreateGroup(hid_t parent, const std::string& name) {
  if (Exists(parent, name)) return OpenGroup(parent, name);
  CreateGroupOf(parent, name);
  const Id create(Check(H5Pcreate(H5P_GROUP_CREATE), "creating a group"));
  DescribeGroup(create.get());
  return Id(Check(H5Gcreate2(parent, name.c_str(), H5P_DEFAULT, create.get(), H5P_DEFAULT),
                  "creating a group"));
}

Id OpenGroup(hid_t parent, const std::string& name) {
  return Id(Check(H5Gopen2(parent, name.c_str(), H5P_DEFAULT), ("opening " + name).c_str()));
}

bool Exists(hid_t parent, const std::string& path) {
  for (std::size_t end = path.find('/', 1);; end = path.find('/', end + 1)) {
    const std::string part = path.substr(0, end);
    if (part.empty() || H5Lexists(parent, part.c_str(), H5P_DEFAULT) <= 0) return false;
    if (end == std::string::npos) return true;
  }
}

void HardLink(hid_t file, const std::string& existing, const std::string& link) {
  Check(H5Lcreate_hard(file, existing.c_str(), file, link.c_str(), H5P_DEFAULT, H5P_DEFAULT),
        "linking");
}

std::vector<std::string> LinkNames(hid_t group) {
  std::vector<std::string> names;
  const auto add = [](hid_t, const char* name, const H5L_info_t*, void* user) -> herr_t {
    static_cast<std::vector<std::string>*>(user)->emplace_back(name);
    return 0;
  };
  Check(H5Literate(group, H5_INDEX_NAME, H5_ITER_INC, nullptr, add, &names), "listing a group");
  return names;
}

Id TextType() {
  Id type(Check(H5Tcopy(H5T_C_S1), "text type"));
  H5Tset_size(type.get(), H5T_VARIABLE);
  H5Tset_cset(type.get(), H5T_CSET_UTF8);
  return type;
}

Id EnumType(std::span<const std::string_view> names) {
  Id type(Check(H5Tenum_create(H5T_NATIVE_UINT8), "enum type"));
  std::uint8_t value = 0;
  for (const std::string_view name : names) {
    Check(H5Tenum_insert(type.get(), std::string(name).c_str(), &value), "enum type");
    ++value;
  }
  return type;
}

// clang-format off
template <> hid_t NativeType<float>() { return H5T_NATIVE_FLOAT; }
template <> hid_t NativeType<double>() { return H5T_NATIVE_DOUBLE; }
template <> hid_t NativeType<std::int32_t>() { return H5T_NATIVE_INT32; }
template <> hid_t NativeType<std::int64_t>() { return H5T_NATIVE_INT64; }
template <> hid_t NativeType<std::uint8_t>() { return H5T_NATIVE_UINT8; }
template <> hid_t NativeType<std::uint16_t>() { return H5T_NATIVE_UINT16; }
// clang-format on

void SetText(hid_t object, const std::string& name, const std::string& value) {
  const Id type = TextType();
  const Id space(Check(H5Screate(H5S_SCALAR), "attribute"));
  const Id attribute = CreateAttribute(object, name, type.get(), space.get());
  const char* text = value.c_str();
  Check(H5Awrite(attribute.get(), type.get(), &text), "writing an attribute");
}

void SetTexts(hid_t object, const std::string& name, const std::vector<std::string>& values) {
  const Id type = TextType();
  const hsize_t n = values.size();
  const Id space(Check(H5Screate_simple(1, &n, nullptr), "attribute"));
  const Id attribute = CreateAttribute(object, name, type.get(), space.get());
  if (n > 0) {
    Check(H5Awrite(attribute.get(), type.get(), Pointers(values).data()), "writing an attribute");
  }
}

void SetNumber(hid_t object, const std::string& name, double value) {
  const Id space(Check(H5Screate(H5S_SCALAR), "attribute"));
  const Id attribute = CreateAttribute(object, name, H5T_NATIVE_DOUBLE, space.get());
  Check(H5Awrite(attribute.get(), H5T_NATIVE_DOUBLE, &value), "writing an attribute");
}

void SetInteger(hid_t object, const std::string& name, std::int64_t value) {
  const Id space(Check(H5Screate(H5S_SCALAR), "attribute"));
  const Id attribute = CreateAttribute(object, name, H5T_NATIVE_INT64, space.get());
  Check(H5Awrite(attribute.get(), H5T_NATIVE_INT64, &value), "writing an attribute");
}

bool HasAttribute(hid_t object, const std::string& name) {
  return H5Aexists(object, name.c_str()) > 0;
}

std::vector<std::string> GetTexts(hid_t object, const std::string& name) {
  const Id attribute(Check(H5Aopen(object, name.c_str(), H5P_DEFAULT), "opening an attribute"));
  const Id stored(Check(H5Aget_type(attribute.get()), "attribute type"));
  const Id space(Check(H5Aget_space(attribute.get()), "attribute size"));
  const hssize_t n = H5Sget_simple_extent_npoints(space.get());
  if (H5Tget_class(stored.get()) != H5T_STRING || n < 0 || n > 1 << 20) {
    throw Error("the attribute " + name + " is no text");
  }
  if (H5Tis_variable_str(stored.get()) > 0) {
    const Id type = TextType();
    H5Tset_cset(type.get(), H5Tget_cset(stored.get()));
    std::vector<char*> raw(static_cast<std::size_t>(n));
    if (n > 0) Check(H5Aread(attribute.get(), type.get(), raw.data()), "reading an attribute");
    return TakeTexts(type.get(), space.get(), raw);
  }
  const std::size_t length = H5Tget_size(stored.get());
  if (length == 0 || length > (1u << 24) / (static_cast<std::size_t>(n) + 1)) {
    throw Error("the attribute " + name + " is too large");
  }
  std::vector<char> raw(length * static_cast<std::size_t>(n));
  Check(H5Aread(attribute.get(), stored.get(), raw.data()), "reading an attribute");
  std::vector<std::string> texts;
  for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
    const char* text = raw.data() + i * length;
    texts.emplace_back(text, strnlen(text, length));
  }
  return texts;
}

std::string GetText(hid_t object, const std::string& name, const std::string& otherwise) {
  if (!HasAttribute(object, name)) return otherwise;
  const std::vector<std::string> texts = GetTexts(object, name);
  return texts.empty() ? otherwise : texts[0];
}

double GetNumber(hid_t object, const std::string& name, double otherwise) {
  if (!HasAttribute(object, name)) return otherwise;
  const Id attribute(Check(H5Aopen(object, name.c_str(), H5P_DEFAULT), "opening an attribute"));
  const Id space(Check(H5Aget_space(attribute.get()), "attribute size"));
  if (H5Sget_simple_extent_npoints(space.get()) != 1) throw Error(name + " is not one number");
  double value = otherwise;
  Check(H5Aread(attribute.get(), H5T_NATIVE_DOUBLE, &value), "reading an attribute");
  return value;
}

Id CreateDataset(hid_t parent, const DatasetSpec& spec, hid_t type, const void* fill) {
  const Id create(Check(H5Pcreate(H5P_DATASET_CREATE), "creating a dataset"));
  Shape largest = spec.shape;
  if (!spec.chunk.empty()) {
    Check(H5Pset_chunk(create.get(), static_cast<int>(spec.chunk.size()), spec.chunk.data()),
          "chunks");
    Check(H5Pset_shuffle(create.get()), "shuffle");
    Check(H5Pset_deflate(create.get(), 1), "deflate");
    largest[0] = H5S_UNLIMITED;
  }
  if (fill != nullptr) Check(H5Pset_fill_value(create.get(), type, fill), "fill value");
  H5Pset_attr_creation_order(create.get(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
  CreateGroupOf(parent, spec.name);
  const Id space(spec.shape.empty() ? Check(H5Screate(H5S_SCALAR), "dataset size")
                                    : Check(H5Screate_simple(static_cast<int>(spec.shape.size()),
                                                             spec.shape.data(), largest.data()),
                                            "dataset size"));
  Id dataset(Check(H5Dcreate2(parent, spec.name.c_str(), type, space.get(), H5P_DEFAULT,
                              create.get(), H5P_DEFAULT),
                   ("creating " + spec.name).c_str()));
  SetText(dataset.get(), "units", spec.units);
  SetText(dataset.get(), "long_name", spec.long_name);
  return dataset;
}

Id WriteTexts(hid_t parent, const DatasetSpec& spec, const std::vector<std::string>& values) {
  const Id type = TextType();
  Id dataset = CreateDataset(parent, spec, type.get());
  if (!values.empty()) {
    Check(
        H5Dwrite(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, Pointers(values).data()),
        "writing texts");
  }
  return dataset;
}

void MakeScale(const Id& dataset, const std::string& label) {
  Check(H5DSset_scale(dataset.get(), label.c_str()), "making an axis");
}

void AttachScales(hid_t file, const Id& dataset, const std::vector<std::string>& scale_paths) {
  for (std::size_t d = 0; d < scale_paths.size(); ++d) {
    const Id scale = OpenDataset(file, scale_paths[d]);
    Check(H5DSattach_scale(dataset.get(), scale.get(), static_cast<unsigned>(d)),
          "attaching an axis");
  }
}

std::string IndexScale(hid_t file, hsize_t n) {
  const std::string path = fmt::format("/axes/index_{}", n);
  if (!Exists(file, path)) {
    std::vector<std::int32_t> values(n);
    std::iota(values.begin(), values.end(), 0);
    MakeScale(WriteArray<std::int32_t>(file, {path, "1", "index", {n}, {}}, values), "index");
  }
  return path;
}

Id OpenDataset(hid_t parent, const std::string& name) {
  return Id(Check(H5Dopen2(parent, name.c_str(), H5P_DEFAULT), ("opening " + name).c_str()));
}

Shape ShapeOf(const Id& dataset) {
  const Id space(Check(H5Dget_space(dataset.get()), "dataset size"));
  const int rank = H5Sget_simple_extent_ndims(space.get());
  Check(rank, "dataset size");
  Shape shape(static_cast<std::size_t>(rank));
  if (rank > 0) {
    Check(H5Sget_simple_extent_dims(space.get(), shape.data(), nullptr), "dataset size");
  }
  return shape;
}

Shape ChunkOf(const Id& dataset) {
  const Id create(Check(H5Dget_create_plist(dataset.get()), "dataset layout"));
  if (H5Pget_layout(create.get()) != H5D_CHUNKED) return {};
  Shape chunk(H5S_MAX_RANK);
  const int rank = H5Pget_chunk(create.get(), H5S_MAX_RANK, chunk.data());
  Check(rank, "dataset layout");
  chunk.resize(static_cast<std::size_t>(rank));
  return chunk;
}

namespace {

// A selection of rows in the file, and as many in memory.
struct Rows {
  Id file, memory;
  hsize_t elements;
};

Rows SelectRows(const Id& dataset, hsize_t first, hsize_t rows) {
  Shape count = ShapeOf(dataset);
  if (count.empty() || first > count[0] || rows > count[0] - first) {
    throw Error("there are no such rows");
  }
  count[0] = rows;
  Shape start(count.size(), 0);
  start[0] = first;
  Rows selected{Id(Check(H5Dget_space(dataset.get()), "dataset size")),
                Id(Check(H5Screate_simple(static_cast<int>(count.size()), count.data(), nullptr),
                         "selecting rows")),
                ElementCount(count)};
  Check(H5Sselect_hyperslab(selected.file.get(), H5S_SELECT_SET, start.data(), nullptr,
                            count.data(), nullptr),
        "selecting rows");
  return selected;
}

template <typename T>
std::vector<T> ReadRowsAs(const Id& dataset, hid_t type, hsize_t first, hsize_t count,
                          hsize_t max_elements) {
  const Rows rows = SelectRows(dataset, first, count);
  if (rows.elements > max_elements) throw Error("a frame is too large");
  std::vector<T> values(rows.elements);
  if (values.empty()) return values;
  Check(
      H5Dread(dataset.get(), type, rows.memory.get(), rows.file.get(), H5P_DEFAULT, values.data()),
      "reading a frame");
  return values;
}

}  // namespace

template <typename T>
std::vector<T> ReadRows(const Id& dataset, hsize_t first, hsize_t count, hsize_t max_elements) {
  return ReadRowsAs<T>(dataset, NativeType<T>(), first, count, max_elements);
}
template std::vector<double> ReadRows<double>(const Id&, hsize_t, hsize_t, hsize_t);

template <typename T>
std::vector<T> ReadSlab(const Id& dataset, hsize_t index, hsize_t max_elements) {
  return ReadRowsAs<T>(dataset, NativeType<T>(), index, 1, max_elements);
}
template std::vector<float> ReadSlab<float>(const Id&, hsize_t, hsize_t);
template std::vector<double> ReadSlab<double>(const Id&, hsize_t, hsize_t);

std::vector<std::uint8_t> ReadSlabBytes(const Id& dataset, hsize_t index, hsize_t max_elements) {
  const Id type(Check(H5Dget_type(dataset.get()), "dataset type"));
  if (H5Tget_size(type.get()) != 1) throw Error("a dataset that should hold bytes does not");
  return ReadRowsAs<std::uint8_t>(dataset, type.get(), index, 1, max_elements);
}

template <typename T>
void AppendRows(const Id& dataset, std::span<const T> values) {
  if (values.empty()) return;
  Shape extent = ShapeOf(dataset);
  const hsize_t before = extent.at(0);
  extent[0] = 1;
  const hsize_t rows = values.size() / ElementCount(extent);
  if (rows * ElementCount(extent) != values.size()) throw Error("adding a part of a row");
  extent[0] = before + rows;
  Check(H5Dset_extent(dataset.get(), extent.data()), "adding rows");
  const Rows selected = SelectRows(dataset, before, rows);
  Check(H5Dwrite(dataset.get(), NativeType<T>(), selected.memory.get(), selected.file.get(),
                 H5P_DEFAULT, values.data()),
        "adding rows");
}
template void AppendRows<double>(const Id&, std::span<const double>);
template void AppendRows<std::int64_t>(const Id&, std::span<const std::int64_t>);

std::vector<std::string> ReadTexts(hid_t parent, const std::string& name, hsize_t max_elements) {
  const Id dataset = OpenDataset(parent, name);
  const Id stored(Check(H5Dget_type(dataset.get()), "dataset type"));
  if (H5Tget_class(stored.get()) != H5T_STRING || H5Tis_variable_str(stored.get()) <= 0) {
    throw Error(name + " does not hold texts");
  }
  const Id space(Check(H5Dget_space(dataset.get()), "dataset size"));
  const hsize_t n = ElementCount(ShapeOf(dataset));
  if (n > max_elements) throw Error(name + " is too large");
  const Id type = TextType();
  H5Tset_cset(type.get(), H5Tget_cset(stored.get()));
  std::vector<char*> raw(n);
  if (n > 0) {
    Check(H5Dread(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, raw.data()),
          ("reading " + name).c_str());
  }
  return TakeTexts(type.get(), space.get(), raw);
}

}  // namespace plumbline::internal::hdf5
