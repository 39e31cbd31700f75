#include "apps/internal/recorded_input.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "io/file_hash.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

std::vector<RecordedInput> InputsOf(const std::string& inputs_json) {
  std::vector<RecordedInput> out;
  const auto inputs = nlohmann::json::parse(inputs_json, nullptr, false);
  if (!inputs.is_array()) return out;
  for (const auto& input : inputs) {
    if (!input.is_object()) continue;
    const auto text = [&](const char* key) {
      return input.contains(key) && input[key].is_string() ? input[key].get<std::string>() : "";
    };
    out.push_back({text("path"), text("sha256")});
  }
  return out;
}

bool IsRecordedInput(const std::string& inputs_json, const std::string& sha256) {
  const std::vector<RecordedInput> inputs = InputsOf(inputs_json);
  return !sha256.empty() && std::any_of(inputs.begin(), inputs.end(),
                                        [&](const auto& input) { return input.sha256 == sha256; });
}

std::optional<fs::path> UnchangedInput(const std::string& inputs_json, const std::string& name,
                                       std::string* why) {
  const std::vector<RecordedInput> inputs = InputsOf(inputs_json);
  // The first: others of that name are other files.
  const auto input = std::find_if(inputs.begin(), inputs.end(), [&](const RecordedInput& one) {
    return one.path.filename() == fs::path(name).filename();
  });
  if (input == inputs.end()) {
    *why = fmt::format("'{}' is not among the recorded inputs", name);
  } else if (!fs::is_regular_file(input->path)) {
    *why = fmt::format("'{}' is not there any more", input->path.string());
  } else if (input->sha256.empty() || FileSha256(input->path) != input->sha256) {
    *why = fmt::format("'{}' is not the file that was read then", input->path.string());
  } else {
    return input->path;
  }
  return std::nullopt;
}

}  // namespace plumbline::internal
