#include "io/channel_table.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include "calib/error.h"

namespace plumbline {
namespace {

namespace fs = std::filesystem;

class ChannelTable : public ::testing::Test {
 protected:
  std::vector<Channel> Read(const std::string& text) const {
    std::ofstream(file_) << text;
    return ReadChannelTable(file_);
  }
  void ExpectRefusal(const std::string& text, const std::string& says) const {
    try {
      Read(text);
      FAIL() << text;
    } catch (const InputError& error) {
      const std::string what = error.what();
      EXPECT_NE(what.find(says), std::string::npos) << what;
      EXPECT_NE(what.find(file_.string()), std::string::npos) << what;
    }
  }

  const fs::path file_ =
      fs::path(::testing::TempDir()) /
      (std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()) + ".csv");
};

TEST_F(ChannelTable, IsReadWithItsNamesAndUnits) {
  const std::vector<Channel> channels = Read(
      "# of the wheel-force transducer\n"
      "time_s,wheel_speed_rad/s,force_x [N],\"force z (kN)\",gear\n"
      "0.005,3.6,-12.5,4.2,2\n"
      "\n"
      "0.010,3.7,,nan,2\r\n");
  ASSERT_EQ(channels.size(), 4U);
  EXPECT_EQ(channels[0].name, "wheel_speed");
  EXPECT_EQ(channels[0].units, "rad/s");
  EXPECT_EQ(channels[1].name, "force_x");
  EXPECT_EQ(channels[1].units, "N");
  EXPECT_EQ(channels[2].name, "force z");
  EXPECT_EQ(channels[2].units, "kN");
  EXPECT_EQ(channels[3].name, "gear");
  EXPECT_EQ(channels[3].units, "");
  EXPECT_EQ(channels[0].time_s, (std::vector<double>{0.005, 0.010}));
  EXPECT_EQ(channels[0].value, (std::vector<double>{3.6, 3.7}));
  EXPECT_EQ(channels[1].value[0], -12.5);
  EXPECT_TRUE(std::isnan(channels[1].value[1]));
  EXPECT_TRUE(std::isnan(channels[2].value[1]));
}

TEST_F(ChannelTable, IsReadWithSemicolonsDecimalCommasAndARowOfUnits) {
  const std::vector<Channel> channels = Read(
      "speed;Timestamp\n"
      "km/h;ms\n"
      "5,25;1000\n"
      "+5,5;1005,5\n");
  ASSERT_EQ(channels.size(), 1U);
  EXPECT_EQ(channels[0].name, "speed");
  EXPECT_EQ(channels[0].units, "km/h");
  EXPECT_NEAR(channels[0].time_s[1], 1.0055, 1e-12);
  EXPECT_EQ(channels[0].value, (std::vector<double>{5.25, 5.5}));
}

TEST_F(ChannelTable, KeepsTheFirstColumnAsTimeWhereNoneIsNamedSo) {
  const std::vector<Channel> channels = Read("clock\tv [m/s]\n1\t2\n2\t3\n");
  ASSERT_EQ(channels.size(), 1U);
  EXPECT_EQ(channels[0].name, "v");
  EXPECT_EQ(channels[0].time_s[0], 1);
}

TEST_F(ChannelTable, IsRefusedWithFileLineAndColumn) {
  EXPECT_THROW(ReadChannelTable("no/such.csv"), InputError);
  ExpectRefusal("", "is empty");
  ExpectRefusal("time\n1\n", "one column alone");
  ExpectRefusal("0,1\n1,2\n", "names the columns");
  ExpectRefusal("t,a\n", "holds no rows");
  ExpectRefusal("t,a,a\n1,2,3\n", "two columns are named \"a\"");
  ExpectRefusal("t,a\n1,2\n2,x\n", "line 3, column a: \"x\" is no number");
  ExpectRefusal("t,a\n1,2\n2,3,4\n", "line 3: 3 cells");
  ExpectRefusal("t,a\n2,2\n1,3\n", "line 3: the time \"1\" is none or goes back");
  ExpectRefusal("t,a\n,2\n", "line 2: the time \"\" is none");
}

}  // namespace
}  // namespace plumbline
