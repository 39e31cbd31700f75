#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

namespace plumbline::testing {

// The folder of real images with reference results, beside the project; absent on most machines.
std::optional<std::filesystem::path> SharedData(std::string_view set);

// What a command printed and returned.
struct CommandResult {
  int exit_code = -1;
  std::string output;  // stdout and stderr together
};
CommandResult RunCommand(const std::string& command);

// Runs Python source with Debian's interpreter (the one that has mrcal, h5py and cv2), arguments
// after the script.
CommandResult RunPython(const std::string& script, const std::string& arguments = "");

// A fresh folder below the build tree, named after the running test and emptied first.
std::filesystem::path TestFolder();

}  // namespace plumbline::testing

// Skips the test, saying so, where the named set of ../shared/data is absent; else defines `name`
// as its path.
#define PLUMBLINE_SHARED_DATA(name, set)                                                         \
  const auto name##_or_none = ::plumbline::testing::SharedData(set);                             \
  if (!name##_or_none) GTEST_SKIP() << "no ../shared/data/" << (set) << " beside this checkout"; \
  const std::filesystem::path& name = *name##_or_none
