#pragma once

#include <string>

#include "io/internal/hdf5.h"
#include "io/rig_file.h"

namespace plumbline::internal {

// The group /rig, in rig files and in series. Throws hdf5::Error, std::invalid_argument.
void WriteRigGroup(hid_t file, const StereoRig& rig, const RigFileExtras& extras);
StereoRig ReadRigGroup(hid_t file);

// Root attributes that every results file has; `inputs` is what DescribeInputs() gives, or "" to
// leave it for later.
void WriteRootAttributes(hid_t file, const std::string& format, const std::string& recipe_toml,
                         const std::string& inputs, std::int64_t format_version = 1);

// The newest that is read. 2: the series of a stereo rig, since its strain has a status of its own.
inline constexpr std::int64_t kFormatVersion = 2;

}  // namespace plumbline::internal
