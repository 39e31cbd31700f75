#pragma once

namespace plumbline {

// By how much the right camera exposes later than the left one (negative: earlier). What moves is
// then seen by the two at different places, which along the baseline is taken for depth.
struct RightDelay {
  double value_s = 0;
  double sigma_s = 0;  // common to all frames

  bool any() const { return value_s != 0 || sigma_s > 0; }

  // Beyond it a correction to first order in the motion does not do.
  static constexpr double kMost_s = 1e-3;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

}  // namespace plumbline
