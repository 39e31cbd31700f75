#pragma once

#include <string>
#include <vector>

namespace plumbline {

// Samples of one quantity. Times (s) grow, at any rate; NaN values are dropouts.
struct SampledSignal {
  std::vector<double> time_s;
  std::vector<double> value;
};

struct ClockOffsetOptions {
  double most_s = 10;  // that the offset may be, either way
  // Each of our values is the mean over so long about its time, as speeds out of angles are. 0:
  // over the time from one of their samples to the next.
  double averaging_s = 0;
  double least_overlap = 0.5;  // share of our samples that have to lie within theirs

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// their clock = our clock + offset.
struct ClockOffset {
  double offset_s = 0;
  double sigma_s = 0;
  double gain = 0, bias = 0;  // ours = gain theirs + bias
  double correlation = 0;     // of ours with theirs, at the offset
  int samples = 0;            // of ours that lie within theirs
  // By how much worse the best offset elsewhere fits: difference of 2 log likelihood.
  double runner_up = 0;
};

// The offset between two clocks, from a quantity that both sides recorded while it changed, as the
// wheel's speed by the images and by a sensor:
//   ours(t) = gain mean(theirs over averaging_s about t + offset) + bias + noise.
// Offsets all over the range are tried, half of the sparser sampling apart; the best one is
// refined by Gauss-Newton with gain and bias free. Their samples are joined by straight lines.
// Sigma: of the least-squares fit, with white noise as large as the residuals.
//
// Throws InputError, saying what to do, when the signals do not overlap enough, or do not tell the
// offset: one of them does not change, they do not correlate, the best offset is the last that was
// tried, or another offset, further away than
// the best one's neighbourhood, is as likely (less than 5 sigma worse), as with periodic signals.
// Accuracy: tests/track/clock_offset_test.cc (sampling).
ClockOffset FindClockOffset(const SampledSignal& ours, const SampledSignal& theirs,
                            const ClockOffsetOptions& options = {});

}  // namespace plumbline
