#include "fit/surface_points.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "match/planar_field.h"

namespace plumbline {
namespace {

// A lower triangular root of a covariance that may be singular.
Eigen::Matrix3d RootOf(const Eigen::Matrix<float, 6, 1>& packed) {
  const Eigen::Matrix3d cov = CovarianceOf(packed);
  Eigen::Matrix3d root = Eigen::Matrix3d::Zero();
  for (int c = 0; c < 3; ++c) {
    const double pivot = cov(c, c) - root.row(c).head(c).squaredNorm();
    if (!(pivot > 1e-12 * cov(c, c))) continue;
    root(c, c) = std::sqrt(pivot);
    for (int r = c + 1; r < 3; ++r) {
      root(r, c) = (cov(r, c) - root.row(r).head(c).dot(root.row(c).head(c))) / root(c, c);
    }
  }
  return root;
}

}  // namespace

void SurfacePoints::Check() const {
  const auto differs = [&](const Image<Eigen::Vector3f>& image) { return image.size() != size(); };
  if (cov_random_mm2.size() != size() ||
      std::any_of(along_common_mm.begin(), along_common_mm.end(), differs) ||
      std::any_of(along_modes_mm.begin(), along_modes_mm.end(), differs)) {
    throw std::invalid_argument("SurfacePoints: points and their errors are of different grids");
  }
}

double MeasuredScalar::sigma_calibration() const {
  return along_modes.size() > 0 ? along_modes.norm() : std::numeric_limits<double>::quiet_NaN();
}

Eigen::Matrix<double, 6, 6> UncertainFrame::Root() const {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> solver(cov_random);
  return solver.eigenvectors() * solver.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
}

SurfacePoints InFrame(const SurfacePoints& in_rig, const UncertainFrame& frame) {
  in_rig.Check();
  if (!frame.along_modes.empty() && frame.along_modes.size() != in_rig.along_modes_mm.size()) {
    throw std::invalid_argument("InFrame: points and frame know different calibration modes");
  }
  const Rigid3& to = frame.frame_from_rig;
  const Eigen::Matrix<double, 6, 6> root = frame.Root();
  SurfacePoints told = in_rig;
  for (Image<Eigen::Vector3f>& error : told.along_common_mm) {
    for (Eigen::Vector3f& e : error.values()) e = to.rotation.cast<float>() * e;
  }
  const std::size_t own = told.along_common_mm.size();
  told.along_common_mm.resize(own + 6,
                              Image<Eigen::Vector3f>(in_rig.size(), Eigen::Vector3f::Zero()));
  for (std::size_t i = 0; i < told.point_mm.pixel_count(); ++i) {
    const Eigen::Vector3d p = in_rig.point_mm.data()[i], q = to * p;
    told.point_mm.data()[i] = q;
    told.cov_random_mm2.data()[i] = TriangleOf(Eigen::Matrix3d(
        to.rotation * CovarianceOf(in_rig.cov_random_mm2.data()[i]) * to.rotation.transpose()));
    for (std::size_t k = 0; k < 6; ++k) {
      const auto error = root.col(static_cast<Eigen::Index>(k));
      const Eigen::Vector3d turn = error.head<3>(), shift = error.tail<3>();
      told.along_common_mm[own + k].data()[i] = (turn.cross(q) + shift).cast<float>();
    }
    for (std::size_t k = 0; k < told.along_modes_mm.size(); ++k) {
      const Rigid3& moved = frame.along_modes.empty() ? to : frame.along_modes[k];
      const Eigen::Vector3d there = p + in_rig.along_modes_mm[k].data()[i].cast<double>();
      told.along_modes_mm[k].data()[i] = (moved * there - q).cast<float>();
    }
  }
  return told;
}

Eigen::MatrixXd IndependentCovariance(std::span<const PointChange> changes,
                                      const SurfacePoints& points,
                                      const NeighbourCorrelation& neighbours) {
  using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 3, 3>;
  const Eigen::Index results = changes.empty() ? 0 : changes.front().change.rows();
  const int columns = points.size().width, reach = neighbours.reach();
  const auto row = [&](std::size_t k) { return static_cast<int>(changes[k].place) / columns; };
  const auto column = [&](std::size_t k) { return static_cast<int>(changes[k].place) % columns; };
  std::vector<PointChange::Matrix> scaled;
  scaled.reserve(changes.size());
  for (const PointChange& c : changes) {
    scaled.emplace_back(c.change * RootOf(points.cov_random_mm2.data()[c.place]));
  }
  Square covariance = Square::Zero(results, results);
  for (std::size_t a = 0; a < changes.size(); ++a) {
    covariance += scaled[a] * scaled[a].transpose();
    // Each pair once: by place, b comes later in the grid.
    for (std::size_t b = a + 1; b < changes.size() && row(b) - row(a) <= reach; ++b) {
      const int dr = row(b) - row(a), dc = column(b) - column(a);
      if (std::abs(dc) > reach) continue;
      const double rho = neighbours.Between(row(a), column(a), dr, dc).trace() / 2;
      const Square both = rho * scaled[a] * scaled[b].transpose();
      covariance += both + both.transpose();
    }
  }
  return covariance;
}

Eigen::MatrixXd ChangeAlong(std::span<const PointChange> changes,
                            const std::vector<Image<Eigen::Vector3f>>& errors_mm) {
  const Eigen::Index results = changes.empty() ? 0 : changes.front().change.rows();
  Eigen::MatrixXd along =
      Eigen::MatrixXd::Zero(results, static_cast<Eigen::Index>(errors_mm.size()));
  for (std::size_t k = 0; k < errors_mm.size(); ++k) {
    for (const PointChange& c : changes) {
      along.col(static_cast<Eigen::Index>(k)) +=
          c.change * errors_mm[k].data()[c.place].cast<double>();
    }
  }
  return along;
}

ErrorSum::ErrorSum(Eigen::Index common, Eigen::Index modes)
    : common_(Eigen::VectorXd::Zero(common)), modes_(Eigen::VectorXd::Zero(modes)) {}

void ErrorSum::AddPoints(std::span<const PointChange> changes, const SurfacePoints& points,
                         const NeighbourCorrelation& neighbours) {
  if (changes.empty()) return;
  variance_ += IndependentCovariance(changes, points, neighbours)(0, 0);
  common_ += ChangeAlong(changes, points.along_common_mm).transpose();
  modes_ += ChangeAlong(changes, points.along_modes_mm).transpose();
}

void ErrorSum::AddScalar(double by, const MeasuredScalar& scalar) {
  variance_ += std::pow(by * scalar.sigma_random, 2);
  if (scalar.along_modes.size() == modes_.size()) {
    modes_ += by * scalar.along_modes;
  } else if (scalar.along_modes.size() > 0) {
    foreign_ = std::hypot(foreign_, by * scalar.sigma_calibration());
  }
}

MeasuredScalar ErrorSum::Of(double value) const {
  Eigen::VectorXd modes = modes_;
  if (foreign_ > 0) {
    modes.conservativeResize(modes.size() + 1);
    modes[modes.size() - 1] = foreign_;
  }
  return {value, std::sqrt(variance_ + common_.squaredNorm()), modes};
}

MeasuredScalar MeasuredSum(std::span<const PointChange> changes, double value,
                           const SurfacePoints& points, const NeighbourCorrelation& neighbours) {
  ErrorSum errors(static_cast<Eigen::Index>(points.along_common_mm.size()),
                  static_cast<Eigen::Index>(points.along_modes_mm.size()));
  errors.AddPoints(changes, points, neighbours);
  return errors.Of(value);
}

}  // namespace plumbline
