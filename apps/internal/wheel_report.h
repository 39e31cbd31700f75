#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "track/wheel_reference.h"

namespace plumbline::internal {

// A wheel's reference for people, some lines; and for scripts.
std::string TextOf(const WheelReference& wheel);
nlohmann::json JsonOf(const WheelReference& wheel);

}  // namespace plumbline::internal
