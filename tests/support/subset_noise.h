#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "match/neighbour_correlation.h"

namespace plumbline::testing {

// Normal deviates that are the same everywhere: Box and Muller's, since the standard's own differ
// between libraries.
class NormalDeviates {
 public:
  explicit NormalDeviates(std::uint32_t seed) : random_(seed) {}
  double Uniform() { return (static_cast<double>(random_()) + 0.5) / 4294967296.0; }
  double operator()() {
    return std::sqrt(-2 * std::log(Uniform())) * std::cos(6.283185307179586 * Uniform());
  }

 private:
  std::mt19937 random_;
};

// A reference image of random speckle with its exact derivatives: Gaussian blobs of random place,
// width and sign.
struct SpeckleTexture {
  Image<float> grey, gx, gy;

  SpeckleTexture(ImageSize size, std::uint32_t seed) : grey(size, 110), gx(size, 0), gy(size, 0) {
    NormalDeviates draw(seed);
    const int blobs = (size.width + 16) * (size.height + 16) / 14;
    for (int i = 0; i < blobs; ++i) {
      const double cx = -8 + (size.width + 16) * draw.Uniform();
      const double cy = -8 + (size.height + 16) * draw.Uniform();
      const double s = 1.2 + draw.Uniform(), a = 35 * draw();
      for (int y = std::max(0, static_cast<int>(cy) - 8);
           y < std::min(size.height, static_cast<int>(cy) + 9); ++y) {
        for (int x = std::max(0, static_cast<int>(cx) - 8);
             x < std::min(size.width, static_cast<int>(cx) + 9); ++x) {
          const double dx = x - cx, dy = y - cy;
          const double value = a * std::exp(-(dx * dx + dy * dy) / (2 * s * s));
          grey(y, x) += static_cast<float>(value);
          gx(y, x) -= static_cast<float>(value * dx / (s * s));
          gy(y, x) -= static_cast<float>(value * dy / (s * s));
        }
      }
    }
  }

  ReferenceTexture Texture() const { return {&grey, &gx, &gy}; }
};

// The linear answer of one subset to the noise of the pixels, written down as the definition says
// and in double precision: the estimate's error is sum_k w(k) n(k).
struct SubsetAnswer {
  struct Pixel {
    int row = 0, column = 0;
    Eigen::Vector2d weight = Eigen::Vector2d::Zero();           // of u, v
    Eigen::Vector4d gradient_weight = Eigen::Vector4d::Zero();  // of du/dx, du/dy, dv/dx, dv/dy
  };
  std::vector<Pixel> pixels;

  SubsetAnswer(const SubsetGrid& subsets, const ReferenceTexture& texture, int row, int column) {
    const int terms = (subsets.order + 1) * (subsets.order + 2) / 2;
    const int radius = subsets.subset_px / 2;
    const int x0 = subsets.first_px.x() + column * subsets.step_px;
    const int y0 = subsets.first_px.y() + row * subsets.step_px;
    std::vector<Eigen::VectorXd> J;
    Pixel pixel;
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(2 * terms + 2, 2 * terms + 2);
    for (int y = -radius; y <= radius; ++y) {
      for (int x = -radius; x <= radius; ++x) {
        const int r = y0 + y, c = x0 + x;
        if (r < 0 || c < 0 || r >= texture.grey->height() || c >= texture.grey->width()) continue;
        if (subsets.circular && std::hypot(x, y) > 0.5 * subsets.subset_px) continue;
        if (texture.mask != nullptr && (*texture.mask)(r, c) == 0) continue;
        Eigen::VectorXd P(6);
        P << 1, x, y, x * x, x * y, y * y;
        Eigen::VectorXd j(2 * terms + 2);
        j << P.head(terms) * (*texture.gradient_x)(r, c),
            P.head(terms) * (*texture.gradient_y)(r, c), 1, (*texture.grey)(r, c);
        H += j * j.transpose();
        J.push_back(j);
        pixel.row = r;
        pixel.column = c;
        pixels.push_back(pixel);
      }
    }
    const Eigen::LDLT<Eigen::MatrixXd> solver(H);
    for (std::size_t k = 0; k < pixels.size(); ++k) {
      const Eigen::VectorXd w = solver.solve(J[k]);
      pixels[k].weight = {w[0], w[terms]};
      if (subsets.order > 0) pixels[k].gradient_weight = {w[1], w[2], w[terms + 1], w[terms + 2]};
    }
  }

  Eigen::Vector2d Error(const Image<float>& noise) const {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (const Pixel& k : pixels) sum += k.weight * noise(k.row, k.column);
    return sum;
  }

  Eigen::Vector4d GradientError(const Image<float>& noise) const {
    Eigen::Vector4d sum = Eigen::Vector4d::Zero();
    for (const Pixel& k : pixels) sum += k.gradient_weight * noise(k.row, k.column);
    return sum;
  }

  // cov(this, other) for noise of this variance, null: 1.
  Eigen::Matrix2d Covariance(const SubsetAnswer& other, const Image<float>* variance) const {
    Eigen::Matrix2d sum = Eigen::Matrix2d::Zero();
    for (const Pixel& k : pixels) {
      for (const Pixel& l : other.pixels) {
        if (k.row == l.row && k.column == l.column)
          sum += (variance != nullptr ? (*variance)(k.row, k.column) : 1.0) * k.weight *
                 l.weight.transpose();
      }
    }
    return sum;
  }

  Eigen::Matrix2d Correlation(const SubsetAnswer& other, const Image<float>* variance) const {
    const Eigen::Vector2d own = Covariance(*this, variance).diagonal().cwiseSqrt();
    const Eigen::Vector2d its = other.Covariance(other, variance).diagonal().cwiseSqrt();
    return own.cwiseInverse().asDiagonal() * Covariance(other, variance) *
           its.cwiseInverse().asDiagonal();
  }
};

}  // namespace plumbline::testing
