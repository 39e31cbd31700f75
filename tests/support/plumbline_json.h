#pragma once

#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/support/plumbline_command.h"

namespace plumbline::testing {

// What `plumbline ... --json` prints, with this exit code.
inline nlohmann::json RunJson(const std::string& arguments, int exit_code = 0) {
  const std::filesystem::path complaints = TestFolder() / "stderr.txt";
  const CommandResult result = RunPlumbline(arguments + " --json 2>" + complaints.string());
  EXPECT_EQ(result.exit_code, exit_code) << result.output << std::ifstream(complaints).rdbuf();
  return nlohmann::json::parse(result.output, nullptr, false);
}

}  // namespace plumbline::testing
