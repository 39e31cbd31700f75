#include "apps/internal/two_digits.h"

#include <gtest/gtest.h>

#include <cmath>

namespace plumbline {
namespace {

using internal::TwoDigits;
using internal::WithErrors;

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

TEST(WithErrors, AValueHasTheDecimalsOfItsErrorByNoise) {
  EXPECT_EQ(WithErrors(18.00312, 0.0162, 0.036), "18.003 +- 0.016 +- 0.036");
  EXPECT_EQ(WithErrors(20198.7, 57.2, 0.066), "20199 +- 57 +- 0.066");
  EXPECT_EQ(WithErrors(0.1834, 1.41, 0.0025), "0.2 +- 1.4 +- 0.0025");
  EXPECT_EQ(WithErrors(-0.0004, 0.0012, NAN), "-0.0004 +- 0.0012");
  EXPECT_EQ(WithErrors(23619.2, 918, 85), "23619 +- 920 +- 85");
  EXPECT_EQ(WithErrors(1.23456789, 0.0996, NAN), "1.23 +- 0.10");
}

TEST(WithErrors, ByTheCalibrationWhereNoNoiseIsKnownAndElseByWhatIsAskedFor) {
  EXPECT_EQ(WithErrors(18.00312, NAN, 0.036, 1), "18.003 +- 0.036");
  EXPECT_EQ(WithErrors(18.00312, NAN, NAN, 2), "18.00");
  EXPECT_EQ(WithErrors(0, 0, 0, 4), "0.0000 +- 0 +- 0");
  EXPECT_EQ(WithErrors(NAN, 0.1, 0.1, 4), "not known");
}

TEST(WithErrors, WhatRoundsToZeroHasNoSign) {
  EXPECT_EQ(WithErrors(-0.0004, 0.12, NAN), "0.00 +- 0.12");
  EXPECT_EQ(WithErrors(-1e-9, NAN, NAN, 4), "0.0000");
  EXPECT_EQ(WithErrors(-0.004, 0.012, NAN), "-0.004 +- 0.012");
}

}  // namespace
}  // namespace plumbline
