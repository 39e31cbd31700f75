#include "io/internal/file_checks.h"

#include <fmt/format.h>
#include <hdf5_hl.h>

#include <algorithm>
#include <cctype>
#include <map>
#include <set>

#include "io/internal/series_layout.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;
using hdf5::Shape;
using Findings = std::vector<std::string>;

// A dimension is a number, or a name for what other datasets have to have as many of.
struct Wanted {
  std::string path;
  std::vector<std::string> dimensions;
};

std::vector<Wanted> WantedInRig() {
  std::vector<Wanted> wanted;
  for (const std::string side : {"left", "right"}) {
    const std::string path = "/rig/" + side;
    wanted.push_back({path + "/cameramodel", {}});
    wanted.push_back({path + "/image_size", {"2"}});
    wanted.push_back({path + "/intrinsics", {side + " intrinsics"}});
    wanted.push_back({path + "/parameter", {side + " intrinsics"}});
  }
  wanted.push_back({"/rig/right_from_left", {"4", "4"}});
  wanted.push_back({"/rig/parameters", {"parameters"}});
  wanted.push_back({"/rig/parameter", {"parameters"}});
  wanted.push_back({"/rig/mode", {"modes"}});
  wanted.push_back({"/rig/modes", {"modes", "parameters"}});
  return wanted;
}

std::vector<Wanted> WantedInSeries(bool has_covariance) {
  std::vector<Wanted> wanted = {
      {"/frames/index", {"frames"}}, {"/grid/pixel", {"rows", "columns", "2"}},
      {"/grid/row", {"rows"}},       {"/grid/col", {"columns"}},
      {"/grid/step_px", {}},         {"/grid/subset_px", {}}};
  for (const char* name :
       {"time_s", "left_id", "right_id", "problem", "dropped_before", "status", "surface_frame"}) {
    wanted.push_back({std::string("/frames/") + name, {"frames"}});
  }
  for (const PointField& field : kPointFields) {
    if (field.name == "covariance" && !has_covariance) continue;
    Wanted dataset{"/surface/" + std::string(field.name), {"frames", "rows", "columns"}};
    if (field.components > 1) dataset.dimensions.push_back(std::to_string(field.components));
    wanted.push_back(dataset);
  }
  for (const char* name : {"offset", "offset_errors_random", "offset_errors_calibration", "rms",
                           "inlier_fraction", "status", "problem"}) {
    wanted.push_back({std::string("/ground/") + name, {"frames"}});
  }
  for (const char* name : {"normal", "e1", "e2", "centroid", "angles_rad",
                           "angles_rad_errors_random", "angles_rad_errors_calibration"}) {
    wanted.push_back({std::string("/ground/") + name, {"frames", "3"}});
  }
  for (const char* name : {"covariance_random", "covariance_calibration"}) {
    wanted.push_back({std::string("/ground/") + name, {"frames", "3", "3"}});
  }
  wanted.push_back({"/ground/ground_from_rig", {"frames", "4", "4"}});
  return wanted;
}

std::string Times(const Shape& shape) {
  return shape.empty() ? "one value" : fmt::format("{}", fmt::join(shape, " x "));
}

class LayoutCheck {
 public:
  explicit LayoutCheck(hid_t file) : file_(file) {}

  bool Group(const std::string& path) {
    return hdf5::Exists(file_, path) || Add("there is no group {}", path);
  }

  void Attributes(const std::string& path, std::initializer_list<const char*> names) {
    if (path != "/" && !hdf5::Exists(file_, path)) return;
    const Id object(hdf5::Check(H5Oopen(file_, path.c_str(), H5P_DEFAULT), "opening an object"));
    for (const char* name : names) {
      if (hdf5::HasAttribute(object.get(), name)) continue;
      Add("{} has no attribute {}", path == "/" ? "the file" : path, name);
    }
  }

  void Dataset(const Wanted& wanted) {
    // Its missing group has been named.
    const std::string group = wanted.path.substr(0, wanted.path.rfind('/'));
    if (!hdf5::Exists(file_, group)) return;
    if (!hdf5::Exists(file_, wanted.path)) {
      Add("there is no dataset {}", wanted.path);
      return;
    }
    const Shape found = hdf5::ShapeOf(hdf5::OpenDataset(file_, wanted.path));
    std::vector<std::string> expected;
    bool fits = found.size() == wanted.dimensions.size();
    for (std::size_t d = 0; d < wanted.dimensions.size(); ++d) {
      const std::string& dimension = wanted.dimensions[d];
      const bool is_number = std::isdigit(static_cast<unsigned char>(dimension[0])) != 0;
      // The first dataset of a dimension says how long it is.
      if (!is_number && fits) sizes_.emplace(dimension, found[d]);
      const auto known = sizes_.find(dimension);
      if (is_number) {
        expected.push_back(dimension);
      } else {
        expected.push_back(known == sizes_.end() ? dimension
                                                 : fmt::format("{} {}", known->second, dimension));
      }
      const hsize_t size = is_number               ? std::stoull(dimension)
                           : known == sizes_.end() ? 0
                                                   : known->second;
      fits = fits && found[d] == size;
    }
    if (!fits) {
      Add("{} holds {}, which should be {}", wanted.path, Times(found),
          expected.empty() ? "one value" : fmt::format("{}", fmt::join(expected, " x ")));
    }
  }

  // What a reader of NeXus files goes by: the names of the values and of their axes.
  void NexusData(const std::string& path) {
    if (!hdf5::Exists(file_, path)) return;
    Attributes(path, {"NX_class", "signal", "axes"});
    const Id group = hdf5::OpenGroup(file_, path);
    if (!hdf5::HasAttribute(group.get(), "axes") || !hdf5::HasAttribute(group.get(), "signal")) {
      return;
    }
    std::vector<std::string> names = hdf5::GetTexts(group.get(), "axes");
    names.push_back(hdf5::GetText(group.get(), "signal"));
    for (const std::string& name : names) {
      if (!hdf5::Exists(group.get(), name)) {
        Add("{} names the dataset {} in its signal or axes, which is not there", path, name);
      }
    }
  }

  template <typename... Args>
  bool Add(fmt::format_string<Args...> format, Args&&... args) {
    findings_.push_back(fmt::format(format, std::forward<Args>(args)...));
    return false;
  }

  // Runs one check; what the library cannot read is a finding.
  template <typename Run>
  void Try(const Run& run) {
    try {
      run();
    } catch (const hdf5::Error& error) {
      findings_.emplace_back(error.what());
    }
  }

  Findings findings() { return std::move(findings_); }

 private:
  hid_t file_;
  std::map<std::string, hsize_t> sizes_;
  Findings findings_;
};

herr_t KeepLength(hid_t, unsigned, hid_t scale, void* user) {
  const hid_t space = H5Dget_space(scale);
  if (space < 0) return -1;
  static_cast<std::vector<hssize_t>*>(user)->push_back(H5Sget_simple_extent_npoints(space));
  H5Sclose(space);
  return 0;
}

void CheckAxes(const Id& dataset, const std::string& path, Findings* findings) {
  if (H5DSis_scale(dataset.get()) > 0) return;
  const Shape shape = hdf5::ShapeOf(dataset);
  for (std::size_t d = 0; d < shape.size(); ++d) {
    std::vector<hssize_t> lengths;
    hdf5::Check(
        H5DSiterate_scales(dataset.get(), static_cast<unsigned>(d), nullptr, KeepLength, &lengths),
        ("reading the axes of " + path).c_str());
    if (lengths.empty()) {
      findings->push_back(fmt::format("dimension {} of {} has no axis attached", d, path));
    }
    for (const hssize_t length : lengths) {
      if (length == static_cast<hssize_t>(shape[d])) continue;
      findings->push_back(fmt::format("dimension {} of {} has {} entries and an axis of {}", d,
                                      path, shape[d], length));
    }
  }
}

void CheckDataset(hid_t group, const std::string& name, const std::string& path,
                  Findings* findings) {
  try {
    const Id dataset = hdf5::OpenDataset(group, name);
    for (const char* attribute : {"units", "long_name"}) {
      if (hdf5::GetText(dataset.get(), attribute).empty()) {
        findings->push_back(fmt::format("{} has no {}", path, attribute));
      }
    }
    CheckAxes(dataset, path, findings);
  } catch (const hdf5::Error& error) {
    findings->push_back(fmt::format("{} cannot be read: {}", path, error.what()));
  }
}

// `seen`: addresses of what was checked, since axes are linked into several groups.
void CheckDatasetsBelow(hid_t group, const std::string& path, std::set<haddr_t>* seen,
                        Findings* findings) {
  for (const std::string& name : hdf5::LinkNames(group)) {
    H5O_info_t object;
    hdf5::Check(H5Oget_info_by_name2(group, name.c_str(), &object, H5O_INFO_BASIC, H5P_DEFAULT),
                "inspecting an object");
    if (!seen->insert(object.addr).second) continue;
    const std::string below = path + "/" + name;
    if (object.type == H5O_TYPE_GROUP) {
      CheckDatasetsBelow(hdf5::OpenGroup(group, name).get(), below, seen, findings);
    } else if (object.type == H5O_TYPE_DATASET) {
      CheckDataset(group, name, below, findings);
    }
  }
}

}  // namespace

Findings CheckLayout(hid_t file, bool is_series) {
  LayoutCheck check(file);
  check.Try([&] {
    check.Attributes("/", {"format", "format_version", "created", "software", "recipe", "inputs"});
  });
  for (const char* path : {"/rig", "/rig/left", "/rig/right"}) check.Group(path);
  check.Try([&] { check.Attributes("/rig", {"board"}); });
  check.Try([&] { check.Attributes("/rig/left", {"lens_model"}); });
  check.Try([&] { check.Attributes("/rig/right", {"lens_model"}); });
  check.Try([&] { check.Attributes("/rig/modes", {"has_scale_mode"}); });
  std::vector<Wanted> wanted = WantedInRig();
  if (is_series) {
    for (const char* path : {"/frames", "/grid", "/surface", "/ground"}) {
      check.Group(path);
      check.Try([&] { check.NexusData(path); });
    }
    check.Try([&] { check.Attributes("/surface", {"frame"}); });
    check.Try([&] { check.Attributes("/surface/position", {"frame"}); });
    for (Wanted& dataset : WantedInSeries(hdf5::Exists(file, "/surface/covariance"))) {
      wanted.push_back(std::move(dataset));
    }
  }
  for (const Wanted& dataset : wanted) {
    check.Try([&] { check.Dataset(dataset); });
  }
  return check.findings();
}

Findings CheckDatasets(hid_t file) {
  Findings findings;
  std::set<haddr_t> seen;
  try {
    CheckDatasetsBelow(hdf5::OpenGroup(file, "/").get(), "", &seen, &findings);
  } catch (const hdf5::Error& error) {
    findings.emplace_back(error.what());
  }
  return findings;
}

}  // namespace plumbline::internal
