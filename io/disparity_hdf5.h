#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "match/disparity.h"

namespace plumbline {

// Writes a disparity map as HDF5: /disparity/value and value_errors (px, one standard deviation;
// NaN where there is none) and status, on the axes row and col of the left image, with the root
// attributes of a series and format = "plumbline-disparity". `recipe_toml` and `inputs` are
// recorded. Written to a temporary name and renamed.
//
// Throws EnvironmentError when the file cannot be written, naming it.
void WriteDisparityHdf5(const std::filesystem::path& file, const DisparityMap& map,
                        const std::string& recipe_toml,
                        const std::vector<std::filesystem::path>& inputs);

}  // namespace plumbline
