#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "io/internal/file_checks.h"
#include "io/internal/patch_contours.h"
#include "io/internal/planar_layout.h"
#include "io/internal/series_file.h"
#include "io/internal/series_header.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_records.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;
using hdf5::Shape;
using Findings = std::vector<std::string>;

// Where there has to be a number: nowhere, at one of the points that are expected to have one at
// least, or at all of them.
enum class Needed : std::uint8_t { kNowhere, kSomewhere, kEverywhere };

// A field of points of a group.
struct OpenField {
  const PointField* field;
  std::string what;  // of a point
  Needed needed = Needed::kNowhere;
  Id dataset;
};

// The dataset if it is there and begins with these dimensions; else nothing.
Id OpenIfFits(hid_t file, const std::string& path, const Shape& leading) {
  if (!hdf5::Exists(file, path)) return Id();
  Id dataset = hdf5::OpenDataset(file, path);
  const Shape shape = hdf5::ShapeOf(dataset);
  const bool fits =
      shape.size() >= leading.size() && std::equal(leading.begin(), leading.end(), shape.begin());
  return fits ? std::move(dataset) : Id();
}

// What a finding calls a part of a point, {} being what the group's vectors are, and where it has
// to hold numbers. A mode may bend the rays of a point so far that they no longer meet; it then has
// a position and no sigma of the calibration.
enum class Rule : std::uint8_t { kOptional, kByStatus, kByModes, kAlways };
struct PartRule {
  PointPart part;
  const char* what;
  Rule rule;
};
constexpr std::array kPartRules = {
    PartRule{PointPart::kValue, "{}", Rule::kByStatus},
    PartRule{PointPart::kRandom, "random sigma of the {}", Rule::kAlways},
    PartRule{PointPart::kCalibration, "calibration sigma of the {}", Rule::kByModes},
    PartRule{PointPart::kCombined, "combined sigma of the {}", Rule::kByModes},
    PartRule{PointPart::kCovariance, "covariance", Rule::kAlways},
    PartRule{PointPart::kPrincipal, "principal {}", Rule::kAlways},
    PartRule{PointPart::kPrincipalRandom, "random sigma of the principal {}", Rule::kOptional},
    PartRule{PointPart::kPrincipalCalibration, "calibration sigma of the principal {}",
             Rule::kOptional},
    PartRule{PointPart::kPrincipalCombined, "combined sigma of the principal {}", Rule::kOptional},
    PartRule{PointPart::kPrincipalAngle, "direction of principal {}", Rule::kOptional},
    PartRule{PointPart::kMaxShear, "largest shear", Rule::kAlways},
    PartRule{PointPart::kVonMises, "von Mises {}", Rule::kAlways},
    PartRule{PointPart::kGradient, "gradient", Rule::kOptional},
    PartRule{PointPart::kGradientRandom, "random sigma of the gradient", Rule::kOptional},
    PartRule{PointPart::kGradientCovariance, "covariance of the gradient", Rule::kOptional},
    PartRule{PointPart::kRightValue, "{} in the right image", Rule::kAlways},
    PartRule{PointPart::kRightCovariance, "covariance in the right image", Rule::kAlways},
};

OpenField Describe(const PointField& field, const PointGroupFacts& group, bool has_status,
                   bool has_modes) {
  const auto known = std::find_if(kPartRules.begin(), kPartRules.end(),
                                  [&](const PartRule& rule) { return rule.part == field.part; });
  if (known == kPartRules.end()) {
    return {&field, fmt::format("value of {}", field.path), Needed::kNowhere, Id()};
  }
  OpenField open{&field, fmt::format(fmt::runtime(known->what), group.what), Needed::kNowhere,
                 Id()};
  if (known->rule == Rule::kAlways || (known->rule == Rule::kByStatus && has_status)) {
    open.needed = Needed::kEverywhere;
  } else if (known->rule == Rule::kByModes && has_modes) {
    open.needed = Needed::kSomewhere;
  }
  return open;
}

// Of the match, which may tell something where it failed, or no number.
bool IsFree(PointPart part) {
  return part == PointPart::kStatus || part == PointPart::kCorrelation ||
         part == PointPart::kEpipolar || part == PointPart::kIterations;
}

// What is checked of the points of a group.
struct OpenGroup {
  const PointGroupFacts* facts;
  // The fields that go by the group's vectors, these first. None where the vectors are not there.
  std::vector<OpenField> fields;
  bool has_status = false;  // of its own, in this version of the format
  Id status;
};

OpenGroup OpenGroupOf(hid_t file, const PointLayout& layout, std::size_t group, const Shape& size,
                      bool has_modes) {
  const std::int64_t version = VersionOf(file);
  OpenGroup open{&layout.groups[group], {}, false, Id()};
  if (open.facts->has_status) {
    const std::string path =
        layout.FieldOf(static_cast<std::uint8_t>(group), PointPart::kStatus).PathIn(version);
    open.has_status = !path.empty();
    if (open.has_status) open.status = OpenIfFits(file, path, size);
  }
  for (const PointField& field : layout.fields) {
    const std::string path = field.PathIn(version);
    if (field.group != group || IsFree(field.part) || path.empty()) continue;
    OpenField described = Describe(field, *open.facts, open.has_status, has_modes);
    described.dataset = OpenIfFits(file, path, size);
    if (described.dataset.get() >= 0) open.fields.push_back(std::move(described));
  }
  if (!open.fields.empty() && open.fields[0].field->part != PointPart::kValue) open.fields.clear();
  return open;
}

enum class Found : std::uint8_t { kNothing, kNumbers, kPartly, kInfinite };

Found Look(const float* value, std::size_t components) {
  const auto is_finite = [](float v) { return std::isfinite(v); };
  const auto is_nan = [](float v) { return std::isnan(v); };
  const auto is_infinite = [](float v) { return std::isinf(v); };
  const float* end = value + components;
  if (std::all_of(value, end, is_nan)) return Found::kNothing;
  if (std::all_of(value, end, is_finite)) return Found::kNumbers;
  return std::any_of(value, end, is_infinite) ? Found::kInfinite : Found::kPartly;
}

// The points of one frame: numbers and what is expected of each point have to say the same, both
// ways. because: what expects a value; denied_by: what does not.
void CheckPoints(const std::vector<float>& values, const std::vector<std::uint8_t>& expected,
                 const OpenField& field, const std::string& because, const std::string& denied_by,
                 hsize_t frame, Findings* findings) {
  const std::size_t components = values.size() / expected.size();
  std::int64_t count = 0, missing = 0, surplus = 0, infinite = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    const Found found = Look(values.data() + i * components, components);
    count += expected[i];
    if (expected[i] != 0 && found != Found::kNumbers) ++missing;
    // A vector needs all of its components.
    const bool is_vector = field.field->part == PointPart::kValue;
    if (expected[i] != 0 && (found == Found::kInfinite || (is_vector && found == Found::kPartly))) {
      ++infinite;
    }
    if (expected[i] == 0 && found != Found::kNothing) ++surplus;
  }
  if (missing > 0 && (field.needed == Needed::kEverywhere ||
                      (field.needed == Needed::kSomewhere && missing == count))) {
    findings->push_back(
        fmt::format("frame {}: {} points have {} and no {}", frame, missing, because, field.what));
  } else if (infinite > 0) {
    findings->push_back(
        fmt::format("frame {}: {} points have a {} that is infinite or lacks a component", frame,
                    infinite, field.what));
  }
  if (surplus > 0) {
    findings->push_back(fmt::format("frame {}: {} points have a {} that their {} denies", frame,
                                    surplus, field.what, denied_by));
  }
}

// One group of one frame. At a point with the status ok the vectors that this status tells of have
// to be there, other vectors may be missing; all else of the group has to be there where the vector
// is.
void CheckGroup(const OpenGroup& group, std::vector<std::uint8_t> expected, hsize_t frame,
                Findings* findings) {
  for (const OpenField& field : group.fields) {
    const auto values = hdf5::ReadSlab<float>(field.dataset, frame, kMaxFrameElements);
    const bool is_vector = field.field->part == PointPart::kValue, is_free = group.facts->free;
    const std::string what(group.facts->what);
    const std::size_t components = values.size() / expected.size();
    if (is_free && is_vector) std::fill(expected.begin(), expected.end(), std::uint8_t{1});
    CheckPoints(values, expected, field, is_free ? "a " + what : "the status ok",
                group.has_status || is_vector ? "status" : "missing " + what, frame, findings);
    if (group.has_status || !is_vector) continue;
    for (std::size_t i = 0; i < expected.size(); ++i) {
      if (Look(values.data() + i * components, components) == Found::kNothing) expected[i] = 0;
    }
  }
}

// Where the status of one frame is ok.
std::vector<std::uint8_t> WhereOk(const PointLayout& layout, const Id& status,
                                  const Id& frame_status, hsize_t frame, Findings* findings) {
  const auto codes = hdf5::ReadSlabBytes(status, frame, kMaxFrameElements);
  std::vector<std::uint8_t> ok(codes.size());
  std::transform(codes.begin(), codes.end(), ok.begin(), [](std::uint8_t code) {
    return static_cast<std::uint8_t>(code == static_cast<std::uint8_t>(Status::kOk) ? 1 : 0);
  });
  const auto count = std::count(ok.begin(), ok.end(), std::uint8_t{1});
  const auto unknown = std::count_if(codes.begin(), codes.end(),
                                     [](std::uint8_t code) { return code >= kStatusNames.size(); });
  if (unknown > 0) {
    findings->push_back(fmt::format("frame {}: {} points have an unknown status", frame, unknown));
  }
  if (hdf5::ReadSlabBytes(frame_status, frame, 1).at(0) != 0 && count > 0) {
    findings->push_back(
        fmt::format("frame {}: {} points have the status ok in a frame without a {}", frame, count,
                    layout.what));
  }
  return ok;
}

void CheckFieldsOfPoints(hid_t file, const PointLayout& layout, hsize_t frames,
                         Findings* findings) {
  const Id frame_status = hdf5::OpenDataset(file, "/frames/status");
  const Shape size =
      hdf5::ShapeOf(hdf5::OpenDataset(file, layout.FieldOf(0, PointPart::kStatus).Path()));
  if (size.size() != 3 || size[0] != frames || size[1] == 0 || size[2] == 0) return;
  const bool has_modes =
      hdf5::Exists(file, "/rig/mode") &&
      hdf5::ElementCount(hdf5::ShapeOf(hdf5::OpenDataset(file, "/rig/mode"))) > 0;
  std::vector<OpenGroup> groups;
  for (std::size_t g = 0; g < layout.groups.size(); ++g) {
    groups.push_back(OpenGroupOf(file, layout, g, size, has_modes));
  }
  for (hsize_t i = 0; i < frames; ++i) {
    std::vector<std::uint8_t> ok;
    for (const OpenGroup& group : groups) {
      if (group.has_status && group.status.get() < 0) continue;
      if (group.has_status) ok = WhereOk(layout, group.status, frame_status, i, findings);
      CheckGroup(group, ok, i, findings);
    }
  }
}

void CheckRecords(hid_t file, const RecordGroup& group, hsize_t frames, Findings* findings) {
  const Id status = hdf5::OpenDataset(file, group.path + "/status");
  if (hdf5::ShapeOf(status) != Shape{frames}) return;
  for (const RecordField& field : group.fields) {
    const std::string path = group.path + "/" + field.name;
    const Id dataset = OpenIfFits(file, path, {frames});
    if (dataset.get() < 0) continue;
    for (hsize_t i = 0; i < frames; ++i) {
      const bool found = hdf5::ReadSlabBytes(status, i, 1).at(0) == 0;
      const auto values = hdf5::ReadSlab<double>(dataset, i, 16);
      const auto is_finite = [](double v) { return std::isfinite(v); };
      const auto is_nan = [](double v) { return std::isnan(v); };
      if (found && field.needed && !std::all_of(values.begin(), values.end(), is_finite)) {
        findings->push_back(
            fmt::format("frame {}: a {} was found and has no {}", i, group.what, field.name));
      } else if (found && std::any_of(values.begin(), values.end(),
                                      [](double v) { return std::isinf(v); })) {
        findings->push_back(fmt::format("frame {}: {} holds an infinite value", i, path));
      }
      if (!found && !std::all_of(values.begin(), values.end(), is_nan)) {
        findings->push_back(
            fmt::format("frame {}: no {} was found, and {} holds a value", i, group.what, path));
      }
    }
  }
}

void CheckContours(hid_t file, hsize_t frames, Findings* findings) {
  for (const char* name : {"contour_first", "contour_count", "status"}) {
    const std::string path = std::string("/patch/") + name;
    if (OpenIfFits(file, path, {frames}).get() < 0) return;
  }
  if (!hdf5::Exists(file, "/patch/contour")) return;
  const Id status = hdf5::OpenDataset(file, "/patch/status");
  for (hsize_t i = 0; i < frames; ++i) {
    try {
      const auto contour = ReadPatchContour(file, i);
      if (!contour.empty() && hdf5::ReadSlabBytes(status, i, 1).at(0) != 0) {
        findings->push_back(
            fmt::format("frame {}: no contact patch was found, and it has a contour", i));
      }
      // A row that is not a number parts two outlines; numbers are finite.
      const auto may_be = [](const Eigen::Vector2d& point) {
        return point.allFinite() || (std::isnan(point.x()) && std::isnan(point.y()));
      };
      if (!std::all_of(contour.begin(), contour.end(), may_be)) {
        findings->push_back(
            fmt::format("frame {}: its contour holds values that are no numbers", i));
      }
    } catch (const hdf5::Error& error) {
      findings->push_back(fmt::format("frame {}: its contour cannot be read: {}", i, error.what()));
    }
  }
}

void CheckChannels(hid_t file, Findings* findings) {
  if (!hdf5::Exists(file, "/channels")) return;
  const Id group = hdf5::OpenGroup(file, "/channels");
  for (const std::string& name : hdf5::LinkNames(group.get())) {
    if (!hdf5::Exists(group.get(), name + "/time_s")) continue;
    const auto time_s = hdf5::ReadArray<double>(group.get(), name + "/time_s");
    const std::size_t wrong = FirstWrongTime(time_s);
    if (wrong == time_s.size()) continue;
    findings->push_back(
        fmt::format("/channels/{}: its time {} is no number or goes back", name, wrong));
  }
}

// Reasons why there is nothing, beside a status that says there is something.
void CheckProblems(hid_t file, const std::string& group, const std::string& what, hsize_t frames,
                   Findings* findings) {
  const Id status = hdf5::OpenDataset(file, group + "/status");
  const auto problems = hdf5::ReadTexts(file, group + "/problem");
  if (hdf5::ShapeOf(status) != Shape{frames} || problems.size() != frames) return;
  for (hsize_t i = 0; i < frames; ++i) {
    if (problems[i].empty() || hdf5::ReadSlabBytes(status, i, 1).at(0) != 0) continue;
    findings->push_back(
        fmt::format("frame {} holds a {} and yet a reason why not: {}", i, what, problems[i]));
  }
}

}  // namespace

Findings CheckValues(hid_t file) {
  const PointLayout& layout = IsPlanar(file) ? PlanarPoints() : StereoPoints();
  const std::string status = layout.FieldOf(0, PointPart::kStatus).Path();
  Findings findings;
  const auto attempt = [&](const auto& run) {
    try {
      run();
    } catch (const hdf5::Error& error) {
      findings.emplace_back(error.what());
    }
  };
  const auto is_there = [&](const std::string& path) { return hdf5::Exists(file, path); };
  attempt([&] { CheckChannels(file, &findings); });
  for (const std::string& path :
       {std::string("/frames/status"), status, std::string("/frames/problem")}) {
    if (!is_there(path)) return findings;
  }
  attempt([&] {
    const Shape shape = hdf5::ShapeOf(hdf5::OpenDataset(file, "/frames/status"));
    if (shape.size() != 1) return;
    if (shape[0] > kMaxFrames) throw hdf5::Error("/frames/status is too large");
    attempt([&] { CheckFieldsOfPoints(file, layout, shape[0], &findings); });
    attempt([&] { CheckProblems(file, "/frames", std::string(layout.what), shape[0], &findings); });
    for (const RecordGroup& group : RecordGroups()) {
      if (!is_there(group.path + "/status") || !is_there(group.path + "/problem")) continue;
      attempt([&] { CheckRecords(file, group, shape[0], &findings); });
      if (group.may_lack) continue;
      attempt([&] { CheckProblems(file, group.path, group.what, shape[0], &findings); });
    }
    attempt([&] { CheckContours(file, shape[0], &findings); });
  });
  return findings;
}

}  // namespace plumbline::internal
