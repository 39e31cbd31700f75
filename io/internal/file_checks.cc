#include "io/internal/file_checks.h"

#include <fmt/format.h>
#include <hdf5_hl.h>

#include <algorithm>
#include <cctype>
#include <map>
#include <set>

#include "io/internal/planar_header.h"
#include "io/internal/planar_layout.h"
#include "io/internal/reference_group.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_header.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_records.h"

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

// What both kinds of series hold.
std::vector<Wanted> WantedInBoth(const PointLayout& layout, std::uint32_t content_bits,
                                 std::int64_t version,
                                 std::initializer_list<const char*> frame_columns) {
  std::vector<Wanted> wanted = {
      {"/frames/index", {"frames"}}, {"/grid/pixel", {"rows", "columns", "2"}},
      {"/grid/row", {"rows"}},       {"/grid/col", {"columns"}},
      {"/grid/step_px", {}},         {"/grid/subset_px", {}}};
  for (const char* name : frame_columns) {
    wanted.push_back({std::string("/frames/") + name, {"frames"}});
  }
  for (const PointField& field : layout.fields) {
    const std::string path = field.PathIn(version);
    if (!Holds(content_bits, field.needs) || path.empty()) continue;
    Wanted dataset{path, {"frames", "rows", "columns"}};
    if (field.axis->count() > 1) dataset.dimensions.push_back(std::to_string(field.axis->count()));
    wanted.push_back(dataset);
    if (field.also.empty()) continue;
    dataset.path = field.also;
    wanted.push_back(dataset);
  }
  return wanted;
}

std::vector<Wanted> WantedInPlanarSeries(hid_t file) {
  std::vector<Wanted> wanted =
      WantedInBoth(PlanarPoints(), BitsOf(ContentsOf<PlanarContents>(file)), VersionOf(file),
                   {"time_s", "id", "problem", "dropped_before", "reference_index", "status"});
  wanted.push_back({"/camera/image_size", {"2"}});
  wanted.push_back({"/camera/noise_offset", {}});
  wanted.push_back({"/camera/noise_slope", {}});
  return wanted;
}

std::vector<Wanted> WantedInSeries(hid_t file) {
  const auto contents = ContentsOf<SeriesContents>(file);
  std::vector<Wanted> wanted = WantedInBoth(
      StereoPoints(), BitsOf(contents), VersionOf(file),
      {"time_s", "left_id", "right_id", "problem", "dropped_before", "status", "surface_frame"});
  for (const RecordGroup& group : RecordGroups()) {
    if (!Holds(contents, group.needs)) continue;
    for (const char* name : {"/status", "/problem"}) {
      wanted.push_back({group.path + name, {"frames"}});
    }
    for (const RecordField& field : group.fields) {
      Wanted dataset{group.path + "/" + field.name, {"frames"}};
      for (const Eigen::Index n : field.shape) dataset.dimensions.push_back(std::to_string(n));
      wanted.push_back(dataset);
    }
  }
  if (hdf5::Exists(file, "/reference")) {
    wanted.push_back({kReferenceStatus, {"rows", "columns"}});
    for (const PointField& field : StereoPoints().fields) {
      if (field.group != kMatch) continue;
      wanted.push_back({PathInReference(field), {"rows", "columns"}});
      const std::size_t count = field.axis->count();
      if (count > 1) wanted.back().dimensions.push_back(std::to_string(count));
    }
  }
  if (contents.survey) wanted.push_back({kSurveyTags, {"frames"}});
  if (contents.patch) {
    wanted.push_back({"/patch/contour_first", {"frames"}});
    wanted.push_back({"/patch/contour_count", {"frames"}});
    wanted.push_back({"/patch/contour_frame", {"contour points"}});
    wanted.push_back({"/patch/contour", {"contour points", "2"}});
  }
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

  // A text that has to be one of those that `known` knows.
  void AttributeText(const std::string& path, const char* name, bool (*known)(const std::string&)) {
    Attributes(path, {name});
    if (!hdf5::Exists(file_, path)) return;
    const Id group = hdf5::OpenGroup(file_, path);
    const std::string text = hdf5::GetText(group.get(), name);
    if (hdf5::HasAttribute(group.get(), name) && !known(text)) {
      Add("the attribute {} of {} is \"{}\", which means nothing", name, path, text);
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

std::vector<std::string> ChannelPaths(hid_t file) {
  std::vector<std::string> paths;
  if (!hdf5::Exists(file, "/channels")) return paths;
  try {
    for (const std::string& name : hdf5::LinkNames(hdf5::OpenGroup(file, "/channels").get())) {
      paths.push_back("/channels/" + name);
    }
  } catch (const hdf5::Error&) {
    // CheckSeriesGroups() says that it is no group.
  }
  return paths;
}

void CheckNexusGroups(hid_t file, std::vector<std::string> groups,
                      std::initializer_list<const char*> optional, LayoutCheck* check) {
  for (const std::string& path : groups) check->Group(path);
  for (const char* path : optional) {
    if (hdf5::Exists(file, path)) groups.emplace_back(path);
  }
  for (const std::string& path : ChannelPaths(file)) groups.push_back(path);
  for (const std::string& path : groups) {
    check->Try([&] { check->NexusData(path); });
  }
}

// The groups of a series with their attributes.
void CheckSeriesGroups(hid_t file, LayoutCheck* check) {
  if (hdf5::Exists(file, "/channels")) {
    check->Try([&] { hdf5::OpenGroup(file, "/channels"); });
  }
  CheckNexusGroups(file, {"/frames", "/grid", "/surface", "/ground"},
                   {"/displacement", "/strain", "/wheel", "/patch", "/slip", "/match", "/velocity",
                    "/rigid_motion", "/rig_watch", "/rig_rotation", "/deformation",
                    "/wheel_channel", "/placement", "/survey", "/reference"},
                   check);
  for (const PointGroupFacts& group : StereoPoints().groups) {
    if (!group.in_surface_frame) continue;
    const std::string path(group.path);
    check->Try([&] { check->Attributes(path, {"frame"}); });
    check->Try([&] { check->Attributes(path + "/" + std::string(group.signal), {"frame"}); });
  }
  check->Try([&] { check->Attributes("/rigid_motion", {"frame"}); });
  check->Try([&] { check->Attributes("/strain", {"vsg_px", "vsg_mm"}); });
  check->Try([&] { check->AttributeText("/strain", "measure", IsStrainMeasure); });
  check->Try([&] { check->AttributeText("/strain", "strain_axes", IsStrainAxes); });
  if (VersionOf(file) >= 2) {
    check->Try([&] { check->Attributes("/displacement", {"rigid_motion_removed"}); });
  }
  check->Try([&] { check->Attributes("/slip", {"convention"}); });
  check->Try([&] { check->Attributes("/survey", {"frames"}); });
  check->Try([&] { check->AttributeText("/grid", "points", IsGridPoints); });
  check->Try([&] { check->AttributeText("/displacement", "reference", IsDisplacementReference); });
}

void CheckPlanarGroups(hid_t file, LayoutCheck* check) {
  CheckNexusGroups(file, {"/frames", "/grid", "/displacement"}, {"/strain"}, check);
  check->Group("/camera");
  check->Try([&] { check->Attributes("/camera", {"noise_source", "bits"}); });
  check->Try([&] {
    check->Attributes("/grid", {"points", "order", "interpolation", "prefilter",
                                "prefilter_sigma_px", "subset_shape"});
  });
  check->Try([&] { check->Attributes("/displacement", {"reference_id", "errors_calibration"}); });
  check->Try([&] { check->AttributeText("/displacement", "reference", IsPlanarReference); });
  if (!hdf5::Exists(file, "/strain")) return;
  check->Try([&] {
    check->Attributes("/strain", {"strain_axes", "vsg_px", "window", "errors_calibration"});
  });
  check->Try([&] { check->AttributeText("/strain", "measure", IsStrainMeasure); });
}

void CheckRig(LayoutCheck* check) {
  for (const char* path : {"/rig", "/rig/left", "/rig/right"}) check->Group(path);
  check->Try([&] { check->Attributes("/rig", {"board"}); });
  check->Try([&] { check->Attributes("/rig/left", {"lens_model"}); });
  check->Try([&] { check->Attributes("/rig/right", {"lens_model"}); });
  check->Try([&] { check->Attributes("/rig/modes", {"has_scale_mode"}); });
}

}  // namespace

Findings CheckLayout(hid_t file, bool is_series) {
  LayoutCheck check(file);
  const bool is_planar = is_series && IsPlanar(file);
  check.Try([&] {
    check.Attributes("/", {"format", "format_version", "created", "software", "recipe", "inputs"});
  });
  std::vector<Wanted> wanted;
  if (is_planar) {
    CheckPlanarGroups(file, &check);
    wanted = WantedInPlanarSeries(file);
  } else {
    CheckRig(&check);
    wanted = WantedInRig();
  }
  if (is_series && !is_planar) {
    CheckSeriesGroups(file, &check);
    for (Wanted& dataset : WantedInSeries(file)) wanted.push_back(std::move(dataset));
    for (const std::string& channel : ChannelPaths(file)) {
      wanted.push_back({channel + "/time_s", {"samples of " + channel}});
      wanted.push_back({channel + "/value", {"samples of " + channel}});
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
