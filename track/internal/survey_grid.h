#pragma once

#include <cstddef>

#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// Throws InputError where the images are not of the size of the wheel's.
void CheckSize(const WheelReference& wheel, const GrayImage& left, const GrayImage& right);

// The view of which most of what a frame at this angle shows is in the picture.
std::size_t NearestView(const WheelReference& wheel, double angle_rad);

// So many of the points of a grid, along rows and columns, that at most `most` are left.
int StrideFor(int points, int most);

// Only points that may be kept are matched, as far as they are near enough, half a subset, for
// neighbours to lead to each other.
RollingSurveyOptions Coarser(RollingSurveyOptions options, ImageSize image);

}  // namespace plumbline::internal
