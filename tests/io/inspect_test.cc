#include "io/inspect.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
using ::testing::Contains;
using ::testing::HasSubstr;

TEST(Inspect, CountsWhatASeriesHoldsAndValidateFindsWhatWasSpoilt) {
  const auto file = testing::TestFolder() / "run.h5";
  SeriesWriter writer(file, testing::SmallHeader());
  writer.Commit(testing::SmallFrame(0));
  writer.Commit(testing::SmallFrame(1));
  writer.Close();
  const FileSummary summary = Inspect(file);
  EXPECT_EQ(summary.frames, 2);
  EXPECT_EQ(summary.points, 56);
  EXPECT_EQ(summary.grid_columns, 7);
  EXPECT_TRUE(Validate(file).empty());
  testing::RunPython(
      "import sys, h5py\nh5py.File(sys.argv[1], 'r+')['surface/position'][1, 0, 3] = 5\n",
      file.string());
  EXPECT_THAT(Validate(file), Contains(HasSubstr("frame 1: 1 points have a position")));
  std::filesystem::resize_file(file, 5000);
  EXPECT_THAT(Validate(file), Contains(HasSubstr("run.h5")));
}

}  // namespace
}  // namespace plumbline
