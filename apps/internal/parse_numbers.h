#pragma once

#include <optional>
#include <string>
#include <vector>

namespace plumbline::internal {

// Finite numbers parted by one character; nothing where it is not that.
std::optional<std::vector<double>> ParseNumbers(const std::string& text, char parted_by);

}  // namespace plumbline::internal
