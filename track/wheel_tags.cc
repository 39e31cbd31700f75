#include "track/wheel_tags.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>
#include <utility>

#include "calib/detect_tags.h"
#include "calib/median.h"
#include "calib/triangulate.h"
#include "track/internal/axis_along_modes.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr double kDegrees = 180 / std::numbers::pi;
constexpr std::size_t kCorners = 4;
using Corners3 = std::array<Eigen::Vector3d, kCorners>;

// Each id once; those that are there more often go to `twice`.
std::map<int, DetectedTag> Once(const std::vector<DetectedTag>& tags, std::vector<int>* twice) {
  std::map<int, DetectedTag> once;
  for (const DetectedTag& tag : tags) {
    if (!once.try_emplace(tag.id, tag).second) twice->push_back(tag.id);
  }
  for (const int id : *twice) once.erase(id);
  return once;
}

bool OnItsEpipolarLines(const StereoRig& rig, const StereoTag& tag) {
  constexpr double kMost_px = 2;
  for (std::size_t k = 0; k < kCorners; ++k) {
    const TriangulatedPoint point = Triangulate(rig, {tag.left_px[k], tag.right_px[k]});
    if (point.status != Status::kOk || std::abs(point.epipolar_px) > kMost_px) return false;
  }
  return true;
}

// A tag as one frame of the reference recording puts it on the wheel; corners of 1 px.
struct Placed {
  std::size_t frame = 0;
  StereoTag seen;
  Corners3 corner_mm;
  std::array<Eigen::Matrix3d, kCorners> information;  // 1 / mm2
  double squares = 0;                                 // of the residuals, over all corners
};

std::optional<Placed> PlaceOf(const WheelReference& wheel, std::size_t frame,
                              const StereoTag& seen) {
  const Rigid3 wheel_from_rig = wheel.axis.RigFromWheel(wheel.frames[frame].angle_rad).Inverse();
  Placed placed{frame, seen, {}, {}, 0};
  for (std::size_t k = 0; k < kCorners; ++k) {
    const TriangulatedPoint point = Triangulate(wheel.rig, {seen.left_px[k], seen.right_px[k]});
    if (point.status != Status::kOk) return std::nullopt;
    placed.corner_mm[k] = wheel_from_rig * point.point_in_rig;
    placed.information[k] =
        (wheel_from_rig.rotation * point.cov_mm2 * wheel_from_rig.rotation.transpose()).inverse();
  }
  return placed;
}

Eigen::Vector3d MiddleOf(const Corners3& corners) {
  return (corners[0] + corners[1] + corners[2] + corners[3]) / 4;
}

double SideOf(const Corners3& corners) {
  double sum = 0;
  for (std::size_t k = 0; k < kCorners; ++k) sum += (corners[k] - corners[(k + 1) % 4]).norm();
  return sum / 4;
}

Eigen::Vector3d MedianMiddle(const std::vector<Placed>& all) {
  Eigen::Vector3d middle;
  for (Eigen::Index d = 0; d < 3; ++d) {
    std::vector<double> values;
    for (const Placed& placed : all) values.push_back(MiddleOf(placed.corner_mm)[d]);
    middle[d] = Median(std::move(values));
  }
  return middle;
}

// Weighted means of the corners, and what each sighting is off them.
void Average(std::vector<Placed>& all, Corners3* mean) {
  for (Placed& placed : all) placed.squares = 0;
  for (std::size_t k = 0; k < kCorners; ++k) {
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    Eigen::Vector3d weighted = Eigen::Vector3d::Zero();
    for (const Placed& placed : all) {
      sum += placed.information[k];
      weighted += placed.information[k] * placed.corner_mm[k];
    }
    (*mean)[k] = sum.ldlt().solve(weighted);
    for (Placed& placed : all) {
      const Eigen::Vector3d off = placed.corner_mm[k] - (*mean)[k];
      placed.squares += off.dot(placed.information[k] * off);
    }
  }
}

struct OneTag {
  std::vector<Placed> sightings;
  Corners3 mean;
};

constexpr double kFreedoms = 12;  // of a sighting

double SigmaOf(const std::map<int, OneTag>& tags) {
  double squares = 0, freedoms = 0;
  for (const auto& [id, tag] : tags) {
    for (const Placed& placed : tag.sightings) squares += placed.squares;
    freedoms += kFreedoms * (static_cast<double>(tag.sightings.size()) - 1);
  }
  return freedoms > 0 ? std::sqrt(squares / freedoms) : std::numeric_limits<double>::quiet_NaN();
}

// Leaves out the sightings that are far off, and averages the others; until none is left.
void LeaveOutOutliers(std::map<int, OneTag>& tags) {
  constexpr double kOutlierSigmas = 4.7;
  constexpr int kRounds = 10;
  for (int round = 0; round < kRounds; ++round) {
    for (auto& [id, tag] : tags) Average(tag.sightings, &tag.mean);
    const double most = kOutlierSigmas * SigmaOf(tags);
    std::size_t left_out = 0;
    for (auto& [id, tag] : tags) {
      left_out += std::erase_if(tag.sightings, [&](const Placed& placed) {
        return std::sqrt(placed.squares / kFreedoms) > most;
      });
    }
    std::erase_if(tags, [](const auto& tag) { return tag.second.sightings.size() < 2; });
    if (left_out == 0) return;
  }
}

// The factor by which what neighbouring sightings have in common makes the means less sure.
double SharedFactor(const std::map<int, OneTag>& tags) {
  constexpr double kMost = 0.9;
  double products = 0, squares = 0, pairs = 0, sightings = 0;
  for (const auto& [id, tag] : tags) {
    for (std::size_t i = 0; i < tag.sightings.size(); ++i) {
      squares += tag.sightings[i].squares;
      ++sightings;
      if (i == 0) continue;
      const Placed &before = tag.sightings[i - 1], &now = tag.sightings[i];
      for (std::size_t k = 0; k < kCorners; ++k) {
        products += (before.corner_mm[k] - tag.mean[k])
                        .dot(now.information[k] * (now.corner_mm[k] - tag.mean[k]));
      }
      ++pairs;
    }
  }
  if (!(pairs > 0 && squares > 0)) return 1;
  // Residuals about a mean of n are correlated by -1 / n where the errors are not.
  const double mean_count = sightings / static_cast<double>(tags.size());
  const double rho =
      std::clamp(products / pairs / (squares / sightings) + 1 / mean_count, 0.0, kMost);
  return (1 + rho) / (1 - rho);
}

// A corner is where straight lines through two edges meet; on a tyre the edges are curved. Up to a
// third of their sagitta towards the axis and a ninth along it, each corner for itself, as far as
// the virtual rig's tags are off.
Eigen::Matrix3d OfCurvedEdges(const Eigen::Vector3d& corner_mm, double side_mm) {
  const double radius_mm = std::hypot(corner_mm.x(), corner_mm.z());
  const double sagitta_mm = side_mm * side_mm / (8 * radius_mm);
  const Eigen::Vector3d outwards =
      sagitta_mm / 3 * Eigen::Vector3d(corner_mm.x(), 0, corner_mm.z()) / radius_mm;
  const Eigen::Vector3d along = sagitta_mm / 9 * Eigen::Vector3d::UnitY();
  return outwards * outwards.transpose() + along * along.transpose();
}

// The corners' covariance and what the modes add, out of those of the sightings.
void AddErrors(const WheelReference& wheel, const OneTag& from, double variance_px2,
               WheelTag* tag) {
  const auto count = static_cast<Eigen::Index>(from.sightings.size());
  Eigen::MatrixXd by_angle(12, count), along = Eigen::MatrixXd::Zero(wheel.rig.modes.count(), 12);
  std::vector<Eigen::Index> frames;
  for (const Placed& placed : from.sightings) {
    frames.push_back(static_cast<Eigen::Index>(placed.frame));
  }
  const std::vector<WheelAxis> axes = internal::AxesAlongModes(wheel);
  std::vector<StereoRig> rigs;
  for (int k = 0; k < wheel.rig.modes.count(); ++k) rigs.push_back(wheel.rig.AlongMode(k));
  for (std::size_t c = 0; c < kCorners; ++c) {
    const auto at = static_cast<Eigen::Index>(3 * c);
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    for (const Placed& placed : from.sightings) sum += placed.information[c];
    const Eigen::Matrix3d inverse = sum.inverse();
    tag->cov_random_mm2.block<3, 3>(at, at) =
        variance_px2 * inverse + OfCurvedEdges(from.mean[c], SideOf(from.mean));
    for (Eigen::Index i = 0; i < count; ++i) {
      const Placed& placed = from.sightings[static_cast<std::size_t>(i)];
      const Eigen::Matrix3d share = inverse * placed.information[c];
      by_angle.block<3, 1>(at, i) = -share * Eigen::Vector3d::UnitY().cross(placed.corner_mm[c]);
      for (std::size_t k = 0; k < rigs.size(); ++k) {
        const auto mode = static_cast<Eigen::Index>(k);
        const double angle =
            wheel.frames[placed.frame].angle_rad +
            wheel.angles_along_modes_rad(mode, frames[static_cast<std::size_t>(i)]);
        const TriangulatedPoint moved =
            Triangulate(rigs[k], {placed.seen.left_px[c], placed.seen.right_px[c]});
        along.block<1, 3>(mode, at) +=
            (share *
             (axes[k].RigFromWheel(angle).Inverse() * moved.point_in_rig - placed.corner_mm[c]))
                .transpose();
      }
    }
  }
  Eigen::MatrixXd angles(count, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    for (Eigen::Index j = 0; j < count; ++j) {
      angles(i, j) = wheel.cov_angles_random_rad2(frames[static_cast<std::size_t>(i)],
                                                  frames[static_cast<std::size_t>(j)]);
    }
  }
  tag->cov_random_mm2 += by_angle * angles * by_angle.transpose();
  tag->along_modes_mm = along;
}

// The sightings of each id, in order; ids that are on the wheel twice are left out and told.
std::map<int, OneTag> Collect(const WheelReference& wheel, std::span<const TagSighting> sightings,
                              std::vector<std::string>* problems) {
  std::map<int, OneTag> tags;
  std::map<int, int> twice, stray;
  for (const TagSighting& sighting : sightings) {
    if (wheel.frames.at(sighting.frame).status != WheelFrameStatus::kPlaced) continue;
    for (const int id : sighting.seen.twice) ++twice[id];
    for (const StereoTag& seen : sighting.seen.tags) {
      if (auto placed = PlaceOf(wheel, sighting.frame, seen)) {
        tags[seen.id].sightings.push_back(*placed);
      }
    }
  }
  for (auto& [id, tag] : tags) {
    const Eigen::Vector3d middle = MedianMiddle(tag.sightings);
    stray[id] = static_cast<int>(std::erase_if(tag.sightings, [&](const Placed& placed) {
      return (MiddleOf(placed.corner_mm) - middle).norm() > SideOf(placed.corner_mm) / 2;
    }));
  }
  const auto refuse = [&](int id) {
    problems->push_back(
        fmt::format("tag {} is on the wheel more than once, or is read where it is not: it is left "
                    "out; number the tags anew",
                    id));
    tags.erase(id);
  };
  for (const auto& [id, count] : stray) {
    if (count > 1 || twice[id] > 1) refuse(id);
  }
  for (const auto& [id, count] : twice) {
    if (count > 1 && stray.count(id) == 0) refuse(id);
  }
  std::erase_if(tags, [&](const auto& tag) {
    if (tag.second.sightings.size() > 1) return false;
    problems->push_back(fmt::format(
        "tag {} is seen in one frame alone, which does not tell how sure its place is: it is left "
        "out",
        tag.first));
    return true;
  });
  return tags;
}

}  // namespace

Eigen::Vector3d WheelTag::Centre() const { return MiddleOf(corner_mm); }
double WheelTag::SideMm() const { return SideOf(corner_mm); }

const WheelTag* WheelTags::Find(int id) const {
  const auto at = std::lower_bound(tags.begin(), tags.end(), id,
                                   [](const WheelTag& tag, int i) { return tag.id < i; });
  return at != tags.end() && at->id == id ? &*at : nullptr;
}

StereoTags FindStereoTags(const StereoRig& rig, const GrayImage& left, const GrayImage& right,
                          const std::string& family) {
  StereoTags out;
  const auto in_left = Once(DetectTags(left, family), &out.twice);
  const auto in_right = Once(DetectTags(right, family), &out.twice);
  for (const auto& [id, tag] : in_left) {
    const auto other = in_right.find(id);
    if (other == in_right.end()) continue;
    const StereoTag both{id, tag.corners, other->second.corners};
    if (OnItsEpipolarLines(rig, both)) out.tags.push_back(both);
  }
  std::sort(out.twice.begin(), out.twice.end());
  out.twice.erase(std::unique(out.twice.begin(), out.twice.end()), out.twice.end());
  std::erase_if(out.tags, [&](const StereoTag& tag) {
    return std::binary_search(out.twice.begin(), out.twice.end(), tag.id);
  });
  return out;
}

WheelTagsFound MakeWheelTags(const WheelReference& wheel, const std::string& family,
                             std::span<const int> rim_ids, std::span<const TagSighting> sightings) {
  WheelTagsFound out;
  out.tags.family = family;
  std::map<int, OneTag> tags = Collect(wheel, sightings, &out.problems);
  LeaveOutOutliers(tags);
  out.tags.sigma_px = SigmaOf(tags);
  const double variance = out.tags.sigma_px * out.tags.sigma_px * SharedFactor(tags);
  for (const auto& [id, from] : tags) {
    WheelTag tag;
    tag.id = id;
    tag.on_rim = std::find(rim_ids.begin(), rim_ids.end(), id) != rim_ids.end();
    tag.frames = static_cast<int>(from.sightings.size());
    tag.corner_mm = from.mean;
    AddErrors(wheel, from, variance, &tag);
    out.tags.tags.push_back(std::move(tag));
  }
  for (const int id : rim_ids) {
    if (out.tags.Find(id) == nullptr) {
      out.problems.push_back(
          fmt::format("tag {}, said to be on the rim, is not found on the wheel", id));
    }
  }
  return out;
}

double AngleOfTag(const WheelReference& wheel, const WheelTag& tag, const StereoTag& seen) {
  const Rigid3 wheel_from_rig = wheel.axis.RigFromWheel(0).Inverse();
  const std::vector<Eigen::Vector3d> points =
      TriangulatePoints(wheel.rig, seen.left_px, seen.right_px);
  const Eigen::Vector3d middle = (points[0] + points[1] + points[2] + points[3]) / 4;
  return MaterialAngle(tag.Centre()) - MaterialAngle(wheel_from_rig * middle);
}

bool TagPlace::Allows(double wheel_angle_rad) const {
  return !found ||
         std::abs(std::remainder(wheel_angle_rad - angle_rad, kTurn_rad)) <= kMostDrawn_rad;
}

std::string TagPlace::Contradiction(double wheel_angle_rad) const {
  return fmt::format(
      "its tags contradict its surface: by them the wheel stands {:.1f} degrees off where its "
      "points are found; a tag is misread, or was moved since the wheel's reference was made",
      std::remainder(angle_rad - wheel_angle_rad, kTurn_rad) * kDegrees);
}

TagPlace PlaceByTags(const WheelReference& wheel, const StereoTags& seen) {
  TagPlace place;
  std::vector<std::pair<int, double>> angles, rim;
  for (const StereoTag& tag : seen.tags) {
    const WheelTag* known = wheel.tags.Find(tag.id);
    if (known == nullptr) {
      place.unknown.push_back(tag.id);
      continue;
    }
    const double angle = AngleOfTag(wheel, *known, tag);
    if (!std::isfinite(angle)) continue;
    ++place.known;
    if (known->on_rim) ++place.rim;
    (known->on_rim ? rim : angles).emplace_back(tag.id, angle);
  }
  if (place.known == 0) return place;
  const std::vector<std::pair<int, double>>& by = rim.empty() ? angles : rim;
  std::vector<double> from_first;
  for (const auto& [id, angle] : by) {
    from_first.push_back(std::remainder(angle - by.front().second, kTurn_rad));
  }
  const double middle = by.front().second + Median(from_first);
  for (const auto* group : {&angles, &rim}) {
    for (const auto& [id, angle] : *group) {
      const double off = std::remainder(angle - middle, kTurn_rad);
      if (std::abs(off) <= TagPlace::kMostDrawn_rad) continue;
      place.why = fmt::format(
          "its tags contradict each other: tag {} says that the wheel stands {:.1f} degrees off "
          "what the others say",
          id, off * kDegrees);
      return place;
    }
  }
  place.found = true;
  place.angle_rad = middle - kTurn_rad * std::floor(middle / kTurn_rad);
  return place;
}

}  // namespace plumbline
