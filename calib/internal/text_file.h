#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace plumbline::internal {

// The whole of a file. Throws EnvironmentError if it cannot be read, InputError beyond `max_bytes`.
std::string ReadTextFile(const std::filesystem::path& path,
                         std::size_t max_bytes = std::size_t{1} << 30);

// Writes a temporary file beside `path`, flushes it to the disk and renames it, so that a reader
// sees the old file or the new one. Throws EnvironmentError.
void WriteTextFile(const std::filesystem::path& path, std::string_view text);

}  // namespace plumbline::internal
