#include "io/virtual_rig/surface_view.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

namespace plumbline {
namespace {

constexpr int kBufferPitch_px = 4;
constexpr int kMargin_px = 16;
constexpr double kMeshVertices = 40000;
constexpr double kFarthestStep_mm = 15;
// Neighbours in the buffer whose ranges differ by more than this share stand on both sides of an
// occluding edge.
constexpr float kEdgeShare = 0.05f;

const Eigen::Vector2d kNowhere =
    Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());

int BufferLength(int pixels) { return (pixels + 2 * kMargin_px) / kBufferPitch_px + 1; }

// Far outside of the image distortion may fold back into it: points (in the camera's frame) that
// are not on the ray of their place, of those named, are nowhere.
void DropFolded(const Camera& camera, const std::vector<Eigen::Vector3d>& points,
                const std::vector<std::size_t>& named, std::vector<Eigen::Vector2d>* at) {
  std::vector<Eigen::Vector2d> pixels;
  for (const std::size_t k : named) {
    pixels.push_back((*at)[k].array() * kBufferPitch_px - kMargin_px);
  }
  std::vector<Eigen::Vector3d> rays(pixels.size());
  camera.Unproject(pixels, rays);
  for (std::size_t n = 0; n < named.size(); ++n) {
    const Eigen::Vector3d& point = points[named[n]];
    if (!(rays[n].cross(point).norm() < 1e-3 * point.norm())) (*at)[named[n]] = kNowhere;
  }
}

}  // namespace

SurfaceView::SurfaceView(const Camera& camera, const Rigid3& camera_from_world,
                         const SurfaceInstant& surface, ImageSize buffer)
    : camera_(camera),
      camera_from_world_(camera_from_world),
      centre_in_world_(camera_from_world.Inverse().translation_mm),
      surface_(surface),
      buffer_(buffer) {}

SurfaceView::SurfaceView(const Camera& camera, const Rigid3& camera_from_world,
                         const SurfaceInstant& surface)
    : SurfaceView(camera, camera_from_world, surface,
                  {BufferLength(camera.size().width), BufferLength(camera.size().height)}) {
  Rasterise();
}

SurfaceView SurfaceView::WithoutDepth(const Camera& camera, const Rigid3& camera_from_world,
                                      const SurfaceInstant& surface) {
  return SurfaceView(camera, camera_from_world, surface, ImageSize{0, 0});
}

void SurfaceView::Rasterise() {
  const MaterialDomain w = surface_.Window();
  const double width = w.u_max - w.u_min, height = w.v_max - w.v_min;
  const double step = std::sqrt(width * height / kMeshVertices);
  const auto nu = static_cast<std::size_t>(std::max(8.0, std::ceil(width / step))) + 1;
  const auto nv = static_cast<std::size_t>(std::max(8.0, std::ceil(height / step))) + 1;
  std::vector<Eigen::Vector3d> points(nu * nv);
  std::vector<Guess> vertices(nu * nv);
  for (std::size_t j = 0; j < nv; ++j) {
    for (std::size_t i = 0; i < nu; ++i) {
      const Eigen::Vector2d m(
          w.u_min + width * static_cast<double>(i) / static_cast<double>(nu - 1),
          w.v_min + height * static_cast<double>(j) / static_cast<double>(nv - 1));
      const Eigen::Vector3d p = camera_from_world_ * surface_.At(m).position_mm;
      points[j * nu + i] = p;
      vertices[j * nu + i] = {static_cast<float>(m.x()), static_cast<float>(m.y()),
                              static_cast<float>(p.norm())};
    }
  }
  std::vector<Eigen::Vector2d> at(points.size());
  camera_.Project(points, at);
  const Eigen::Vector2d reach(camera_.size().width, camera_.size().height);
  for (Eigen::Vector2d& pixel : at) {
    const bool far = (pixel - reach / 2).cwiseAbs().maxCoeff() > 2 * reach.maxCoeff();
    pixel = far ? kNowhere : (pixel.array() + kMargin_px) / kBufferPitch_px;
  }
  std::vector<Triangle> triangles;
  std::vector<std::size_t> corners;
  for (std::size_t j = 0; j + 1 < nv; ++j) {
    for (std::size_t i = 0; i + 1 < nu; ++i) {
      const std::size_t a = j * nu + i, b = a + 1, c = a + nu, d = c + 1;
      for (const Triangle& triangle : {Bound(at, {a, b, c}), Bound(at, {b, d, c})}) {
        if (!triangle.Reaches()) continue;
        triangles.push_back(triangle);
        corners.insert(corners.end(), triangle.corner.begin(), triangle.corner.end());
      }
    }
  }
  std::sort(corners.begin(), corners.end());
  corners.erase(std::unique(corners.begin(), corners.end()), corners.end());
  DropFolded(camera_, points, corners, &at);
  for (const Triangle& triangle : triangles) Fill(at, vertices, triangle);
  MarkEdges();
}

// Where the sixteen places about a cell hold a surface nearer than its own four, that one may reach
// into it.
void SurfaceView::MarkEdges() {
  near_edge_ = Image<std::uint8_t>(buffer_.size());
  for (int y = 0; y < buffer_.height(); ++y) {
    for (int x = 0; x < buffer_.width(); ++x) {
      const std::vector<Guess> ring = GuessesAround(Eigen::Vector2d(x, y), 1);
      const std::vector<Guess> own = GuessesAround(Eigen::Vector2d(x, y), 0);
      if (ring.empty() || own.empty()) continue;
      near_edge_(y, x) = Nearest(own).range > Nearest(ring).range * (1 + kEdgeShare) ? 1 : 0;
    }
  }
}

// `at`: places in the buffer.
SurfaceView::Triangle SurfaceView::Bound(const std::vector<Eigen::Vector2d>& at,
                                         const std::array<std::size_t, 3>& corner) const {
  const Eigen::Vector2d &a = at[corner[0]], &b = at[corner[1]], &c = at[corner[2]];
  if (!a.allFinite() || !b.allFinite() || !c.allFinite()) return {corner, 0, -1, 0, -1};
  const Eigen::Array2d low = a.cwiseMin(b).cwiseMin(c).array().ceil();
  const Eigen::Array2d high = a.cwiseMax(b).cwiseMax(c).array().floor();
  return {corner, std::max(0, static_cast<int>(low.x())),
          std::min(buffer_.width() - 1, static_cast<int>(high.x())),
          std::max(0, static_cast<int>(low.y())),
          std::min(buffer_.height() - 1, static_cast<int>(high.y()))};
}

// Writes a triangle of the mesh into the depth buffer.
void SurfaceView::Fill(const std::vector<Eigen::Vector2d>& at, const std::vector<Guess>& vertices,
                       const Triangle& triangle) {
  const auto& [corner, x0, x1, y0, y1] = triangle;
  const Eigen::Vector2d q[3] = {at[corner[0]], at[corner[1]], at[corner[2]]};
  if (!q[0].allFinite() || !q[1].allFinite() || !q[2].allFinite()) return;
  const auto cross = [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return a.x() * b.y() - a.y() * b.x();
  };
  const double area = cross(q[1] - q[0], q[2] - q[0]);
  if (std::abs(area) < 1e-12) return;
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const Eigen::Vector2d p(x, y);
      const double b = cross(p - q[0], q[2] - q[0]) / area;
      const double c = cross(q[1] - q[0], p - q[0]) / area;
      const double a = 1 - b - c;
      if (a < -1e-9 || b < -1e-9 || c < -1e-9) continue;
      const Guess &A = vertices[corner[0]], &B = vertices[corner[1]], &C = vertices[corner[2]];
      const auto mix = [&](float ga, float gb, float gc) {
        return static_cast<float>(a * static_cast<double>(ga) + b * static_cast<double>(gb) +
                                  c * static_cast<double>(gc));
      };
      const Guess guess{mix(A.u, B.u, C.u), mix(A.v, B.v, C.v), mix(A.range, B.range, C.range)};
      Guess& there = buffer_(y, x);
      if (there.range < 0 || guess.range < there.range) there = guess;
    }
  }
}

// Newton's method across the ray: u, v such that the surface point has no part perpendicular to it.
// It converges quadratically, so that the step from an error of 1e-6 leaves one of 1e-12 times the
// curvature: the last step is taken along the tangents.
std::optional<SeenPoint> SurfaceView::Solve(const Eigen::Vector3d& ray_in_camera,
                                            const Eigen::Vector2d& guess) const {
  const Eigen::Vector3d ray = camera_from_world_.rotation.transpose() * ray_in_camera;
  Eigen::Matrix<double, 2, 3> across;
  across.row(0) = ray.unitOrthogonal().transpose();
  across.row(1) = ray.cross(across.row(0).transpose()).transpose();
  SeenPoint seen;
  seen.material_mm = guess;
  seen.ray_in_camera = ray_in_camera;
  double last_step = std::numeric_limits<double>::infinity();
  for (int iteration = 0; iteration < 10; ++iteration) {
    seen.surface = surface_.At(seen.material_mm);
    const Eigen::Matrix2d J = across * seen.surface.d_position_d_material;
    Eigen::Vector2d step = -J.inverse() * (across * (seen.surface.position_mm - centre_in_world_));
    const double length = step.norm();
    if (!std::isfinite(length) || (iteration > 4 && length > 2 * last_step)) return std::nullopt;
    if (length > kFarthestStep_mm) step *= kFarthestStep_mm / length;
    last_step = length;
    seen.material_mm += step;
    if (length > 1e-6) continue;
    seen.surface.position_mm += seen.surface.d_position_d_material * step;
    seen.range_mm = (seen.surface.position_mm - centre_in_world_).dot(ray);
    if (seen.range_mm <= 0) return std::nullopt;
    return seen;
  }
  return std::nullopt;
}

std::optional<SeenPoint> SurfaceView::Follow(const SeenPoint& before) const {
  auto seen = Solve(before.ray_in_camera, before.material_mm);
  const double share = static_cast<double>(kEdgeShare) * before.range_mm;
  if (seen && std::abs(seen->range_mm - before.range_mm) > share) seen.reset();
  return seen;
}

std::optional<SeenPoint> SurfaceView::Look(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector3d ray = camera_.Unproject(pixel);
  if (!ray.allFinite()) return std::nullopt;
  const Eigen::Vector2d at = (pixel.array() + kMargin_px) / kBufferPitch_px;
  const int x0 = static_cast<int>(std::floor(at.x())), y0 = static_cast<int>(std::floor(at.y()));
  const bool inside = x0 >= 0 && y0 >= 0 && x0 < buffer_.width() && y0 < buffer_.height();
  if (inside && near_edge_(y0, x0) != 0) return NearestHit(ray, GuessesAround(at, 1));
  std::vector<Guess> around = GuessesAround(at, 0);
  if (around.size() == 4 && std::all_of(around.begin(), around.end(), [&](const Guess& guess) {
        return guess.range < Nearest(around).range * (1 + kEdgeShare);
      })) {
    const double fx = at.x() - std::floor(at.x()), fy = at.y() - std::floor(at.y());
    const auto mix = [&](float Guess::*m) {
      return (1 - fy) * ((1 - fx) * static_cast<double>(around[0].*m) +
                         fx * static_cast<double>(around[1].*m)) +
             fy * ((1 - fx) * static_cast<double>(around[2].*m) +
                   fx * static_cast<double>(around[3].*m));
    };
    if (const auto seen = Solve(ray, {mix(&Guess::u), mix(&Guess::v)})) return seen;
  }
  if (const auto seen = NearestHit(ray, std::move(around))) return seen;
  return NearestHit(ray, GuessesAround(at, 1));
}

// What the buffer holds at the four places around one, or, with a ring more, at sixteen.
std::vector<SurfaceView::Guess> SurfaceView::GuessesAround(const Eigen::Vector2d& at,
                                                           int ring) const {
  const int x0 = static_cast<int>(std::floor(at.x())), y0 = static_cast<int>(std::floor(at.y()));
  std::vector<Guess> around;
  for (int y = std::max(0, y0 - ring); y <= std::min(buffer_.height() - 1, y0 + 1 + ring); ++y) {
    for (int x = std::max(0, x0 - ring); x <= std::min(buffer_.width() - 1, x0 + 1 + ring); ++x) {
      if (buffer_(y, x).range >= 0) around.push_back(buffer_(y, x));
    }
  }
  return around;
}

// At an occluding edge: one try for each surface that is about here, the nearest first.
std::optional<SeenPoint> SurfaceView::NearestHit(const Eigen::Vector3d& ray,
                                                 std::vector<Guess> guesses) const {
  while (!guesses.empty()) {
    const Guess front = Nearest(guesses);
    const float reach = front.range * (1 + kEdgeShare);
    const auto seen = Solve(ray, {front.u, front.v});
    if (seen && seen->range_mm < static_cast<double>(reach)) return seen;
    std::erase_if(guesses, [&](const Guess& guess) { return guess.range < reach; });
  }
  return std::nullopt;
}

const SurfaceView::Guess& SurfaceView::Nearest(const std::vector<Guess>& guesses) {
  return *std::min_element(guesses.begin(), guesses.end(),
                           [](const Guess& a, const Guess& b) { return a.range < b.range; });
}

Eigen::Vector2d SurfaceView::Project(const Eigen::Vector3d& point_in_world) const {
  return camera_.Project(camera_from_world_ * point_in_world);
}

bool SurfaceView::IsHidden(const Eigen::Vector3d& point_in_world) const {
  const auto seen = Look(Project(point_in_world));
  return seen && seen->range_mm < (point_in_world - centre_in_world_).norm() - 0.05;
}

}  // namespace plumbline
