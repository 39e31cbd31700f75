// A binary of its own: PCL brings a hundred libraries along.
#include <gtest/gtest.h>
#include <pcl/io/ply_io.h>

#include <cstring>
#include <string>

#include "io/export.h"
#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

float ValueOf(const pcl::PCLPointCloud2& cloud, std::size_t point, const std::string& name) {
  for (const pcl::PCLPointField& field : cloud.fields) {
    if (field.name != name) continue;
    EXPECT_EQ(field.datatype, pcl::PCLPointField::FLOAT32);
    float value = 0;
    std::memcpy(&value, &cloud.data[point * cloud.point_step + field.offset], sizeof value);
    return value;
  }
  ADD_FAILURE() << "no property " << name;
  return 0;
}

TEST(ExportPcl, LoadPlyFileReadsEveryValue) {
  const auto file = testing::TestFolder() / "a.ply";
  const SeriesFrame frame = testing::SmallFrame(2);
  ExportPly(file, frame);
  pcl::PointCloud<pcl::PointXYZ> points;
  ASSERT_EQ(pcl::io::loadPLYFile(file.string(), points), 0);
  pcl::PCLPointCloud2 cloud;
  ASSERT_EQ(pcl::io::loadPLYFile(file.string(), cloud), 0);
  const Surface& s = frame.surface;
  std::size_t k = 0;
  for (std::size_t i = 0; i < s.status.pixel_count(); ++i) {
    if (s.status.data()[i] != Status::kOk) continue;
    ASSERT_LT(k, points.size());
    EXPECT_EQ(points[k].getVector3fMap(), s.position_mm.data()[i]);
    for (int c = 0; c < 3; ++c) {
      const std::string axis(1, "xyz"[c]);
      EXPECT_EQ(ValueOf(cloud, k, axis), s.position_mm.data()[i][c]);
      EXPECT_EQ(ValueOf(cloud, k, "sigma_random_" + axis), s.sigma_random_mm.data()[i][c]);
      EXPECT_EQ(ValueOf(cloud, k, "sigma_calibration_" + axis),
                s.sigma_calibration_mm.data()[i][c]);
    }
    EXPECT_EQ(ValueOf(cloud, k, "correlation"), s.correlation.data()[i]);
    EXPECT_EQ(ValueOf(cloud, k, "epipolar_px"), s.epipolar_px.data()[i]);
    ++k;
  }
  EXPECT_EQ(k, points.size());
  EXPECT_EQ(k, 28u);
}

}  // namespace
}  // namespace plumbline
