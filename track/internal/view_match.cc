#include "track/internal/view_match.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/median.h"
#include "calib/triangulate.h"

namespace plumbline::internal {
namespace {

// Where the points of a view should be in an image; NaN where they cannot be seen.
using Places = Image<Eigen::Vector2d>;

Places PlacesOf(const Camera& camera, const Rigid3& camera_from_rig,
                const Image<Eigen::Vector3d>& points) {
  std::vector<Eigen::Vector3d> moved;
  for (const Eigen::Vector3d& p : points.values()) moved.push_back(camera_from_rig * p);
  Places places(points.size(), Eigen::Vector2d::Zero());
  camera.Project(moved, places.values());
  return places;
}

// The motion around an inner point of the grid, of second order from its eight neighbours.
SubsetWarp WarpAt(const WheelView& view, const Places& places, int r, int c) {
  const auto at = [&](int down, int along) {
    return (places(r + down, c + along) - view.PixelOf(r + down, c + along).cast<double>()).eval();
  };
  const double h = view.step_px;
  const Eigen::Vector2d here = at(0, 0), west = at(0, -1), east = at(0, 1), north = at(-1, 0),
                        south = at(1, 0);
  SubsetWarp warp = SubsetWarp::Of(here);
  warp.c.col(1) = (east - west) / (2 * h);
  warp.c.col(2) = (south - north) / (2 * h);
  warp.c.col(3) = (west - 2 * here + east) / (2 * h * h);
  warp.c.col(4) = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / (4 * h * h);
  warp.c.col(5) = (north - 2 * here + south) / (2 * h * h);
  return warp;
}

const Image<std::uint8_t>* OrNull(const Image<std::uint8_t>& mask) {
  return mask.empty() ? nullptr : &mask;
}

}  // namespace

PreparedPair::PreparedPair(const GrayImage& left, const GrayImage& right,
                           const CorrelationImageOptions& options) {
  tbb::parallel_invoke([&] { images[0].emplace(left, options); },
                       [&] { images[1].emplace(right, options); });
}

CorrelatorOptions Across(const StereoSequenceOptions& options) {
  CorrelatorOptions across = options.field.correlator;
  if (options.right_noise) across.deformed_noise = options.right_noise;
  return across;
}

std::vector<ExpectedPoint> ExpectPoints(const StereoRig& rig, const WheelView& view,
                                        const Rigid3& now_from_view, bool right, double room_px) {
  const Camera& camera = right ? rig.right : rig.left;
  const Places places = PlacesOf(
      camera, right ? rig.right_from_left * now_from_view : now_from_view, view.point_in_rig_mm);
  std::vector<ExpectedPoint> expected;
  for (int r = 1; r + 1 < places.height(); ++r) {
    for (int c = 1; c + 1 < places.width(); ++c) {
      const Eigen::Vector2d& at = places(r, c);
      if (!(at.minCoeff() > room_px && at.x() < camera.size().width - room_px &&
            at.y() < camera.size().height - room_px)) {
        continue;
      }
      const ExpectedPoint point{r, c, right, WarpAt(view, places, r, c)};
      // Much nearer or farther than in the view, too oblique, or from behind.
      constexpr double kMostStretched = 3;
      const double stretch = (Eigen::Matrix2d::Identity() + point.start.gradient()).determinant();
      if (point.start.c.allFinite() && stretch > 1 / kMostStretched && stretch < kMostStretched) {
        expected.push_back(point);
      }
    }
  }
  return expected;
}

ViewMatcher::ViewMatcher(const StereoRig& rig, const WheelView& view,
                         const StereoSequenceOptions& options, const Image<std::uint8_t>& mask)
    : rig_(rig),
      view_(view),
      image_(view.left, options.field.image),
      left_(image_, options.field.correlator, OrNull(mask)),
      right_(image_, Across(options), OrNull(mask)) {}

std::vector<ExpectedPoint> ViewMatcher::Expect(const Rigid3& now_from_view, bool right) const {
  return ExpectPoints(rig_, view_, now_from_view, right, left_.options().radius_px());
}

SubsetMatch ViewMatcher::Match(const PreparedPair& pair, const ExpectedPoint& point) const {
  return (point.right ? right_ : left_)
      .Match(pair.Of(point.right), view_.PixelOf(point.row, point.column), point.start);
}

double ViewMatcher::Score(const PreparedPair& pair, const Rigid3& now_from_view) const {
  constexpr std::size_t kEnough = 24, kFew = 8;
  const std::vector<ExpectedPoint> points = Expect(now_from_view, false);
  if (points.size() < kFew) return -1;
  const std::size_t step = std::max<std::size_t>(1, points.size() / kEnough);
  std::vector<double> values;
  for (std::size_t i = step / 2; i < points.size(); i += step) {
    const double zncc =
        left_.Zncc(pair.Of(false), view_.PixelOf(points[i].row, points[i].column), points[i].start);
    if (std::isfinite(zncc)) values.push_back(zncc);
  }
  return values.size() < kFew / 2 ? -1 : Median(std::move(values));
}

Image<Eigen::Vector3d> SurfaceLike(const StereoRig& rig, const WheelView& last,
                                   const GrayImage& left, const PreparedPair& pair,
                                   const StereoSequenceOptions& options,
                                   const Image<std::uint8_t>& mask) {
  CorrelatorOptions second = Across(options);
  second.order = 2;
  const CorrelationImage image(left, options.field.image);
  const SubsetCorrelator correlator(image, second, OrNull(mask));
  const Places places = PlacesOf(rig.right, rig.right_from_left, last.point_in_rig_mm);
  Image<Eigen::Vector3d> points(
      places.size(), Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
  tbb::parallel_for(0, places.height(), [&](int r) {
    for (int c = 0; c < places.width(); ++c) {
      const bool inner = r > 0 && c > 0 && r + 1 < places.height() && c + 1 < places.width();
      const Eigen::Vector2d pixel = last.PixelOf(r, c).cast<double>();
      SubsetWarp start = SubsetWarp::Of(places(r, c) - pixel);
      if (inner) start = WarpAt(last, places, r, c);
      if (!start.c.allFinite()) start = SubsetWarp::Of(places(r, c) - pixel);
      if (!start.c.allFinite()) continue;
      const SubsetMatch match = correlator.Match(pair.Of(true), last.PixelOf(r, c), start);
      if (match.status != Status::kOk) continue;
      const TriangulatedPoint point =
          Triangulate(rig, {pixel, pixel + match.warp.displacement_px()});
      constexpr double kOff_px = 1;
      if (point.status == Status::kOk && std::abs(point.epipolar_px) < kOff_px) {
        points(r, c) = point.point_in_rig;
      }
    }
  });
  return points;
}

}  // namespace plumbline::internal
