#include "apps/pipeline.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>

#include "apps/internal/finite_median.h"
#include "apps/internal/ground_record.h"
#include "apps/internal/surface_points.h"
#include "calib/error.h"
#include "calib/mode_triangulation.h"
#include "calib/parallel.h"

namespace plumbline {
namespace {

using internal::MeasurementGrid;
using internal::SurfacePoints;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr double kNanDouble = std::numeric_limits<double>::quiet_NaN();
const Eigen::Vector3f kNanVector = Eigen::Vector3f::Constant(kNan);

Surface EmptySurface(ImageSize size, bool with_covariance) {
  Surface surface;
  surface.position_mm = Image<Eigen::Vector3f>(size, kNanVector);
  surface.sigma_random_mm = Image<Eigen::Vector3f>(size, kNanVector);
  surface.sigma_calibration_mm = Image<Eigen::Vector3f>(size, kNanVector);
  surface.correlation = Image<float>(size, kNan);
  surface.epipolar_px = Image<float>(size, kNan);
  if (with_covariance) {
    surface.cov_random_mm2 =
        Image<Eigen::Matrix<float, 6, 1>>(size, Eigen::Matrix<float, 6, 1>::Constant(kNan));
  }
  return surface;
}

// What the calibration does to points and plane: the sums over modes of squared differences.
struct CalibrationPart {
  std::vector<Eigen::Vector3d> variance_mm2;  // a point
  Eigen::Matrix3d cov_plane = Eigen::Matrix3d::Constant(kNanDouble);
};

// The differences of so many modes are held at a time, a float vector a point and mode.
constexpr int kModeGroup = 4;

CalibrationPart EvaluateModes(const ModeTriangulation& modes, const SurfacePoints& points,
                              const std::optional<GroundPlane>& plane, bool in_ground,
                              const Rigid3& ground_from_rig, double correlation_area) {
  CalibrationPart part;
  const std::size_t count = points.point_in_rig.size();
  if (modes.count() == 0) {
    part.variance_mm2.assign(count, Eigen::Vector3d::Constant(kNanDouble));
    return part;
  }
  part.variance_mm2.assign(count, Eigen::Vector3d::Zero());
  if (plane) part.cov_plane.setZero();
  std::vector<Eigen::Vector3d> moved(count);
  std::vector<Eigen::Vector3f> differences;
  for (int first = 0; first < modes.count(); first += kModeGroup) {
    const int group = std::min(kModeGroup, modes.count() - first);
    differences.resize(count * static_cast<std::size_t>(group));
    modes.Differences(points.left, points.right, first, group, differences);
    for (int k = 0; k < group; ++k) {
      ForEachIndex(count, [&](std::size_t i) {
        moved[i] = points.point_in_rig[i] +
                   differences[i * static_cast<std::size_t>(group) + static_cast<std::size_t>(k)]
                       .cast<double>();
      });
      Rigid3 back;  // from the mode's rig frame to where the positions are compared
      if (plane) {
        const GroundPlane plane_k =
            RefitPlane(moved, points.cov_mm2, plane->inlier, correlation_area);
        const Eigen::Vector3d difference = PlaneDifference(*plane, plane_k);
        part.cov_plane += difference * difference.transpose();
        back = GroundFromRig(plane_k, Eigen::Vector3d::Zero(), plane_k.centroid);
      }
      if (!in_ground) back = internal::BestRigidMotion(moved, points.point_in_rig);
      ForEachIndex(count, [&](std::size_t i) {
        const Eigen::Vector3d nominal =
            in_ground ? ground_from_rig * points.point_in_rig[i] : points.point_in_rig[i];
        part.variance_mm2[i] += (back * moved[i] - nominal).cwiseAbs2();
      });
    }
  }
  return part;
}

// The random covariance of a point's position; that of the height in the ground frame also has the
// plane's own.
Eigen::Matrix3d RandomCovariance(const SurfacePoints& points, std::size_t i, bool in_ground,
                                 const std::optional<GroundPlane>& plane,
                                 const Rigid3& ground_from_rig) {
  if (!in_ground) return points.cov_mm2[i];
  const Eigen::Matrix3d& R = ground_from_rig.rotation;
  Eigen::Matrix3d cov = R * points.cov_mm2[i] * R.transpose();
  const Eigen::Vector3d q = points.point_in_rig[i] - plane->centroid;
  const Eigen::Vector3d J(-plane->e2.dot(q), plane->e1.dot(q), -1);
  cov(2, 2) += J.dot(plane->cov * J);
  return cov;
}

}  // namespace

void MeasureOptions::Check() const {
  if (step_px < 1) throw UsageError("The step between points must be at least 1 px.");
  if (min_distance_mm.has_value() != max_distance_mm.has_value()) {
    throw UsageError(
        "Give the smallest and the largest distance together, or neither to have them found.");
  }
  if (min_distance_mm && !(*min_distance_mm > 0 && *min_distance_mm < *max_distance_mm)) {
    throw UsageError(
        fmt::format("The smallest distance ({} mm) must be positive and below the largest ({} mm).",
                    *min_distance_mm, *max_distance_mm));
  }
  ground.Check();
}

struct StereoMeasurement::Impl {
  StereoRig rig;
  MeasureOptions options;
  ModeTriangulation modes;
  Rectification rectification;
  MeasurementGrid grid;
  Image<Eigen::Vector2f> grid_px;
  Image<std::uint8_t> wanted;  // of the rectified left image
  std::int64_t grid_points = 0;

  Impl(const StereoRig& r, const MeasureOptions& o);
  void MakeGrid();
  void SetRange(double near_mm, double far_mm, DisparityOptions& disparity) const;
  DisparityMap Match(const GrayImage& left, const GrayImage& right,
                     const Image<std::uint8_t>& left_valid,
                     const Image<std::uint8_t>& right_valid) const;
  void Fill(const StereoFrame& pair, MeasuredFrame& out) const;
  void Store(const SurfacePoints& points, const std::optional<GroundPlane>& plane,
             MeasuredFrame& out) const;
};

StereoMeasurement::Impl::Impl(const StereoRig& r, const MeasureOptions& o)
    : rig(r), options(o), modes(r), rectification(r, o.rectification) {
  options.Check();
  if (!options.mask.empty() && !(options.mask.size() == rig.left.size())) {
    throw InputError(fmt::format("The mask is {}x{} px and the left image {}x{} px.",
                                 options.mask.width(), options.mask.height(), rig.left.size().width,
                                 rig.left.size().height));
  }
  if (options.roi) options.roi->CheckInside(rig.left.size());
  if (options.min_distance_mm) {
    SetRange(*options.min_distance_mm, *options.max_distance_mm, options.disparity);
  }
  options.disparity.Check();
  const double windows = static_cast<double>(2 * options.disparity.refinement_radius_px + 1) /
                         static_cast<double>(options.step_px);
  options.ground.correlation_area_points = std::max(1.0, windows * windows);
  MakeGrid();
}

void StereoMeasurement::Impl::SetRange(double near_mm, double far_mm,
                                       DisparityOptions& disparity) const {
  // A pixel more on both sides, because distances are counted in the middle of the image.
  const double near_px = rectification.DisparityAtDistance(near_mm);
  const double far_px = rectification.DisparityAtDistance(far_mm);
  disparity.min_disparity_px = static_cast<int>(std::floor(std::min(near_px, far_px))) - 1;
  disparity.max_disparity_px = static_cast<int>(std::ceil(std::max(near_px, far_px))) + 1;
}

DisparityMap StereoMeasurement::Impl::Match(const GrayImage& left, const GrayImage& right,
                                            const Image<std::uint8_t>& left_valid,
                                            const Image<std::uint8_t>& right_valid) const {
  const bool searched = !options.disparity.min_disparity_px.has_value();
  try {
    return ComputeDisparity(left, right, options.disparity, &left_valid, &right_valid);
  } catch (const InputError&) {
    if (!searched || !options.likely_distance_mm) throw;
  }
  DisparityOptions disparity = options.disparity;
  SetRange(0.9 * *options.likely_distance_mm, 1.1 * *options.likely_distance_mm, disparity);
  return ComputeDisparity(left, right, disparity, &left_valid, &right_valid);
}

void StereoMeasurement::Impl::MakeGrid() {
  const ImageSize size = rectification.size();
  const PixelRegion whole{0, 0, rig.left.size().width, rig.left.size().height};
  const PixelRegion region = options.roi.value_or(whole);
  Image<Eigen::Vector2d> raw(size, Eigen::Vector2d::Zero());
  Image<Status> why(size, Status::kOk);
  tbb::parallel_for(0, size.height, [&](int y) {
    for (int x = 0; x < size.width; ++x) {
      const Eigen::Vector2d pixel = rectification.LeftRawPixel(Eigen::Vector2d(x, y));
      raw(y, x) = pixel;
      if (!pixel.allFinite() || !rig.left.Contains(pixel)) {
        why(y, x) = Status::kOutsideImage;
        continue;
      }
      const int column = std::clamp(static_cast<int>(std::lround(pixel.x())), 0, whole.width - 1);
      const int row = std::clamp(static_cast<int>(std::lround(pixel.y())), 0, whole.height - 1);
      const bool inside = column >= region.x && row >= region.y &&
                          column - region.x < region.width && row - region.y < region.height;
      if (!inside || (!options.mask.empty() && options.mask(row, column) == 0)) {
        why(y, x) = Status::kMasked;
      }
    }
  });
  int x0 = size.width, y0 = size.height, x1 = -1, y1 = -1;
  wanted = Image<std::uint8_t>(size, 0);
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      if (why(y, x) != Status::kOk) continue;
      wanted(y, x) = 1;
      x0 = std::min(x0, x);
      y0 = std::min(y0, y);
      x1 = std::max(x1, x);
      y1 = std::max(y1, y);
    }
  }
  if (x1 < 0) {
    throw InputError("The region and the mask leave no point of the left image to measure.");
  }
  grid.x0 = x0;
  grid.y0 = y0;
  grid.step_px = options.step_px;
  const ImageSize grid_size{(x1 - x0) / options.step_px + 1, (y1 - y0) / options.step_px + 1};
  grid.raw_left = Image<Eigen::Vector2d>(grid_size, Eigen::Vector2d::Zero());
  grid.use = Image<std::uint8_t>(grid_size);
  grid.status = Image<Status>(grid_size);
  grid_px = Image<Eigen::Vector2f>(grid_size, Eigen::Vector2f::Zero());
  for (int r = 0; r < grid_size.height; ++r) {
    for (int c = 0; c < grid_size.width; ++c) {
      const int y = y0 + r * options.step_px;
      const int x = x0 + c * options.step_px;
      grid.raw_left(r, c) = raw(y, x);
      grid.status(r, c) = why(y, x);
      grid.use(r, c) = wanted(y, x);
      grid_px(r, c) = raw(y, x).cast<float>();
      grid_points += wanted(y, x);
    }
  }
  if (grid_points == 0) {
    throw InputError("No point of the grid falls into the region; choose a smaller step.");
  }
}

void StereoMeasurement::Impl::Fill(const StereoFrame& pair, MeasuredFrame& out) const {
  Image<std::uint8_t> left_valid, right_valid;
  const GrayImage left = rectification.RemapLeft(pair.left, &left_valid);
  const GrayImage right = rectification.RemapRight(pair.right, &right_valid);
  for (std::size_t i = 0; i < left_valid.pixel_count(); ++i) {
    left_valid.values()[i] = static_cast<std::uint8_t>(left_valid.values()[i] & wanted.values()[i]);
  }
  const DisparityMap disparity = Match(left, right, left_valid, right_valid);
  out.summary.min_disparity_px = disparity.min_disparity_px;
  out.summary.max_disparity_px = disparity.max_disparity_px;
  out.frame.surface = EmptySurface(grid.use.size(), options.point_covariance);
  const SurfacePoints points =
      internal::TriangulateDisparity(rig, rectification, disparity, grid, out.frame.surface.status);
  out.summary.valid_points = static_cast<std::int64_t>(points.grid_index.size());
  if (points.grid_index.empty()) {
    throw InputError("No point could be matched between the two images.");
  }
  std::optional<GroundPlane> plane;
  try {
    plane = FitGroundPlane(points.point_in_rig, points.cov_mm2, options.ground);
  } catch (const InputError& error) {
    out.frame.ground.problem = error.what();
  }
  Store(points, plane, out);
}

void StereoMeasurement::Impl::Store(const SurfacePoints& points,
                                    const std::optional<GroundPlane>& plane,
                                    MeasuredFrame& out) const {
  GroundRecord& ground = out.frame.ground;
  Rigid3 ground_from_rig;
  if (plane) {
    ground_from_rig = GroundFromRig(*plane, Eigen::Vector3d::Zero(), plane->centroid);
    ground = internal::GroundRecordOf(*plane, ground_from_rig);
  }
  const bool in_ground = plane.has_value() && options.turn_into_ground_frame;
  const CalibrationPart calibration = EvaluateModes(
      modes, points, plane, in_ground, ground_from_rig, options.ground.correlation_area_points);
  if (plane) ground.cov_calibration = calibration.cov_plane;

  Surface& surface = out.frame.surface;
  surface.frame = in_ground ? SurfaceFrame::kGround : SurfaceFrame::kRig;
  ForEachIndex(points.grid_index.size(), [&](std::size_t i) {
    const std::size_t at = points.grid_index[i];
    const Eigen::Vector3d position =
        in_ground ? ground_from_rig * points.point_in_rig[i] : points.point_in_rig[i];
    surface.position_mm.values()[at] = position.cast<float>();
    const Eigen::Matrix3d C = RandomCovariance(points, i, in_ground, plane, ground_from_rig);
    surface.sigma_random_mm.values()[at] = C.diagonal().cwiseMax(0).cwiseSqrt().cast<float>();
    if (options.point_covariance) {
      surface.cov_random_mm2.values()[at] << static_cast<float>(C(0, 0)),
          static_cast<float>(C(0, 1)), static_cast<float>(C(0, 2)), static_cast<float>(C(1, 1)),
          static_cast<float>(C(1, 2)), static_cast<float>(C(2, 2));
    }
    surface.sigma_calibration_mm.values()[at] =
        calibration.variance_mm2[i].cwiseSqrt().cast<float>();
  });

  FrameSummary& summary = out.summary;
  std::vector<double> random, common;
  double depth = 0;
  for (std::size_t i = 0; plane && i < points.grid_index.size(); ++i) {
    if (plane->inlier[i] == 0) continue;
    ++summary.plane_points;
    depth += points.point_in_rig[i].z();
    random.push_back(std::sqrt(plane->normal.dot(points.cov_mm2[i] * plane->normal)));
    if (in_ground) common.push_back(std::sqrt(calibration.variance_mm2[i].z()));
  }
  summary.plane_distance_mm =
      plane ? depth / static_cast<double>(summary.plane_points) : kNanDouble;
  summary.median_sigma_random_mm = internal::MedianOfFinite(std::move(random));
  summary.median_sigma_calibration_mm = internal::MedianOfFinite(std::move(common));
}

StereoMeasurement::StereoMeasurement(const StereoRig& rig, const MeasureOptions& options)
    : impl_(std::make_unique<const Impl>(rig, options)) {}

StereoMeasurement::~StereoMeasurement() = default;

const Image<Eigen::Vector2f>& StereoMeasurement::grid_px() const { return impl_->grid_px; }

int StereoMeasurement::window_px() const {
  return 2 * impl_->options.disparity.refinement_radius_px + 1;
}

MeasuredFrame StereoMeasurement::Measure(const StereoFrame& pair) const {
  MeasuredFrame out;
  out.frame.index = pair.index;
  out.frame.time_s = pair.time_s;
  out.frame.left_id = pair.left_id;
  out.frame.right_id = pair.right_id;
  out.frame.problem = pair.problem;
  out.summary.grid_points = impl_->grid_points;
  if (!pair.problem.empty()) return out;
  const auto check = [](const GrayImage& image, const Camera& camera, const std::string& id,
                        const char* side) {
    if (image.size() == camera.size()) return;
    throw InputError(fmt::format(
        "{} is {}x{} px, but the {} camera of the rig was calibrated with {}x{} px.", id,
        image.width(), image.height(), side, camera.size().width, camera.size().height));
  };
  check(pair.left, impl_->rig.left, pair.left_id, "left");
  check(pair.right, impl_->rig.right, pair.right_id, "right");
  try {
    impl_->Fill(pair, out);
  } catch (const InputError& error) {
    out.frame.problem = error.what();
    out.frame.surface = {};
  }
  return out;
}

}  // namespace plumbline
