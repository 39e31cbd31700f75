#include "io/internal/series_run.h"

#include <fmt/format.h>

#include <atomic>
#include <future>
#include <stdexcept>
#include <string>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/journal.h"
#include "io/internal/series_pack.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

std::vector<std::uint8_t> EncodeStart(const SeriesShape& shape,
                                      const std::vector<fs::path>& inputs) {
  ByteWriter out;
  out.Put(shape);
  out.Put(static_cast<std::uint64_t>(inputs.size()));
  for (const fs::path& input : inputs) out.Put(input.string());
  return std::move(out.bytes());
}

void MakePartsFolder(const fs::path& file) {
  const fs::path folder = PartsFolder(file);
  std::error_code failed;
  if (fs::create_directory(folder, failed)) return;
  if (failed) ThrowSystemError("cannot create the folder", folder, failed.value());
  throw InputError(
      fmt::format("{} holds the frames of a run that was not finished; recover them (plumbline "
                  "recover {}) or delete that folder",
                  folder.string(), file.string()));
}

}  // namespace

struct SeriesRun::Impl {
  fs::path file;
  SeriesShape shape;
  std::unique_ptr<JournalWriter> journal;
  std::int64_t committed = 0;
  bool closed = false;
  std::atomic<bool> stop{false};
  std::future<std::string> inputs;  // hashed while the run goes on

  ~Impl() {
    stop = true;
    if (inputs.valid()) inputs.wait();
    if (closed || !journal) return;
    journal.reset();
    std::error_code ignored;
    if (committed == 0) fs::remove_all(PartsFolder(file), ignored);
  }
};

SeriesRun::SeriesRun(const fs::path& file, const SeriesShape& shape,
                     const std::vector<fs::path>& inputs,
                     const std::function<void(const fs::path&)>& write_header)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = file;
  impl_->shape = shape;
  MakePartsFolder(file);
  try {
    WriteDurably(HeaderFile(file), write_header);
    impl_->journal = std::make_unique<JournalWriter>(JournalFile(file));
    impl_->journal->Append(EncodeStart(shape, inputs));
    SyncPath(PartsFolder(file));
    SyncPath(file.parent_path());
  } catch (...) {
    std::error_code ignored;
    impl_->journal.reset();
    fs::remove_all(PartsFolder(file), ignored);
    try {
      throw;
    } catch (const hdf5::Error& error) {
      throw EnvironmentError(fmt::format("cannot write {}: {}", file.string(), error.what()));
    }
  }
  impl_->inputs = std::async(std::launch::async, [impl = impl_.get(), inputs] {
    return DescribeInputs(inputs, [impl] { return impl->stop.load(); });
  });
}

SeriesRun::~SeriesRun() = default;

const SeriesShape& SeriesRun::shape() const { return impl_->shape; }
std::int64_t SeriesRun::committed() const { return impl_->committed; }

void SeriesRun::Commit(std::span<const std::uint8_t> record) {
  if (impl_->closed) throw std::logic_error("a frame was committed to a series after Close");
  impl_->journal->Append(record);
  ++impl_->committed;
}

void SeriesRun::Close() {
  if (impl_->closed) return;
  const std::string inputs = impl_->inputs.valid() ? impl_->inputs.get() : "";
  PackSeries(impl_->file, inputs, false);
  impl_->closed = true;
}

}  // namespace plumbline::internal
