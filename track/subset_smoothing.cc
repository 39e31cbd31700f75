#include "track/subset_smoothing.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>

#include "calib/parallel.h"
#include "track/surface_motion.h"

namespace plumbline {
namespace {

using Vector6f = Eigen::Matrix<float, 6, 1>;

constexpr int kMostPerSide = 3;  // points of the window to each side
// What is found has been smoothed, so that less of it is left out than of the motion itself: set so
// that displacements of the virtual tyre on flat ground and over a bar are covered (order 2).
constexpr double kSmoothedLess = 1.5;
constexpr double kBeyondNoise = 1.5;  // what is less may be noise
const Eigen::Vector3d kNowhere =
    Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());

// Weights that give the value at the origin of the polynomial of least squares through values at
// these places; empty where they do not tell it.
Eigen::VectorXd Kernel(const Eigen::Matrix2Xd& places, int order) {
  constexpr double kSmallestPivot = 1e-9;
  const Eigen::Index n = places.cols();
  const double scale = std::max(1.0, places.cwiseAbs().maxCoeff());
  Eigen::MatrixXd terms(n, order == 2 ? 6 : 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double x = places(0, i) / scale, y = places(1, i) / scale;
    terms.row(i).head<3>() << 1, x, y;
    if (order == 2) terms.row(i).tail<3>() << x * x, x * y, y * y;
  }
  const Eigen::LDLT<Eigen::MatrixXd> normal(terms.transpose() * terms);
  const auto pivots = normal.vectorD();
  if (n < terms.cols() || !(pivots.minCoeff() > kSmallestPivot * pivots.maxCoeff())) return {};
  return terms * normal.solve(Eigen::VectorXd::Unit(terms.cols(), 0));
}

// What a kernel makes of the first power that its order leaves out, the mean of x and y.
double Response(const Eigen::Matrix2Xd& places, const Eigen::VectorXd& kernel, int order) {
  const Eigen::ArrayXXd squares = places.array().square();
  const Eigen::ArrayXXd powers = order == 2 ? Eigen::ArrayXXd(squares.square()) : squares;
  return (powers.matrix() * kernel).mean();
}

Eigen::Matrix2Xd PlacesOf(const std::vector<Eigen::Vector2i>& offsets, int step_px) {
  Eigen::Matrix2Xd places(2, static_cast<Eigen::Index>(offsets.size()));
  for (Eigen::Index k = 0; k < places.cols(); ++k) {
    places.col(k) = (step_px * offsets[static_cast<std::size_t>(k)]).cast<double>();
  }
  return places;
}

Eigen::Matrix2Xd PixelsOf(int subset_px) {
  const int radius = subset_px / 2, side = 2 * radius + 1;
  Eigen::Matrix2Xd pixels(2, side * side);
  for (int k = 0; k < side * side; ++k) pixels.col(k) << k % side - radius, k / side - radius;
  return pixels;
}

// Where both matches are, less what orders 0 and 1 take over from the pair at rest; NaN where one
// is missing.
Eigen::Vector4d PixelsAt(const StereoField& reference, const StereoField& field, int order,
                         std::size_t i) {
  if (field.left.status.data()[i] != Status::kOk || field.right.status.data()[i] != Status::kOk) {
    return Eigen::Vector4d::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  Eigen::Vector4d px;
  px << field.left.displacement_px.data()[i], field.right.displacement_px.data()[i];
  if (order < 2) px.tail<2>() -= reference.right.displacement_px.data()[i];
  return px;
}

Eigen::Matrix2d Back(const PlanarField& match, std::size_t i) {
  return (Eigen::Matrix2d::Identity() + match.gradient.data()[i].cast<double>()).inverse();
}

// How much of `seen` is beyond `noise`.
Eigen::Matrix3d Beyond(const Eigen::Matrix3d& seen, Eigen::Matrix3d noise) {
  constexpr double kRoom = 1e-6;  // for directions in which noise has no part
  noise += kRoom * noise.trace() * Eigen::Matrix3d::Identity();
  const Eigen::LLT<Eigen::Matrix3d> root(noise);
  if (root.info() != Eigen::Success) return Eigen::Matrix3d::Zero();
  const Eigen::Matrix3d half = root.matrixL().solve(seen);
  const Eigen::Matrix3d in_noise = root.matrixL().solve(half.transpose());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(in_noise);
  const Eigen::Vector3d beyond = eigen.eigenvalues().unaryExpr(
      [](double ratio) { return ratio > kBeyondNoise ? kSmoothedLess * (ratio - 1) : 0; });
  const Eigen::Matrix3d axes = root.matrixL() * eigen.eigenvectors();
  return axes * beyond.asDiagonal() * axes.transpose();
}

}  // namespace

SubsetSmoothing::SubsetSmoothing(const PlanarField& of)
    : order_(of.order),
      step_px_(of.step_px),
      neighbours_(NeighbourCorrelation::OfOverlap(of.size(), of.step_px, of.subset_px, of.order)) {
  const Eigen::Matrix2Xd pixels = PixelsOf(of.subset_px);
  const double of_pixels = Response(pixels, Kernel(pixels, order_), order_);
  // Three points in a row tell no fourth power from a square.
  const int least = order_ == 2 ? 2 : 1;
  const int reach = std::max(
      least, static_cast<int>(std::lround(0.5 * of.subset_px / static_cast<double>(of.step_px))));
  const int apart = (reach + kMostPerSide - 1) / kMostPerSide, most = reach / apart;
  std::vector<Eigen::Vector2i> offsets;
  for (int y = -most; y <= most; ++y) {
    for (int x = -most; x <= most; ++x) offsets.emplace_back(apart * x, apart * y);
  }
  const Eigen::Matrix2Xd points = PlacesOf(offsets, of.step_px);
  scale_ = of_pixels / Response(points, Kernel(points, order_), order_);
  whole_ = Among(std::move(offsets));
}

SubsetSmoothing::Difference SubsetSmoothing::Among(std::vector<Eigen::Vector2i> offsets) const {
  // One more point than unknowns would tell what is left out by chance.
  constexpr std::size_t kMore = 3;
  Difference out;
  if (offsets.size() < (order_ == 2 ? 6 : 3) + kMore) return out;
  const Eigen::VectorXd kernel = Kernel(PlacesOf(offsets, step_px_), order_);
  if (kernel.size() == 0) return out;
  out.weights = kernel;
  for (Eigen::Index k = 0; k < kernel.size(); ++k) {
    if (offsets[static_cast<std::size_t>(k)].isZero()) out.weights[k] -= 1;
  }
  out.weights *= scale_;
  for (std::size_t a = 0; a < offsets.size(); ++a) {
    for (std::size_t b = 0; b < offsets.size(); ++b) {
      const Eigen::Vector2i apart = offsets[b] - offsets[a];
      out.noise_gain += out.weights[static_cast<Eigen::Index>(a)] *
                        out.weights[static_cast<Eigen::Index>(b)] *
                        static_cast<double>(neighbours_.Between(0, 0, apart.y(), apart.x())(0, 0));
    }
  }
  out.offsets = std::move(offsets);
  return out;
}

Image<Vector6f> SubsetSmoothing::LeftOut(const StereoField& reference, const StereoField& field,
                                         const SurfaceState& instant,
                                         const Image<Eigen::Vector3f>& cov_px2) const {
  const ImageSize size = instant.size();
  const auto columns = static_cast<std::size_t>(size.width);
  Image<Eigen::Vector4d> px(size, Eigen::Vector4d::Zero());
  ForEachIndex(px.pixel_count(),
               [&](std::size_t i) { px.data()[i] = PixelsAt(reference, field, order_, i); });
  const Image<Vector6f> cov = CovarianceOf(instant, cov_px2);
  // Of the points around (row, column), those that `has` says are there.
  const auto around = [&](std::size_t i, auto&& has) {
    const int row = static_cast<int>(i / columns), column = static_cast<int>(i % columns);
    std::vector<Eigen::Vector2i> there;
    for (const Eigen::Vector2i& offset : whole_.offsets) {
      const int r = row + offset.y(), c = column + offset.x();
      if (r < 0 || c < 0 || r >= size.height || c >= size.width || !has(r, c)) continue;
      there.push_back(offset);
    }
    return there;
  };
  Image<Eigen::Vector3d> error_mm(size, kNowhere);
  Image<Eigen::Matrix3d> noise_mm2(size, Eigen::Matrix3d::Zero());
  ForEachIndex(px.pixel_count(), [&](std::size_t i) {
    if (!instant.point_mm.data()[i].allFinite()) return;
    const int row = static_cast<int>(i / columns), column = static_cast<int>(i % columns);
    std::vector<Eigen::Vector2i> there =
        around(i, [&](int r, int c) { return px(r, c).allFinite(); });
    const bool complete = there.size() == whole_.offsets.size();
    const Difference some = complete ? Difference{} : Among(std::move(there));
    const Difference& difference = complete ? whole_ : some;
    if (difference.offsets.empty()) return;
    Eigen::Vector4d d = Eigen::Vector4d::Zero();
    for (std::size_t k = 0; k < difference.offsets.size(); ++k) {
      const Eigen::Vector2i& offset = difference.offsets[k];
      d += difference.weights[static_cast<Eigen::Index>(k)] *
           px(row + offset.y(), column + offset.x());
    }
    error_mm.data()[i] =
        instant.d_left.data()[i].cast<double>() * (Back(field.left, i) * d.head<2>()) +
        instant.d_right.data()[i].cast<double>() * (Back(field.right, i) * d.tail<2>());
    noise_mm2.data()[i] = difference.noise_gain * CovarianceOf(cov.data()[i]);
  });
  Image<Vector6f> out(size, Vector6f::Constant(std::numeric_limits<float>::quiet_NaN()));
  ForEachIndex(out.pixel_count(), [&](std::size_t i) {
    if (!instant.point_mm.data()[i].allFinite()) return;
    const int row = static_cast<int>(i / columns), column = static_cast<int>(i % columns);
    Eigen::Matrix3d seen = Eigen::Matrix3d::Zero(), noise = Eigen::Matrix3d::Zero();
    const auto there = around(i, [&](int r, int c) { return error_mm(r, c).allFinite(); });
    for (const Eigen::Vector2i& offset : there) {
      const Eigen::Vector3d& d = error_mm(row + offset.y(), column + offset.x());
      seen += d * d.transpose();
      noise += noise_mm2(row + offset.y(), column + offset.x());
    }
    const auto count = static_cast<double>(std::max<std::size_t>(1, there.size()));
    out.data()[i] =
        there.empty() ? Vector6f::Zero().eval() : TriangleOf(Beyond(seen / count, noise / count));
  });
  return out;
}

}  // namespace plumbline
