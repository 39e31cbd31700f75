#include "match/internal/refine_disparity.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "match/internal/bspline.h"

namespace plumbline::internal {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kSameSurfacePx = 1.5F;  // plus the slope of the surface
constexpr double kStartSigmaPx = 0.5;   // of the dense matcher's disparity
constexpr double kSlopeSigma = 0.15;    // of the slope taken from the dense matcher
constexpr int kIterations = 6;
constexpr double kConvergedPx = 0.01;     // step at which a window stops: convergence is fast ...
constexpr double kAcceptedStepPx = 0.05;  // ... and that at which it still counts when time is up
constexpr double kLargestShiftPx = 1.0;
constexpr int kFewestSamples = 12;
constexpr double kBorderPx = 3;  // of the right image that no sample may start in
constexpr double kLargestGradientNoiseShare = 0.6;  // above it there is no texture
// Variance of GradientX() for white noise of variance 1: of the spline's derivative along x (the
// mean over frequencies of (3 sin w / (2 + cos w))^2), times the sum of the squared weights of the
// rows.
constexpr double kGradientNoiseGain = 1.392305 * (9 + 100 + 9) / 256.0;

using Vector5 = Eigen::Matrix<double, 5, 1>;
using Matrix5 = Eigen::Matrix<double, 5, 5>;

// The samples of one window that lie on the centre's surface, in plain arrays so that the loops
// over them vectorise. Capacity (2 radius + 1)^2.
struct Window {
  explicit Window(int radius) : side(2 * radius + 1) {
    for (auto* v : {&xi, &eta, &grey, &gx, &right, &column, &row_base}) {
      v->resize(static_cast<std::size_t>(side) * static_cast<std::size_t>(side));
    }
    rows.resize(xi.size());
  }
  int side;
  int count = 0;
  std::vector<float> xi, eta, grey, gx, right, column, row_base;
  std::vector<int> rows;
};

// The disparity at window coordinates (xi, eta): d + dx xi + dy eta.
struct Plane {
  double d = 0, dx = 0, dy = 0;
};

struct Images {
  const GrayImage& left;
  Image<float> gradient;            // of the left image along x, grey levels per px
  Image<float> right_coefficients;  // cubic B-spline along rows
  const Image<float>& start;
};

// Slopes of the starting disparities over those within the tolerance; two passes, the second with
// the slopes of the first.
Plane FitPlane(const Image<float>& start, int x, int y, int radius, float* relief = nullptr) {
  const float centre = start(y, x);
  Plane plane{centre, 0, 0};
  for (int pass = 0; pass < 2; ++pass) {
    double n = 0, sx = 0, sy = 0, sxx = 0, syy = 0, sxy = 0, sd = 0, sxd = 0, syd = 0, sdd = 0;
    for (int v = -radius; v <= radius; ++v) {
      if (y + v < 0 || y + v >= start.height()) continue;
      const float* row = start.row(y + v);
      for (int u = std::max(-radius, -x); u <= std::min(radius, start.width() - 1 - x); ++u) {
        const double e = static_cast<double>(row[x + u]) - centre;
        if (!(std::abs(e - plane.dx * u - plane.dy * v) <= static_cast<double>(kSameSurfacePx))) {
          continue;
        }
        n += 1, sx += u, sy += v, sxx += u * u, syy += v * v, sxy += u * v;
        sd += e, sxd += u * e, syd += v * e, sdd += e * e;
      }
    }
    if (n < 6) return plane;
    Eigen::Matrix3d A;
    A << n, sx, sy, sx, sxx + 1, sxy, sy, sxy, syy + 1;  // + 1: no slope from a single column
    const Eigen::Vector3d b(sd, sxd, syd);
    const Eigen::Vector3d fit = A.ldlt().solve(b);
    plane.dx = std::clamp(fit[1], -1.0, 0.7);
    plane.dy = std::clamp(fit[2], -1.0, 1.0);
    if (relief != nullptr) {
      *relief = static_cast<float>(std::sqrt(std::max(0.0, (sdd - fit.dot(b)) / n)));
    }
  }
  return plane;
}

void Collect(const Images& images, int x, int y, int radius, const Plane& plane, Window* window) {
  const Image<float>& start = images.start;
  int n = 0;
  for (int v = -radius; v <= radius; ++v) {
    if (y + v < 0 || y + v >= start.height()) continue;
    const float* row = start.row(y + v);
    const float* gx = images.gradient.row(y + v);
    const std::uint16_t* grey = images.left.grey.row(y + v);
    for (int u = std::max(-radius, -x); u <= std::min(radius, start.width() - 1 - x); ++u) {
      const double expected = plane.d + plane.dx * u + plane.dy * v;
      if (!(std::abs(static_cast<double>(row[x + u]) - expected) <=
            static_cast<double>(kSameSurfacePx))) {
        continue;
      }
      const double column = x + u - expected;
      if (!(column >= kBorderPx && column <= start.width() - 1 - kBorderPx)) continue;
      const auto i = static_cast<std::size_t>(n++);
      window->xi[i] = static_cast<float>(u);
      window->eta[i] = static_cast<float>(v);
      window->grey[i] = static_cast<float>(grey[x + u]);
      window->gx[i] = gx[x + u];
      window->rows[i] = y + v;
    }
  }
  window->count = n;
}

// The right image along the plane; false when a sample lies outside it.
bool SampleRight(const Images& images, int x, const Plane& plane, Window* window) {
  const Image<float>& c = images.right_coefficients;
  const auto last = static_cast<float>(c.width() - 3);
  const auto d = static_cast<float>(static_cast<double>(x) - plane.d);
  const auto ax = static_cast<float>(1 - plane.dx);
  const auto ay = static_cast<float>(-plane.dy);
  bool inside = true;
  for (int i = 0; i < window->count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    window->column[k] = d + ax * window->xi[k] + ay * window->eta[k];
    inside &= window->column[k] >= 1 && window->column[k] <= last;
  }
  if (!inside) return false;
  for (int i = 0; i < window->count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const int column = static_cast<int>(window->column[k]);
    float w[4];
    CubicWeights(window->column[k] - static_cast<float>(column), w);
    const float* p = c.row(window->rows[k]) + column - 1;
    window->right[k] = w[0] * p[0] + w[1] * p[1] + w[2] * p[2] + w[3] * p[3];
  }
  return true;
}

// Normal matrix of (gx, gx xi, gx eta, grey - mean, 1): the left image only, once a window.
Matrix5 NormalMatrix(const Window& w, float mean) {
  float s[15] = {};
  for (int i = 0; i < w.count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const float g = w.gx[k], gxi = g * w.xi[k], geta = g * w.eta[k], f = w.grey[k] - mean;
    s[0] += g * g, s[1] += g * gxi, s[2] += g * geta, s[3] += g * f, s[4] += g;
    s[5] += gxi * gxi, s[6] += gxi * geta, s[7] += gxi * f, s[8] += gxi;
    s[9] += geta * geta, s[10] += geta * f, s[11] += geta;
    s[12] += f * f, s[13] += f, s[14] += 1;
  }
  Matrix5 N;
  for (int r = 0, i = 0; r < 5; ++r) {
    for (int c = r; c < 5; ++c, ++i) N(r, c) = N(c, r) = static_cast<double>(s[i]);
  }
  return N;
}

struct RightHandSide {
  Vector5 b = Vector5::Zero();
  double squares = 0;  // of left - right
};

RightHandSide Residuals(const Window& w, float mean) {
  float s[6] = {};
  for (int i = 0; i < w.count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const float e = w.grey[k] - w.right[k];
    const float ge = w.gx[k] * e;
    s[0] += ge, s[1] += ge * w.xi[k], s[2] += ge * w.eta[k];
    s[3] += (w.grey[k] - mean) * e, s[4] += e, s[5] += e * e;
  }
  RightHandSide rhs;
  for (int i = 0; i < 5; ++i) rhs.b[i] = static_cast<double>(s[i]);
  rhs.squares = static_cast<double>(s[5]);
  return rhs;
}

float Mean(const Window& w) {
  float sum = 0;
  for (int i = 0; i < w.count; ++i) sum += w.grey[static_cast<std::size_t>(i)];
  return sum / static_cast<float>(w.count);
}

double Correlation(const Window& w) {
  double sl = 0, sr = 0, sll = 0, srr = 0, slr = 0;
  for (int i = 0; i < w.count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const double l = static_cast<double>(w.grey[k]), r = static_cast<double>(w.right[k]);
    sl += l, sr += r, sll += l * l, srr += r * r, slr += l * r;
  }
  const double n = w.count;
  const double left = sll - sl * sl / n, right = srr - sr * sr / n;
  return left > 0 && right > 0 ? (slr - sl * sr / n) / std::sqrt(left * right) : 0;
}

// One pixel's result, to be put into the images.
struct PixelResult {
  RefineOutcome outcome = RefineOutcome::kTextureless;
  double value = 0, variance = 0, data_share = 0, gradient_noise_share = 0, noise = 0,
         correlation = 0, residual = 0;
};

// Composes the plane with the inverse of the increment (delta, in px, at the centre and along xi
// and eta), see the header's source, equation 31.
Plane Compose(const Plane& p, const Eigen::Vector3d& delta) {
  const double a = (1 - p.dx) / (1 + delta[1]);
  return {p.d + a * delta[0], 1 - a, p.dy + a * delta[2]};
}

// What stays the same while a window iterates.
struct WindowSystem {
  WindowSystem(const Window& window, float mean_grey)
      : mean(mean_grey), N(NormalMatrix(window, mean_grey)) {
    N.diagonal() *= 1 + 1e-6;  // beyond rounding: gain and disparity may be one on a bare ramp
    free_solver.compute(N);
  }
  bool HasContrast() const { return N(0, 0) > 0 && N(3, 3) > 0; }
  float mean;
  Matrix5 N;
  Eigen::LLT<Matrix5> free_solver;
};

// One step of `plane`, whose samples are in window.right, and everything that it says about the
// pixel. The residuals' own variance sets the weight of the prior. Infinite when the step fails.
double GaussNewtonStep(const WindowSystem& system, const Window& window, const Plane& start,
                       Plane* plane, PixelResult* result) {
  const RightHandSide rhs = Residuals(window, system.mean);
  const Vector5 free_fit = system.free_solver.solve(rhs.b);
  const double gain = std::clamp(1 - free_fit[3], 0.2, 5.0);
  // No residual is below the rounding of both images.
  const double noise2 =
      std::max(2.0 / 12, (rhs.squares - free_fit.dot(rhs.b)) / (window.count - 5));
  Matrix5 A = system.N;
  Vector5 b = rhs.b;
  const Eigen::Vector3d moved(plane->d - start.d, plane->dx - start.dx, plane->dy - start.dy);
  for (int i = 0; i < 3; ++i) {
    const double sigma = i == 0 ? kStartSigmaPx : kSlopeSigma;
    const double weight = noise2 / (sigma * sigma * gain * gain);
    A(i, i) += weight;
    b[i] += weight * gain * moved[i];
  }
  const Eigen::LLT<Matrix5> solver(A);
  const Eigen::Vector3d delta = -solver.solve(b).head<3>() / gain;
  if (!delta.allFinite() || !(delta[1] > -0.5)) return std::numeric_limits<double>::infinity();
  *plane = Compose(*plane, delta);
  // The gradients' own noise makes the normal matrix look stronger than it is: what weighs is the
  // product of measured and true gradient, the variance rises by the square of the ratio.
  const double variance = noise2 / (gain * gain) * solver.solve(Vector5::Unit(0))[0];
  const double gradient_noise =
      kGradientNoiseGain * window.count * noise2 / (1 + gain * gain) / system.N(0, 0);
  result->gradient_noise_share = gradient_noise;
  result->data_share = 1 - variance / (kStartSigmaPx * kStartSigmaPx);
  result->variance = variance / std::pow(1 - std::min(gradient_noise, 0.9), 2);
  result->noise = std::sqrt(noise2);
  return std::abs(delta[0]);
}

// left - right at the centre, less its mean over the window; NaN where the centre is left out.
double CentreResidual(const Window& window) {
  double centre = std::numeric_limits<double>::quiet_NaN(), sum = 0;
  for (int i = 0; i < window.count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const auto e = static_cast<double>(window.grey[k] - window.right[k]);
    sum += e;
    if (window.xi[k] == 0 && window.eta[k] == 0) centre = e;
  }
  return centre - sum / window.count;
}

PixelResult RefinePixel(const Images& images, int x, const Plane& start, Window* window) {
  PixelResult result;
  result.value = start.d;
  if (window->count < kFewestSamples) return result;
  const WindowSystem system(*window, Mean(*window));
  if (!system.HasContrast()) return result;
  result.outcome = RefineOutcome::kStayed;
  Plane plane = start;
  double step = std::numeric_limits<double>::infinity();
  for (int iteration = 0; iteration < kIterations && !(step < kConvergedPx); ++iteration) {
    if (!SampleRight(images, x, plane, window)) return result;
    if (iteration == 0) result.correlation = Correlation(*window);
    step = GaussNewtonStep(system, *window, start, &plane, &result);
    if (result.gradient_noise_share > kLargestGradientNoiseShare) {
      result.outcome = RefineOutcome::kTextureless;
      return result;
    }
    if (!(std::abs(plane.d - start.d) <= kLargestShiftPx)) return result;
  }
  if (!(step < kAcceptedStepPx)) return result;
  result.outcome = RefineOutcome::kRefined;
  result.value = plane.d;
  result.correlation = Correlation(*window);
  result.residual = CentreResidual(*window);
  return result;
}

Image<float> ToFloat(const Image<std::uint16_t>& image) {
  Image<float> out(image.size());
  for (std::size_t i = 0; i < out.pixel_count(); ++i) {
    out.data()[i] = static_cast<float>(image.data()[i]);
  }
  return out;
}

// Derivative of the cubic B-spline at the samples, averaged over three rows with Scharr's weights:
// an instrument with less noise than the derivative itself, which is what the variance depends on.
Image<float> GradientX(const Image<std::uint16_t>& image) {
  Image<float> c = ToFloat(image);
  RowSamplesToCoefficients(3, c);
  Image<float> gradient(image.size(), 0.0F);
  const int height = c.height();
  tbb::parallel_for(0, height, [&](int y) {
    const float* above = c.row(std::max(0, y - 1));
    const float* here = c.row(y);
    const float* below = c.row(std::min(height - 1, y + 1));
    float* out = gradient.row(y);
    for (int x = 1; x + 1 < c.width(); ++x) {
      out[x] = (3 * (above[x + 1] - above[x - 1] + below[x + 1] - below[x - 1]) +
                10 * (here[x + 1] - here[x - 1])) /
               32;
    }
  });
  return gradient;
}

}  // namespace

RefinedDisparity RefineDisparity(const GrayImage& left, const GrayImage& right,
                                 const Image<float>& start_px, int radius_px) {
  const ImageSize size = left.size();
  Images images{left, GradientX(left.grey), ToFloat(right.grey), start_px};
  RowSamplesToCoefficients(3, images.right_coefficients);
  RefinedDisparity out;
  for (auto* image :
       {&out.value_px, &out.variance_px2, &out.data_share, &out.gradient_noise_share,
        &out.noise_grey, &out.correlation, &out.residual_grey, &out.relief_px, &out.support}) {
    *image = Image<float>(size, kNaN);
  }
  out.outcome = Image<RefineOutcome>(size, RefineOutcome::kNone);
  tbb::parallel_for(0, size.height, [&](int y) {
    Window window(radius_px);
    for (int x = 0; x < size.width; ++x) {
      if (!std::isfinite(start_px(y, x))) continue;
      const Plane start = FitPlane(start_px, x, y, radius_px);
      Collect(images, x, y, radius_px, start, &window);
      const PixelResult result = RefinePixel(images, x, start, &window);
      out.outcome(y, x) = result.outcome;
      out.value_px(y, x) = static_cast<float>(result.value);
      out.support(y, x) =
          static_cast<float>(window.count) / static_cast<float>(window.side * window.side);
      out.correlation(y, x) = static_cast<float>(result.correlation);
      if (result.outcome != RefineOutcome::kRefined) continue;
      out.variance_px2(y, x) = static_cast<float>(result.variance);
      out.data_share(y, x) = static_cast<float>(result.data_share);
      out.gradient_noise_share(y, x) = static_cast<float>(result.gradient_noise_share);
      out.noise_grey(y, x) = static_cast<float>(result.noise);
      out.residual_grey(y, x) = static_cast<float>(result.residual);
    }
  });
  tbb::parallel_for(0, size.height, [&](int y) {
    for (int x = 0; x < size.width; ++x) {
      if (!std::isfinite(out.value_px(y, x))) continue;
      FitPlane(out.value_px, x, y, radius_px, &out.relief_px(y, x));
    }
  });
  return out;
}

}  // namespace plumbline::internal
