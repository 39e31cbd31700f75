#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "calib/camera.h"
#include "calib/rigid3.h"
#include "io/virtual_rig/material_surface.h"

namespace plumbline {

// The material point under a pixel.
struct SeenPoint {
  Eigen::Vector2d material_mm;
  SurfacePoint surface;           // world frame
  double range_mm = 0;            // from the camera's centre
  Eigen::Vector3d ray_in_camera;  // unit
};

// What a camera sees of a surface at one moment: exact in both directions.
//
// A depth buffer of a mesh gives the first guess, Newton's method on the viewing ray the rest, to
// 1e-9 mm. The surface must outlive the view.
class SurfaceView {
 public:
  SurfaceView(const Camera& camera, const Rigid3& camera_from_world, const SurfaceInstant& surface);

  // The same view without the depth buffer: only Follow() and Project() may be asked. For a moment
  // shortly before or after that of another view.
  static SurfaceView WithoutDepth(const Camera& camera, const Rigid3& camera_from_world,
                                  const SurfaceInstant& surface);

  // The nearest material point on the viewing ray of a pixel (up to some pixels outside of the
  // image too); nothing where the ray meets no surface. Beyond the edge of the material, as far as
  // the surface is defined there, points are delivered as well: see MaterialDomain.
  std::optional<SeenPoint> Look(const Eigen::Vector2d& pixel) const;

  // What Look() would find at the pixel at which another view of the same camera saw `before`.
  // Nothing where the search fails or ends at another surface, 5 % nearer or farther.
  std::optional<SeenPoint> Follow(const SeenPoint& before) const;

  // Where a material point is in the image; NaN behind the camera. It may be outside of the image
  // or hidden.
  Eigen::Vector2d Project(const Eigen::Vector3d& point_in_world) const;

  // Whether something nearer lies on the line of sight to a point (tolerance: 0.05 mm).
  bool IsHidden(const Eigen::Vector3d& point_in_world) const;

  const Camera& camera() const { return camera_; }
  const Rigid3& camera_from_world() const { return camera_from_world_; }

 private:
  struct Guess {
    float u = 0, v = 0;
    float range = -1;  // negative: no surface
  };

  SurfaceView(const Camera& camera, const Rigid3& camera_from_world, const SurfaceInstant& surface,
              ImageSize buffer);
  void Rasterise();
  void MarkEdges();
  // Of the mesh, and the places of the buffer about it.
  struct Triangle {
    std::array<std::size_t, 3> corner;
    int x0, x1, y0, y1;
    bool Reaches() const { return x0 <= x1 && y0 <= y1; }
  };
  Triangle Bound(const std::vector<Eigen::Vector2d>& at,
                 const std::array<std::size_t, 3>& corner) const;
  void Fill(const std::vector<Eigen::Vector2d>& at, const std::vector<Guess>& vertices,
            const Triangle& triangle);
  std::vector<Guess> GuessesAround(const Eigen::Vector2d& at, int ring) const;
  std::optional<SeenPoint> NearestHit(const Eigen::Vector3d& ray_in_camera,
                                      std::vector<Guess> guesses) const;
  static const Guess& Nearest(const std::vector<Guess>& guesses);
  std::optional<SeenPoint> Solve(const Eigen::Vector3d& ray_in_camera,
                                 const Eigen::Vector2d& guess) const;

  Camera camera_;
  Rigid3 camera_from_world_;
  Eigen::Vector3d centre_in_world_;
  const SurfaceInstant& surface_;
  Image<Guess> buffer_;
  Image<std::uint8_t> near_edge_;  // 1: a nearer surface ends within a place or two of the buffer
};

}  // namespace plumbline
