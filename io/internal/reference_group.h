#pragma once

#include <string>
#include <vector>

#include "io/internal/hdf5.h"
#include "io/internal/point_layout.h"
#include "io/series_frame.h"

namespace plumbline::internal {

// Where /reference holds what a dataset of /match holds of the frames.
std::string PathInReference(const PointField& field);
inline constexpr const char* kReferenceStatus = "/reference/status";

// After WriteGrid(). Throws hdf5::Error; std::invalid_argument where the images are not of the
// grid's size.
void WriteReferenceGroup(hid_t file, const ReferenceMatches& reference, ImageSize grid);

}  // namespace plumbline::internal
