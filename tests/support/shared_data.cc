#include "tests/support/shared_data.h"

#include <array>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>

namespace plumbline::testing {
namespace fs = std::filesystem;

std::optional<fs::path> SharedData(std::string_view set) {
  const char* root = std::getenv("PLUMBLINE_SHARED_DATA");
  const fs::path folder =
      (root != nullptr ? fs::path(root)
                       : fs::path(PLUMBLINE_SOURCE_DIR) / ".." / "shared" / "data") /
      set;
  if (!fs::is_directory(folder)) return std::nullopt;
  return fs::canonical(folder);
}

CommandResult RunCommand(const std::string& command) {
  CommandResult result;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  if (pipe == nullptr) throw std::runtime_error("cannot run: " + command);
  std::array<char, 4096> buffer;
  while (const std::size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe)) {
    result.output.append(buffer.data(), n);
  }
  const int status = pclose(pipe);
  result.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return result;
}

CommandResult RunPython(const std::string& script, const std::string& arguments) {
  const fs::path file = TestFolder() / "script.py";
  std::ofstream(file) << script;
  return RunCommand(std::string(PLUMBLINE_PYTHON) + " " + file.string() + " " + arguments);
}

fs::path TestFolder() {
  const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
  fs::path folder = fs::path(PLUMBLINE_BINARY_DIR) / "test_output" /
                    (std::string(info->test_suite_name()) + "." + info->name());
  static std::string last;
  if (last != folder.string()) {
    fs::remove_all(folder);
    last = folder.string();
  }
  fs::create_directories(folder);
  return folder;
}

}  // namespace plumbline::testing
