#include <fmt/format.h>

#include <array>

#include "io/internal/hdf5.h"

namespace plumbline::internal::hdf5 {
namespace {

constexpr int kMaxObjects = 100'000;
constexpr int kMaxDepth = 32;

void RefuseForeignSource(const Id& create, const std::string& path) {
  std::size_t count = 0;
  Check(H5Pget_virtual_count(create.get(), &count), "virtual dataset");
  for (std::size_t i = 0; i < count; ++i) {
    std::array<char, 4096> name{};
    Check(H5Pget_virtual_filename(create.get(), i, name.data(), name.size()), "virtual dataset");
    const std::filesystem::path source(name.data());
    bool upward = source.is_absolute();
    for (const auto& part : source) upward = upward || part == "..";
    if (upward) throw Error(fmt::format("{} takes its values from the file {}", path, name.data()));
  }
}

void InspectDataset(hid_t parent, const char* name, const std::string& path) {
  const Id dataset = OpenDataset(parent, name);
  const Id create(Check(H5Dget_create_plist(dataset.get()), "dataset layout"));
  if (H5Pget_external_count(create.get()) > 0) {
    throw Error(fmt::format("{} keeps its values in another file", path));
  }
  if (H5Pget_layout(create.get()) == H5D_VIRTUAL) RefuseForeignSource(create, path);
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

struct Walk {
  int objects = 0;
  std::vector<haddr_t> open_groups;  // from the root down to here: a group inside itself is a loop
};

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
      InspectDataset(group, name.c_str(), below);
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
  return id;
}

}  // namespace plumbline::internal::hdf5
