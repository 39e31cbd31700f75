#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <set>

#include "io/internal/hdf5.h"

namespace plumbline::internal::hdf5 {
namespace {

constexpr int kMaxObjects = 100'000;
constexpr int kMaxDepth = 32;

struct Walk {
  int objects = 0;
  std::vector<haddr_t> open_groups;  // from the root down to here: a group inside itself is a loop
  bool is_source = false;            // of a virtual dataset: then it may not have sources itself
  std::set<std::string> sources;
};

void TakeSources(const Id& create, const std::string& path, Walk* walk) {
  if (walk->is_source) throw Error(fmt::format("{} is virtual in a file that is a source", path));
  std::size_t count = 0;
  Check(H5Pget_virtual_count(create.get(), &count), "virtual dataset");
  for (std::size_t i = 0; i < count; ++i) {
    std::array<char, 4096> name{};
    const ssize_t length = H5Pget_virtual_filename(create.get(), i, name.data(), name.size());
    Check(length, "virtual dataset");
    if (length >= static_cast<ssize_t>(name.size())) throw Error("a source has too long a name");
    const std::filesystem::path source(name.data());
    bool upward = source.is_absolute();
    for (const auto& part : source) upward = upward || part == "..";
    if (upward) throw Error(fmt::format("{} takes its values from the file {}", path, name.data()));
    walk->sources.insert(name.data());
  }
}

// Throws Error unless the source is a file in the folder or below it, links followed.
void CheckPlace(const std::filesystem::path& folder, const std::string& source) {
  std::error_code failed;
  const auto home = std::filesystem::canonical(folder, failed);
  const auto place = failed ? home : std::filesystem::canonical(folder / source, failed);
  if (failed || !std::filesystem::is_regular_file(place)) {
    throw Error(fmt::format("its source {} is missing", (folder / source).string()));
  }
  const auto [end, ignored] = std::mismatch(home.begin(), home.end(), place.begin(), place.end());
  if (end != home.end()) throw Error(fmt::format("its source {} lies elsewhere", source));
}

void InspectDataset(hid_t parent, const char* name, const std::string& path, Walk* walk) {
  const Id dataset = OpenDataset(parent, name);
  const Id create(Check(H5Dget_create_plist(dataset.get()), "dataset layout"));
  if (H5Pget_external_count(create.get()) > 0) {
    throw Error(fmt::format("{} keeps its values in another file", path));
  }
  if (H5Pget_layout(create.get()) == H5D_VIRTUAL) TakeSources(create, path, walk);
  const int filters = H5Pget_nfilters(create.get());
  for (int i = 0; i < filters; ++i) {
    unsigned flags = 0;
    std::size_t elements = 0;
    const H5Z_filter_t id = H5Pget_filter2(create.get(), static_cast<unsigned>(i), &flags,
                                           &elements, nullptr, 0, nullptr, nullptr);
    if (id != H5Z_FILTER_DEFLATE && id != H5Z_FILTER_SHUFFLE && id != H5Z_FILTER_FLETCHER32) {
      throw Error(fmt::format("{} is packed by a filter (number {}) that is not read", path, id));
    }
  }
}

void InspectGroup(hid_t group, const std::string& path, Walk& walk) {
  H5O_info_t info;
  Check(H5Oget_info2(group, &info, H5O_INFO_BASIC), "inspecting a group");
  for (const haddr_t above : walk.open_groups) {
    if (above == info.addr) throw Error(fmt::format("{} contains itself", path));
  }
  if (walk.open_groups.size() > kMaxDepth) throw Error("its groups are nested too deeply");
  walk.open_groups.push_back(info.addr);
  for (const std::string& name : LinkNames(group)) {
    const std::string below = path + "/" + name;
    if (++walk.objects > kMaxObjects) throw Error("it holds too many objects");
    H5L_info_t link;
    Check(H5Lget_info(group, name.c_str(), &link, H5P_DEFAULT), "inspecting a link");
    if (link.type != H5L_TYPE_HARD) {
      throw Error(fmt::format("{} is a link to elsewhere", below));
    }
    H5O_info_t object;
    Check(H5Oget_info_by_name2(group, name.c_str(), &object, H5O_INFO_BASIC, H5P_DEFAULT),
          "inspecting an object");
    if (object.type == H5O_TYPE_GROUP) {
      InspectGroup(OpenGroup(group, name).get(), below, walk);
    } else if (object.type == H5O_TYPE_DATASET) {
      InspectDataset(group, name.c_str(), below, &walk);
    }
  }
  walk.open_groups.pop_back();
}

}  // namespace

Id OpenForeignFile(const std::filesystem::path& file) {
  Id id = OpenFile(file, false);
  Walk walk;
  const Id root = OpenGroup(id.get(), "/");
  InspectGroup(root.get(), "", walk);
  std::filesystem::path folder = file.parent_path();
  if (folder.empty()) folder = ".";
  for (const std::string& name : walk.sources) {
    CheckPlace(folder, name);
    const Id source = OpenFile(folder / name, false);
    Walk below;
    below.is_source = true;
    InspectGroup(OpenGroup(source.get(), "/").get(), name + ":", below);
  }
  return id;
}

}  // namespace plumbline::internal::hdf5
