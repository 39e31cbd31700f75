#include "io/rig_file.h"

#include <fmt/format.h>

#include <stdexcept>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/rig_group.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;
namespace {

// Runs a reader, and says which file it was where something is wrong.
template <typename Read>
auto Reading(const fs::path& path, const Read& read) {
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) {
    throw InputError(fmt::format("there is no rig file {}", path.string()));
  }
  const auto refuse = [&](const char* reason) {
    return InputError(fmt::format("{} cannot be read as a rig file: {}", path.string(), reason));
  };
  try {
    const hdf5::Id file = hdf5::OpenForeignFile(path);
    return read(file.get());
  } catch (const hdf5::Error& error) {
    throw refuse(error.what());
  } catch (const std::invalid_argument& error) {  // impossible camera parameters
    throw refuse(error.what());
  } catch (const InputError& error) {  // unknown lens model
    throw refuse(error.what());
  }
}

}  // namespace

void WriteRigFile(const fs::path& path, const StereoRig& rig, const RigFileExtras& extras) {
  const std::string inputs = internal::DescribeInputs(extras.inputs);
  try {
    internal::WriteDurably(path, [&](const fs::path& temporary) {
      hdf5::Id file = hdf5::CreateFile(temporary);
      internal::WriteRootAttributes(file.get(), "plumbline-rig", extras.recipe_toml, inputs);
      internal::WriteRigGroup(file.get(), rig, extras);
      file.Close("closing the file");
    });
  } catch (const hdf5::Error& error) {
    throw EnvironmentError(fmt::format("cannot write {}: {}", path.string(), error.what()));
  }
}

StereoRig ReadRigFile(const fs::path& path) {
  return Reading(path, [](hid_t file) { return internal::ReadRigGroup(file); });
}

NamedArray ReadRigArray(const fs::path& path, const std::string& name) {
  return Reading(path, [&](hid_t file) {
    NamedArray array;
    array.name = name;
    hdf5::Shape shape;
    array.values = hdf5::ReadArray<double>(file, "/rig/" + name, &shape);
    array.shape.assign(shape.begin(), shape.end());
    const hdf5::Id dataset = hdf5::OpenDataset(file, "/rig/" + name);
    array.units = hdf5::GetText(dataset.get(), "units");
    array.long_name = hdf5::GetText(dataset.get(), "long_name");
    return array;
  });
}

}  // namespace plumbline
