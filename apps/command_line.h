#pragma once

#include <string>
#include <vector>

namespace plumbline {

// Runs the plumbline command: `arguments` without the program's name. Results go to stdout,
// progress and complaints to stderr.
//
// Returns the exit code: 0 done; 1 a fault of our own; 2 wrong usage; 3 bad input; 4 the
// environment failed (disk full, folder not writable); 130 stopped by Ctrl-C, with what was
// finished kept. Throws nothing.
int RunCommandLine(const std::vector<std::string>& arguments) noexcept;

}  // namespace plumbline
