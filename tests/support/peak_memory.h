#pragma once

#include <fstream>
#include <string>

namespace plumbline::testing {

// The most memory that this process has held so far, MB; -1 where the system does not tell.
inline double PeakMegabytes() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0) return static_cast<double>(std::stol(line.substr(6))) / 1024;
  }
  return -1;
}

}  // namespace plumbline::testing
