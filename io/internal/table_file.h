#pragma once

#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <ostream>
#include <string>

namespace plumbline::internal {

// A comma and a number, with as many digits as tell two values apart.
template <typename Scalar>
std::string Cell(Scalar value) {
  constexpr int digits = std::numeric_limits<Scalar>::max_digits10;
  return std::isnan(value) ? ",nan" : fmt::format(",{:.{}g}", value, digits);  // never -nan
}

// Writes to a temporary name that is then renamed. Throws EnvironmentError naming the file.
void WriteTableFile(const std::filesystem::path& file,
                    const std::function<void(std::ostream&)>& write);

}  // namespace plumbline::internal
