#include "io/inspect.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

#include "calib/error.h"
#include "io/internal/file_checks.h"
#include "io/internal/hdf5.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_parts.h"
#include "io/internal/series_sources.h"
#include "io/planar_series_reader.h"
#include "io/rig_file.h"
#include "io/series_reader.h"
#include "io/wheel_file.h"

namespace plumbline {
namespace {

namespace fs = std::filesystem;

bool IsSeries(const fs::path& file) {
  try {
    const internal::hdf5::Id id = internal::hdf5::OpenForeignFile(file);
    return internal::hdf5::GetText(id.get(), "format") != "plumbline-rig";
  } catch (const internal::hdf5::Error& error) {
    throw InputError(fmt::format("{} cannot be read: {}", file.string(), error.what()));
  }
}

std::int64_t CountOk(const Image<Status>& status) {
  return std::count(status.values().begin(), status.values().end(), Status::kOk);
}

void AddRig(const StereoRig& rig, FileSummary* summary) {
  summary->lens_model = rig.left.model().Name();
  summary->baseline_mm = rig.baseline_mm();
  summary->calibration_modes = rig.modes.count();
}

void AddPlanar(const PlanarSeriesReader& reader, FileSummary* summary) {
  const PlanarSeriesHeader& header = reader.header();
  summary->planar = true;
  summary->created = reader.facts().created;
  summary->software = reader.facts().software;
  summary->goes_on = reader.facts().goes_on;
  summary->frames = reader.frame_count();
  summary->grid_rows = header.grid.height;
  summary->grid_columns = header.grid.width;
  summary->planar_contents = header.contents;
  for (std::int64_t i = 0; i < summary->frames; ++i) {
    const PlanarSeriesFrame frame = reader.Frame(i);
    summary->frames_with_surface += frame.field.status.empty() ? 0 : 1;
    summary->points += CountOk(frame.field.status);
    summary->strain_points += CountOk(frame.strain.status);
  }
}

void Append(std::vector<std::string> more, std::vector<std::string>* findings) {
  std::move(more.begin(), more.end(), std::back_inserter(*findings));
}

// What the file says it is; a finding where this program does not know it.
std::string FormatOf(hid_t file, std::vector<std::string>* findings) {
  const std::string format = internal::hdf5::GetText(file, "format");
  if (format != "plumbline-series" && format != "plumbline-rig") {
    findings->push_back(fmt::format(
        "the file is neither a series nor a rig: its attribute format is \"{}\"", format));
    return "";
  }
  const double version = internal::hdf5::GetNumber(file, "format_version", 1);
  if (!(version >= 1 && version <= static_cast<double>(internal::kFormatVersion))) {
    findings->push_back(
        fmt::format("the file is of the format version {}; this program reads up to {}", version,
                    internal::kFormatVersion));
    return "";
  }
  return format;
}

std::vector<std::string> CheckFile(const fs::path& path) {
  std::vector<std::string> found;
  try {
    const internal::hdf5::Id file = internal::hdf5::OpenForeignFile(path);
    const std::string format = FormatOf(file.get(), &found);
    if (format.empty()) return found;
    const bool is_series = format == "plumbline-series";
    Append(internal::ProblemsOfSources(path, internal::ReadSources(file.get()), true), &found);
    if (!found.empty()) return found;  // of what is not there, HDF5 gives fill values
    std::vector<std::string> layout = internal::CheckLayout(file.get(), is_series);
    // Where something is missing, the readers would only say so again.
    if (layout.empty()) {
      const bool is_planar = is_series && internal::IsPlanar(file.get());
      if (!is_planar) ReadRigFile(path);
      if (is_planar) PlanarSeriesReader{path};
      if (is_series && !is_planar) SeriesReader{path};
    }
    Append(std::move(layout), &found);
    Append(internal::CheckDatasets(file.get()), &found);
    if (is_series) Append(internal::CheckValues(file.get()), &found);
  } catch (const internal::hdf5::Error& error) {
    found.push_back(fmt::format("{} cannot be read: {}", path.string(), error.what()));
  } catch (const InputError& error) {
    found.emplace_back(error.what());
  }
  return found;
}

}  // namespace

std::string FileSummary::Text() const {
  std::string text = fmt::format("format: {}\n", format);
  if (!planar) {
    text += fmt::format("lens model: {}\nbaseline: {:.4f} mm\ncalibration modes: {}\n", lens_model,
                        baseline_mm, calibration_modes);
  }
  if (format != "plumbline-series") return text;
  const std::string found = planar
                                ? fmt::format("{} with a displacement field", frames_with_surface)
                                : fmt::format("{} with a surface, {} with a ground plane",
                                              frames_with_surface, frames_with_ground);
  text += fmt::format("created: {} by {}\nframes: {}, {}\ngrid: {} rows, {} columns\npoints: {}\n",
                      created, software, frames, found, grid_rows, grid_columns, points);
  if (goes_on) text += "the run goes on: more frames will come\n";
  if (planar && planar_contents.strain)
    text += fmt::format("points with strain: {}\n", strain_points);
  std::vector<std::string> also = planar ? Names(planar_contents) : Names(contents);
  if (!channels.empty()) also.push_back(fmt::format("channels ({})", fmt::join(channels, ", ")));
  if (!also.empty()) text += fmt::format("also holds: {}\n", fmt::join(also, ", "));
  return text;
}

FileSummary Inspect(const fs::path& file) {
  FileSummary summary;
  if (!IsSeries(file)) {
    summary.format = "plumbline-rig";
    AddRig(ReadRigFile(file), &summary);
    return summary;
  }
  summary.format = "plumbline-series";
  if (IsPlanarSeries(file)) {
    AddPlanar(PlanarSeriesReader(file), &summary);
    return summary;
  }
  const SeriesReader reader(file);
  AddRig(reader.rig(), &summary);
  summary.created = reader.facts().created;
  summary.software = reader.facts().software;
  summary.goes_on = reader.facts().goes_on;
  summary.frames = reader.frame_count();
  summary.grid_rows = reader.grid_px().height();
  summary.grid_columns = reader.grid_px().width();
  summary.contents = reader.contents();
  for (const Channel& channel : reader.channels()) summary.channels.push_back(channel.name);
  for (std::int64_t i = 0; i < summary.frames; ++i) {
    const SeriesFrame frame = reader.Frame(i);
    summary.frames_with_surface += frame.surface.status.empty() ? 0 : 1;
    summary.frames_with_ground += frame.ground.found ? 1 : 0;
    summary.points += CountOk(frame.surface.status);
  }
  return summary;
}

std::vector<std::string> Validate(const fs::path& file) {
  std::vector<std::string> findings;
  if (IsWheelFile(file)) {
    try {
      (void)ReadWheelFile(file);
    } catch (const InputError& error) {
      findings.emplace_back(error.what());
    }
    return findings;
  }
  const fs::path parts = internal::PartsFolder(file);
  std::error_code ignored;
  if (fs::exists(parts, ignored) && !internal::HoldsARun(file)) {
    findings.push_back(fmt::format("{} is left over from a run; delete it", parts.string()));
  } else if (fs::exists(parts, ignored)) {
    findings.push_back(
        fmt::format("{} holds the frames of a run that was not finished; recover them (plumbline "
                    "recover {}) or delete that folder",
                    parts.string(), file.string()));
  }
  Append(CheckFile(file), &findings);
  return findings;
}

}  // namespace plumbline
