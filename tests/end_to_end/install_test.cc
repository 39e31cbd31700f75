#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

TEST(InstalledPackage, IsFoundAndLinkedByAProjectOfItsOwn) {
  const std::filesystem::path folder = testing::TestFolder();
  const std::string prefix = (folder / "prefix").string();
  const std::string build = (folder / "build").string();
  auto result = testing::RunCommand("cmake --install " PLUMBLINE_BINARY_DIR " --prefix " + prefix);
  ASSERT_EQ(result.exit_code, 0) << result.output;
  result = testing::RunCommand(
      "cmake -S " PLUMBLINE_SOURCE_DIR "/tests/consumer -B " + build +
      " -G Ninja -DCMAKE_CXX_FLAGS=" PLUMBLINE_CONSUMER_FLAGS " -DCMAKE_PREFIX_PATH=" + prefix +
      " && cmake --build " + build);
  ASSERT_EQ(result.exit_code, 0) << result.output;
  result = testing::RunCommand(build + "/consumer");
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_EQ(result.output, "0.000000 0.000000 500.000000 mm\n");
}

}  // namespace
}  // namespace plumbline
