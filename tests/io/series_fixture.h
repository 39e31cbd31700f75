#pragma once

#include <cmath>
#include <limits>
#include <random>

#include "io/series_writer.h"

namespace plumbline::testing {

inline StereoRig SmallRig() {
  LensModel model;
  Eigen::VectorXd left(9), right(9);
  left << 500.1, 501.2, 320.3, 240.4, -0.1, 0.01, 1e-3, -1e-3, 1.0 / 3;
  right << 502.1, 503.2, 321.3, 241.4, -0.2, 0.02, 2e-3, -2e-3, 1.0 / 7;
  StereoRig rig{Camera(model, {640, 480}, left),
                Camera(model, {640, 480}, right),
                Rigid3::FromRotationVector({0.01, -0.3, 0.02}, {-123.25, 0.5, 20.0 / 3}),
                {},
                "chessboard:9x6:10mm"};
  std::mt19937 rng(1);
  std::normal_distribution<double> noise;
  rig.modes.modes = Eigen::MatrixXd::NullaryExpr(5, 24, [&] { return 1e-3 * noise(rng); });
  rig.modes.has_scale_mode = true;
  return rig;
}

inline SeriesHeader SmallHeader(ImageSize grid = {7, 5}) {
  SeriesHeader header{SmallRig(),
                      Image<Eigen::Vector2f>(grid, Eigen::Vector2f::Zero()),
                      4,
                      11,
                      "threads = 2\n",
                      {},
                      {},
                      false};
  for (int r = 0; r < grid.height; ++r) {
    for (int c = 0; c < grid.width; ++c) {
      header.grid_px(r, c) = Eigen::Vector2f(static_cast<float>(4 * c), static_cast<float>(4 * r));
    }
  }
  return header;
}

// A frame that depends on its number in every value; every fifth point holds none.
inline SeriesFrame SmallFrame(std::int64_t i, ImageSize grid = {7, 5}) {
  SeriesFrame frame;
  frame.index = 10 + i;
  frame.time_s = 0.05 * static_cast<double>(i);
  frame.left_id = "left" + std::to_string(i) + ".png";
  frame.right_id = "right" + std::to_string(i) + ".png";
  frame.dropped_before = static_cast<int>(i % 2);
  Surface& s = frame.surface;
  s.frame = SurfaceFrame::kGround;
  s.position_mm = s.sigma_random_mm = s.sigma_calibration_mm =
      Image<Eigen::Vector3f>(grid, Eigen::Vector3f::Zero());
  s.correlation = s.epipolar_px = Image<float>(grid);
  s.status = Image<Status>(grid);
  for (std::size_t k = 0; k < s.status.pixel_count(); ++k) {
    const bool ok = k % 5 != 3;
    const float v = ok ? static_cast<float>(i) + 0.1f * static_cast<float>(k)
                       : std::numeric_limits<float>::quiet_NaN();
    s.position_mm.data()[k] = Eigen::Vector3f(v, 2 * v, 3 * v);
    s.sigma_random_mm.data()[k] = Eigen::Vector3f(v, v, v).cwiseAbs() * 0.01f;
    s.sigma_calibration_mm.data()[k] = Eigen::Vector3f(v, v, v).cwiseAbs() * 0.02f;
    s.correlation.data()[k] = v;
    s.epipolar_px.data()[k] = -v;
    s.status.data()[k] = ok ? Status::kOk : Status::kOccluded;
  }
  GroundRecord& g = frame.ground;
  g.found = true;
  g.normal_in_rig = Eigen::Vector3d(0.1, -0.2, -1).normalized();
  g.offset_mm = -400 - static_cast<double>(i);
  g.e1_in_rig = g.normal_in_rig.unitOrthogonal();
  g.e2_in_rig = g.normal_in_rig.cross(g.e1_in_rig);
  g.centroid_in_rig_mm = g.offset_mm * g.normal_in_rig + 20 * g.e1_in_rig - 30 * g.e2_in_rig;
  g.cov_random << 4e-8, 1e-9, 2e-7, 1e-9, 3e-8, -1e-7, 2e-7, -1e-7, 1e-4;
  g.cov_calibration = 9 * g.cov_random;
  g.ground_from_rig = Rigid3::FromRotationVector({3, 0.1, 0.2}, {1, 2, 400});
  g.rms_mm = 0.03;
  g.inlier_fraction = 0.9;
  return frame;
}

}  // namespace plumbline::testing
