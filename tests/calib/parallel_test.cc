#include "calib/parallel.h"

#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

namespace plumbline {
namespace {

TEST(ForEachIndex, VisitsEachOnce) {
  for (const std::size_t count : {std::size_t{0}, std::size_t{1}, std::size_t{5001}}) {
    std::vector<int> visits(count, 0);
    ForEachIndex(count, [&](std::size_t i) { ++visits[i]; });
    EXPECT_EQ(visits, std::vector<int>(count, 1));
  }
}

TEST(ForEachIndex, ThrowsWhatItsBodyThrows) {
  EXPECT_THROW(ForEachIndex(3000,
                            [](std::size_t i) {
                              if (i == 2999) throw std::runtime_error("there");
                            }),
               std::runtime_error);
}

}  // namespace
}  // namespace plumbline
