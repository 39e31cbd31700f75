#include "io/internal/hdf5_tree.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <set>

namespace plumbline::internal::hdf5 {
namespace {

void AddBelow(hid_t group, const std::string& path, std::vector<Object>* objects) {
  for (const std::string& name : LinkNames(group)) {
    H5O_info_t info;
    Check(H5Oget_info_by_name2(group, name.c_str(), &info, H5O_INFO_BASIC, H5P_DEFAULT),
          "inspecting an object");
    const std::string below = (path == "/" ? "" : path) + "/" + name;
    objects->push_back({below, info.type == H5O_TYPE_DATASET, info.addr});
    if (info.type == H5O_TYPE_GROUP) AddBelow(OpenGroup(group, name).get(), below, objects);
  }
}

Id Open(hid_t file, const std::string& path) {
  return Id(Check(H5Oopen(file, path.c_str(), H5P_DEFAULT), ("opening " + path).c_str()));
}

bool IsText(const Id& type) { return H5Tis_variable_str(type.get()) > 0; }

// read(type, buffer) of either a dataset or an attribute.
template <typename Read>
Values Take(Id type, const Id& space, const Read& read) {
  const H5T_class_t kind = H5Tget_class(type.get());
  if (kind != H5T_INTEGER && kind != H5T_FLOAT && kind != H5T_ENUM && kind != H5T_STRING) {
    throw Error("a value is neither number nor text");
  }
  const int rank = H5Sget_simple_extent_ndims(space.get());
  Values values{std::move(type), Shape(static_cast<std::size_t>(std::max(rank, 0))), {}, {}};
  if (rank > 0) {
    Check(H5Sget_simple_extent_dims(space.get(), values.shape.data(), nullptr), "reading a size");
  }
  const hsize_t count = ElementCount(values.shape);
  if (count > kMaxElements) throw Error("a dataset is too large");
  if (count == 0) return values;
  if (IsText(values.type)) {
    std::vector<char*> raw(count);
    Check(read(values.type.get(), raw.data()), "reading texts");
    for (const char* text : raw) values.texts.emplace_back(text != nullptr ? text : "");
    H5Dvlen_reclaim(values.type.get(), space.get(), H5P_DEFAULT, raw.data());
  } else {
    values.bytes.resize(count * H5Tget_size(values.type.get()));
    Check(read(values.type.get(), values.bytes.data()), "reading values");
  }
  return values;
}

// write(type, buffer) into either.
template <typename Write>
void Put(const Values& values, const Write& write) {
  if (ElementCount(values.shape) == 0) return;
  if (!IsText(values.type)) {
    Check(write(values.type.get(), values.bytes.data()), "writing values");
    return;
  }
  std::vector<const char*> pointers;
  for (const std::string& text : values.texts) pointers.push_back(text.c_str());
  Check(write(values.type.get(), pointers.data()), "writing texts");
}

}  // namespace

std::vector<Object> ObjectsOf(hid_t file) {
  H5O_info_t info;
  Check(H5Oget_info2(file, &info, H5O_INFO_BASIC), "inspecting the file");
  std::vector<Object> objects = {{"/", false, info.addr}};
  AddBelow(OpenGroup(file, "/").get(), "/", &objects);
  return objects;
}

std::vector<std::string> AttributeNames(hid_t object) {
  std::vector<std::string> names;
  const auto add = [](hid_t, const char* name, const H5A_info_t*, void* user) -> herr_t {
    static_cast<std::vector<std::string>*>(user)->emplace_back(name);
    return 0;
  };
  Check(H5Aiterate2(object, H5_INDEX_NAME, H5_ITER_INC, nullptr, add, &names),
        "listing attributes");
  return names;
}

bool operator==(const Values& a, const Values& b) {
  return H5Tequal(a.type.get(), b.type.get()) > 0 && a.shape == b.shape && a.bytes == b.bytes &&
         a.texts == b.texts;
}

Values ValuesOf(const Id& dataset) {
  const Id space(Check(H5Dget_space(dataset.get()), "dataset size"));
  return Take(Id(Check(H5Dget_type(dataset.get()), "dataset type")), space,
              [&](hid_t type, void* to) {
                return H5Dread(dataset.get(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, to);
              });
}

Values AttributeOf(hid_t object, const std::string& name) {
  const Id attribute(Check(H5Aopen(object, name.c_str(), H5P_DEFAULT), "opening an attribute"));
  const Id space(Check(H5Aget_space(attribute.get()), "attribute size"));
  return Take(Id(Check(H5Aget_type(attribute.get()), "attribute type")), space,
              [&](hid_t type, void* to) { return H5Aread(attribute.get(), type, to); });
}

void Write(const Id& dataset, const Values& values) {
  Put(values, [&](hid_t type, const void* from) {
    return H5Dwrite(dataset.get(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, from);
  });
}

void WriteAttribute(hid_t object, const std::string& name, const Values& values) {
  const Id space(Check(
      values.shape.empty()
          ? H5Screate(H5S_SCALAR)
          : H5Screate_simple(static_cast<int>(values.shape.size()), values.shape.data(), nullptr),
      "attribute size"));
  if (HasAttribute(object, name)) Check(H5Adelete(object, name.c_str()), "replacing an attribute");
  const Id attribute(Check(
      H5Acreate2(object, name.c_str(), values.type.get(), space.get(), H5P_DEFAULT, H5P_DEFAULT),
      "creating an attribute"));
  Put(values, [&](hid_t type, const void* from) { return H5Awrite(attribute.get(), type, from); });
}

bool IsOfAxes(const std::string& attribute) {
  return attribute == "DIMENSION_LIST" || attribute == "REFERENCE_LIST";
}

std::optional<std::string> FirstDifference(
    hid_t a, hid_t b,
    const std::function<bool(const std::string& path, const std::string& attribute)>& compared) {
  std::map<std::string, bool> found[2];  // whether it is a dataset
  const hid_t files[2] = {a, b};
  for (int k = 0; k < 2; ++k) {
    std::string passed_over = "\n";
    for (const Object& object : ObjectsOf(files[k])) {
      if (object.path.rfind(passed_over + "/", 0) == 0) continue;
      if (compared(object.path, "")) {
        found[k].emplace(object.path, object.is_dataset);
      } else {
        passed_over = object.path;
      }
    }
  }
  for (const auto& [path, is_dataset] : found[1]) {
    if (found[0].count(path) == 0) return path;
  }
  for (const auto& [path, is_dataset] : found[0]) {
    const auto other = found[1].find(path);
    if (other == found[1].end() || other->second != is_dataset) return path;
    const Id x = Open(a, path), y = Open(b, path);
    std::set<std::string> names;
    for (const hid_t object : {x.get(), y.get()}) {
      for (std::string& name : AttributeNames(object)) {
        if (!IsOfAxes(name) && compared(path, name)) names.insert(std::move(name));
      }
    }
    for (const std::string& name : names) {
      if (HasAttribute(x.get(), name) && HasAttribute(y.get(), name) &&
          AttributeOf(x.get(), name) == AttributeOf(y.get(), name)) {
        continue;
      }
      return path == "/" ? fmt::format("the attribute {}", name)
                         : fmt::format("the attribute {} of {}", name, path);
    }
    if (is_dataset && !(ValuesOf(x) == ValuesOf(y))) return path;
  }
  return std::nullopt;
}

}  // namespace plumbline::internal::hdf5
