#include "io/series_writer.h"

#include <fmt/format.h>

#include <atomic>
#include <future>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/journal.h"
#include "io/internal/series_header.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_pack.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

std::vector<std::uint8_t> EncodeStart(const internal::SeriesShape& shape,
                                      const std::vector<fs::path>& inputs) {
  internal::ByteWriter out;
  out.Put(shape);
  out.Put(static_cast<std::uint64_t>(inputs.size()));
  for (const fs::path& input : inputs) out.Put(input.string());
  return std::move(out.bytes());
}

void MakePartsFolder(const fs::path& file) {
  const fs::path folder = internal::PartsFolder(file);
  std::error_code failed;
  if (fs::create_directory(folder, failed)) return;
  if (failed) internal::ThrowSystemError("cannot create the folder", folder, failed.value());
  throw InputError(
      fmt::format("{} holds the frames of a run that was not finished; recover them (plumbline "
                  "recover {}) or delete that folder",
                  folder.string(), file.string()));
}

}  // namespace

struct SeriesWriter::Impl {
  fs::path file;
  internal::SeriesShape shape;
  std::unique_ptr<internal::JournalWriter> journal;
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
    if (committed == 0) fs::remove_all(internal::PartsFolder(file), ignored);
  }
};

SeriesWriter::SeriesWriter(const fs::path& file, const SeriesHeader& header)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = file;
  internal::CheckSeriesHeader(header);
  impl_->shape = internal::SeriesShape::For(header.grid_px.size(), header.contents);
  MakePartsFolder(file);
  try {
    internal::WriteDurably(internal::HeaderFile(file), [&](const fs::path& temporary) {
      internal::WriteSeriesHeader(temporary, header);
    });
    impl_->journal = std::make_unique<internal::JournalWriter>(internal::JournalFile(file));
    impl_->journal->Append(EncodeStart(impl_->shape, header.inputs));
    internal::SyncPath(internal::PartsFolder(file));
    internal::SyncPath(file.parent_path());
  } catch (...) {
    std::error_code ignored;
    impl_->journal.reset();
    fs::remove_all(internal::PartsFolder(file), ignored);
    try {
      throw;
    } catch (const internal::hdf5::Error& error) {
      throw EnvironmentError(fmt::format("cannot write {}: {}", file.string(), error.what()));
    }
  }
  impl_->inputs = std::async(std::launch::async, [impl = impl_.get(), paths = header.inputs] {
    return internal::DescribeInputs(paths, [impl] { return impl->stop.load(); });
  });
}

SeriesWriter::~SeriesWriter() = default;

void SeriesWriter::Commit(const SeriesFrame& frame) {
  if (impl_->closed) throw std::logic_error("SeriesWriter::Commit after Close");
  impl_->journal->Append(internal::EncodeFrame(frame, impl_->shape));
  ++impl_->committed;
}

std::int64_t SeriesWriter::committed() const { return impl_->committed; }

void SeriesWriter::Close() {
  if (impl_->closed) return;
  const std::string inputs = impl_->inputs.valid() ? impl_->inputs.get() : "";
  internal::PackSeries(impl_->file, inputs, false);
  impl_->closed = true;
}

RecoveredSeries RecoverSeries(const fs::path& file) {
  if (!fs::is_directory(internal::PartsFolder(file))) {
    throw InputError(fmt::format("there is nothing to recover: no folder {}",
                                 internal::PartsFolder(file).string()));
  }
  return internal::PackSeries(file, "", true);
}

}  // namespace plumbline
