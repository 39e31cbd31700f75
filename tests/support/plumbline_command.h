#pragma once

#include <string>

#include "tests/support/shared_data.h"

namespace plumbline::testing {

// Runs the built `plumbline` with these arguments (a shell's words). `output` holds stdout and
// stderr together, unless the arguments redirect one.
inline CommandResult RunPlumbline(const std::string& arguments) {
  // In parentheses, so that a redirection of the caller's comes first.
  return RunCommand("(" + std::string(PLUMBLINE_BINARY_DIR) + "/plumbline " + arguments + ")");
}

}  // namespace plumbline::testing
