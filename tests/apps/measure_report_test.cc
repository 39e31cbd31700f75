#include "apps/internal/measure_report.h"

#include <gmock/gmock.h>

#include <string>

namespace plumbline {
namespace {

using internal::MeasureReport;
using internal::ReportedFrame;
using ::testing::HasSubstr;
using ::testing::Not;

// What a run says at its end of frames whose pose was refined ('r') or not ('-').
std::string TextOfRun(const std::string& frames) {
  MeasureReport report("run.h5", static_cast<std::int64_t>(frames.size()), true);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    ReportedFrame reported;
    reported.frame.index = static_cast<std::int64_t>(i);
    reported.frame.rig_watch.found = true;
    reported.frame.rig_watch.refined = reported.frame.rig_watch.alarm = frames[i] == 'r';
    reported.motion.emplace();
    report.Add(reported);
  }
  return report.Make().text;
}

TEST(MeasureReport, SaysThatAVibratingCameraMovesInOtherFramesToo) {
  EXPECT_THAT(TextOfRun("-r-rr-"),
              HasSubstr("refined in 3 of 6 frames, and 2 after one of these keep that of the "
                        "calibration"));
}

TEST(MeasureReport, SaysNothingOfVibrationWhereACameraWasKnockedOnceOrNever) {
  for (const char* frames : {"---rrr", "rrrrrr", "------"}) {
    EXPECT_THAT(TextOfRun(frames), Not(HasSubstr("vibrate"))) << frames;
  }
}

}  // namespace
}  // namespace plumbline
