#include "apps/internal/result_file.h"

#include <fmt/format.h>

#include <numbers>

#include "calib/error.h"
#include "io/rig_file.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

namespace {

// Of what cannot be read at all, the readers say why.
bool IsOfOneCamera(const std::string& path) {
  try {
    return IsPlanarSeries(path);
  } catch (const InputError&) {
    return false;
  }
}

}  // namespace

ResultFile OpenResultFile(const std::string& path) {
  if (!fs::is_regular_file(path)) {
    std::string parts = path;
    while (parts.size() > 1 && parts.back() == '/') parts.pop_back();
    if (!parts.ends_with(".parts")) parts += ".parts";
    if (fs::is_directory(parts)) {
      throw InputError(
          fmt::format("'{}' was not finished: it is being written, and {}/live.h5 holds its first "
                      "frames; or its "
                      "run was killed, then use plumbline recover {}.",
                      path, parts, parts.substr(0, parts.size() - 6)));
    }
    throw InputError(fmt::format("There is no file '{}'.", path));
  }
  ResultFile file;
  if (IsOfOneCamera(path)) {
    file.planar = std::make_unique<PlanarSeriesReader>(path);
    return file;
  }
  std::string why_no_series;
  try {
    file.series = std::make_unique<SeriesReader>(path);
    file.rig = file.series->rig();
    return file;
  } catch (const InputError& error) {
    why_no_series = error.what();
  }
  try {
    file.series.reset();
    file.rig = ReadRigFile(path);
  } catch (const InputError&) {
    throw InputError(why_no_series);
  }
  return file;
}

std::string RigText(const StereoRig& rig) {
  const auto camera = [](const char* side, const Camera& c) {
    return fmt::format("  {} camera: {}x{} px, {}, fx {:.1f} fy {:.1f} cx {:.1f} cy {:.1f} px\n",
                       side, c.size().width, c.size().height, c.model().Name(), c.parameters()[0],
                       c.parameters()[1], c.parameters()[2], c.parameters()[3]);
  };
  std::string text = fmt::format(
      "Rig: baseline {:.3f} mm, angle between the cameras {:.3f} deg{}\n", rig.baseline_mm(),
      rig.right_from_left.RotationVector().norm() * 180 / std::numbers::pi,
      rig.board.empty() ? "" : ", calibrated from " + rig.board);
  text += camera("left", rig.left) + camera("right", rig.right);
  text += rig.modes.count() > 0
              ? fmt::format("  uncertainty: {} calibration modes{}\n", rig.modes.count(),
                            rig.modes.has_scale_mode ? ", the last one is the board's scale" : "")
              : std::string("  uncertainty: unknown, the calibration carries none\n");
  return text;
}

fs::path CheckedOutput(const std::string& output, bool overwrite) {
  const fs::path path = fs::absolute(output);
  if (fs::exists(path) && !overwrite) {
    throw InputError(fmt::format(
        "'{}' is there already; choose another name with -o, or say --overwrite.", output));
  }
  if (!fs::is_directory(path.parent_path())) {
    throw EnvironmentError(fmt::format("There is no folder '{}' to write into; make it first.",
                                       path.parent_path().string()));
  }
  return path;
}

std::filesystem::path NumberedFile(const std::filesystem::path& file, std::int64_t index) {
  return file.parent_path() /
         fmt::format("{}_{:04}{}", file.stem().string(), index, file.extension().string());
}

}  // namespace plumbline::internal
