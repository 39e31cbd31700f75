#pragma once

#include <memory>

#include "io/image_source.h"
#include "io/internal/file_list.h"

namespace plumbline::internal {

std::unique_ptr<ImageSource> OpenImagePairs(PairedFiles pairs, const ImageSourceOptions& options);

std::unique_ptr<ImageSource> OpenVideoPair(const std::filesystem::path& left,
                                           const std::filesystem::path& right,
                                           const ImageSourceOptions& options);

// Time of a frame: from the table, else by the rate, else NaN.
double FrameTime(std::int64_t index, const std::vector<double>& table, double frames_per_second);

// Throws UsageError when a frame rate is given that is not positive.
void CheckFrameRate(const ImageSourceOptions& options);

}  // namespace plumbline::internal
