#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "io/inspect.h"
#include "tests/support/shared_data.h"

namespace plumbline::testing {

// One way to damage a file: lines of Python on the open file f, and what has to be found.
struct Damage {
  const char* python;
  const char* finding;
};

// Damages one copy of a whole file each, all in one run of Python, and looks for the findings.
inline void ExpectFindings(const std::filesystem::path& whole, const std::vector<Damage>& damages) {
  std::string script =
      "import sys, shutil, h5py, numpy as np\n"
      "def damaged(k):\n"
      "    shutil.copy(sys.argv[1], sys.argv[1] + str(k))\n"
      "    return h5py.File(sys.argv[1] + str(k), 'r+')\n";
  for (std::size_t k = 0; k < damages.size(); ++k) {
    script += "with damaged(" + std::to_string(k) + ") as f: " + damages[k].python + "\n";
  }
  const auto made = RunPython(script, whole.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  for (std::size_t k = 0; k < damages.size(); ++k) {
    EXPECT_THAT(Validate(whole.string() + std::to_string(k)),
                ::testing::Contains(::testing::HasSubstr(damages[k].finding)))
        << damages[k].python;
  }
}

// Calls read(file) for copies that are cut off somewhere or have changed bytes.
template <typename Read>
void ForGarbledCopies(const std::filesystem::path& whole, const Read& read) {
  std::ifstream in(whole, std::ios::binary);
  const std::string good{std::istreambuf_iterator<char>(in), {}};
  const std::filesystem::path file = whole.parent_path() / "bad.h5";
  std::mt19937 rng(4);
  for (int k = 0; k < 300; ++k) {
    std::string bytes = good;
    if (k % 3 == 0) {
      bytes.resize(rng() % bytes.size());
    } else {
      for (int n = 0; n < 8; ++n) bytes[rng() % bytes.size()] = static_cast<char>(rng());
    }
    std::ofstream(file, std::ios::binary) << bytes;
    read(file);
  }
}

}  // namespace plumbline::testing
