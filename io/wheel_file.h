#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "track/wheel_reference.h"

namespace plumbline {

// Writes a wheel's reference: root attribute format = "plumbline-wheel" (docs/file_format.md).
// Written to a temporary name and renamed. Throws EnvironmentError naming the file.
void WriteWheelFile(const std::filesystem::path& path, const WheelReference& wheel,
                    const std::string& recipe_toml = {},
                    const std::vector<std::filesystem::path>& inputs = {});

// Whether a file says that it is one. False where it cannot be read at all.
bool IsWheelFile(const std::filesystem::path& path);

// Reads it, bit for bit as it was written. Throws InputError naming the file and what is missing or
// wrong in it.
WheelReference ReadWheelFile(const std::filesystem::path& path);

}  // namespace plumbline
