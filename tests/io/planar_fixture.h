#pragma once

#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "io/planar_series_reader.h"
#include "io/planar_series_writer.h"
#include "tests/io/series_comparison.h"

namespace plumbline::testing {

inline PlanarSeriesHeader PlanarHeader(ImageSize grid = {7, 5}) {
  PlanarSeriesHeader header;
  header.grid = grid;
  header.first_px = {20, 31};
  header.step_px = 8;
  header.subset_px = 33;
  header.order = 2;
  header.subset_shape = "circle";
  header.interpolation = "quintic";
  header.prefilter = "gaussian";
  header.prefilter_sigma_px = 0.5;
  header.reference = "frame 10";
  header.reference_id = "first.png";
  header.strain_measure = "hencky";
  header.vsg_px = 65;
  header.window_points = 5;
  header.camera = {{640, 480}, 12, {2.5, 0.03}, "static frames"};
  header.recipe_toml = "step = 8\n";
  header.contents = {true, true};
  return header;
}

// A frame that depends on its number in every value. Every fifth point has no displacement, but a
// correlation; the second row has no strain, and one point has a strain and no displacement.
inline PlanarSeriesFrame PlanarFrame(std::int64_t i,
                                     const PlanarSeriesHeader& header = PlanarHeader()) {
  PlanarSeriesFrame frame;
  frame.index = 10 + i;
  frame.time_s = 0.05 * static_cast<double>(i);
  frame.id = "image" + std::to_string(i) + ".png";
  frame.dropped_before = static_cast<int>(i % 2);
  frame.reference_index = i < 2 ? -1 : 11;
  PlanarField& f = frame.field;
  f.first_px = header.first_px;
  f.step_px = header.step_px;
  f.subset_px = header.subset_px;
  f.order = header.order;
  PlanarStrainRecord& e = frame.strain;
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  f.displacement_px = Image<Eigen::Vector2d>(header.grid, Eigen::Vector2d::Constant(nan));
  f.gradient = Image<Eigen::Matrix2f>(header.grid, Eigen::Matrix2f::Constant(nan));
  f.cov_displacement_px2 = Image<Eigen::Vector3f>(header.grid, Eigen::Vector3f::Constant(nan));
  f.cov_gradient =
      Image<Eigen::Matrix<float, 10, 1>>(header.grid, Eigen::Matrix<float, 10, 1>::Constant(nan));
  f.zncc = Image<float>(header.grid, nan);
  f.iterations = Image<std::uint8_t>(header.grid, 0);
  f.status = Image<Status>(header.grid, Status::kLowCorrelation);
  e.strain = Image<Eigen::Vector3f>(header.grid, Eigen::Vector3f::Constant(nan));
  e.covariance =
      Image<Eigen::Matrix<float, 6, 1>>(header.grid, Eigen::Matrix<float, 6, 1>::Constant(nan));
  e.status = Image<Status>(header.grid, Status::kExtrapolated);
  for (std::size_t k = 0; k < f.status.pixel_count(); ++k) {
    const auto v = static_cast<float>(i) + 0.1f * static_cast<float>(k);
    f.zncc.data()[k] = 0.9f + 0.001f * static_cast<float>(k % 90);
    f.iterations.data()[k] = static_cast<std::uint8_t>(2 + k % 7);
    if (k / static_cast<std::size_t>(header.grid.width) != 1) {
      e.status.data()[k] = Status::kOk;
      e.strain.data()[k] = Eigen::Vector3f(1e-3f * v, -2e-3f, 5e-4f * v);
      e.covariance.data()[k] << 4e-8f, 1e-8f, -1e-8f, 9e-8f, 2e-8f, 1e-8f;
    }
    if (k % 5 == 3) continue;
    f.status.data()[k] = Status::kOk;
    f.displacement_px.data()[k] = Eigen::Vector2d(v + 1e-12, -2 * v);  // more than a float holds
    f.gradient.data()[k] << 0.01f * v, 0.02f, 0.03f, 0.04f * v;
    f.cov_displacement_px2.data()[k] = Eigen::Vector3f(4e-6f, 1e-6f, 9e-6f + 1e-8f * v);
    f.cov_gradient.data()[k] << 1e-8f, 1, 2, 3, 4e-8f, 5, 6, 9e-8f, 7, 16e-8f;
  }
  return frame;
}

inline PlanarSeriesFrame BadPlanarFrame() {
  PlanarSeriesFrame frame;
  frame.index = 11;
  frame.id = "image1.png";
  frame.problem = "image1.png is truncated";
  return frame;
}

inline void WritePlanar(const std::filesystem::path& file, const PlanarSeriesHeader& header,
                        const std::vector<PlanarSeriesFrame>& frames) {
  PlanarSeriesWriter writer(file, header);
  for (const PlanarSeriesFrame& frame : frames) writer.Commit(frame);
  EXPECT_EQ(writer.committed(), static_cast<std::int64_t>(frames.size()));
  writer.Close();
  EXPECT_FALSE(std::filesystem::exists(file.string() + ".parts"));
}

// That b is what a reads back as.
inline void ExpectSamePlanarFrame(const PlanarSeriesFrame& a, const PlanarSeriesFrame& b) {
  EXPECT_EQ(a.index, b.index);
  EXPECT_EQ(a.time_s, b.time_s);
  EXPECT_EQ(a.id, b.id);
  EXPECT_EQ(a.problem, b.problem);
  EXPECT_EQ(a.dropped_before, b.dropped_before);
  EXPECT_EQ(a.reference_index, b.reference_index);
  if (!a.problem.empty()) {
    EXPECT_TRUE(b.field.displacement_px.empty());
    return;
  }
  EXPECT_EQ(a.field.first_px, b.field.first_px);
  EXPECT_EQ(a.field.step_px, b.field.step_px);
  EXPECT_EQ(a.field.subset_px, b.field.subset_px);
  EXPECT_EQ(a.field.order, b.field.order);
  ExpectSamePoints(a.field.displacement_px, b.field.displacement_px);
  ExpectSamePoints(a.field.gradient, b.field.gradient);
  ExpectSamePoints(a.field.cov_displacement_px2, b.field.cov_displacement_px2);
  ExpectSamePoints(a.field.cov_gradient, b.field.cov_gradient);
  ExpectSamePoints(a.field.zncc, b.field.zncc);
  ExpectSameBits(a.field.iterations, b.field.iterations);
  ExpectSameBits(a.field.status, b.field.status);
  ExpectSamePoints(a.strain.strain, b.strain.strain);
  ExpectSamePoints(a.strain.covariance, b.strain.covariance);
  ExpectSameBits(a.strain.status, b.strain.status);
}

}  // namespace plumbline::testing
