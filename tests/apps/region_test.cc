#include "apps/region.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>

#include "calib/error.h"

namespace plumbline {
namespace {

TEST(PixelRegion, ReadsFourNumbersAndNothingElse) {
  const PixelRegion region = PixelRegion::Parse("10,20,300,40");
  EXPECT_EQ(region.x, 10);
  EXPECT_EQ(region.height, 40);
  for (const char* wrong :
       {"", "1,2,3", "1,2,3,4,5", "1,2,3,4 ", "-1,2,3,4", "1,2,0,4", "a,b,c,d"}) {
    EXPECT_THROW(PixelRegion::Parse(wrong), UsageError) << wrong;
  }
}

int Count(const Image<std::uint8_t>& wanted) {
  return std::accumulate(wanted.values().begin(), wanted.values().end(), 0);
}

TEST(WantedPixels, AreThoseOfRegionAndMask) {
  const ImageSize size{40, 30};
  EXPECT_TRUE(WantedPixels(size, std::nullopt, {}).empty());
  const Image<std::uint8_t> region = WantedPixels(size, PixelRegion{35, 10, 1 << 30, 5}, {});
  EXPECT_EQ(Count(region), 5 * 5);
  EXPECT_EQ(region(14, 39), 1);
  Image<std::uint8_t> mask(size, 0);
  mask(12, 36) = mask(0, 0) = 1;
  EXPECT_EQ(Count(WantedPixels(size, std::nullopt, mask)), 2);
  EXPECT_EQ(Count(WantedPixels(size, PixelRegion{35, 10, 5, 5}, mask)), 1);
}

TEST(WantedPixels, RefusesWhatLeavesNothing) {
  const ImageSize size{40, 30};
  const Image<std::uint8_t> all(size, 1);
  EXPECT_THROW(WantedPixels(size, PixelRegion{40, 0, 5, 5}, {}), InputError);
  EXPECT_THROW(WantedPixels({30, 40}, std::nullopt, all), InputError);
  Image<std::uint8_t> mask(size, 0);
  mask(0, 0) = 1;
  EXPECT_THROW(WantedPixels(size, PixelRegion{10, 10, 5, 5}, mask), InputError);
}

}  // namespace
}  // namespace plumbline
