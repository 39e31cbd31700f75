#include "io/internal/series_header.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>
#include <stdexcept>

#include "calib/error.h"
#include "io/internal/hdf5.h"
#include "io/internal/reference_group.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_datasets.h"
#include "track/strain_measure.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;

// What is the same for all frames of a group; packing fills the groups.
void WriteGroupAttributes(hid_t file, const SeriesHeader& header) {
  if (header.contents.displacement) {
    const Id group = hdf5::CreateGroup(file, "/displacement");
    hdf5::SetText(group.get(), "reference", header.displacement_reference);
    hdf5::SetInteger(group.get(), "rigid_motion_removed", header.rigid_motion_removed ? 1 : 0);
  }
  if (header.contents.strain) {
    const Id group = hdf5::CreateGroup(file, "/strain");
    hdf5::SetText(group.get(), "measure", header.strain_measure);
    hdf5::SetText(group.get(), "strain_axes", header.strain_axes);
    hdf5::SetInteger(group.get(), "vsg_px", header.vsg_px);
    hdf5::SetNumber(group.get(), "vsg_mm", header.vsg_mm);
  }
  if (header.contents.slip) {
    const Id group = hdf5::CreateGroup(file, "/slip");
    hdf5::SetText(group.get(), "convention", header.slip_convention);
  }
  if (header.contents.survey) {
    const Id group = hdf5::CreateGroup(file, "/survey");
    hdf5::SetInteger(group.get(), "frames", header.surveyed_frames);
  }
  if (header.right_delay) {
    const Id group = hdf5::CreateGroup(file, "/wheel");
    hdf5::SetNumber(group.get(), "right_delay_s", header.right_delay->value_s);
    hdf5::SetNumber(group.get(), "sigma_right_delay_s", header.right_delay->sigma_s);
    if (header.estimated_right_delay) {
      hdf5::SetNumber(group.get(), "estimated_right_delay_s",
                      header.estimated_right_delay->value_s);
      hdf5::SetNumber(group.get(), "sigma_estimated_right_delay_s",
                      header.estimated_right_delay->sigma_s);
    }
  }
}

void WriteChannel(hid_t file, const Channel& channel) {
  const std::string path = "/channels/" + channel.name;
  const Id group = hdf5::CreateGroup(file, path);
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "value");
  hdf5::SetTexts(group.get(), "axes", {"time_s"});
  hdf5::SetNumber(group.get(), "clock_offset_s", channel.clock_offset_s);
  hdf5::SetNumber(group.get(), "sigma_clock_offset_s", channel.sigma_clock_offset_s);
  const hsize_t n = channel.value.size();
  hdf5::MakeScale(hdf5::WriteArray<double>(
                      file, {path + "/time_s", "s", "time, on the clock of the channel", {n}, {}},
                      channel.time_s),
                  "time_s");
  hdf5::AttachScales(
      file,
      hdf5::WriteArray<double>(file,
                               {path + "/value",
                                channel.units.empty() ? "1" : channel.units,
                                channel.long_name.empty() ? channel.name : channel.long_name,
                                {n},
                                {}},
                               channel.value),
      {path + "/time_s"});
}

void WriteChannels(hid_t file, const std::vector<Channel>& channels) {
  if (channels.empty()) return;
  const Id group = hdf5::CreateGroup(file, "/channels");
  hdf5::SetText(group.get(), "NX_class", "NXcollection");
  for (const Channel& channel : channels) WriteChannel(file, channel);
}

// Why the channel cannot be stored; empty: it can.
std::string ProblemOf(const Channel& channel) {
  const std::string& name = channel.name;
  if (name.empty() || name == "." || name == ".." || name.find('/') != std::string::npos ||
      name.find('\0') != std::string::npos) {
    return "its name cannot be that of a group: rename it without a slash";
  }
  if (channel.time_s.size() != channel.value.size()) {
    return fmt::format("it has {} times and {} values", channel.time_s.size(),
                       channel.value.size());
  }
  const std::size_t wrong = FirstWrongTime(channel.time_s);
  if (wrong == channel.time_s.size()) return "";
  return fmt::format("its time {} ({} s) is no number or goes back", wrong, channel.time_s[wrong]);
}

}  // namespace

std::size_t FirstWrongTime(const std::vector<double>& time_s) {
  for (std::size_t i = 0; i < time_s.size(); ++i) {
    if (!std::isfinite(time_s[i]) || (i > 0 && time_s[i] < time_s[i - 1])) return i;
  }
  return time_s.size();
}

bool IsGridPoints(const std::string& text) { return text == "image" || text == "material"; }

bool IsDisplacementReference(const std::string& text) {
  const std::string frame = "frame ";
  if (text == "previous" || text == "wheel") return true;
  return text.rfind(frame, 0) == 0 && text.size() > frame.size() &&
         text.find_first_not_of("0123456789", frame.size()) == std::string::npos;
}

bool IsStrainMeasure(const std::string& text) {
  return std::find(kStrainMeasureNames.begin(), kStrainMeasureNames.end(), text) !=
         kStrainMeasureNames.end();
}

bool IsStrainAxes(const std::string& text) {
  if (text == "material" || text == "ground") return true;
  Eigen::Vector3d axis;
  int used = 0;
  return std::sscanf(text.c_str(), "%lf,%lf,%lf%n", &axis[0], &axis[1], &axis[2], &used) == 3 &&
         static_cast<std::size_t>(used) == text.size() && axis.allFinite() && axis.norm() > 0;
}

void CheckShard(const std::optional<SeriesShard>& shard) {
  if (!shard ||
      *shard == ShardOf(shard->index, shard->count, shard->frame_count, shard->block_frames))
    return;
  throw std::invalid_argument("the header's shard is not one of ShardOf()");
}

void CheckSeriesHeader(const SeriesHeader& header) {
  if (!IsGridPoints(header.grid_points)) {
    throw std::invalid_argument("SeriesHeader::grid_points is neither image nor material: " +
                                header.grid_points);
  }
  if (!IsDisplacementReference(header.displacement_reference)) {
    throw std::invalid_argument(
        "SeriesHeader::displacement_reference is none of frame N, previous, wheel: " +
        header.displacement_reference);
  }
  if (!IsStrainMeasure(header.strain_measure)) {
    throw std::invalid_argument("SeriesHeader::strain_measure is none of those known: " +
                                header.strain_measure);
  }
  if (!IsStrainAxes(header.strain_axes)) {
    throw std::invalid_argument(
        "SeriesHeader::strain_axes is none of material, ground and a direction x,y,z: " +
        header.strain_axes);
  }
  CheckShard(header.shard);
  std::set<std::string> names;
  for (const Channel& channel : header.channels) {
    std::string problem = ProblemOf(channel);
    if (!names.insert(channel.name).second) problem = "another one has that name";
    if (problem.empty()) continue;
    throw InputError(fmt::format("the channel '{}' cannot be stored: {}", channel.name, problem));
  }
}

void WriteSeriesHeader(const std::filesystem::path& path, const SeriesHeader& header) {
  Id file = hdf5::CreateFile(path);
  WriteRootAttributes(file.get(), "plumbline-series", header.recipe_toml, "", kFormatVersion);
  WriteShardAttributes(file.get(), header.shard);
  hdf5::SetText(file.get(), "default", "surface");
  WriteRigGroup(file.get(), header.rig, header.rig_extras);
  const Id grid = WriteGrid(
      file.get(), {header.grid_px, header.step_px, header.subset_px},
      "where the points sit in the left image; (0, 0) is the centre of the top-left pixel");
  hdf5::SetText(grid.get(), "points", header.grid_points);
  WriteGroupAttributes(file.get(), header);
  if (header.reference) WriteReferenceGroup(file.get(), *header.reference, header.grid_px.size());
  WriteChannels(file.get(), header.channels);
  file.Close("closing the file");
}

}  // namespace plumbline::internal
