#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace plumbline::internal {

// An input of a run as its file has recorded it.
struct RecordedInput {
  std::filesystem::path path;
  std::string sha256;  // empty: not known
};

std::vector<RecordedInput> InputsOf(const std::string& inputs_json);

// Whether one of them was this file.
bool IsRecordedInput(const std::string& inputs_json, const std::string& sha256);

// The recorded input of this file name, if the file is still the same; else nothing and why.
std::optional<std::filesystem::path> UnchangedInput(const std::string& inputs_json,
                                                    const std::string& name, std::string* why);

}  // namespace plumbline::internal
