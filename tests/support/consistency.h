#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <cstdio>

namespace plumbline::testing {

// Whether sigmas hold: normalised squared errors, and how many 95 % intervals of single numbers
// have the truth in them.
class Consistency {
 public:
  void Add(double error, double sigma) {
    squares_ += error * error / (sigma * sigma);
    Count(error, sigma);
  }
  // Of numbers with a sigma each.
  template <typename Error, typename Sigma>
  void AddEach(const Error& error, const Sigma& sigma) {
    for (int k = 0; k < error.size(); ++k) {
      Add(static_cast<double>(error[k]), static_cast<double>(sigma[k]));
    }
  }
  // Of a vector with a covariance.
  template <typename Error, typename Covariance>
  void AddJoint(const Error& error, const Covariance& covariance) {
    squares_ += error.dot(covariance.ldlt().solve(error));
    for (int k = 0; k < error.size(); ++k) Count(error[k], std::sqrt(covariance(k, k)));
  }
  void Add(const Consistency& other) {
    squares_ += other.squares_;
    covered_ += other.covered_;
    variance_ += other.variance_;
    count_ += other.count_;
  }

  double nees() const { return squares_ / count_; }  // per dimension
  double coverage() const { return covered_ / count_; }
  double count() const { return count_; }  // of numbers
  double sigma() const { return std::sqrt(variance_ / count_); }

  // As a row of a table: what, its sigma, NEES per dimension, coverage, numbers.
  void Print(const char* what) const {
    std::printf("| %s | %.3g | %.3f | %.1f %% | %.0f |\n", what, sigma(), nees(), 100 * coverage(),
                count());
  }

 private:
  void Count(double error, double sigma) {
    covered_ += std::abs(error) < 1.959964 * sigma ? 1 : 0;
    variance_ += sigma * sigma;
    ++count_;
  }

  double squares_ = 0, covered_ = 0, variance_ = 0, count_ = 0;
};

}  // namespace plumbline::testing
