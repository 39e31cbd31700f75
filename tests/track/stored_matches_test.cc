#include "track/stored_matches.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace plumbline {
namespace {

TEST(StoredMatches, AreRoundedToWhatFloatsHold) {
  StereoField field;
  field.left = PlanarField({5, 1}, {0, 0}, 8);
  field.right = field.left;
  for (int c = 0; c < 4; ++c) {
    field.left.displacement_px(0, c) = {50.123456789 + c, 1.0 / 3};
    field.right.displacement_px(0, c) = {-300.1, 1e-9 / (c + 3)};
  }
  const StereoField before = field;
  RoundAsStored(&field);
  for (int c = 0; c < 4; ++c) {
    for (int k = 0; k < 2; ++k) {
      const double left = field.left.displacement_px(0, c)[k],
                   right = field.right.displacement_px(0, c)[k];
      // Not by a cast there and back, which is what a compiler may leave out.
      EXPECT_EQ(std::fmod(std::abs(left), std::ldexp(1.0, std::ilogb(left) - 23)), 0) << left;
      EXPECT_EQ(std::fmod(std::abs(right), std::ldexp(1.0, std::ilogb(right) - 23)), 0) << right;
      EXPECT_NE(left, before.left.displacement_px(0, c)[k]);
      EXPECT_NEAR(left, before.left.displacement_px(0, c)[k], 2e-6);
      EXPECT_NEAR(right, before.right.displacement_px(0, c)[k], 1.6e-5);
    }
  }
  EXPECT_TRUE(std::isnan(field.left.displacement_px(0, 4).x()));
}

}  // namespace
}  // namespace plumbline
