#include "apps/internal/two_digits.h"

#include <gtest/gtest.h>

#include <cmath>

namespace plumbline {
namespace {

using internal::TwoDigits;

TEST(TwoDigits, HaveNoExponentWhereTheyCanBeRead) {
  EXPECT_EQ(TwoDigits(0.01234), "0.012");
  EXPECT_EQ(TwoDigits(0.1), "0.10");
  EXPECT_EQ(TwoDigits(0.0996), "0.10");
  EXPECT_EQ(TwoDigits(0.99), "0.99");
  EXPECT_EQ(TwoDigits(1), "1.0");
  EXPECT_EQ(TwoDigits(9.96), "10");
  EXPECT_EQ(TwoDigits(85.4), "85");
  EXPECT_EQ(TwoDigits(99.7), "100");
  EXPECT_EQ(TwoDigits(918.2), "920");
  EXPECT_EQ(TwoDigits(12345), "12000");
  EXPECT_EQ(TwoDigits(3.11e-5), "0.000031");
  EXPECT_EQ(TwoDigits(2.1e-9), "2.1e-09");
  EXPECT_EQ(TwoDigits(0), "0");
  EXPECT_EQ(TwoDigits(NAN), "nan");
}

}  // namespace
}  // namespace plumbline
