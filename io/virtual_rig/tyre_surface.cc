#include "io/virtual_rig/tyre_surface.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "calib/error.h"
#include "io/virtual_rig/internal/ground_profile.h"
#include "io/virtual_rig/internal/jet_instant.h"
#include "io/virtual_rig/internal/meridian.h"
#include "io/virtual_rig/internal/smooth_step.h"

namespace plumbline {
namespace {

using internal::SmoothRamp;
using internal::SmoothStep;
using internal::ValueOf;
using internal::Vector3;

// Shares and angles of the deformation, chosen to look like a radial tyre: see docs/virtual_rig.md.
constexpr double kBulge = 0.2;              // of the deflection: the widest sidewall moves out
constexpr double kNear_rad = 0.30;          // lift and bulge are whole up to here
constexpr double kFar_rad = 0.90;           // and gone from here on
constexpr double kStraightFade_rad = 0.35;  // the belt turns round within this angle
constexpr double kSlideFade_rad = 0.35;
// The belt, straight and therefore ahead of its angle in the patch, is ahead by this angle beside
// it.
constexpr double kAhead_rad = 0.0061, kAheadGrow_rad = 0.30, kAheadFar_rad = 1.25;
constexpr double kTreadHalf_mm = 78, kTreadFade_mm = 82;  // what runs with the belt, along s
constexpr double kShearFade_rad = 0.25;
constexpr double kAdhesion_rad = 0.03;  // half angle over which shear sets in
constexpr double kStickShare = 0.55;    // of the trailing half of the patch
constexpr double kGatherFade_rad = 1.0, kGatherFade_mm = 130;  // of what obstacles draw in
constexpr double kLateralCompliance_mm_rad = 60;  // shift of the carcass by the slip angle
constexpr double kAxleRise = 0.35;  // of the mean height of the ground under the footprint
constexpr double kFootprintLength_mm = 240, kFootprintWidth_mm = 140;
constexpr double kWindow_rad = 1.15;

}  // namespace

class TyreSurface::Shape {
 public:
  Shape(const TyreOptions& options, bool deformed)
      : options_(options),
        meridian_(options.section),
        ground_(options.obstacles, options.bending_length_mm),
        deformed_(deformed && options.lifted_mm <= 0) {
    const double lift = options.tread_lift * options.deflection_mm;
    const double height = meridian_.outer_radius_mm() - options.deflection_mm;
    const double cosine =
        (height + lift + options.contact_edge_mm - options.section.crown_thickness_mm) /
        options.section.crown_radius_mm;
    leading_rad_ = std::acos(std::clamp(cosine, -1.0, 1.0));
    sliding_rad_ = -kStickShare * leading_rad_;
    tan_slip_ = std::tan(options.slip_angle_rad);
  }

  template <typename S>
  struct State {
    S angle, travel, height;
  };

  // Travel a radian of the wheel, along the wheel's heading.
  double RollingRadius() const {
    return options_.free_rolling_radius_mm / (1 + options_.slip_ratio);
  }
  double RadiansPerTravel() const { return std::cos(options_.slip_angle_rad) / RollingRadius(); }

  template <typename S>
  S Travel(const S& t) const {
    using std::cos;
    const double w = 2 * std::numbers::pi / options_.speed_period_s;
    return options_.speed_mm_s * t + options_.speed_swing_mm_s / w * (1.0 - cos(w * t));
  }

  template <typename S>
  State<S> StateAt(const S& t) const {
    const S way = Travel(t);
    State<S> state{options_.start_angle_rad + way * RadiansPerTravel(),
                   options_.start_travel_mm + way, S(0.0)};
    state.height = AxleHeight(state.travel);
    return state;
  }

  template <typename T, typename S>
  Vector3<T> Position(const State<S>& state, const T& u, const T& v) const {
    return deformed_ ? Deformed(state, u, v).position
                     : ToGround(Revolved(Angle(state, u), v, state.height));
  }

  MaterialDomain WindowAt(const State<double>& state) const {
    MaterialDomain window = Domain();
    const double bottom = state.angle * options_.section.crown_radius_mm;
    window.u_min = bottom - kWindow_rad * options_.section.crown_radius_mm;
    window.u_max = bottom + kWindow_rad * options_.section.crown_radius_mm;
    return window;
  }

  MaterialDomain Domain() const {
    const TyreSection& section = options_.section;
    const double period = 2 * std::numbers::pi * section.crown_radius_mm;
    return {0, period, -section.half_length_mm, section.half_length_mm, period};
  }

  // Height above which the ramp of the patch starts, and the place on the ground.
  struct Contact {
    double clearance;  // of the carcass if nothing pressed, from the enveloped ground
    Eigen::Vector2d ground;
    double height;  // of the inner surface
  };
  Contact ContactAt(const State<double>& state, const Eigen::Vector2d& m) const {
    const auto deformed = Deformed(state, m.x(), m.y());
    const Vector3<double>& p = deformed.position;
    return {deformed.clearance, OnTheWay(p.head<2>(), state.travel), p.z()};
  }

  Eigen::Vector2d OnTheWay(const Eigen::Vector2d& ground_mm, double travel) const {
    return {ground_mm.x() + travel, ground_mm.y()};
  }

  // Of the wheel's centre on flat ground.
  double LevelHeight() const {
    return meridian_.outer_radius_mm() +
           (options_.lifted_mm > 0 ? options_.lifted_mm : -options_.deflection_mm);
  }

  double Compression(double travel) const {
    if (options_.lifted_mm > 0) return 0;
    return options_.deflection_mm + (1 - kAxleRise) * MeanGround(travel);
  }

  const TyreOptions& options() const { return options_; }
  const internal::Meridian& meridian() const { return meridian_; }
  const internal::GroundProfile& ground() const { return ground_; }
  bool deformed() const { return deformed_; }

 private:
  template <typename T>
  struct DeformedPoint {
    Vector3<T> position;  // ground frame
    T clearance;
  };

  template <typename T, typename S>
  T Angle(const State<S>& state, const T& u) const {
    const T phi = u / options_.section.crown_radius_mm - state.angle;
    return phi - 2 * std::numbers::pi * std::round(ValueOf(phi) / (2 * std::numbers::pi));
  }

  template <typename T, typename S>
  Vector3<T> Revolved(const T& phi, const T& s, const S& height) const {
    using std::cos;
    using std::sin;
    const auto p = meridian_.At(s);
    return {T(p.radius_mm * sin(phi)), p.y_mm, T(height - p.radius_mm * cos(phi))};
  }

  template <typename T, typename S>
  DeformedPoint<T> Deformed(const State<S>& state, const T& u, const T& s) const {
    using std::abs;
    const T phi = Angle(state, u), a = abs(s);
    const T tread = 1.0 - SmoothStep(T((a - kTreadHalf_mm) / kTreadFade_mm));
    Vector3<T> p = Revolved(T(phi + tread * Ahead(phi)), s, state.height);
    if (abs(ValueOf(phi)) < kFar_rad) {
      const T near = 1.0 - SmoothStep(T((abs(phi) - kNear_rad) / (kFar_rad - kNear_rad)));
      const T bulge = SmoothStep(T(a / 150.0)) * (1.0 - SmoothStep(T((a - 150.0) / 60.0)));
      const T shear = Shear(phi);
      p.x() += tread * (Straight(phi) * (options_.free_rolling_radius_mm * phi - p.x()) +
                        (RollingRadius() - options_.free_rolling_radius_mm) * shear);
      p.y() += near * (s < 0.0 ? -1.0 : 1.0) * kBulge * options_.deflection_mm * bulge +
               tread * (RollingRadius() * tan_slip_ * shear -
                        kLateralCompliance_mm_rad * tan_slip_ * near);
      p.z() += near * options_.tread_lift * options_.deflection_mm *
               (1.0 - SmoothStep(T((a - 100.0) / 110.0)));
    }
    return OnTheGround(state, phi, s, ToGround(p));
  }

  // What the ground does to a point (ground frame) that would be at p without it.
  template <typename T, typename S>
  DeformedPoint<T> OnTheGround(const State<S>& state, const T& phi, const T& s,
                               Vector3<T> p) const {
    using std::abs;
    const T a = abs(s);
    const T near = (1.0 - SmoothStep(T((abs(phi) - leading_rad_) / kGatherFade_rad))) *
                   (1.0 - SmoothStep(T((a - kTreadHalf_mm) / kGatherFade_mm)));
    if (near > 0.0) p.template head<2>() += near * ground_.Gathered(T(p.x() + state.travel), p.y());
    const T floor = meridian_.Thickness(s) + ground_.Enveloped(T(p.x() + state.travel), p.y());
    const T clearance = p.z() - floor;
    p.z() = floor + SmoothRamp(clearance, options_.contact_edge_mm);
    return {p, clearance};
  }

  template <typename T>
  T Ahead(const T& phi) const {
    using std::abs;
    const T a = abs(phi);
    return (phi < 0.0 ? -kAhead_rad : kAhead_rad) * SmoothStep(T(a / kAheadGrow_rad)) *
           (1.0 - SmoothStep(T((a - kAheadGrow_rad) / (kAheadFar_rad - kAheadGrow_rad))));
  }

  // 1 where the belt runs straight along the ground, 0 where it is round.
  template <typename T>
  T Straight(const T& phi) const {
    return (1.0 - SmoothStep(T((phi - leading_rad_) / kStraightFade_rad))) *
           (1.0 - SmoothStep(T((sliding_rad_ - phi) / kSlideFade_rad)));
  }

  // Angle since the leading edge (negative), relaxing in the sliding zone.
  template <typename T>
  T Shear(const T& phi) const {
    return -SmoothRamp(T(leading_rad_ - phi), kAdhesion_rad) *
           (1.0 - SmoothStep(T((sliding_rad_ - phi) / kShearFade_rad)));
  }

  // The ground's x axis is the direction of travel, turned by the slip angle from the heading.
  template <typename T>
  Vector3<T> ToGround(const Vector3<T>& p) const {
    if (options_.slip_angle_rad == 0) return p;
    const double c = std::cos(options_.slip_angle_rad), s = std::sin(options_.slip_angle_rad);
    return {T(c * p.x() + s * p.y()), T(-s * p.x() + c * p.y()), p.z()};
  }

  template <typename S>
  S AxleHeight(const S& travel) const {
    if (options_.lifted_mm > 0) return S(LevelHeight());
    return LevelHeight() + kAxleRise * MeanGround(travel);
  }

  // Mean height of the enveloped ground, the middle of the footprint counting most.
  template <typename S>
  S MeanGround(const S& travel) const {
    S sum(0.0);
    double weights = 0;
    constexpr int nx = 49, ny = 15;
    for (int i = 0; i < nx && !ground_.obstacles().empty(); ++i) {
      const double a = (i + 0.5) / nx - 0.5, wa = 1 + std::cos(2 * std::numbers::pi * a);
      for (int j = 0; j < ny; ++j) {
        const double b = (j + 0.5) / ny - 0.5, w = wa * (1 + std::cos(2 * std::numbers::pi * b));
        sum +=
            w * ground_.Enveloped(S(travel + a * kFootprintLength_mm), S(b * kFootprintWidth_mm));
        weights += w;
      }
    }
    return weights > 0 ? S(sum / weights) : S(0.0);
  }

  TyreOptions options_;
  internal::Meridian meridian_;
  internal::GroundProfile ground_;
  bool deformed_;
  double leading_rad_ = 0, sliding_rad_ = 0, tan_slip_ = 0;
};

void TyreOptions::Check() const {
  const double outer = section.crown_radius_mm + section.crown_thickness_mm;
  if (!(section.crown_radius_mm > 0) || !(section.half_length_mm > 0)) {
    throw UsageError("The tyre's radius and section must be positive.");
  }
  if (!(deflection_mm > 8 && deflection_mm < 0.1 * outer)) {
    throw UsageError("The tyre's deflection must lie between 8 mm and a tenth of its radius.");
  }
  if (!(tread_lift >= 0 && tread_lift <= 0.5) ||
      !(contact_edge_mm >= 1 && contact_edge_mm < deflection_mm / 2)) {
    throw UsageError(
        "The tread is lifted by 0 to 0.5 of the deflection, and its edge rounded over 1 mm to half "
        "the deflection.");
  }
  if (!(lifted_mm >= 0)) throw UsageError("A wheel is lifted by 0 mm or more.");
  if (!(free_rolling_radius_mm > 0.8 * outer && free_rolling_radius_mm < outer)) {
    throw UsageError("The free rolling radius must lie between 0.8 and 1 outer radii.");
  }
  if (!(bending_length_mm >= 15 && bending_length_mm <= 200)) {
    throw UsageError("The carcass's bending length must lie in 15 to 200 mm.");
  }
  if (!(speed_period_s > 0)) throw UsageError("The period of the speed's swing must be positive.");
  if (!(std::abs(slip_ratio) <= 0.1) || !(std::abs(slip_angle_rad) <= 0.1223)) {
    throw UsageError("The virtual tyre stands slips up to 0.1 and slip angles up to 7 degrees.");
  }
  if (!(speed_mm_s >= 0 && speed_mm_s <= 1e5) || !(std::abs(speed_swing_mm_s) <= 1e5) ||
      !std::isfinite(start_travel_mm) || !std::isfinite(start_angle_rad)) {
    throw UsageError(
        "The vehicle's speed must lie in 0 to 100 m/s, and where it starts must be finite.");
  }
}

TyreSurface::TyreSurface(const TyreOptions& options) {
  options.Check();
  loaded_ = std::make_shared<Shape>(options, true);
  unloaded_ = std::make_shared<Shape>(options, false);
}

TyreSurface::~TyreSurface() = default;

MaterialDomain TyreSurface::Domain() const { return loaded_->Domain(); }

std::unique_ptr<const SurfaceInstant> TyreSurface::At(double time_s) const {
  return std::make_unique<internal::JetInstant<Shape>>(loaded_, time_s);
}

std::unique_ptr<const SurfaceInstant> TyreSurface::Reference(double time_s) const {
  return std::make_unique<internal::JetInstant<Shape>>(unloaded_, time_s);
}

WheelState TyreSurface::Wheel(double time_s) const {
  const auto state = loaded_->StateAt(ceres::Jet<double, 1>(time_s, 0));
  const TyreOptions& o = options();
  WheelState wheel;
  wheel.angle_rad = state.angle.a;
  wheel.angular_speed_rad_s = state.angle.v[0];
  wheel.centre_height_mm = state.height.a;
  wheel.level_height_mm = loaded_->LevelHeight();
  wheel.speed_mm_s = state.travel.v[0];
  const double w = 2 * std::numbers::pi / o.speed_period_s;
  wheel.acceleration_mm_s2 = o.speed_swing_mm_s * w * std::cos(w * time_s);
  wheel.travel_mm = state.travel.a;
  wheel.compression_mm = loaded_->Compression(wheel.travel_mm);
  wheel.axis = {std::sin(o.slip_angle_rad), std::cos(o.slip_angle_rad), 0};
  return wheel;
}

double TyreSurface::CarcassThickness(double v_mm) const {
  return loaded_->meridian().Thickness(v_mm);
}

double TyreSurface::GroundHeight(const Eigen::Vector2d& ground_mm, double time_s) const {
  return loaded_->ground().Height(loaded_->OnTheWay(ground_mm, loaded_->StateAt(time_s).travel));
}

class TyreSurface::ContactInstant : public TyreContact {
 public:
  ContactInstant(std::shared_ptr<const Shape> shape, double time_s)
      : shape_(std::move(shape)), state_(shape_->StateAt(time_s)) {}

  double Level(const Eigen::Vector2d& material_mm) const override {
    const auto contact = shape_->ContactAt(state_, material_mm);
    return std::max(contact.clearance + shape_->options().contact_edge_mm,
                    shape_->ground().Bridging(contact.ground));
  }
  double Gap(const Eigen::Vector2d& material_mm) const override {
    const auto contact = shape_->ContactAt(state_, material_mm);
    return contact.height - shape_->ground().Height(contact.ground) -
           shape_->meridian().Thickness(material_mm.y());
  }

 private:
  std::shared_ptr<const Shape> shape_;
  Shape::State<double> state_;
};

std::unique_ptr<const TyreContact> TyreSurface::Contact(double time_s) const {
  if (!loaded_->deformed()) return nullptr;
  return std::make_unique<ContactInstant>(loaded_, time_s);
}

const TyreOptions& TyreSurface::options() const { return loaded_->options(); }

}  // namespace plumbline
