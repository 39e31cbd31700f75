#include "io/inspect.h"

#include <fmt/format.h>

#include <algorithm>

#include "calib/error.h"
#include "io/internal/hdf5.h"
#include "io/rig_file.h"
#include "io/series_reader.h"

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

std::int64_t CountOk(const Surface& surface) {
  const auto& status = surface.status.values();
  return std::count(status.begin(), status.end(), Status::kOk);
}

void AddRig(const StereoRig& rig, FileSummary* summary) {
  summary->lens_model = rig.left.model().Name();
  summary->baseline_mm = rig.baseline_mm();
  summary->calibration_modes = rig.modes.count();
}

void CheckSurface(const Surface& surface, std::int64_t frame, std::vector<std::string>* findings) {
  std::int64_t missing = 0, surplus = 0, without_sigma = 0;
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    const bool ok = surface.status.data()[i] == Status::kOk;
    const auto& position = surface.position_mm.data()[i];
    if (ok && !position.allFinite()) ++missing;
    if (!ok && !position.array().isNaN().all()) ++surplus;
    if (ok && !surface.sigma_random_mm.data()[i].allFinite()) ++without_sigma;
  }
  const auto add = [&](std::int64_t count, const char* what) {
    if (count > 0) findings->push_back(fmt::format("frame {}: {} points {}", frame, count, what));
  };
  add(missing, "have the status ok and no position");
  add(surplus, "have a position that their status denies");
  add(without_sigma, "have the status ok and no random sigma");
}

}  // namespace

std::string FileSummary::Text() const {
  std::string text = fmt::format(
      "format: {}\nlens model: {}\nbaseline: {:.4f} mm\n"
      "calibration modes: {}\n",
      format, lens_model, baseline_mm, calibration_modes);
  if (format != "plumbline-series") return text;
  return text + fmt::format(
                    "created: {} by {}\nframes: {}, {} with a surface, {} with a ground "
                    "plane\ngrid: {} rows, {} columns\npoints: {}\n",
                    created, software, frames, frames_with_surface, frames_with_ground, grid_rows,
                    grid_columns, points);
}

FileSummary Inspect(const fs::path& file) {
  FileSummary summary;
  if (!IsSeries(file)) {
    summary.format = "plumbline-rig";
    AddRig(ReadRigFile(file), &summary);
    return summary;
  }
  const SeriesReader reader(file);
  summary.format = "plumbline-series";
  AddRig(reader.rig(), &summary);
  summary.created = reader.facts().created;
  summary.software = reader.facts().software;
  summary.frames = reader.frame_count();
  summary.grid_rows = reader.grid_px().height();
  summary.grid_columns = reader.grid_px().width();
  for (std::int64_t i = 0; i < summary.frames; ++i) {
    const SeriesFrame frame = reader.Frame(i);
    summary.frames_with_surface += frame.surface.status.empty() ? 0 : 1;
    summary.frames_with_ground += frame.ground.found ? 1 : 0;
    summary.points += CountOk(frame.surface);
  }
  return summary;
}

std::vector<std::string> Validate(const fs::path& file) {
  std::vector<std::string> findings;
  try {
    if (!IsSeries(file)) {
      ReadRigFile(file);
      return findings;
    }
    const SeriesReader reader(file);
    reader.rig();
    for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
      CheckSurface(reader.Frame(i).surface, i, &findings);
    }
  } catch (const InputError& error) {
    findings.emplace_back(error.what());
  }
  return findings;
}

}  // namespace plumbline
