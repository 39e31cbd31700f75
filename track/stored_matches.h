#pragma once

#include "match/stereo_sequence.h"

namespace plumbline {

// Rounds the displacements of both images to floats, as files hold them: what follows from the
// matches then follows from a file, to the last bit. Below 512 px they move by 0.000015 px at most.
void RoundAsStored(StereoField* field);

}  // namespace plumbline
