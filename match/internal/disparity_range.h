#pragma once

#include "match/internal/dense_match.h"

namespace plumbline::internal {

// The disparities that a pair shows, from some hundred textured patches that are searched along the
// whole of their row by normalised cross-correlation, kept where the way back agrees and
// no second place is nearly as good; with a margin. count == 0 when too few patches agree.
DisparityRange FindDisparityRange(const cv::Mat1b& left, const cv::Mat1b& right,
                                  const Image<std::uint8_t>* left_valid,
                                  const Image<std::uint8_t>* right_valid);

}  // namespace plumbline::internal
