#include "apps/internal/calibration_extras.h"

#include <fmt/format.h>

#include <limits>

namespace plumbline::internal {
namespace {

NamedArray Number(std::string name, std::string units, std::string long_name, double value) {
  return {std::move(name), std::move(units), std::move(long_name), {}, {value}, {}};
}

NamedArray Matrix(std::string name, std::string long_name, const Eigen::MatrixXd& matrix) {
  NamedArray array{std::move(name), "mixed", std::move(long_name), {}, {}, {}};
  array.shape = {static_cast<std::size_t>(matrix.rows()), static_cast<std::size_t>(matrix.cols())};
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) array.values.push_back(matrix(r, c));
  }
  return array;
}

NamedArray TargetPoints(const Calibration& c) {
  NamedArray array{
      "board/points",          "mm", "points of the board as they were found, board frame",
      {c.target_mm.size(), 3}, {},   {}};
  for (std::size_t i = 0; i < c.target_mm.size(); ++i) {
    for (int k = 0; k < 3; ++k) {
      array.values.push_back(c.target_seen[i] ? c.target_mm[i][k]
                                              : std::numeric_limits<double>::quiet_NaN());
    }
  }
  return array;
}

NamedArray Residuals(const Calibration& c) {
  NamedArray array{"residuals/values",
                   "px",
                   "one row a point: pair, camera (0 left, 1 right), point id, pixel x, pixel y, "
                   "residual x, residual y, outlier (1) or not (0)",
                   {c.residuals.size(), 8},
                   {},
                   {}};
  for (const CalibrationResidual& r : c.residuals) {
    for (const double v :
         {static_cast<double>(r.pair), static_cast<double>(r.camera), static_cast<double>(r.id),
          r.pixel.x(), r.pixel.y(), r.residual_px.x(), r.residual_px.y(), r.outlier ? 1.0 : 0.0}) {
      array.values.push_back(v);
    }
  }
  return array;
}

}  // namespace

RigFileExtras CalibrationExtras(const Calibration& c) {
  RigFileExtras extras;
  auto& arrays = extras.arrays;
  arrays.push_back(
      Matrix("covariance",
             "covariance of the parameters, clustered by pair, without the scale; units "
             "of the parameters",
             c.covariance));
  arrays.push_back(Matrix("covariance_independent",
                          "the same if all residuals were independent: what others report",
                          c.covariance_independent));
  if (!c.target_mm.empty()) arrays.push_back(TargetPoints(c));
  if (!c.residuals.empty()) arrays.push_back(Residuals(c));
  arrays.push_back(
      Number("rms/left", "px", "rms of the left residuals per component", c.left_rms_px));
  arrays.push_back(
      Number("rms/right", "px", "rms of the right residuals per component", c.right_rms_px));
  arrays.push_back(Number("rms/joint", "px", "rms of all residuals per component", c.joint_rms_px));
  arrays.push_back(
      Number("rms/rigid", "px", "the same with the board at its nominal shape", c.rigid_rms_px));
  arrays.push_back(Number("scale_sigma", "1",
                          "relative standard deviation of the board's overall scale",
                          c.scale_sigma));
  arrays.push_back(Number("working_distance", "mm",
                          "median distance of the board from the left camera",
                          c.working_distance_mm));
  std::string pairs;
  for (const PairResult& pair : c.pairs) {
    pairs += fmt::format("{} {}: {}\n", pair.left_name, pair.right_name,
                         pair.used ? "used" : "not used, " + pair.problem);
  }
  extras.texts["pairs"] = pairs;
  std::string warnings;
  for (const std::string& warning : c.warnings) warnings += warning + "\n";
  extras.texts["warnings"] = warnings;
  return extras;
}

}  // namespace plumbline::internal
