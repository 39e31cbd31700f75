#include "track/right_delay_estimate.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <optional>
#include <vector>

#include "calib/median.h"
#include "calib/triangulate.h"
#include "track/camera_motion.h"

namespace plumbline {
namespace {

constexpr Eigen::Index kPose = 5;  // directions of the right camera's motion

using Pixels = std::vector<Eigen::Vector2d>;

// Signed distances from the epipolar lines (px).
Eigen::VectorXd EpipolarOf(const StereoRig& rig, const Pixels& left, const Pixels& right) {
  std::vector<StereoObservation> observations(left.size());
  for (std::size_t i = 0; i < left.size(); ++i) observations[i] = {left[i], right[i]};
  const std::vector<TriangulatedPoint> points = Triangulate(rig, observations);
  Eigen::VectorXd distances(static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) {
    distances[static_cast<Eigen::Index>(i)] = points[i].epipolar_px;
  }
  return distances;
}

Pixels Moved(Pixels pixels, const Pixels& along, double by) {
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] += by * along[i];
  return pixels;
}

// d distance / d turn (px a radian).
Eigen::VectorXd AlongTurn(const StereoRig& rig, const Pixels& left, const Pixels& right,
                          const Pixels& flow_px) {
  constexpr double kStep_rad = 1e-4;
  return (EpipolarOf(rig, left, Moved(right, flow_px, kStep_rad)) -
          EpipolarOf(rig, left, Moved(right, flow_px, -kStep_rad))) /
         (2 * kStep_rad);
}

// d distance / d motion of the right camera: turns, and shifts across the baseline. Of a size that
// does about as much each.
Eigen::MatrixXd AlongPose(const StereoRig& rig, const Pixels& left, const Pixels& right) {
  const Eigen::Vector3d along = rig.right_from_left.translation_mm.normalized();
  const Eigen::Vector3d across = along.unitOrthogonal();
  constexpr double kTurn_rad = 1e-5;
  const double shift_mm = kTurn_rad * rig.baseline_mm();
  const Eigen::VectorXd here = EpipolarOf(rig, left, right);
  Eigen::MatrixXd columns(here.size(), kPose);
  for (Eigen::Index k = 0; k < kPose; ++k) {
    Eigen::Matrix<double, 6, 1> motion = Eigen::Matrix<double, 6, 1>::Zero();
    if (k < 3) {
      motion[k] = kTurn_rad;
    } else {
      motion.tail<3>() = shift_mm * (k == 3 ? across : along.cross(across));
    }
    StereoRig there = rig;
    there.right_from_left = PoseAfter(motion, rig.right_from_left);
    columns.col(k) = EpipolarOf(there, left, right) - here;
  }
  return columns;
}

struct FrameEstimate {
  double delay_s = 0, sigma_s = 0;
  Eigen::VectorXd along_modes_s;
};

class EstimateOfRun {
 public:
  EstimateOfRun(const WheelReference& reference, const RollingWheel& rolling, int subset_px)
      : reference_(reference), rolling_(rolling) {
    for (int k = 0; k < reference.rig.modes.count(); ++k) {
      // Modes that move no camera, as the carcass's, change nothing here.
      if (!reference.rig.modes.modes.row(k).isZero()) along_.push_back(reference.rig.AlongMode(k));
    }
    const double share = static_cast<double>(subset_px) / std::max(1, rolling.spacing_px);
    alike_ = std::max(1.0, share * share);
  }

  // Nothing where the frame's points do not tell it.
  std::optional<FrameEstimate> Of(const RollingFrame& frame) const;

 private:
  const WheelReference& reference_;
  const RollingWheel& rolling_;
  std::vector<StereoRig> along_;
  double alike_ = 1;  // points that share one noise
};

std::optional<FrameEstimate> EstimateOfRun::Of(const RollingFrame& frame) const {
  constexpr std::size_t kLeast = 60;
  Pixels left, right, flow, view_right;
  for (const RollingPoint& p : frame.points) {
    if (!p.view_right_px.allFinite()) continue;
    left.push_back(p.left_px);
    right.push_back(p.right_px);
    flow.push_back(p.right_flow_px);
    view_right.push_back(p.view_right_px);
  }
  if (left.size() < kLeast || !std::isfinite(frame.speed_rad_s)) return std::nullopt;
  const StereoRig& rig = reference_.rig;
  const Eigen::VectorXd moves = frame.speed_rad_s * AlongTurn(rig, left, right, flow);
  const auto difference = [&](const StereoRig& by) -> Eigen::VectorXd {
    return EpipolarOf(by, left, right) - EpipolarOf(by, left, view_right);
  };
  // As it was before anything was moved back.
  const Eigen::VectorXd z = difference(rig) + rolling_.right_delay.value_s * moves;
  Eigen::MatrixXd X(z.size(), 1 + kPose);
  X.col(0) = moves;
  X.rightCols<kPose>() = AlongPose(rig, left, right);
  if (!z.allFinite() || !X.allFinite()) return std::nullopt;
  const Eigen::RowVectorXd scale = X.colwise().norm().cwiseMax(1e-300);
  X = X.array().rowwise() / scale.array();
  constexpr int kRounds = 10;
  constexpr double kCauchy = 2.4;  // of the scatter
  Eigen::VectorXd weight = Eigen::VectorXd::Ones(z.size());
  Eigen::VectorXd solution;
  double scatter_px = 0;
  Eigen::MatrixXd weighted;
  for (int round = 0; round < kRounds; ++round) {
    weighted = weight.asDiagonal() * X;
    solution = weighted.colPivHouseholderQr().solve(weight.cwiseProduct(z));
    const Eigen::VectorXd off = z - X * solution;
    std::vector<double> sizes(static_cast<std::size_t>(off.size()));
    for (Eigen::Index i = 0; i < off.size(); ++i)
      sizes[static_cast<std::size_t>(i)] = std::abs(off[i]);
    constexpr double kSigmaOfMedian = 1.4826;
    scatter_px = std::max(1e-9, kSigmaOfMedian * Median(std::move(sizes)));
    weight = (1 + (off / (kCauchy * scatter_px)).array().square()).rsqrt();
  }
  const Eigen::MatrixXd normal = weighted.transpose() * weighted;
  const Eigen::LLT<Eigen::MatrixXd> llt(normal);
  if (llt.info() != Eigen::Success || !(llt.rcond() > 1e-9)) return std::nullopt;
  const Eigen::MatrixXd inverse =
      llt.solve(Eigen::MatrixXd::Identity(normal.rows(), normal.cols()));
  FrameEstimate out;
  out.delay_s = solution[0] / scale[0];
  out.sigma_s = scatter_px * std::sqrt(alike_ * inverse(0, 0)) / scale[0];
  out.along_modes_s.resize(static_cast<Eigen::Index>(along_.size()));
  const Eigen::VectorXd here = difference(rig);
  for (std::size_t k = 0; k < along_.size(); ++k) {
    const Eigen::VectorXd change = weight.cwiseProduct(difference(along_[k]) - here);
    out.along_modes_s[static_cast<Eigen::Index>(k)] =
        inverse.row(0).dot(weighted.transpose() * change) / scale[0];
  }
  return out;
}

// What the frames of one view say: they share its errors, so that more of them are no surer.
struct ViewEstimate {
  double sum_s = 0, sum_variance_s2 = 0;
  int frames = 0;

  double delay_s() const { return sum_s / frames; }
  double weight() const { return frames / sum_variance_s2; }
};

}  // namespace

RightDelayEstimate EstimateRightDelay(const WheelReference& reference, const RollingWheel& rolling,
                                      std::span<const std::uint8_t> steady, int subset_px) {
  constexpr std::size_t kMostFrames = 48;
  RightDelayEstimate out;
  std::vector<std::size_t> usable;
  for (std::size_t f = 0; f < rolling.frames.size(); ++f) {
    if (steady[f] != 0 && rolling.frames[f].status == RollingFrameStatus::kPlaced) {
      usable.push_back(f);
    }
  }
  const EstimateOfRun run(reference, rolling, subset_px);
  const std::size_t count = std::min(usable.size(), kMostFrames);
  std::map<std::size_t, ViewEstimate> views;
  Eigen::VectorXd along_s;
  for (std::size_t n = 0; n < count; ++n) {
    const RollingFrame& frame = rolling.frames[usable[n * usable.size() / count]];
    const std::optional<FrameEstimate> one = run.Of(frame);
    if (!one) continue;
    ViewEstimate& view = views[frame.view];
    view.sum_s += one->delay_s;
    view.sum_variance_s2 += one->sigma_s * one->sigma_s;
    ++view.frames;
    if (out.frames++ == 0) {
      along_s = one->along_modes_s;
    } else {
      along_s += one->along_modes_s;
    }
  }
  if (out.frames == 0) {
    out.problem =
        "no frame on flat ground has a time and points enough to tell whether both cameras expose "
        "together";
    return out;
  }
  double sum = 0, weights = 0;
  for (const auto& [number, view] : views) {
    sum += view.weight() * view.delay_s();
    weights += view.weight();
  }
  out.found = true;
  out.value_s = sum / weights;
  double contradiction = 0;
  for (const auto& [number, view] : views) {
    contradiction += std::pow(view.weight() / weights * (view.delay_s() - out.value_s), 2);
  }
  const auto n = static_cast<double>(views.size());
  if (n > 1) contradiction *= n / (n - 1);
  constexpr double kFlow = 0.03;
  out.sigma_s = std::sqrt(std::max(1 / weights, contradiction) +
                          (along_s / out.frames).squaredNorm() + std::pow(kFlow * out.value_s, 2));
  return out;
}

}  // namespace plumbline
