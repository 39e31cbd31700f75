#include "track/material_velocity.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "calib/error.h"
#include "calib/parallel.h"
#include "match/planar_field.h"
#include "track/internal/finite_differences.h"
#include "track/internal/material_lookup.h"

namespace plumbline {
namespace {

using Share = MaterialVelocity::Share;
using internal::MaterialLookup;
constexpr int kBefore = 0, kNow = 1, kAfter = 2;
const Eigen::Vector3d kNone = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());

void CheckFrame(const MaterialFrame& frame, const MaterialFrame& now) {
  frame.points.Check();
  if (frame.material.size() != now.points.size() || frame.points.size() != now.points.size() ||
      frame.points.along_modes_mm.size() != now.points.along_modes_mm.size()) {
    throw std::invalid_argument("VelocityOfMaterial: frames of different grids or modes");
  }
  if (frame.contact.empty() != now.contact.empty() ||
      (!now.contact.empty() && frame.contact.size() != now.points.size())) {
    throw std::invalid_argument("VelocityOfMaterial: contact is known in some frames only");
  }
  if (!frame.points.along_common_mm.empty()) {
    throw std::invalid_argument("VelocityOfMaterial: errors in common belong to the ground frame");
  }
  for (const Image<Eigen::Vector3f>& error : frame.along_own_mm) {
    if (error.size() != frame.points.size()) {
      throw std::invalid_argument("VelocityOfMaterial: errors of another grid");
    }
  }
}

void CheckOrder(const MaterialFrame& earlier, const MaterialFrame& later) {
  if (later.time_s > earlier.time_s) return;
  throw InputError(
      "the velocity of a wheel's material needs frames in the order of their times; check the "
      "timestamps");
}

using GroundErrors = std::array<Eigen::Matrix<double, 6, Eigen::Dynamic>, 3>;

// As they are given, or each frame's own.
GroundErrors GroundErrorsOf(const FrameTriple& frames) {
  GroundErrors errors = frames.ground_errors;
  const std::array<const MaterialFrame*, 3> all = {frames.before, frames.now, frames.after};
  const bool given = errors[kNow].cols() > 0;
  for (std::size_t f = 0; f < 3; ++f) {
    if (given && all[f] != nullptr && errors[f].cols() != errors[kNow].cols()) {
      throw std::invalid_argument("VelocityOfMaterial: ground frames with different errors");
    }
    if (given) continue;
    errors[f].setZero(6, 18);
    if (all[f] == nullptr) continue;
    errors[f].middleCols<6>(6 * static_cast<Eigen::Index>(f)) = all[f]->ground.Root();
  }
  return errors;
}

// The frames with their points told in the ground frames of their own moments.
class Triple {
 public:
  explicit Triple(const FrameTriple& frames) : frames_{frames.before, frames.now, frames.after} {
    if (frames.now == nullptr || (frames.before == nullptr && frames.after == nullptr)) {
      throw std::invalid_argument("VelocityOfMaterial: a frame and a neighbour are needed");
    }
    for (int f = 0; f < 3; ++f) {
      if (at(f) == nullptr) continue;
      CheckFrame(*at(f), *frames.now);
      ground_[static_cast<std::size_t>(f)] = InFrame(at(f)->points, at(f)->ground);
    }
    if (frames.before != nullptr) CheckOrder(*frames.before, *frames.now);
    if (frames.after != nullptr) CheckOrder(*frames.now, *frames.after);
    errors_ = GroundErrorsOf(frames);
  }

  const MaterialFrame* at(int f) const { return frames_[static_cast<std::size_t>(f)]; }
  const SurfacePoints& ground(int f) const { return ground_[static_cast<std::size_t>(f)]; }
  const GroundErrors& ground_errors() const { return errors_; }

 private:
  std::array<const MaterialFrame*, 3> frames_;
  std::array<SurfacePoints, 3> ground_;
  GroundErrors errors_;
};

template <typename Points>
Eigen::Vector3d Interpolated(const std::vector<Share>& shares, const Points& points) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Share& s : shares) sum += s.share * points.data()[s.place].template cast<double>();
  return sum;
}

class Velocities {
 public:
  Velocities(const Triple& triple, const MaterialVelocityOptions& options) : triple_(triple) {
    const ImageSize size = triple.ground(kNow).size();
    v_.value_mm_s = v_.before_mm_s = v_.after_mm_s = v_.per_s = Image<Eigen::Vector3d>(size, kNone);
    v_.from = Image<VelocityFrom>(size, VelocityFrom::kNone);
    for (auto& shares : v_.shares) shares.resize(v_.per_s.pixel_count());
    for (const int f : {kBefore, kNow, kAfter}) {
      if (triple.at(f) != nullptr) FindMaterial(f, options.reach_mm);
    }
    if (triple.at(kBefore) != nullptr) by_before_ = WeightsOf(kBefore, kNow);
    if (triple.at(kAfter) != nullptr) by_after_ = WeightsOf(kNow, kAfter);
    if (triple.at(kBefore) != nullptr && triple.at(kAfter) != nullptr) {
      by_both_ = WeightsOf(kBefore, kAfter);
    }
    ForEachIndex(v_.per_s.pixel_count(), [&](std::size_t i) { SetVelocity(i); });
    SetGroundErrors(triple.ground_errors());
    for (int f = 0; f < 3; ++f) SetOwnErrors(f);
    SetModes();
  }

  MaterialVelocity& result() { return v_; }

 private:
  std::vector<Share>& SharesOf(int f, std::size_t i) {
    return v_.shares[static_cast<std::size_t>(f)][i];
  }

  void FindMaterial(int f, double reach_mm) {
    const MaterialLookup lookup(triple_.at(f)->material, triple_.ground(f).point_mm, reach_mm);
    const Image<Eigen::Vector3d>& material = triple_.at(kNow)->material;
    ForEachIndex(material.pixel_count(), [&](std::size_t i) {
      if (!triple_.ground(kNow).point_mm.data()[i].allFinite()) return;
      for (const auto& [place, share] : lookup.SharesAt(material.data()[i])) {
        SharesOf(f, i).push_back({place, share});
      }
      if (f == kNow && SharesOf(f, i).empty()) SharesOf(f, i) = {{i, 1.0}};
    });
  }

  bool Touches(int f, std::size_t i) {
    double sum = 0;
    for (const Share& s : SharesOf(f, i)) sum += s.share * triple_.at(f)->contact.data()[s.place];
    return sum > 0.5;
  }

  // By which places of the three frames make a velocity, from `first` to `last`.
  Eigen::Vector3d WeightsOf(int first, int last) const {
    Eigen::Vector3d weights = Eigen::Vector3d::Zero();
    std::vector<double> times;
    for (int f = first; f <= last; ++f) times.push_back(triple_.at(f)->time_s);
    const std::vector<double> slope =
        internal::SlopeWeights(times, static_cast<std::size_t>(kNow - first));
    for (int f = first; f <= last; ++f) weights[f] = slope[static_cast<std::size_t>(f - first)];
    return weights;
  }

  void SetVelocity(std::size_t i) {
    // Of this frame, too, told by the points around, so that a curve takes all three to the same
    // side: from one neighbour alone that would be taken for a motion.
    Eigen::Matrix3d places = Eigen::Matrix3d::Zero();
    for (int f = 0; f < 3; ++f) {
      if (!SharesOf(f, i).empty()) {
        places.col(f) = Interpolated(SharesOf(f, i), triple_.ground(f).point_mm);
      }
    }
    bool before = !SharesOf(kBefore, i).empty(), after = !SharesOf(kAfter, i).empty();
    if (before) v_.before_mm_s.data()[i] = places * by_before_;
    if (after) v_.after_mm_s.data()[i] = places * by_after_;
    const Image<std::uint8_t>& contact = triple_.at(kNow)->contact;
    if (before && after && !contact.empty() && contact.data()[i] != 0) {
      const bool touched = Touches(kBefore, i), will_touch = Touches(kAfter, i);
      if (touched != will_touch) (touched ? after : before) = false;
    }
    if (!before && !after) return;
    v_.from.data()[i] = before && after ? VelocityFrom::kBoth
                        : before        ? VelocityFrom::kBefore
                                        : VelocityFrom::kAfter;
    v_.per_s.data()[i] = before && after ? by_both_ : before ? by_before_ : by_after_;
    v_.value_mm_s.data()[i] = places * v_.per_s.data()[i];
  }

  // What an error does to the velocities that moves a point i of frame f by of(f, i).
  template <typename Of>
  Image<Eigen::Vector3f> Combined(const Of& of) {
    Image<Eigen::Vector3f> sum(v_.size(), kNone.cast<float>());
    ForEachIndex(sum.pixel_count(), [&](std::size_t i) {
      if (v_.from.data()[i] == VelocityFrom::kNone) return;
      Eigen::Vector3d total = Eigen::Vector3d::Zero();
      for (int f = 0; f < 3; ++f) {
        const double by = v_.per_s.data()[i][f];
        if (by != 0) total += by * Eigen::Vector3d(of(f, i));
      }
      sum.data()[i] = total.cast<float>();
    });
    return sum;
  }

  void SetGroundErrors(const GroundErrors& errors) {
    for (Eigen::Index k = 0; k < errors[kNow].cols(); ++k) {
      v_.along_common_mm_s.push_back(Combined([&](int f, std::size_t i) -> Eigen::Vector3d {
        const auto error = errors[static_cast<std::size_t>(f)].col(k);
        const Eigen::Vector3d turn = error.head<3>(), shift = error.tail<3>();
        return turn.cross(Interpolated(SharesOf(f, i), triple_.ground(f).point_mm)) + shift;
      }));
      v_.turn_along_common_rad.emplace_back(errors[kNow].col(k).head<3>());
    }
  }

  void SetOwnErrors(int frame) {
    if (triple_.at(frame) == nullptr) return;
    const Eigen::Matrix3d& turn = triple_.at(frame)->ground.frame_from_rig.rotation;
    for (const Image<Eigen::Vector3f>& error : triple_.at(frame)->along_own_mm) {
      v_.along_common_mm_s.push_back(Combined([&](int f, std::size_t i) -> Eigen::Vector3d {
        if (f != frame) return Eigen::Vector3d::Zero();
        return turn * Interpolated(SharesOf(f, i), error);
      }));
      v_.turn_along_common_rad.emplace_back(Eigen::Vector3d::Zero());
    }
  }

  void SetModes() {
    std::array<const Image<Eigen::Vector3f>*, 3> errors{};
    const UncertainFrame& ground = triple_.at(kNow)->ground;
    for (std::size_t k = 0; k < triple_.ground(kNow).along_modes_mm.size(); ++k) {
      for (int f = 0; f < 3; ++f) {
        if (triple_.at(f) == nullptr) continue;
        errors[static_cast<std::size_t>(f)] = &triple_.ground(f).along_modes_mm[k];
      }
      v_.along_modes_mm_s.push_back(Combined([&](int f, std::size_t i) {
        return Interpolated(SharesOf(f, i), *errors[static_cast<std::size_t>(f)]);
      }));
      Eigen::Vector3d turn = Eigen::Vector3d::Zero();
      if (!ground.along_modes.empty()) {
        turn = (ground.along_modes[k] * ground.frame_from_rig.Inverse()).RotationVector();
      }
      v_.turn_along_modes_rad.push_back(turn);
    }
  }

  const Triple& triple_;
  // By which places of the three frames make velocities; 0 where the frames are not there.
  Eigen::Vector3d by_before_ = Eigen::Vector3d::Zero(), by_after_ = by_before_,
                  by_both_ = by_before_;
  MaterialVelocity v_;
};

// The covariance of a weighted sum of velocities from the independent noise of the points.
Eigen::Matrix3d IndependentCovarianceOfSum(const MaterialVelocity& v,
                                           const std::array<const SurfacePoints*, 3>& in_rig,
                                           const std::vector<std::pair<std::size_t, double>>& sum,
                                           const std::array<Eigen::Matrix3d, 3>& turns,
                                           const NeighbourCorrelation& neighbours) {
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (std::size_t f = 0; f < 3; ++f) {
    if (in_rig[f] == nullptr) continue;
    std::vector<std::pair<std::size_t, double>> by_place;
    for (const auto& [i, weight] : sum) {
      const double by = weight * v.per_s.data()[i][static_cast<Eigen::Index>(f)];
      if (by == 0) continue;
      for (const Share& s : v.shares[f][i]) by_place.emplace_back(s.place, by * s.share);
    }
    std::sort(by_place.begin(), by_place.end());
    std::vector<PointChange> changes;
    for (const auto& [place, by] : by_place) {
      if (changes.empty() || changes.back().place != place) {
        changes.push_back({place, Eigen::Matrix3d::Zero()});
      }
      changes.back().change += by * turns[f];
    }
    if (!changes.empty()) covariance += IndependentCovariance(changes, *in_rig[f], neighbours);
  }
  return covariance;
}

struct Sources {
  std::array<const SurfacePoints*, 3> points{};
  std::array<Eigen::Matrix3d, 3> turns;

  explicit Sources(const FrameTriple& frames) {
    const std::array<const MaterialFrame*, 3> all = {frames.before, frames.now, frames.after};
    for (std::size_t f = 0; f < 3; ++f) {
      turns[f].setIdentity();
      if (all[f] == nullptr) continue;
      points[f] = &all[f]->points;
      turns[f] = all[f]->ground.frame_from_rig.rotation;
    }
  }
};

}  // namespace

void MaterialVelocityOptions::Check() const {
  if (!(reach_mm >= 0) || !std::isfinite(reach_mm)) {
    throw UsageError("The reach over which material is looked for has to be 0 mm or more.");
  }
}

MaterialVelocity VelocityOfMaterial(const FrameTriple& frames,
                                    const NeighbourCorrelation& neighbours,
                                    const MaterialVelocityOptions& options) {
  options.Check();
  const Triple triple(frames);
  Velocities velocities(triple, options);
  MaterialVelocity velocity = std::move(velocities.result());
  const Sources sources(frames);
  using Cov = Eigen::Matrix<float, 6, 1>;
  velocity.cov_random_mm2_s2 =
      Image<Cov>(velocity.size(), Cov::Constant(std::numeric_limits<float>::quiet_NaN()));
  ForEachRange(velocity.per_s.pixel_count(), [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (velocity.from.data()[i] == VelocityFrom::kNone) continue;
      velocity.cov_random_mm2_s2.data()[i] = TriangleOf(IndependentCovarianceOfSum(
          velocity, sources.points, {{i, 1.0}}, sources.turns, neighbours));
    }
  });
  return velocity;
}

MeanVelocity MeanOf(const MaterialVelocity& velocity, const FrameTriple& frames,
                    const Image<double>& weight, const NeighbourCorrelation& neighbours) {
  MeanVelocity mean;
  std::vector<std::pair<std::size_t, double>> sum;
  std::vector<PointChange> changes;
  for (std::size_t i = 0; i < weight.pixel_count(); ++i) {
    if (weight.data()[i] == 0) continue;
    sum.emplace_back(i, weight.data()[i]);
    changes.push_back({i, weight.data()[i] * Eigen::Matrix3d::Identity()});
    mean.value_mm_s += weight.data()[i] * velocity.value_mm_s.data()[i];
  }
  const Sources sources(frames);
  mean.cov_independent =
      IndependentCovarianceOfSum(velocity, sources.points, sum, sources.turns, neighbours);
  mean.along_common = ChangeAlong(changes, velocity.along_common_mm_s);
  mean.along_modes = ChangeAlong(changes, velocity.along_modes_mm_s);
  return mean;
}

}  // namespace plumbline
