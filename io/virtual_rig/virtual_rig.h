#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "io/image_source.h"
#include "io/virtual_rig/scenario.h"
#include "io/virtual_rig/surface_view.h"

namespace plumbline {

// What is true of one material point at the moment of a frame's left exposure (its middle). Ground
// frame; see TyreSurface and SpecimenOptions for where that is.
struct TruePoint {
  Eigen::Vector2d material_mm{0, 0};
  Eigen::Vector3d position_mm{0, 0, 0};
  Eigen::Vector3d normal{0, 0, 1};
  Eigen::Vector3d displacement_mm{0, 0, 0};  // from the undeformed state
  Eigen::Vector3d green_lagrange{0, 0, 0};   // xx, yy, xy in the material axes
  // Relative to the ground: in a tyre the ground frame travels along, and its speed is added.
  Eigen::Vector3d velocity_mm_s{0, 0, 0};
  Eigen::Vector2d left_px{0, 0}, right_px{0, 0};  // NaN behind a camera
  bool in_left = false, in_right = false;         // inside of the image
  bool hidden_in_left = false, hidden_in_right = false;
};

enum class Side { kLeft, kRight };

// One moment of a frame, for asking many points.
class TrueFrame {
 public:
  virtual ~TrueFrame() = default;
  // The nearest material under a pixel of the left image; nothing where there is none, or where the
  // specimen has ended.
  virtual std::optional<TruePoint> UnderLeftPixel(const Eigen::Vector2d& pixel) const = 0;
  virtual TruePoint OfMaterial(const Eigen::Vector2d& material_mm) const = 0;
  virtual Rigid3 ground_from_rig() const = 0;
  virtual Rigid3 right_from_left() const = 0;
};

// A scenario come to life: the images that its cameras would take, and the truth of them.
//
// Frame i is exposed around time i / frames_per_second, the right one right_delay_s later. The same
// images for any number of threads. Immutable and thread-safe.
class VirtualRig {
 public:
  // Throws UsageError naming a broken constraint of the scenario.
  explicit VirtualRig(Scenario scenario);
  ~VirtualRig();

  const Scenario& scenario() const;
  const MaterialSurface& surface() const;
  const TyreSurface* tyre() const;  // null in the laboratory

  double FrameTime(int frame) const;
  bool IsDropped(int frame) const;
  // The frames that are not dropped, in order: what a recording holds.
  std::vector<int> Recorded() const;
  Rigid3 GroundFromRig(double time_s) const;
  Rigid3 RightFromLeft(double time_s) const;

  // The noise-free image in grey levels at 8 bits' scale, above the sensor's black level.
  Image<float> MeanImage(int frame, Side side) const;
  GrayImage TakeImage(int frame, Side side) const;

  // The rig must outlive it.
  std::unique_ptr<const TrueFrame> Truth(int frame) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

// The recording as a source of stereo pairs, dropped frames missing. `frames` as in
// ImageSourceOptions, counted over what was recorded.
std::unique_ptr<ImageSource> OpenVirtualRig(std::shared_ptr<const VirtualRig> rig,
                                            const std::string& frames = "");

}  // namespace plumbline
