#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>

#include "tests/support/shared_data.h"

// What h5py, a reader that is not ours, makes of our files.
namespace plumbline::testing {

// Python that opens the file of its first argument as f, reads every dataset, checks its units,
// long_name and an axis on every dimension, and leaves their number in `count`.
inline constexpr const char* kWalkEveryDataset = R"py(
import sys, h5py, numpy as np
f = h5py.File(sys.argv[1], 'r')
count = 0
def visit(name, o):
    global count
    if not isinstance(o, h5py.Dataset): return
    o[()]
    count += 1
    assert o.attrs['units'], name
    assert o.attrs['long_name'], name
    if h5py.h5ds.is_scale(o.id): return
    for d in range(o.ndim):
        assert len(o.dims[d]) > 0, (name, d)
        assert o.dims[d][0].shape == (o.shape[d],), (name, d)
f.visititems(visit)
def check_nexus(*groups):
    for g in groups:
        assert f[g].attrs['NX_class'] == 'NXdata'
        signal = f[g][f[g].attrs['signal']]
        for d, axis in enumerate(np.atleast_1d(f[g].attrs['axes'])): assert f[g][axis].shape == (signal.shape[d],)
)py";

// Runs that and then `checks`, which has to end by printing 'walked'.
inline void WalkWithH5py(const std::filesystem::path& file, const std::string& checks) {
  const CommandResult read = RunPython(kWalkEveryDataset + checks, file.string());
  EXPECT_EQ(read.exit_code, 0) << read.output;
  EXPECT_THAT(read.output, ::testing::HasSubstr("walked"));
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
