#include "apps/internal/rolling_records.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "apps/internal/rolling_report.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(RollingRecords, TurnsAreThereWithoutTheHeight) {
  RigRotationFrame rotation;
  rotation.pose = RigPose(0.01, -0.002, 398);
  rotation.sigma_random = RigPose(1e-4, 2e-4, 90);
  rotation.problem = "the frames around do not tell the height of the ground";
  EXPECT_FALSE(internal::RigRotationRecordOf(rotation).found);
  rotation.known = {true, true, false};
  const RigRotationRecord record = internal::RigRotationRecordOf(rotation);
  EXPECT_TRUE(record.found);
  EXPECT_EQ(record.pitch_rad, 0.01);
  EXPECT_EQ(record.sigma_random_roll_rad, 2e-4);
  EXPECT_TRUE(std::isnan(record.height_mm) && std::isnan(record.sigma_random_height_mm));
  EXPECT_EQ(record.problem, rotation.problem);
  EXPECT_FALSE(internal::GroundRecordOf(rotation).found);

  SeriesFrame frame;
  frame.rig_rotation = record;
  const auto report = internal::RollingReportOf(frame);
  ASSERT_TRUE(report.has_value());
  const std::string text = internal::TextOf(*report);
  EXPECT_THAT(text, HasSubstr("height not known"));
  EXPECT_THAT(text, HasSubstr(rotation.problem));
  EXPECT_THAT(text, Not(HasSubstr("nan")));
}

}  // namespace
}  // namespace plumbline
