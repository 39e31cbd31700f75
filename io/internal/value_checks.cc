#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "io/internal/file_checks.h"
#include "io/internal/series_layout.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;
using hdf5::Shape;
using Findings = std::vector<std::string>;

// The same bounds as SeriesReader's.
constexpr hsize_t kMaxFrameElements = hsize_t{3} << 28;
constexpr hsize_t kMaxFrames = 100'000'000;

// Where there has to be a number: nowhere, at one of the points with the status ok at least, or at
// all of them.
enum class Needed { kNowhere, kSomewhere, kEverywhere };

// A dataset whose first dimension counts the frames.
struct FrameField {
  std::string path;
  std::string what;  // of a point or frame
  Needed needed = Needed::kNowhere;
  Id dataset;
};

void OpenIfThere(hid_t file, FrameField field, const Shape& leading,
                 std::vector<FrameField>* fields) {
  if (!hdf5::Exists(file, field.path)) return;
  field.dataset = hdf5::OpenDataset(file, field.path);
  const Shape shape = hdf5::ShapeOf(field.dataset);
  if (shape.size() < leading.size()) return;
  if (!std::equal(leading.begin(), leading.end(), shape.begin())) return;
  fields->push_back(std::move(field));
}

std::vector<FrameField> SurfaceFields(hid_t file, const Shape& size, bool has_modes) {
  std::vector<FrameField> fields;
  const auto add = [&](int index, const char* what, Needed needed) {
    const std::string name(kPointFields[static_cast<std::size_t>(index)].name);
    OpenIfThere(file, {"/surface/" + name, what, needed, Id()}, size, &fields);
  };
  add(kPosition, "position", Needed::kEverywhere);
  add(kErrorsRandom, "random sigma", Needed::kEverywhere);
  // A mode may bend the rays of a point so far that they no longer meet; it then has a position and
  // no sigma of the calibration.
  const Needed by_modes = has_modes ? Needed::kSomewhere : Needed::kNowhere;
  add(kErrorsCalibration, "calibration sigma", by_modes);
  add(kErrors, "combined sigma", by_modes);
  add(kCovariance, "covariance", Needed::kEverywhere);
  return fields;
}

std::vector<FrameField> GroundFields(hid_t file, hsize_t frames) {
  std::vector<FrameField> fields;
  for (const char* name : {"normal", "offset", "ground_from_rig"}) {
    OpenIfThere(file, {std::string("/ground/") + name, name, Needed::kEverywhere, Id()}, {frames},
                &fields);
  }
  for (const char* name :
       {"covariance_random", "covariance_calibration", "offset_errors_random",
        "offset_errors_calibration", "angles_rad", "angles_rad_errors_random",
        "angles_rad_errors_calibration", "e1", "e2", "centroid", "rms", "inlier_fraction"}) {
    OpenIfThere(file, {std::string("/ground/") + name, name, Needed::kNowhere, Id()}, {frames},
                &fields);
  }
  return fields;
}

// The points of one frame: numbers and status have to say the same, both ways.
void CheckPoints(const std::vector<float>& values, const std::vector<std::uint8_t>& status,
                 const FrameField& field, hsize_t frame, Findings* findings) {
  const std::size_t components = values.size() / status.size();
  std::int64_t count_ok = 0, missing = 0, surplus = 0;
  for (std::size_t i = 0; i < status.size(); ++i) {
    const float* value = values.data() + i * components;
    const bool ok = status[i] == static_cast<std::uint8_t>(Status::kOk);
    const auto is_finite = [](float v) { return std::isfinite(v); };
    const auto is_nan = [](float v) { return std::isnan(v); };
    if (ok) ++count_ok;
    if (ok && !std::all_of(value, value + components, is_finite)) ++missing;
    if (!ok && !std::all_of(value, value + components, is_nan)) ++surplus;
  }
  if (missing > 0 && (field.needed == Needed::kEverywhere ||
                      (field.needed == Needed::kSomewhere && missing == count_ok))) {
    findings->push_back(fmt::format("frame {}: {} points have the status ok and no {}", frame,
                                    missing, field.what));
  }
  if (surplus > 0) {
    findings->push_back(fmt::format("frame {}: {} points have a {} that their status denies", frame,
                                    surplus, field.what));
  }
}

void CheckSurfaces(hid_t file, hsize_t frames, Findings* findings) {
  const Id status = hdf5::OpenDataset(file, "/surface/status");
  const Id frame_status = hdf5::OpenDataset(file, "/frames/status");
  const Shape size = hdf5::ShapeOf(status);
  if (size.size() != 3 || size[0] != frames || size[1] == 0 || size[2] == 0) return;
  const bool has_modes =
      hdf5::Exists(file, "/rig/mode") &&
      hdf5::ElementCount(hdf5::ShapeOf(hdf5::OpenDataset(file, "/rig/mode"))) > 0;
  const std::vector<FrameField> fields = SurfaceFields(file, size, has_modes);
  for (hsize_t i = 0; i < frames; ++i) {
    const auto codes = hdf5::ReadSlabBytes(status, i, kMaxFrameElements);
    const auto ok = std::count(codes.begin(), codes.end(), static_cast<std::uint8_t>(Status::kOk));
    const auto unknown = std::count_if(
        codes.begin(), codes.end(), [](std::uint8_t code) { return code >= kStatusNames.size(); });
    if (unknown > 0) {
      findings->push_back(fmt::format("frame {}: {} points have an unknown status", i, unknown));
    }
    if (hdf5::ReadSlabBytes(frame_status, i, 1).at(0) != 0 && ok > 0) {
      findings->push_back(fmt::format(
          "frame {}: {} points have the status ok in a frame without a surface", i, ok));
    }
    for (const FrameField& field : fields) {
      CheckPoints(hdf5::ReadSlab<float>(field.dataset, i, kMaxFrameElements), codes, field, i,
                  findings);
    }
  }
}

void CheckGrounds(hid_t file, hsize_t frames, Findings* findings) {
  const Id status = hdf5::OpenDataset(file, "/ground/status");
  if (hdf5::ShapeOf(status) != Shape{frames}) return;
  const std::vector<FrameField> fields = GroundFields(file, frames);
  for (hsize_t i = 0; i < frames; ++i) {
    const bool found = hdf5::ReadSlabBytes(status, i, 1).at(0) == 0;
    for (const FrameField& field : fields) {
      const auto values = hdf5::ReadSlab<double>(field.dataset, i, 16);
      const auto is_finite = [](double v) { return std::isfinite(v); };
      const auto is_nan = [](double v) { return std::isnan(v); };
      if (found && field.needed == Needed::kEverywhere &&
          !std::all_of(values.begin(), values.end(), is_finite)) {
        findings->push_back(
            fmt::format("frame {}: a ground plane was found and has no {}", i, field.what));
      }
      if (!found && !std::all_of(values.begin(), values.end(), is_nan)) {
        findings->push_back(fmt::format("frame {}: no ground plane was found, and {} holds a value",
                                        i, field.path));
      }
    }
  }
}

// Reasons why there is nothing, beside a status that says there is something.
void CheckProblems(hid_t file, const std::string& group, const char* what, hsize_t frames,
                   Findings* findings) {
  const Id status = hdf5::OpenDataset(file, group + "/status");
  const auto problems = hdf5::ReadTexts(file, group + "/problem");
  if (hdf5::ShapeOf(status) != Shape{frames} || problems.size() != frames) return;
  for (hsize_t i = 0; i < frames; ++i) {
    if (problems[i].empty() || hdf5::ReadSlabBytes(status, i, 1).at(0) != 0) continue;
    findings->push_back(
        fmt::format("frame {} holds {} and yet a reason why not: {}", i, what, problems[i]));
  }
}

}  // namespace

Findings CheckValues(hid_t file) {
  Findings findings;
  const auto attempt = [&](const auto& run) {
    try {
      run();
    } catch (const hdf5::Error& error) {
      findings.emplace_back(error.what());
    }
  };
  for (const char* path : {"/frames/status", "/surface/status", "/ground/status", "/frames/problem",
                           "/ground/problem"}) {
    if (!hdf5::Exists(file, path)) return findings;
  }
  attempt([&] {
    const Shape shape = hdf5::ShapeOf(hdf5::OpenDataset(file, "/frames/status"));
    if (shape.size() != 1) return;
    if (shape[0] > kMaxFrames) throw hdf5::Error("/frames/status is too large");
    attempt([&] { CheckSurfaces(file, shape[0], &findings); });
    attempt([&] { CheckGrounds(file, shape[0], &findings); });
    attempt([&] { CheckProblems(file, "/frames", "a surface", shape[0], &findings); });
    attempt([&] { CheckProblems(file, "/ground", "a ground plane", shape[0], &findings); });
  });
  return findings;
}

}  // namespace plumbline::internal
