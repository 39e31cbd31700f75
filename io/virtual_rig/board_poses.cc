#include "io/virtual_rig/board_poses.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <random>
#include <string>

#include "calib/error.h"
#include "io/virtual_rig/internal/board_view.h"

namespace plumbline {
namespace {

using internal::BoardView;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kGoldenAngle_rad = 2.399963229728653;  // spreads directions evenly at any count

// How a board is held, wherever it is.
struct Hold {
  double distance_mm = 0;
  double tilt_rad = 0;
  double tilt_direction_rad = 0;  // of the axis that it is tilted about, in the board
  double roll_rad = 0;
};

// How much a board may be rolled so that its points can still be told: see DetectBoard().
double LargestRoll(const BoardSpec& spec) {
  switch (spec.SymmetryOrder()) {
    case 4:
      return 10 * kDegree;
    case 2:
      return 25 * kDegree;
    default:
      return 30 * kDegree;
  }
}

// How often points have been in each part of each image.
class Coverage {
 public:
  explicit Coverage(const StereoRig& rig) : sizes_{rig.left.size(), rig.right.size()} {
    for (auto& counts : counts_) counts.assign(kColumns * kRows, 0);
  }

  // What a view adds: parts that were never seen count most.
  double Gain(const BoardView::Seen& seen) const {
    double gain = 0;
    for (std::size_t k = 0; k < 2; ++k) {
      for (const std::size_t part : Parts(seen, k)) gain += std::pow(0.4, counts_[k][part]);
    }
    return gain;
  }

  void Add(const BoardView::Seen& seen) {
    for (std::size_t k = 0; k < 2; ++k) {
      for (const std::size_t part : Parts(seen, k)) ++counts_[k][part];
    }
  }

 private:
  static constexpr std::size_t kColumns = 12, kRows = 9;

  std::vector<std::size_t> Parts(const BoardView::Seen& seen, std::size_t k) const {
    std::array<bool, kColumns * kRows> hit{};
    for (const Eigen::Vector2d& pixel : seen.pixels[k]) {
      const auto x = static_cast<std::size_t>((pixel.x() + 0.5) / sizes_[k].width * kColumns);
      const auto y = static_cast<std::size_t>((pixel.y() + 0.5) / sizes_[k].height * kRows);
      hit[std::min(y, kRows - 1) * kColumns + std::min(x, kColumns - 1)] = true;
    }
    std::vector<std::size_t> parts;
    for (std::size_t i = 0; i < hit.size(); ++i) {
      if (hit[i]) parts.push_back(i);
    }
    return parts;
  }

  std::array<ImageSize, 2> sizes_;
  std::array<std::vector<int>, 2> counts_;
};

class Drawer {
 public:
  Drawer(const StereoRig& rig, const BoardSpec& spec, const BoardPrint& print,
         const BoardPoseOptions& options)
      : rig_(rig),
        spec_(spec),
        options_(options),
        view_(rig, spec, print, options.edge_margin_px),
        left_from_right_(rig.right_from_left.Inverse()),
        face_(FacingBothCameras()),
        coverage_(rig),
        random_(options.seed) {}

  std::vector<Rigid3> Draw() {
    std::vector<Rigid3> poses = {Frontal()};
    coverage_.Add(*view_.Look(poses[0], BoardView::Need::kWhole));
    const double frontal_distance = (poses[0] * view_.middle_mm()).z();
    const std::vector<double> distances = SpreadDistances();
    for (int k = 1; k < options_.count; ++k) {
      const bool careless = options_.style == BoardPoseOptions::Style::kCareless;
      poses.push_back(careless ? Careless(frontal_distance)
                               : Careful(k, distances[static_cast<std::size_t>(k)]));
    }
    return poses;
  }

 private:
  double Uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }

  // left_from_board of a board that looks at both cameras alike, its rows along theirs.
  Eigen::Matrix3d FacingBothCameras() const {
    const Eigen::Matrix3d& R = left_from_right_.rotation;
    Eigen::Matrix3d face;
    const Eigen::Vector3d z = (Eigen::Vector3d::UnitZ() + R.col(2)).normalized();
    const Eigen::Vector3d x = Eigen::Vector3d::UnitX() + R.col(0);
    face.col(2) = z;
    face.col(0) = (x - x.dot(z) * z).normalized();
    face.col(1) = z.cross(face.col(0));
    return face;
  }

  Rigid3 PoseOf(const Hold& hold, const Eigen::Vector3d& place) const {
    const Eigen::Vector3d axis(std::cos(hold.tilt_direction_rad), std::sin(hold.tilt_direction_rad),
                               0);
    Rigid3 pose;
    pose.rotation = face_ * Eigen::AngleAxisd(hold.tilt_rad, axis).toRotationMatrix() *
                    Eigen::AngleAxisd(hold.roll_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    pose.translation_mm = place - pose.rotation * view_.middle_mm();
    return pose;
  }

  // The place (left frame) at a distance along the left axis that a pixel of a camera shows; NaN
  // where there is none.
  Eigen::Vector3d PlaceUnder(int camera, const Eigen::Vector2d& pixel, double distance_mm) const {
    Eigen::Vector3d from = Eigen::Vector3d::Zero();
    Eigen::Vector3d ray = (camera == 0 ? rig_.left : rig_.right).Unproject(pixel);
    if (camera == 1) {
      from = left_from_right_.translation_mm;
      ray = left_from_right_.rotation * ray;
    }
    return from + ray * ((distance_mm - from.z()) / ray.z());
  }

  // Half way between what the middles of the two images show.
  Eigen::Vector3d MiddleOfField(double distance_mm) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const int camera : {0, 1}) {
      const ImageSize size = (camera == 0 ? rig_.left : rig_.right).size();
      sum += PlaceUnder(camera, {0.5 * (size.width - 1), 0.5 * (size.height - 1)}, distance_mm);
    }
    return sum / 2;
  }

  Rigid3 Frontal() const;
  // What stood against the frontal poses.
  struct Obstacles {
    bool common_field = false, fits_somewhere = false, fits_nearest = false;
    double widest_px = 0;
  };
  [[noreturn]] void Refuse(const Obstacles& found) const;

  // One distance a pose, spread evenly over the range, in random order.
  std::vector<double> SpreadDistances() {
    std::vector<double> shares(static_cast<std::size_t>(options_.count));
    for (std::size_t i = 0; i < shares.size(); ++i) {
      shares[i] = (static_cast<double>(i) + Uniform(0, 1)) / static_cast<double>(shares.size());
    }
    std::shuffle(shares.begin(), shares.end(), random_);
    for (double& share : shares) {
      share =
          options_.min_distance_mm + share * (options_.max_distance_mm - options_.min_distance_mm);
    }
    return shares;
  }

  // The most useful place for a board held so, if there is one.
  std::optional<Rigid3> BestPlace(const Hold& hold, BoardView::Need need) {
    constexpr int kTries = 400, kEnough = 24;
    std::optional<Rigid3> best;
    BoardView::Seen best_seen;
    double best_gain = -1;
    for (int tries = 0, good = 0; tries < kTries && good < kEnough; ++tries) {
      const int camera = tries % 2;
      const ImageSize size = (camera == 0 ? rig_.left : rig_.right).size();
      const Eigen::Vector2d pixel(Uniform(0, size.width - 1), Uniform(0, size.height - 1));
      const Eigen::Vector3d place = PlaceUnder(camera, pixel, hold.distance_mm);
      if (!place.allFinite()) continue;
      const Rigid3 pose = PoseOf(hold, place);
      const auto seen = view_.Look(pose, need);
      if (!seen) continue;
      ++good;
      const double gain = coverage_.Gain(*seen);
      if (gain <= best_gain) continue;
      best = pose;
      best_seen = *seen;
      best_gain = gain;
    }
    if (best) coverage_.Add(best_seen);
    return best;
  }

  Rigid3 Careful(int k, double distance_mm) {
    const bool may_stick_out = view_.PartIsEnough() && k % 2 == 1;
    const auto need = may_stick_out ? BoardView::Need::kPart : BoardView::Need::kWhole;
    Hold hold{distance_mm, 0, kGoldenAngle_rad * k, 0};
    constexpr int kRounds = 50;
    for (int round = 0; round < kRounds; ++round) {
      hold.tilt_rad = Uniform(options_.min_tilt_rad, options_.max_tilt_rad);
      hold.roll_rad = Uniform(-1, 1) * LargestRoll(spec_);
      if (const auto pose = BestPlace(hold, need)) return *pose;
      hold.distance_mm = Uniform(options_.min_distance_mm, options_.max_distance_mm);
      hold.tilt_direction_rad = Uniform(-std::numbers::pi, std::numbers::pi);
    }
    throw InputError(fmt::format(
        "the board {} fits into both images only when it is held straight: between {:g} and {:g} "
        "mm it cannot be tilted by {:.0f} to {:.0f} deg and seen whole and large enough; take a "
        "smaller board or another range of distances",
        spec_.Word(), options_.min_distance_mm, options_.max_distance_mm,
        options_.min_tilt_rad / kDegree, options_.max_tilt_rad / kDegree));
  }

  Rigid3 Careless(double distance_mm) {
    for (double spread = 1; spread > 0.01; spread *= 0.9) {
      const Hold hold{distance_mm * (1 + 0.02 * spread * Uniform(-1, 1)),
                      7.5 * kDegree * spread * Uniform(0, 1),
                      Uniform(-std::numbers::pi, std::numbers::pi),
                      5 * kDegree * spread * Uniform(-1, 1)};
      const Eigen::Vector3d aside =
          0.03 * spread * hold.distance_mm * Eigen::Vector3d(Uniform(-1, 1), Uniform(-1, 1), 0);
      const Rigid3 pose = PoseOf(hold, MiddleOfField(hold.distance_mm) + aside);
      if (view_.Look(pose, BoardView::Need::kWhole)) return pose;
    }
    return PoseOf({distance_mm, 0, 0, 0}, MiddleOfField(distance_mm));
  }

  const StereoRig& rig_;
  const BoardSpec& spec_;
  const BoardPoseOptions& options_;
  BoardView view_;
  Rigid3 left_from_right_;
  Eigen::Matrix3d face_;
  Coverage coverage_;
  std::mt19937_64 random_;
};

// In the middle, as near to the middle of the distances as possible.
Rigid3 Drawer::Frontal() const {
  constexpr int kSteps = 20;
  Obstacles found;
  for (int step = 0; step <= kSteps; ++step) {
    // 1/2, then further and nearer in turn.
    const int away = (step + 1) / 2;
    const double offset = static_cast<double>(away) / kSteps;
    const double share = 0.5 + (step % 2 == 1 ? offset : -offset);
    const double distance =
        (1 - share) * options_.min_distance_mm + share * options_.max_distance_mm;
    const Eigen::Vector3d place = MiddleOfField(distance);
    if (!rig_.left.Contains(rig_.left.Project(place)) ||
        !rig_.right.Contains(rig_.right.Project(rig_.right_from_left * place))) {
      continue;
    }
    found.common_field = true;
    const Rigid3 pose = PoseOf({distance, 0, 0, 0}, place);
    if (view_.Look(pose, BoardView::Need::kWhole)) return pose;
    if (!view_.Fits(pose)) continue;
    found.fits_somewhere = true;
    found.fits_nearest = step == kSteps;
    found.widest_px = std::max(found.widest_px, view_.FeatureWidth(pose));
  }
  Refuse(found);
}

void Drawer::Refuse(const Obstacles& found) const {
  const std::string range =
      fmt::format("between {:g} and {:g} mm", options_.min_distance_mm, options_.max_distance_mm);
  if (!found.common_field) {
    throw InputError(fmt::format(
        "the two cameras have no field in common {}; check the rig and the distances", range));
  }
  if (!found.fits_somewhere) {
    throw InputError(fmt::format(
        "the board {} is too large for this rig: at no distance {} is all of it in both images; "
        "take a smaller board, or hold it further away",
        spec_.Word(), range));
  }
  throw InputError(fmt::format(
      "the board {} is too small for this rig: {}, where it fits into both images, its {} are at "
      "most {:.1f} px wide and detection needs {:g}; {}",
      spec_.Word(), range, view_.feature().name, found.widest_px, view_.feature().least_px,
      found.fits_nearest ? "take one with larger ones, or hold it nearer"
                         : "take one of the same size with fewer and larger ones"));
}

}  // namespace

void BoardPoseOptions::Check() const {
  if (count < 1) throw UsageError("the number of board poses must be at least 1");
  if (!(min_distance_mm > 0) || !(max_distance_mm >= min_distance_mm) ||
      !std::isfinite(max_distance_mm)) {
    throw UsageError(
        fmt::format("the distances of the board, {} to {} mm, must be positive and the first not "
                    "above the second",
                    min_distance_mm, max_distance_mm));
  }
  if (!(min_tilt_rad >= 0) || !(max_tilt_rad >= min_tilt_rad) || !(max_tilt_rad <= 60 * kDegree)) {
    throw UsageError(
        fmt::format("the tilts of the board, {:.1f} to {:.1f} deg, must be within 0 to 60 and the "
                    "first not above the second",
                    min_tilt_rad / kDegree, max_tilt_rad / kDegree));
  }
  if (!(edge_margin_px >= 0) || !std::isfinite(edge_margin_px)) {
    throw UsageError("the board's distance from the image's edge must not be negative, in px");
  }
}

std::vector<Rigid3> DrawBoardPoses(const StereoRig& rig, const BoardSpec& spec,
                                   const BoardPrint& print, const BoardPoseOptions& options) {
  options.Check();
  print.Check(spec);
  return Drawer(rig, spec, print, options).Draw();
}

}  // namespace plumbline
