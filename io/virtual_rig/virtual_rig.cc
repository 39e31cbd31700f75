#include "io/virtual_rig/virtual_rig.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "io/internal/frame_selection.h"
#include "io/virtual_rig/internal/mixed_seed.h"

namespace plumbline {
namespace {

// What tells the random streams of a frame apart.
enum Stream : std::uint64_t { kLeftNoise = 1, kRightNoise = 2, kBrightness = 3 };

std::uint64_t StreamOf(int frame, Stream stream) {
  return 4 * static_cast<std::uint64_t>(frame) + stream;
}

std::unique_ptr<const MaterialSurface> MakeSurface(const Scenario& scenario) {
  if (scenario.HasTyre()) {
    return std::make_unique<TyreSurface>(std::get<TyreOptions>(scenario.surface));
  }
  return MakeSpecimen(std::get<SpecimenOptions>(scenario.surface));
}

std::unique_ptr<const Albedo> MakeAlbedo(const Scenario& scenario, const MaterialDomain& domain) {
  auto speckle = MakeSpeckle(domain, scenario.speckle);
  if (!scenario.tags) return speckle;
  return MakeTaggedAlbedo(std::move(speckle), domain, *scenario.tags);
}

Scenario Checked(Scenario scenario) {
  scenario.Check();
  return scenario;
}

}  // namespace

struct VirtualRig::Impl {
  explicit Impl(Scenario s)
      : scenario(Checked(std::move(s))),
        surface(MakeSurface(scenario)),
        tyre(dynamic_cast<const TyreSurface*>(surface.get())),
        albedo(MakeAlbedo(scenario, surface->Domain())) {}

  Scenario scenario;
  std::unique_ptr<const MaterialSurface> surface;
  const TyreSurface* tyre;
  std::unique_ptr<const Albedo> albedo;
};

namespace {

class TrueFrameOfRig : public TrueFrame {
 public:
  TrueFrameOfRig(const VirtualRig& rig, double time_s)
      : rig_(rig),
        ground_from_rig_(rig.GroundFromRig(time_s)),
        right_from_left_(rig.RightFromLeft(time_s)),
        now_(rig.surface().At(time_s)),
        reference_(rig.surface().Reference(time_s)),
        left_(rig.scenario().rig.left, ground_from_rig_.Inverse(), *now_),
        right_(rig.scenario().rig.right, right_from_left_ * ground_from_rig_.Inverse(), *now_) {
    if (rig.tyre() != nullptr) travel_.x() = rig.tyre()->Wheel(time_s).speed_mm_s;
  }

  std::optional<TruePoint> UnderLeftPixel(const Eigen::Vector2d& pixel) const override {
    const auto seen = left_.Look(pixel);
    if (!seen) return std::nullopt;
    const MaterialDomain domain = rig_.surface().Domain();
    const Eigen::Vector2d& m = seen->material_mm;
    const bool within_u =
        std::isfinite(domain.period_u) || (m.x() >= domain.u_min && m.x() <= domain.u_max);
    if (!within_u || m.y() < domain.v_min || m.y() > domain.v_max) return std::nullopt;
    return OfMaterial(m);
  }

  TruePoint OfMaterial(const Eigen::Vector2d& material) const override {
    const SurfacePoint now = now_->At(material), reference = reference_->At(material);
    TruePoint point;
    point.material_mm = material;
    point.position_mm = now.position_mm;
    point.normal = now.Normal();
    point.displacement_mm = now.position_mm - reference.position_mm;
    point.green_lagrange = GreenLagrangeStrain(reference, now);
    point.velocity_mm_s = now_->Velocity(material) + travel_;
    point.left_px = left_.Project(now.position_mm);
    point.right_px = right_.Project(now.position_mm);
    point.in_left = left_.camera().Contains(point.left_px);
    point.in_right = right_.camera().Contains(point.right_px);
    point.hidden_in_left = point.in_left && left_.IsHidden(now.position_mm);
    point.hidden_in_right = point.in_right && right_.IsHidden(now.position_mm);
    return point;
  }

  Rigid3 ground_from_rig() const override { return ground_from_rig_; }
  Rigid3 right_from_left() const override { return right_from_left_; }

 private:
  const VirtualRig& rig_;
  Rigid3 ground_from_rig_, right_from_left_;
  std::unique_ptr<const SurfaceInstant> now_, reference_;
  SurfaceView left_, right_;
  Eigen::Vector3d travel_{0, 0, 0};
};

}  // namespace

VirtualRig::VirtualRig(Scenario scenario) : impl_(std::make_unique<Impl>(std::move(scenario))) {}
VirtualRig::~VirtualRig() = default;

const Scenario& VirtualRig::scenario() const { return impl_->scenario; }
const MaterialSurface& VirtualRig::surface() const { return *impl_->surface; }
const TyreSurface* VirtualRig::tyre() const { return impl_->tyre; }

double VirtualRig::FrameTime(int frame) const { return frame / impl_->scenario.frames_per_second; }

bool VirtualRig::IsDropped(int frame) const {
  const std::vector<int>& dropped = impl_->scenario.dropped;
  return std::find(dropped.begin(), dropped.end(), frame) != dropped.end();
}

std::vector<int> VirtualRig::Recorded() const {
  std::vector<int> recorded;
  for (int i = 0; i < impl_->scenario.frames; ++i) {
    if (!IsDropped(i)) recorded.push_back(i);
  }
  return recorded;
}

Rigid3 VirtualRig::GroundFromRig(double time_s) const {
  const Scenario& s = impl_->scenario;
  const Rigid3 mounting = Rigid3::FromRotationVector(s.motion.mounting_rad, {0, 0, 0});
  if (impl_->tyre == nullptr) return mounting * s.ground_from_rig;
  const TyreOptions& tyre = impl_->tyre->options();
  const WheelState wheel = impl_->tyre->Wheel(time_s);
  double pitch_rad = s.motion.flexure_rad_per_m_s2 * wheel.acceleration_mm_s2 / 1000;
  if (s.motion.wheelbase_mm > 0) {
    const double level = impl_->tyre->Wheel(0).level_height_mm;
    // The nose, and with it the front wheel, goes up: a turn from x to z, negative about y.
    pitch_rad -= std::atan((wheel.centre_height_mm - level) / s.motion.wheelbase_mm);
  }
  const Rigid3 pitch = Rigid3::FromRotationVector({0, pitch_rad, 0}, {0, 0, 0});
  const Rigid3 heading =
      Rigid3::FromRotationVector({0, 0, -tyre.slip_angle_rad}, {0, 0, wheel.centre_height_mm});
  return heading * pitch * mounting * s.ground_from_rig;
}

Rigid3 VirtualRig::RightFromLeft(double time_s) const {
  const Scenario& s = impl_->scenario;
  if (s.motion.vibration_rad == 0) return s.rig.right_from_left;
  const double phase = 2 * std::numbers::pi * s.motion.vibration_hz * time_s;
  const Eigen::Vector3d turn(std::sin(phase), std::sin(1.31 * phase + 1),
                             std::sin(0.73 * phase + 2));
  Rigid3 moved = s.rig.right_from_left;
  moved.rotation =
      RotationFromVector(s.motion.vibration_rad * turn) * s.rig.right_from_left.rotation;
  // The camera turns about its own centre.
  const Eigen::Vector3d centre = s.rig.right_from_left.Inverse().translation_mm;
  moved.translation_mm = -moved.rotation * centre;
  return moved;
}

Image<float> VirtualRig::MeanImage(int frame, Side side) const {
  const Scenario& s = impl_->scenario;
  const bool right = side == Side::kRight;
  const Camera& camera = right ? s.rig.right : s.rig.left;
  const double middle_s = FrameTime(frame) + (right ? s.right_delay_s : 0);
  const auto camera_from_ground = [&](double t) {
    const Rigid3 rig_from_ground = GroundFromRig(t).Inverse();
    return right ? RightFromLeft(t) * rig_from_ground : rig_from_ground;
  };
  std::mt19937_64 random(internal::MixedSeed({s.seed, StreamOf(frame, kBrightness)}));
  std::normal_distribution<double> normal(0, 1);
  const double brightness = 1 + s.lighting.flicker * normal(random);
  const Light light = MakeLight(s.lighting, camera, GroundFromRig(middle_s), brightness);
  const auto opening = impl_->surface->At(middle_s - s.exposure_s / 2);
  const auto closing = impl_->surface->At(middle_s + s.exposure_s / 2);
  Exposure exposure{opening.get(), opening.get(), camera_from_ground(middle_s - s.exposure_s / 2),
                    camera_from_ground(middle_s + s.exposure_s / 2)};
  if (s.exposure_s > 0) exposure.closing = closing.get();
  return Render(camera, exposure, *impl_->albedo, light, s.render);
}

GrayImage VirtualRig::TakeImage(int frame, Side side) const {
  const Scenario& s = impl_->scenario;
  return Expose(MeanImage(frame, side), s.sensor, s.seed,
                StreamOf(frame, side == Side::kLeft ? kLeftNoise : kRightNoise));
}

std::unique_ptr<const TrueFrame> VirtualRig::Truth(int frame) const {
  return std::make_unique<TrueFrameOfRig>(*this, FrameTime(frame));
}

namespace {

class VirtualRigSource : public ImageSource {
 public:
  VirtualRigSource(std::shared_ptr<const VirtualRig> rig, const std::string& frames)
      : rig_(std::move(rig)), recorded_(rig_->Recorded()) {
    selection_ = internal::ParseFrames(frames, static_cast<std::int64_t>(recorded_.size()));
    next_ = selection_.first;
  }

  std::int64_t DeclaredCount() const override { return selection_.Count(); }

  std::optional<StereoFrame> Next() override {
    if (next_ >= selection_.end) return std::nullopt;
    const int exposed = recorded_[static_cast<std::size_t>(next_)];
    StereoFrame frame;
    frame.index = next_;
    next_ += selection_.step;
    frame.time_s = rig_->FrameTime(exposed) - rig_->FrameTime(recorded_.front());
    frame.left_id = fmt::format("left_{:05}", exposed);
    frame.right_id = fmt::format("right_{:05}", exposed);
    frame.left = rig_->TakeImage(exposed, Side::kLeft);
    frame.right = rig_->TakeImage(exposed, Side::kRight);
    return frame;
  }

  std::vector<std::string> Notes() const override {
    const std::size_t dropped = rig_->scenario().dropped.size();
    if (dropped == 0) return {};
    return {fmt::format("{} of {} frames were dropped", dropped, rig_->scenario().frames)};
  }

  std::vector<std::filesystem::path> Files() const override { return {}; }

 private:
  std::shared_ptr<const VirtualRig> rig_;
  std::vector<int> recorded_;
  internal::FrameSelection selection_;
  std::int64_t next_ = 0;
};

}  // namespace

std::unique_ptr<ImageSource> OpenVirtualRig(std::shared_ptr<const VirtualRig> rig,
                                            const std::string& frames) {
  return std::make_unique<VirtualRigSource>(std::move(rig), frames);
}

}  // namespace plumbline
