#include "calib/camera.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "calib/internal/mrcal.h"

namespace plumbline {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kChunk = 256;           // points handed to libmrcal in one call
constexpr std::size_t kParallelGrain = 8192;  // points below which threads do not pay
constexpr int kMaxNewtonSteps = 30;
constexpr double kUnprojectTolerance_px = 1e-9;

using DenseJacobian = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;

// The inverse of a projection is sought in a plane chart of the viewing directions: u -> point(u),
// in which the bare lens (pinhole or stereographic) is affine, so that Newton's method starts
// within the distortion of the answer.
struct Chart {
  bool stereographic;
  double fxycxy[4] = {1, 1, 0, 0};

  mrcal_point3_t Point(const Eigen::Vector2d& u, Eigen::Matrix<double, 3, 2>* d_point_d_u) const {
    mrcal_point3_t p;
    if (!stereographic) {
      p.x = u.x();
      p.y = u.y();
      p.z = 1;
      *d_point_d_u << 1, 0, 0, 1, 0, 0;
      return p;
    }
    const mrcal_point2_t q = {{u.x(), u.y()}};
    std::array<mrcal_point2_t, 3> gradient;
    mrcal_unproject_stereographic(&p, gradient.data(), &q, 1, fxycxy);
    for (int r = 0; r < 3; ++r) {
      (*d_point_d_u)(r, 0) = gradient[static_cast<std::size_t>(r)].x;
      (*d_point_d_u)(r, 1) = gradient[static_cast<std::size_t>(r)].y;
    }
    return p;
  }
};

}  // namespace

namespace internal {

mrcal_lensmodel_t ToMrcal(const LensModel& model) {
  mrcal_lensmodel_t m{};
  const std::string name = model.Name();
  if (!mrcal_lensmodel_from_name(&m, name.c_str())) {
    throw InputError(
        "lens model '" + name +
        "' is not one libmrcal accepts; use OPENCV4, OPENCV5, OPENCV8 or SPLINED_STEREOGRAPHIC");
  }
  return m;
}

LensModel FromMrcal(const mrcal_lensmodel_t& model) {
  LensModel m;
  switch (model.type) {
    case MRCAL_LENSMODEL_OPENCV4:
      m.kind = LensModel::Kind::kOpenCv4;
      return m;
    case MRCAL_LENSMODEL_OPENCV5:
      m.kind = LensModel::Kind::kOpenCv5;
      return m;
    case MRCAL_LENSMODEL_OPENCV8:
      m.kind = LensModel::Kind::kOpenCv8;
      return m;
    case MRCAL_LENSMODEL_SPLINED_STEREOGRAPHIC: {
      const auto& c = model.LENSMODEL_SPLINED_STEREOGRAPHIC__config;
      m.kind = LensModel::Kind::kSplinedStereographic;
      m.spline_order = c.order;
      m.knots_x = c.Nx;
      m.knots_y = c.Ny;
      m.fov_x_deg = c.fov_x_deg;
      return m;
    }
    default:
      throw InputError("unsupported lens model");
  }
}

}  // namespace internal

std::string LensModel::Name() const {
  switch (kind) {
    case Kind::kOpenCv4:
      return "LENSMODEL_OPENCV4";
    case Kind::kOpenCv5:
      return "LENSMODEL_OPENCV5";
    case Kind::kOpenCv8:
      return "LENSMODEL_OPENCV8";
    case Kind::kSplinedStereographic:
      break;
  }
  return "LENSMODEL_SPLINED_STEREOGRAPHIC_order=" + std::to_string(spline_order) +
         "_Nx=" + std::to_string(knots_x) + "_Ny=" + std::to_string(knots_y) +
         "_fov_x_deg=" + std::to_string(fov_x_deg);
}

LensModel LensModel::FromName(std::string_view name) {
  std::string full(name);
  if (full.rfind("LENSMODEL_", 0) != 0) {
    // Upper case up to the configuration, whose keys (order, Nx, ...) keep theirs.
    const std::size_t configuration = std::min(full.find("_order="), full.size());
    std::transform(full.begin(), full.begin() + static_cast<std::ptrdiff_t>(configuration),
                   full.begin(),
                   [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
    full = "LENSMODEL_" + full;
  }
  mrcal_lensmodel_t m{};
  const bool known = mrcal_lensmodel_from_name(&m, full.c_str());
  const bool supported =
      known &&
      (m.type == MRCAL_LENSMODEL_OPENCV4 || m.type == MRCAL_LENSMODEL_OPENCV5 ||
       m.type == MRCAL_LENSMODEL_OPENCV8 || m.type == MRCAL_LENSMODEL_SPLINED_STEREOGRAPHIC);
  if (!supported) {
    throw InputError("lens model '" + std::string(name) +
                     "' is not supported; use OPENCV4, OPENCV5, OPENCV8 or "
                     "SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=11_fov_x_deg=80");
  }
  return internal::FromMrcal(m);
}

int LensModel::ParameterCount() const {
  const mrcal_lensmodel_t m = internal::ToMrcal(*this);
  return mrcal_lensmodel_num_params(&m);
}

struct Camera::Impl {
  LensModel model;
  ImageSize size;
  Eigen::VectorXd parameters;
  mrcal_lensmodel_t mrcal;
  Chart chart;

  bool Visible(const Eigen::Vector3d& p) const {
    return p.allFinite() &&
           (model.IsSplined() ? p.norm() > std::abs(p.z()) * (1 + 1e-12) || p.z() > 0 : p.z() > 0);
  }

  void ProjectChunk(std::span<const Eigen::Vector3d> points,
                    std::span<Eigen::Vector2d> pixels) const {
    std::array<mrcal_point3_t, kChunk> p{};
    std::array<mrcal_point2_t, kChunk> q;
    const std::size_t n = points.size();
    for (std::size_t i = 0; i < n; ++i) {
      const bool visible = Visible(points[i]);
      p[i].x = visible ? points[i].x() : 0;
      p[i].y = visible ? points[i].y() : 0;
      p[i].z = visible ? points[i].z() : 1;
    }
    mrcal_project(q.data(), nullptr, nullptr, p.data(), static_cast<int>(n), &mrcal,
                  parameters.data());
    for (std::size_t i = 0; i < n; ++i) {
      pixels[i] =
          Visible(points[i]) ? Eigen::Vector2d(q[i].x, q[i].y) : Eigen::Vector2d(kNaN, kNaN);
    }
  }

  // The gradient at one point. One call a point: libmrcal 2.2 fills only the first gradient of
  // several when those of the intrinsics are not wanted.
  Eigen::Matrix<double, 2, 3> Gradient(const mrcal_point3_t& p, mrcal_point2_t* q) const {
    std::array<mrcal_point3_t, 2> dq_dp;
    mrcal_project(q, dq_dp.data(), nullptr, &p, 1, &mrcal, parameters.data());
    Eigen::Matrix<double, 2, 3> g;
    g << dq_dp[0].x, dq_dp[0].y, dq_dp[0].z, dq_dp[1].x, dq_dp[1].y, dq_dp[1].z;
    return g;
  }

  // The viewing ray of one pixel by Newton's method on the chart; a step after which the residual
  // grows is halved. NaN where that does not end.
  Eigen::Vector3d UnprojectByNewton(const Eigen::Vector2d& pixel) const {
    Eigen::Vector2d u((pixel.x() - parameters[2]) / parameters[0],
                      (pixel.y() - parameters[3]) / parameters[1]);
    Eigen::Vector2d step = Eigen::Vector2d::Zero();
    double error = std::numeric_limits<double>::infinity();
    for (int iteration = 0; iteration < kMaxNewtonSteps; ++iteration) {
      Eigen::Matrix<double, 3, 2> d_point_d_u;
      const mrcal_point3_t p = chart.Point(u, &d_point_d_u);
      mrcal_point2_t q;
      const Eigen::Matrix2d jacobian = Gradient(p, &q) * d_point_d_u;
      const Eigen::Vector2d residual = pixel - Eigen::Vector2d(q.x, q.y);
      const double residual_norm = residual.norm();
      const double determinant = jacobian.determinant();
      if (residual_norm < kUnprojectTolerance_px) {
        // A mirrored neighbourhood is the far side of a fold, not the lens.
        if (!(determinant > 0)) break;
        return Eigen::Vector3d(p.x, p.y, p.z).normalized();
      }
      if (!std::isfinite(residual_norm) || residual_norm >= error || !(determinant > 0)) {
        step *= 0.5;  // the last step went too far
        u -= step;
        if (step.norm() < 1e-15) break;
      } else {
        error = residual_norm;
        step = jacobian.inverse() * residual;
        u += step;
      }
    }
    return Eigen::Vector3d::Constant(kNaN);
  }

  // One Newton step, then Broyden's (Broyden 1965, "good" update of the inverse Jacobian): after
  // the first, a step needs the projection alone, which libmrcal gives for many points at a fifth
  // of the price of a gradient. Only steps that shrink the residual at least fivefold are believed,
  // so that the neighbourhood stays the one whose orientation was checked at the start; the rest
  // goes to UnprojectByNewton. For the OPENCV models, whose chart is z = 1.
  void UnprojectChunkByBroyden(std::span<const Eigen::Vector2d> pixels,
                               std::span<Eigen::Vector3d> rays) const {
    std::array<Eigen::Vector2d, kChunk> step, residual;
    std::array<Eigen::Matrix2d, kChunk> inverse;
    std::array<mrcal_point3_t, kChunk> p;
    std::array<mrcal_point2_t, kChunk> q;
    std::array<std::size_t, kChunk> active;
    std::size_t active_count = 0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      rays[i].setConstant(kNaN);
      if (!pixels[i].allFinite()) continue;
      const std::size_t a = active_count;
      p[a].x = (pixels[i].x() - parameters[2]) / parameters[0];
      p[a].y = (pixels[i].y() - parameters[3]) / parameters[1];
      p[a].z = 1;
      const Eigen::Matrix2d jacobian = Gradient(p[a], &q[a]).leftCols<2>();
      residual[i] = pixels[i] - Eigen::Vector2d(q[a].x, q[a].y);
      if (!(jacobian.determinant() > 0) || !residual[i].allFinite()) {
        rays[i] = UnprojectByNewton(pixels[i]);
        continue;
      }
      inverse[i] = jacobian.inverse();
      step[i] = inverse[i] * residual[i];
      p[a].x += step[i].x();
      p[a].y += step[i].y();
      active[active_count++] = i;
    }
    for (int iteration = 0; iteration < kMaxNewtonSteps && active_count > 0; ++iteration) {
      mrcal_project(q.data(), nullptr, nullptr, p.data(), static_cast<int>(active_count), &mrcal,
                    parameters.data());
      std::size_t kept = 0;
      for (std::size_t a = 0; a < active_count; ++a) {
        const std::size_t i = active[a];
        const Eigen::Vector2d now = pixels[i] - Eigen::Vector2d(q[a].x, q[a].y);
        const double norm = now.norm();
        if (norm < kUnprojectTolerance_px) {
          rays[i] = Eigen::Vector3d(p[a].x, p[a].y, 1).normalized();
          continue;
        }
        const Eigen::Vector2d inverse_times_change = inverse[i] * (residual[i] - now);
        const double denominator = step[i].dot(inverse_times_change);
        if (!(norm < 0.2 * residual[i].norm()) || !(denominator > 0)) {
          rays[i] = UnprojectByNewton(pixels[i]);
          continue;
        }
        inverse[i] +=
            ((step[i] - inverse_times_change) / denominator) * (step[i].transpose() * inverse[i]);
        residual[i] = now;
        step[i] = inverse[i] * now;
        p[kept] = p[a];
        p[kept].x += step[i].x();
        p[kept].y += step[i].y();
        active[kept++] = i;
      }
      active_count = kept;
    }
  }

  void UnprojectChunk(std::span<const Eigen::Vector2d> pixels,
                      std::span<Eigen::Vector3d> rays) const {
    if (!model.IsSplined()) {
      UnprojectChunkByBroyden(pixels, rays);
      return;
    }
    // A splined projection costs nearly as much without its gradient: Newton's fewer steps win.
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      rays[i] = pixels[i].allFinite() ? UnprojectByNewton(pixels[i])
                                      : Eigen::Vector3d(Eigen::Vector3d::Constant(kNaN));
    }
  }
};

Camera::Camera(const LensModel& model, ImageSize size, Eigen::VectorXd parameters) {
  const int expected = model.ParameterCount();
  if (parameters.size() != expected) {
    throw std::invalid_argument("camera: " + model.Name() + " has " + std::to_string(expected) +
                                " parameters, not " + std::to_string(parameters.size()));
  }
  if (!parameters.allFinite())
    throw std::invalid_argument("camera: a parameter is not a finite number");
  if (!(parameters[0] > 0 && parameters[1] > 0)) {
    throw std::invalid_argument("camera: the focal lengths must be positive");
  }
  if (size.width <= 0 || size.height <= 0)
    throw std::invalid_argument("camera: the image size must be positive");
  const mrcal_lensmodel_t m = internal::ToMrcal(model);
  impl_ = std::make_shared<const Impl>(
      Impl{model, size, std::move(parameters), m, Chart{model.IsSplined()}});
}

const LensModel& Camera::model() const { return impl_->model; }
ImageSize Camera::size() const { return impl_->size; }
const Eigen::VectorXd& Camera::parameters() const { return impl_->parameters; }

Camera Camera::WithParameters(Eigen::VectorXd parameters) const {
  return Camera(impl_->model, impl_->size, std::move(parameters));
}

Eigen::Vector2d Camera::Project(const Eigen::Vector3d& point_mm) const {
  Eigen::Vector2d pixel;
  impl_->ProjectChunk({&point_mm, 1}, {&pixel, 1});
  return pixel;
}

Camera::Projection Camera::ProjectWithJacobians(const Eigen::Vector3d& point_mm) const {
  Projection out;
  DenseJacobian d_parameters(2, parameter_count());
  if (!impl_->Visible(point_mm)) {
    out.pixel.setConstant(kNaN);
    out.d_pixel_d_point.setConstant(kNaN);
    out.d_pixel_d_parameters = DenseJacobian::Constant(2, parameter_count(), kNaN);
    return out;
  }
  const mrcal_point3_t p = {{point_mm.x(), point_mm.y(), point_mm.z()}};
  mrcal_point2_t q;
  std::array<mrcal_point3_t, 2> dq_dp;
  d_parameters.setZero();  // libmrcal leaves the entries that a spline patch does not touch
  mrcal_project(&q, dq_dp.data(), d_parameters.data(), &p, 1, &impl_->mrcal, parameters().data());
  out.pixel << q.x, q.y;
  out.d_pixel_d_point << dq_dp[0].x, dq_dp[0].y, dq_dp[0].z, dq_dp[1].x, dq_dp[1].y, dq_dp[1].z;
  out.d_pixel_d_parameters = d_parameters;
  return out;
}

namespace {

// Runs f(first, count) over [0, n) in chunks, in parallel where there are enough of them.
template <typename F>
void ForEachChunk(std::size_t n, const F& f) {
  const auto range = [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; i += kChunk) f(i, std::min(kChunk, end - i));
  };
  if (n < kParallelGrain) {
    range(0, n);
    return;
  }
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, (n + kChunk - 1) / kChunk, 8),
                    [&](const tbb::blocked_range<std::size_t>& r) {
                      range(r.begin() * kChunk, std::min(n, r.end() * kChunk));
                    });
}

}  // namespace

void Camera::Project(std::span<const Eigen::Vector3d> points_mm,
                     std::span<Eigen::Vector2d> pixels) const {
  ForEachChunk(points_mm.size(), [&](std::size_t first, std::size_t count) {
    impl_->ProjectChunk(points_mm.subspan(first, count), pixels.subspan(first, count));
  });
}

void Camera::ProjectWithPointJacobians(
    std::span<const Eigen::Vector3d> points_mm, std::span<Eigen::Vector2d> pixels,
    std::span<Eigen::Matrix<double, 2, 3>> d_pixel_d_point) const {
  ForEachChunk(points_mm.size(), [&](std::size_t first, std::size_t count) {
    for (std::size_t i = first; i < first + count; ++i) {
      const Eigen::Vector3d& p = points_mm[i];
      if (!impl_->Visible(p)) {
        pixels[i].setConstant(kNaN);
        d_pixel_d_point[i].setConstant(kNaN);
        continue;
      }
      mrcal_point2_t q;
      d_pixel_d_point[i] = impl_->Gradient({{p.x(), p.y(), p.z()}}, &q);
      pixels[i] << q.x, q.y;
    }
  });
}

Eigen::Vector3d Camera::Unproject(const Eigen::Vector2d& pixel) const {
  Eigen::Vector3d ray;
  impl_->UnprojectChunk({&pixel, 1}, {&ray, 1});
  return ray;
}

Camera::Unprojection Camera::UnprojectWithJacobians(const Eigen::Vector2d& pixel) const {
  Unprojection out;
  out.ray = Unproject(pixel);
  if (!out.ray.allFinite()) {
    out.d_ray_d_pixel.setConstant(kNaN);
    out.d_ray_d_parameters = Eigen::MatrixXd::Constant(3, parameter_count(), kNaN);
    return out;
  }
  const Projection at = ProjectWithJacobians(out.ray);
  const Eigen::Matrix<double, 2, 3>& G = at.d_pixel_d_point;
  out.d_ray_d_pixel = G.transpose() * (G * G.transpose()).inverse();
  out.d_ray_d_parameters = -out.d_ray_d_pixel * at.d_pixel_d_parameters;
  return out;
}

void Camera::Unproject(std::span<const Eigen::Vector2d> pixels,
                       std::span<Eigen::Vector3d> rays) const {
  ForEachChunk(pixels.size(), [&](std::size_t first, std::size_t count) {
    impl_->UnprojectChunk(pixels.subspan(first, count), rays.subspan(first, count));
  });
}

void Camera::UnprojectWithPixelJacobians(
    std::span<const Eigen::Vector2d> pixels, std::span<Eigen::Vector3d> rays,
    std::span<Eigen::Matrix<double, 3, 2>> d_ray_d_pixel) const {
  ForEachChunk(pixels.size(), [&](std::size_t first, std::size_t count) {
    impl_->UnprojectChunk(pixels.subspan(first, count), rays.subspan(first, count));
    for (std::size_t i = first; i < first + count; ++i) {
      if (!rays[i].allFinite()) {
        d_ray_d_pixel[i].setConstant(kNaN);
        continue;
      }
      mrcal_point2_t q;
      const Eigen::Matrix<double, 2, 3> G =
          impl_->Gradient({{rays[i].x(), rays[i].y(), rays[i].z()}}, &q);
      d_ray_d_pixel[i] = G.transpose() * (G * G.transpose()).inverse();
    }
  });
}

double Camera::NonInvertibleShare(int step_px) const {
  std::vector<Eigen::Vector2d> pixels;
  for (int y = 0; y < size().height; y += step_px) {
    for (int x = 0; x < size().width; x += step_px) pixels.emplace_back(x, y);
  }
  std::vector<Eigen::Vector3d> rays(pixels.size());
  Unproject(pixels, rays);
  const auto bad = std::count_if(rays.begin(), rays.end(),
                                 [](const Eigen::Vector3d& r) { return !r.allFinite(); });
  return static_cast<double>(bad) / static_cast<double>(pixels.size());
}

}  // namespace plumbline
