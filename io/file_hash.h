#pragma once

#include <filesystem>
#include <string>

namespace plumbline {

// SHA-256 of a file in hexadecimal, as the `inputs` of a results file record it; "" if the file
// cannot be read.
std::string FileSha256(const std::filesystem::path& file);

}  // namespace plumbline
