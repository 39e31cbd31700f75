#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

namespace plumbline::internal {

// The next name for `file` while it is being written: beside it, so that a rename suffices.
std::filesystem::path TemporaryName(const std::filesystem::path& file);

// Throws EnvironmentError: "<doing> <file>: <the system's words>".
[[noreturn]] void ThrowSystemError(const std::string& doing, const std::filesystem::path& file,
                                   int error_number);

// Forces a file (a folder) to the disk.
void SyncPath(const std::filesystem::path& path);

// Calls write(temporary name), forces the result to the disk and renames it to `file`. When write()
// throws, the temporary file is removed and the exception goes on.
void WriteDurably(const std::filesystem::path& file,
                  const std::function<void(const std::filesystem::path&)>& write);

// Writes a file to a temporary name and renames it, without forcing it to the disk: for what can be
// made again. Throws EnvironmentError.
void WriteBytes(const std::filesystem::path& file, std::span<const char> bytes);

// SHA-256 of a file in hexadecimal, "" if it cannot be read or stop() says so.
std::string Sha256(const std::filesystem::path& file, const std::function<bool()>& stop = {});

// The `inputs` attribute of a results file: a JSON array of {path, size, sha256}. Files are hashed
// in parallel.
std::string DescribeInputs(const std::vector<std::filesystem::path>& inputs,
                           const std::function<bool()>& stop = {});

// Now, as ISO 8601 in UTC.
std::string TimestampNow();

}  // namespace plumbline::internal
