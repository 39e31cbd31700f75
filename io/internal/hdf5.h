#pragma once

#include <hdf5.h>

#include <cstdint>
#include <filesystem>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

// The one place where this project meets the HDF5 1.10 C API. Identifiers close themselves, errors
// are exceptions with the library's own words, and nothing is printed.
namespace plumbline::internal::hdf5 {

// What the library said. Callers turn it into InputError or EnvironmentError with the file's name.
class Error : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Once a process: no exit handler (after a failed write it would crash), no plugins, no printing.
void Initialise();

// Throws Error when `result` is negative; gives it back otherwise.
hid_t Check(hid_t result, const char* doing);

// Any HDF5 identifier, closed at the end of its life.
class Id {
 public:
  Id() = default;
  explicit Id(hid_t id) : id_(id) {}
  Id(Id&& other) noexcept : id_(std::exchange(other.id_, -1)) {}
  Id& operator=(Id&& other) noexcept {
    std::swap(id_, other.id_);
    return *this;
  }
  ~Id() {
    if (id_ >= 0) H5Idec_ref(id_);
  }
  hid_t get() const { return id_; }
  // Closes now, so that a failing flush is heard of.
  void Close(const char* doing);

 private:
  hid_t id_ = -1;
};

using Shape = std::vector<hsize_t>;
hsize_t ElementCount(const Shape& shape);

// --- files and groups
// has_virtual: it will hold virtual datasets, which need a newer format.
Id CreateFile(const std::filesystem::path& file, bool has_virtual = false);
Id OpenFile(const std::filesystem::path& file, bool writable);
Id CreateGroup(hid_t parent, const std::string& name);  // with the groups above it
Id OpenGroup(hid_t parent, const std::string& name);
bool Exists(hid_t parent, const std::string& path);
void HardLink(hid_t file, const std::string& existing, const std::string& link);
std::vector<std::string> LinkNames(hid_t group);

// --- types
Id TextType();
Id EnumType(std::span<const std::string_view> names);  // of bytes, 0, 1, 2...
template <typename T>
hid_t NativeType();

// --- attributes; a new one replaces one of the same name
void SetText(hid_t object, const std::string& name, const std::string& value);
void SetTexts(hid_t object, const std::string& name, const std::vector<std::string>& values);
void SetNumber(hid_t object, const std::string& name, double value);
void SetInteger(hid_t object, const std::string& name, std::int64_t value);
bool HasAttribute(hid_t object, const std::string& name);
std::vector<std::string> GetTexts(hid_t object, const std::string& name);
std::string GetText(hid_t object, const std::string& name, const std::string& otherwise = "");
double GetNumber(hid_t object, const std::string& name, double otherwise);

// --- datasets
struct DatasetSpec {
  std::string name;
  std::string units;  // UDUNITS; "1" where there is none
  std::string long_name;
  Shape shape;
  Shape chunk;  // empty: contiguous
};

// Creates a dataset with its units and long_name. Chunked ones are shuffled and deflated (level 1)
// and may grow along their first dimension. fill: null for the library's zero.
Id CreateDataset(hid_t parent, const DatasetSpec& spec, hid_t type, const void* fill = nullptr);

template <typename T>
Id WriteArray(hid_t parent, const DatasetSpec& spec, std::span<const T> values) {
  if (values.size() != ElementCount(spec.shape)) throw Error("wrong size of " + spec.name);
  Id dataset = CreateDataset(parent, spec, NativeType<T>());
  if (!values.empty()) {
    Check(H5Dwrite(dataset.get(), NativeType<T>(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
          "writing an array");
  }
  return dataset;
}
Id WriteTexts(hid_t parent, const DatasetSpec& spec, const std::vector<std::string>& values);

// Makes a dataset an axis named `label`; attaches axes to the dimensions of another, in order.
void MakeScale(const Id& dataset, const std::string& label);
void AttachScales(hid_t file, const Id& dataset, const std::vector<std::string>& scale_paths);
// The path of a scale 0..n-1, made on first use, for dimensions that have no axis of their own.
std::string IndexScale(hid_t file, hsize_t n);

Id OpenDataset(hid_t parent, const std::string& name);
Shape ShapeOf(const Id& dataset);
Shape ChunkOf(const Id& dataset);  // empty: not chunked

inline constexpr hsize_t kMaxElements = hsize_t{1} << 30;

// The whole dataset, converted to T. Throws Error if it is larger than max_elements.
template <typename T>
std::vector<T> ReadArray(hid_t parent, const std::string& name, Shape* shape = nullptr,
                         hsize_t max_elements = kMaxElements) {
  const Id dataset = OpenDataset(parent, name);
  const Shape found = ShapeOf(dataset);
  if (ElementCount(found) > max_elements) throw Error(name + " is too large");
  std::vector<T> values(ElementCount(found));
  if (!values.empty()) {
    Check(H5Dread(dataset.get(), NativeType<T>(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
          ("reading " + name).c_str());
  }
  if (shape != nullptr) *shape = found;
  return values;
}

// Entry `index` along the first dimension, converted to T.
template <typename T>
std::vector<T> ReadSlab(const Id& dataset, hsize_t index, hsize_t max_elements = kMaxElements);

// Entries first to first + count - 1 along the first dimension, converted to T.
template <typename T>
std::vector<T> ReadRows(const Id& dataset, hsize_t first, hsize_t count,
                        hsize_t max_elements = kMaxElements);

// Lets a chunked dataset grow along its first dimension by whole rows. Throws Error.
template <typename T>
void AppendRows(const Id& dataset, std::span<const T> values);

// The same as ReadSlab() of a dataset of one-byte values, enums too. Throws Error if they are not.
std::vector<std::uint8_t> ReadSlabBytes(const Id& dataset, hsize_t index,
                                        hsize_t max_elements = kMaxElements);

std::vector<std::string> ReadTexts(hid_t parent, const std::string& name,
                                   hsize_t max_elements = 1 << 22);

// Opens a file that anybody may have written. Refuses (Error) what could make reading it read other
// files or run code: links other than hard ones, external storage, virtual datasets whose sources
// are not there, lie outside its own folder and those below it (links on the way followed) or would
// themselves be refused, filters that are not part of the library, more than 100 000 objects.
Id OpenForeignFile(const std::filesystem::path& file);

}  // namespace plumbline::internal::hdf5
