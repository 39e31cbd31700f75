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

// Expects that two files hold the same datasets, chunk by chunk as they are stored.
inline void ExpectSameStoredBytes(const std::filesystem::path& a, const std::filesystem::path& b,
                                  int least_datasets, int least_chunks) {
  const auto compared = RunPython(
      R"py(
import sys, h5py
a, b = (h5py.File(name, 'r') for name in sys.argv[1:3])
names = []
a.visititems(lambda name, o: names.append(name) if isinstance(o, h5py.Dataset) else None)
chunks = 0
for name in names:
    x, y = a[name], b[name]
    assert x.dtype == y.dtype and x.shape == y.shape, name
    if x.dtype == object: assert (x[()] == y[()]) if x.ndim == 0 else list(x[()]) == list(y[()]), name
    else: assert x[()].tobytes() == y[()].tobytes(), name
    if x.chunks is None: continue
    for k in range(x.id.get_num_chunks()):
        at = x.id.get_chunk_info(k).chunk_offset
        assert x.id.read_direct_chunk(at) == y.id.read_direct_chunk(at), (name, at)
        chunks += 1
assert a.attrs['inputs'] == b.attrs['inputs']
assert len(names) > int(sys.argv[3]) and chunks > int(sys.argv[4]), (len(names), chunks)
print('same')
)py",
      a.string() + " " + b.string() + " " + std::to_string(least_datasets) + " " +
          std::to_string(least_chunks));
  EXPECT_THAT(compared.output, ::testing::HasSubstr("same"));
}

}  // namespace plumbline::testing
