#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "io/noise_file.h"
#include "match/photon_transfer.h"

namespace plumbline::internal {

// What still frames say of a camera: for people, and for scripts.
std::string TextOf(const PhotonTransfer& found);
nlohmann::json JsonOf(const PhotonTransfer& found);

// The noise floor for people, a line a component, and what they should know of it, a sentence each
// without its full stop.
std::string TextOf(const NoiseFloor& floor);
std::vector<std::string> NotesOf(const NoiseFloor& floor);

nlohmann::json JsonOf(const NoiseFloor& floor);

}  // namespace plumbline::internal
