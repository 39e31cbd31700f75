#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <string>

#include "tests/support/plumbline_command.h"

// Runs of stereo-DIC on the virtual rig.
namespace plumbline::testing {

// The folder of a recording of a sheet that is stretched, in steps, by 2 % along x; to be made once
// for all tests of a process. more: of `plumbline simulate`.
inline std::filesystem::path RecordStretch(const std::string& name, int frames,
                                           const std::string& more) {
  const std::filesystem::path made =
      std::filesystem::temp_directory_path() / (name + "-" + std::to_string(getpid()));
  const CommandResult result =
      RunPlumbline("simulate stretch --cameras laboratory --frame-count " + std::to_string(frames) +
                   " --fps 10 -q -o " + made.string() + " " + more);
  EXPECT_EQ(result.exit_code, 0) << result.output;
  return made;
}

// Whether all datasets of two runs hold the same bytes.
inline void ExpectSameData(const std::filesystem::path& a, const std::filesystem::path& b) {
  const CommandResult result = RunPython(
      "import sys, h5py, numpy as np\n"
      "a, b = h5py.File(sys.argv[1]), h5py.File(sys.argv[2])\n"
      "count = 0\n"
      "def visit(name, o):\n"
      "    global count\n"
      "    if not isinstance(o, h5py.Dataset): return\n"
      "    x, y = o[()], b[name][()]\n"
      "    same = x.tobytes() == y.tobytes() if isinstance(x, np.ndarray) and x.dtype != object "
      "else np.array_equal(x, y)\n"
      "    assert same, name\n"
      "    count += 1\n"
      "a.visititems(visit)\n"
      "print('same', count > 40)\n",
      a.string() + " " + b.string());
  EXPECT_NE(result.output.find("same True"), std::string::npos) << result.output;
}

}  // namespace plumbline::testing
