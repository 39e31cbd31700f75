#pragma once

#include <string>

namespace plumbline {

// "plumbline 0.1.0 (commit abc1234)"; the commit is left out where the build did not know it.
std::string SoftwareVersion();

}  // namespace plumbline
