#include "apps/progress.h"

#include <gtest/gtest.h>

namespace plumbline {
namespace {

using std::chrono::duration;

TEST(Progress, TellsShareAndEstimate) {
  EXPECT_EQ(ProgressText("measuring", 3, 12, duration<double>(10), 0),
            "measuring  3/12  25 %, 0.3/s, about 30 s left");
  EXPECT_EQ(ProgressText("measuring", 12, 12, duration<double>(95), 0),
            "measuring  12/12  100 %, took 1 min 35 s");
  EXPECT_EQ(ProgressText("x", 1, 2, duration<double>(1), 4),
            "x  [##..]  1/2  50 %, 1/s, about 1 s left");
}

TEST(Progress, TellsADetailBesideTheCount) {
  EXPECT_EQ(ProgressText("measuring", 3, 12, duration<double>(10), 0, "97.2 % valid"),
            "measuring  3/12  25 %, 0.3/s, 97.2 % valid, about 30 s left");
}

TEST(Progress, PromisesNothingBeforeTheFirstStepOrWithoutATotal) {
  EXPECT_EQ(ProgressText("x", 0, 2, duration<double>(9), 0), "x  0/2  0 %");
  EXPECT_EQ(ProgressText("x", 7, -1, duration<double>(9), 30), "x  7 done in 9 s");
}

TEST(Progress, StaysWhole) {
  // More done than announced: a video may declare too few frames.
  EXPECT_EQ(ProgressText("x", 5, 4, duration<double>(9), 4), "x  [####]  5/4  100 %, took 9 s");
}

TEST(Progress, WritesDurationsForPeople) {
  EXPECT_EQ(DurationText(duration<double>(0.4)), "0 s");
  EXPECT_EQ(DurationText(duration<double>(200)), "3 min 20 s");
  EXPECT_EQ(DurationText(duration<double>(7500)), "2 h 5 min");
}

}  // namespace
}  // namespace plumbline
