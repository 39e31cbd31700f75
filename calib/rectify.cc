#include "calib/rectify.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>
#include <string>
#include <vector>

#include "calib/error.h"
#include "calib/internal/rectified_view.h"

namespace plumbline {
namespace {

using internal::RectificationMap;
using internal::RectifiedProjection;
using internal::RectifiedView;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kPi = 3.14159265358979323846;
constexpr double kPinholeUpTo_rad = kPi / 2;       // of view, for kAuto
constexpr double kPinholeLargest_tan = 3.7320508;  // 75 degrees off z: beyond, pixels explode
constexpr double kLargestPixelRatio = 4;           // rectified pixels per input pixel
constexpr int kFootprintSteps = 48;                // samples along each side of a photograph
constexpr double kAnglesToSpare = 1.02;

struct Interval {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  void Add(double v) {
    low = std::min(low, v);
    high = std::max(high, v);
  }
  double width() const { return high - low; }
};

// What a camera sees in the rectified frame, in a projection of unit focal length.
struct Footprint {
  Interval x, y;
};

std::vector<Eigen::Vector3d> RaysOfImage(const Camera& camera) {
  std::vector<Eigen::Vector2d> pixels;
  const ImageSize size = camera.size();
  for (int r = 0; r <= kFootprintSteps; ++r) {
    for (int c = 0; c <= kFootprintSteps; ++c) {
      pixels.emplace_back((size.width - 1.0) * c / kFootprintSteps,
                          (size.height - 1.0) * r / kFootprintSteps);
    }
  }
  std::vector<Eigen::Vector3d> rays(pixels.size());
  camera.Unproject(pixels, rays);
  std::erase_if(rays, [](const Eigen::Vector3d& ray) { return !ray.allFinite(); });
  return rays;
}

Footprint FootprintOf(const std::vector<Eigen::Vector3d>& rays,
                      const Eigen::Matrix3d& rectified_from_camera, RectificationKind kind) {
  const RectifiedProjection unit{kind, {1, 1, 0, 0}};
  Footprint out;
  for (const Eigen::Vector3d& ray : rays) {
    Eigen::Vector2d u = unit.Project(rectified_from_camera * ray);
    if (!u.allFinite()) continue;
    if (kind == RectificationKind::kPinhole) {
      u = u.cwiseMax(-kPinholeLargest_tan).cwiseMin(kPinholeLargest_tan);
    }
    out.x.Add(u.x());
    out.y.Add(u.y());
  }
  return out;
}

double CosLargestAngle(const std::vector<Eigen::Vector3d>& rays) {
  double largest = 0;
  for (const Eigen::Vector3d& ray : rays) {
    largest = std::max(largest, std::atan2(std::hypot(ray.x(), ray.y()), ray.z()));
  }
  return std::cos(std::min(kPi, kAnglesToSpare * largest));
}

[[noreturn]] void NothingInCommon(const std::string& why) {
  throw InputError("rectification: the two cameras do not look at anything in common (" + why +
                   "); check that right_from_left is not the inverse, and that left and right are "
                   "not swapped");
}

// Rotation of the rectified frame: mrcal's rectified_system.
Eigen::Matrix3d RectifiedFromLeft(const Eigen::Vector3d& right_in_left,
                                  const Eigen::Vector3d& right_axis_in_left) {
  const double baseline = right_in_left.norm();
  if (!(baseline > 0)) NothingInCommon("their distance is zero");
  const Eigen::Vector3d x = right_in_left / baseline;
  const Eigen::Vector3d forward = Eigen::Vector3d::UnitZ() + right_axis_in_left;
  Eigen::Vector3d z = forward - forward.dot(x) * x;
  if (!(z.norm() > 1e-3)) NothingInCommon("they look along the line between them or apart");
  z.normalize();
  Eigen::Matrix3d R;
  R.row(0) = x;
  R.row(1) = z.cross(x);
  R.row(2) = z;
  return R;
}

// The point (left camera) on which the disparity is to be zero; none for parallel axes.
std::optional<Eigen::Vector3d> WorkingPoint(const Eigen::Vector3d& right_in_left,
                                            const Eigen::Vector3d& right_axis,
                                            const RectificationOptions& options) {
  const Eigen::Vector3d left_axis = Eigen::Vector3d::UnitZ();
  if (options.working_distance_mm) return *options.working_distance_mm * left_axis;
  const Eigen::Vector3d n = left_axis.cross(right_axis);
  if (n.norm() < 1e-6) return std::nullopt;
  const double depth0 = right_in_left.cross(right_axis).dot(n) / n.squaredNorm();
  const double depth1 = right_in_left.cross(left_axis).dot(n) / n.squaredNorm();
  if (!(depth0 > 0 && depth1 > 0)) return std::nullopt;
  return 0.5 * (depth0 * left_axis + right_in_left + depth1 * right_axis);
}

// Raw pixels per unit of (x, y) of the unit-focal projection, seen towards a direction.
Eigen::Vector2d Resolution(const Camera& camera, const Eigen::Matrix3d& rectified_from_camera,
                           RectificationKind kind, const Eigen::Vector3d& toward_rectified) {
  const RectifiedProjection unit{kind, {1, 1, 0, 0}};
  const RectifiedView view{camera, rectified_from_camera, unit, -1};
  Eigen::Matrix2d d;
  (void)view.RawPixel(unit.Project(toward_rectified), &d);
  return {d.col(0).norm(), d.col(1).norm()};
}

}  // namespace

void RectificationOptions::Check() const {
  if (!(pixels_per_input_pixel > 0.01 && pixels_per_input_pixel < 100)) {
    throw UsageError("rectification: pixels_per_input_pixel must lie between 0.01 and 100, not " +
                     std::to_string(pixels_per_input_pixel));
  }
  if (working_distance_mm && !(*working_distance_mm > 0 && std::isfinite(*working_distance_mm))) {
    throw UsageError("rectification: the working distance must be positive, in mm");
  }
}

struct Rectification::Impl {
  std::array<RectifiedView, 2> views;
  ImageSize size{};
  double baseline_mm = 0;
  mutable std::array<RectificationMap, 2> maps{};
  mutable std::array<std::once_flag, 2> map_made{};

  Impl(const StereoRig& rig, const RectificationOptions& options)
      : views{RectifiedView{rig.left, {}, {}, -1}, RectifiedView{rig.right, {}, {}, -1}},
        baseline_mm(rig.baseline_mm()) {
    const Eigen::Matrix3d left_from_right = rig.right_from_left.rotation.transpose();
    const Eigen::Vector3d right_in_left = -(left_from_right * rig.right_from_left.translation_mm);
    const Eigen::Vector3d right_axis = left_from_right.col(2);
    views[0].rectified_from_camera = RectifiedFromLeft(right_in_left, right_axis);
    views[1].rectified_from_camera = views[0].rectified_from_camera * left_from_right;
    const auto working_point = WorkingPoint(right_in_left, right_axis, options);
    LayOut(working_point, options);
  }

  // Chooses kind, focal lengths, principal points and size.
  void LayOut(const std::optional<Eigen::Vector3d>& working_point,
              const RectificationOptions& options) {
    const std::array<std::vector<Eigen::Vector3d>, 2> rays = {RaysOfImage(views[0].camera),
                                                              RaysOfImage(views[1].camera)};
    std::array<Footprint, 2> seen;
    const auto see_as = [&](RectificationKind kind) {
      for (std::size_t k = 0; k < 2; ++k) {
        views[k].projection.kind = kind;
        views[k].cos_largest_angle = CosLargestAngle(rays[k]);
        seen[k] = FootprintOf(rays[k], views[k].rectified_from_camera, kind);
      }
    };
    RectificationKind kind = options.kind;
    if (kind == RectificationKind::kAuto) {
      see_as(RectificationKind::kLatLon);
      const double view_rad =
          std::max({seen[0].x.width(), seen[0].y.width(), seen[1].x.width(), seen[1].y.width()});
      kind = view_rad > kPinholeUpTo_rad ? RectificationKind::kLatLon : RectificationKind::kPinhole;
    }
    see_as(kind);

    // Where a point at the working distance lies in the two images, focal length one.
    const RectifiedProjection unit{kind, {1, 1, 0, 0}};
    double offset = 0;
    std::array<Eigen::Vector3d, 2> toward;
    for (std::size_t k = 0; k < 2; ++k) {
      toward[k] = views[k].rectified_from_camera.col(2);  // the optical axis
      if (working_point) {
        toward[k] = views[0].rectified_from_camera * *working_point -
                    static_cast<double>(k) * baseline_mm * Eigen::Vector3d::UnitX();
      }
    }
    if (working_point) offset = unit.Project(toward[0]).x() - unit.Project(toward[1]).x();
    if (!std::isfinite(offset)) NothingInCommon("the working distance lies behind them");

    const Interval rows{std::max(seen[0].y.low, seen[1].y.low),
                        std::min(seen[0].y.high, seen[1].y.high)};
    if (!(rows.width() > 0)) NothingInCommon("one looks above what the other sees");
    if (!(seen[1].x.low < seen[0].x.high)) NothingInCommon("they look apart");
    const Interval columns{std::min(seen[0].x.low, seen[1].x.low + offset),
                           std::max(seen[0].x.high, seen[1].x.high + offset)};
    Place(columns, rows, offset, toward, options.pixels_per_input_pixel);
  }

  void Place(const Interval& columns, const Interval& rows, double offset,
             const std::array<Eigen::Vector3d, 2>& toward, double pixels_per_input_pixel) {
    const RectificationKind kind = views[0].projection.kind;
    const auto resolution = [&](std::size_t k) {
      return Resolution(views[k].camera, views[k].rectified_from_camera, kind, toward[k]);
    };
    // The geometric mean, so that neither image is enlarged much.
    Eigen::Vector2d f =
        pixels_per_input_pixel * (resolution(0).array() * resolution(1).array()).sqrt();
    if (!f.allFinite()) NothingInCommon("the working point is outside a camera's lens model");
    const auto pixels = [](ImageSize s) {
      return static_cast<double>(s.width) * static_cast<double>(s.height);
    };
    const double most = kLargestPixelRatio *
                        std::max(pixels(views[0].camera.size()), pixels(views[1].camera.size()));
    const double wanted = columns.width() * f.x() * rows.width() * f.y();
    if (wanted > most) f *= std::sqrt(most / wanted);
    size.width = std::max(2, static_cast<int>(columns.width() * f.x()) + 1);
    size.height = std::max(2, static_cast<int>(rows.width() * f.y()) + 1);
    views[0].projection.intrinsics << f, -columns.low * f.x(), -rows.low * f.y();
    views[1].projection.intrinsics = views[0].projection.intrinsics;
    views[1].projection.intrinsics[2] += offset * f.x();
  }

  double offset_px() const {
    return views[1].projection.intrinsics[2] - views[0].projection.intrinsics[2];
  }

  // Range along the left ray of a rectified pixel at which the disparity is this.
  double RangeAtDisparity(const Eigen::Vector2d& pixel, double disparity_px) const {
    const Eigen::Vector3d v0 = views[0].projection.Unproject(pixel).normalized();
    const Eigen::Vector3d v1 =
        views[1].projection.Unproject({pixel.x() - disparity_px, pixel.y()}).normalized();
    // Both lie in one plane through the baseline: the sine of the angle between them, by that
    // plane's two axes (x, and the direction across it).
    const double across0 = std::hypot(v0.y(), v0.z()), across1 = std::hypot(v1.y(), v1.z());
    const double sine = v0.x() * across1 - v1.x() * across0;
    if (sine < 0) return kNaN;
    return baseline_mm * across1 / sine;
  }

  const RectificationMap& Map(std::size_t k) const {
    std::call_once(map_made[k], [&] { maps[k] = internal::MakeMap(views[k], size); });
    return maps[k];
  }

  GrayImage Remap(std::size_t k, const GrayImage& image, Image<std::uint8_t>* valid) const {
    const ImageSize expected = views[k].camera.size();
    if (!(image.size() == expected)) {
      const auto text = [](ImageSize s) {
        return std::to_string(s.width) + "x" + std::to_string(s.height);
      };
      throw InputError(std::string("the ") + (k == 0 ? "left" : "right") + " photograph is " +
                       text(image.size()) + " pixels, but its camera was calibrated at " +
                       text(expected) + "; give a photograph of the same camera and size");
    }
    return internal::Remap(Map(k), image, valid);
  }

  void RawPixels(std::size_t k, std::span<const Eigen::Vector2d> rectified,
                 std::span<Eigen::Vector2d> raw, std::span<Eigen::Matrix2d> d) const {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, rectified.size(), 1024),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                        for (std::size_t i = range.begin(); i != range.end(); ++i) {
                          raw[i] = views[k].RawPixel(rectified[i], d.empty() ? nullptr : &d[i]);
                        }
                      });
  }
};

Rectification::Rectification(const StereoRig& rig, const RectificationOptions& options) {
  options.Check();
  impl_ = std::make_shared<const Impl>(rig, options);
}

ImageSize Rectification::size() const { return impl_->size; }
RectificationKind Rectification::kind() const { return impl_->views[0].projection.kind; }
Eigen::Matrix3d Rectification::rectified_from_left() const {
  return impl_->views[0].rectified_from_camera;
}
Eigen::Matrix3d Rectification::rectified_from_right() const {
  return impl_->views[1].rectified_from_camera;
}
double Rectification::baseline_mm() const { return impl_->baseline_mm; }
Eigen::Vector4d Rectification::LeftIntrinsics() const {
  return impl_->views[0].projection.intrinsics;
}
Eigen::Vector4d Rectification::RightIntrinsics() const {
  return impl_->views[1].projection.intrinsics;
}

GrayImage Rectification::RemapLeft(const GrayImage& image, Image<std::uint8_t>* valid) const {
  return impl_->Remap(0, image, valid);
}
GrayImage Rectification::RemapRight(const GrayImage& image, Image<std::uint8_t>* valid) const {
  return impl_->Remap(1, image, valid);
}

Eigen::Vector2d Rectification::LeftRawPixel(const Eigen::Vector2d& rectified,
                                            Eigen::Matrix2d* d_raw_d_rectified) const {
  return impl_->views[0].RawPixel(rectified, d_raw_d_rectified);
}
Eigen::Vector2d Rectification::RightRawPixel(const Eigen::Vector2d& rectified,
                                             Eigen::Matrix2d* d_raw_d_rectified) const {
  return impl_->views[1].RawPixel(rectified, d_raw_d_rectified);
}
void Rectification::LeftRawPixels(std::span<const Eigen::Vector2d> rectified,
                                  std::span<Eigen::Vector2d> raw,
                                  std::span<Eigen::Matrix2d> d_raw_d_rectified) const {
  impl_->RawPixels(0, rectified, raw, d_raw_d_rectified);
}
void Rectification::RightRawPixels(std::span<const Eigen::Vector2d> rectified,
                                   std::span<Eigen::Vector2d> raw,
                                   std::span<Eigen::Matrix2d> d_raw_d_rectified) const {
  impl_->RawPixels(1, rectified, raw, d_raw_d_rectified);
}
Eigen::Vector2d Rectification::LeftRectifiedPixel(const Eigen::Vector2d& raw,
                                                  Eigen::Matrix2d* d_rectified_d_raw) const {
  return impl_->views[0].RectifiedPixel(raw, d_rectified_d_raw);
}
Eigen::Vector2d Rectification::RightRectifiedPixel(const Eigen::Vector2d& raw,
                                                   Eigen::Matrix2d* d_rectified_d_raw) const {
  return impl_->views[1].RectifiedPixel(raw, d_rectified_d_raw);
}

double Rectification::ZeroDisparityOffset_px() const { return impl_->offset_px(); }

double Rectification::DisparityAtDistance(double distance_mm) const {
  const Eigen::Vector2d centre((size().width - 1) / 2.0, (size().height - 1) / 2.0);
  const Eigen::Vector3d point =
      distance_mm * impl_->views[0].projection.Unproject(centre).normalized();
  const Eigen::Vector3d in_right = point - impl_->baseline_mm * Eigen::Vector3d::UnitX();
  return centre.x() - impl_->views[1].projection.Project(in_right).x();
}

double Rectification::DistanceAtDisparity(double disparity_px) const {
  const Eigen::Vector2d centre((size().width - 1) / 2.0, (size().height - 1) / 2.0);
  return impl_->RangeAtDisparity(centre, disparity_px);
}

Eigen::Vector3d Rectification::PointInRig(const Eigen::Vector2d& rectified_left,
                                          double disparity_px) const {
  const double range = impl_->RangeAtDisparity(rectified_left, disparity_px);
  return impl_->views[0].rectified_from_camera.transpose() *
         (range * impl_->views[0].projection.Unproject(rectified_left).normalized());
}

}  // namespace plumbline
