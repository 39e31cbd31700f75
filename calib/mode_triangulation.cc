#include "calib/mode_triangulation.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "calib/internal/common_perpendicular.h"
#include "calib/internal/ray_table.h"
#include "calib/triangulate.h"

namespace plumbline {
namespace {

using internal::ModeVectors;
using internal::RayTable;
using internal::TurnedCamera;
using Lanes = ModeVectors::Lanes;

constexpr std::size_t kGrain = 512;  // points that pay for a task
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

ModeVectors Same(const Eigen::Vector3d& v) {
  const Eigen::Vector3f f = v.cast<float>();
  return {Lanes::Constant(f.x()), Lanes::Constant(f.y()), Lanes::Constant(f.z())};
}
ModeVectors operator+(const ModeVectors& a, const ModeVectors& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
ModeVectors operator-(const ModeVectors& a, const ModeVectors& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
ModeVectors operator*(const Lanes& s, const ModeVectors& a) { return {s * a.x, s * a.y, s * a.z}; }
Lanes Dot(const ModeVectors& a, const ModeVectors& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
ModeVectors Cross(const ModeVectors& a, const ModeVectors& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// One point at the rig itself, its rays in the rig frame.
class NominalPoint {
 public:
  NominalPoint(const Eigen::Vector3d& f0, const Eigen::Vector3d& f1, const Eigen::Vector3d& centre)
      : f0_(Same(f0)), f1_(Same(f1)) {
    double depth0 = 0, depth1 = 0;
    valid_ = internal::CommonPerpendicular(f0, f1, centre, &depth0, &depth1);
    if (!valid_) return;
    n_ = Same(f0.cross(f1));
    miss_ = Same(depth0 * f0 - depth1 * f1 - centre);
    depth0_ = Lanes::Constant(static_cast<float>(depth0));
    depth1_ = Lanes::Constant(static_cast<float>(depth1));
  }

  // Where it goes when its rays and the right camera's centre change; see the header.
  ModeVectors Move(const ModeVectors& df0, const ModeVectors& df1, const ModeVectors& dc) const {
    if (!valid_) return Same(Eigen::Vector3d::Constant(kNaN));
    const ModeVectors f0 = f0_ + df0;
    const ModeVectors f1 = f1_ + df1;
    const ModeVectors shift0 = depth0_ * df0;
    const ModeVectors shift1 = depth1_ * df1;
    const ModeVectors dW = shift0 - shift1 - dc;
    const Lanes u0 = -(Dot(df0, miss_) + Dot(f0, dW));
    const Lanes u1 = -(Dot(df1, miss_) + Dot(f1, dW));
    // |f0 x f1|^2 without the cancellation of nearly parallel rays.
    const ModeVectors n = n_ + Cross(df0, f1) + Cross(f0_, df1);
    const Lanes determinant = Dot(n, n);
    const Lanes between = Dot(f0, f1);
    const Lanes d_depth0 = (Dot(f1, f1) * u0 - between * u1) / determinant;
    const Lanes d_depth1 = (between * u0 - Dot(f0, f0) * u1) / determinant;
    const ModeVectors twice = shift0 + d_depth0 * f0 + dc + shift1 + d_depth1 * f1;
    constexpr auto kParallel2 =
        static_cast<float>(internal::kParallel_rad * internal::kParallel_rad);
    const Lanes good =
        (determinant > kParallel2 && depth0_ + d_depth0 > 0 && depth1_ + d_depth1 > 0)
            .select(Lanes::Constant(0.5F), Lanes::Constant(kNaN));
    return good * twice;
  }

 private:
  ModeVectors f0_, f1_, n_, miss_;
  Lanes depth0_, depth1_;
  bool valid_ = false;
};

}  // namespace

struct ModeTriangulation::Impl {
  StereoRig rig;
  std::vector<StereoRig> along;  // one a mode
  Eigen::Vector3d centre;        // of the right camera, in the rig
  std::vector<ModeVectors> centre_change;
  std::unique_ptr<const RayTable> left, right;

  explicit Impl(const StereoRig& nominal)
      : rig(nominal), centre(nominal.right_from_left.Inverse().translation_mm) {
    const int modes = rig.modes.count();
    std::vector<TurnedCamera> left_states, right_states;
    centre_change.resize(
        static_cast<std::size_t>((modes + ModeVectors::kLanes - 1) / ModeVectors::kLanes),
        Same(Eigen::Vector3d::Zero()));
    for (int k = 0; k < modes; ++k) {
      along.push_back(rig.AlongMode(k));
      const Rigid3 left_from_right = along.back().right_from_left.Inverse();
      left_states.push_back({along.back().left});
      right_states.push_back({along.back().right, left_from_right.rotation});
      ModeVectors& block = centre_change[static_cast<std::size_t>(k / ModeVectors::kLanes)];
      const Eigen::Vector3f change = (left_from_right.translation_mm - centre).cast<float>();
      const int lane = k % ModeVectors::kLanes;
      block.x[lane] = change.x();
      block.y[lane] = change.y();
      block.z[lane] = change.z();
    }
    left = std::make_unique<const RayTable>(TurnedCamera{rig.left}, left_states);
    right = std::make_unique<const RayTable>(
        TurnedCamera{rig.right, rig.right_from_left.rotation.transpose()}, right_states);
  }

  // Points [0, n) of one task.
  void Evaluate(std::span<const Eigen::Vector2d> left_px, std::span<const Eigen::Vector2d> right_px,
                int first, int modes, std::span<Eigen::Vector3f> out) const {
    const int first_block = first / ModeVectors::kLanes;
    const auto blocks = static_cast<std::size_t>(
        (first + modes + ModeVectors::kLanes - 1) / ModeVectors::kLanes - first_block);
    std::vector<ModeVectors> df0(blocks), df1(blocks);
    std::vector<std::size_t> outright;
    for (std::size_t i = 0; i < left_px.size(); ++i) {
      Eigen::Vector3d f0, f1;
      if (!left->Look(left_px[i], first_block, df0, &f0) ||
          !right->Look(right_px[i], first_block, df1, &f1)) {
        outright.push_back(i);
        continue;
      }
      const NominalPoint point(f0, f1, centre);
      Eigen::Vector3f* const to = out.data() + i * static_cast<std::size_t>(modes);
      for (std::size_t b = 0; b < blocks; ++b) {
        const std::size_t block = static_cast<std::size_t>(first_block) + b;
        const ModeVectors moved = point.Move(df0[b], df1[b], centre_change[block]);
        const int k0 = static_cast<int>(block) * ModeVectors::kLanes;
        for (int k = std::max(k0, first); k < std::min(k0 + ModeVectors::kLanes, first + modes);
             ++k) {
          to[k - first] = {moved.x[k - k0], moved.y[k - k0], moved.z[k - k0]};
        }
      }
    }
    if (!outright.empty()) Outright(outright, left_px, right_px, first, modes, out);
  }

  void Outright(std::span<const std::size_t> points, std::span<const Eigen::Vector2d> left_px,
                std::span<const Eigen::Vector2d> right_px, int first, int modes,
                std::span<Eigen::Vector3f> out) const {
    std::vector<Eigen::Vector2d> q0, q1;
    for (const std::size_t i : points) {
      q0.push_back(left_px[i]);
      q1.push_back(right_px[i]);
    }
    const std::vector<Eigen::Vector3d> nominal = TriangulatePoints(rig, q0, q1);
    for (int m = 0; m < modes; ++m) {
      const std::vector<Eigen::Vector3d> moved =
          TriangulatePoints(*(along.begin() + first + m), q0, q1);
      for (std::size_t j = 0; j < points.size(); ++j) {
        out[points[j] * static_cast<std::size_t>(modes) + static_cast<std::size_t>(m)] =
            (moved[j] - nominal[j]).cast<float>();
      }
    }
  }
};

ModeTriangulation::ModeTriangulation(const StereoRig& rig)
    : impl_(std::make_shared<const Impl>(rig)) {}

int ModeTriangulation::count() const { return impl_->rig.modes.count(); }

void ModeTriangulation::Differences(std::span<const Eigen::Vector2d> left,
                                    std::span<const Eigen::Vector2d> right,
                                    std::span<Eigen::Vector3f> out) const {
  Differences(left, right, 0, count(), out);
}

void ModeTriangulation::Differences(std::span<const Eigen::Vector2d> left,
                                    std::span<const Eigen::Vector2d> right, int first, int modes,
                                    std::span<Eigen::Vector3f> out) const {
  if (first < 0 || modes < 0 || first + modes > count()) {
    throw std::invalid_argument("ModeTriangulation: modes " + std::to_string(first) + " to " +
                                std::to_string(first + modes - 1) + " of " +
                                std::to_string(count()));
  }
  const auto per_point = static_cast<std::size_t>(modes);
  if (left.size() != right.size() || out.size() != left.size() * per_point) {
    throw std::invalid_argument("ModeTriangulation: " + std::to_string(left.size()) +
                                " left pixels, " + std::to_string(right.size()) +
                                " right ones and " + std::to_string(out.size()) +
                                " differences of " + std::to_string(modes) + " modes");
  }
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, left.size(), kGrain),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      impl_->Evaluate(
                          left.subspan(range.begin(), range.size()),
                          right.subspan(range.begin(), range.size()), first, modes,
                          out.subspan(range.begin() * per_point, range.size() * per_point));
                    });
}

}  // namespace plumbline
