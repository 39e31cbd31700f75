#include "io/series_writer.h"

#include <fmt/format.h>

#include "calib/error.h"
#include "io/internal/series_header.h"
#include "io/internal/series_layout.h"
#include "io/internal/series_pack.h"
#include "io/internal/series_parts.h"
#include "io/internal/series_run.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

internal::SeriesShape CheckedShape(const SeriesHeader& header) {
  internal::CheckSeriesHeader(header);
  return internal::StereoShape(header.grid_px.size(), header.contents);
}

}  // namespace

struct SeriesWriter::Impl {
  internal::SeriesRun run;
};

SeriesWriter::SeriesWriter(const fs::path& file, const SeriesHeader& header, SeriesStart start,
                           const LiveReading& live)
    : impl_(new Impl{internal::SeriesRun(
          file, CheckedShape(header), header.inputs,
          [&](const fs::path& temporary) { internal::WriteSeriesHeader(temporary, header); }, start,
          live)}) {}

SeriesWriter::~SeriesWriter() = default;

void SeriesWriter::Commit(const SeriesFrame& frame) {
  impl_->run.Commit(internal::EncodeFrame(frame, impl_->run.shape()));
}

std::int64_t SeriesWriter::committed() const { return impl_->run.committed(); }
std::optional<std::int64_t> SeriesWriter::last_index() const { return impl_->run.last_index(); }

std::string SeriesWriter::live_problem() const { return impl_->run.live_problem(); }

void SeriesWriter::Close() { impl_->run.Close(); }

RecoveredSeries RecoverSeries(const fs::path& file) {
  if (!fs::is_directory(internal::PartsFolder(file))) {
    throw InputError(fmt::format("there is nothing to recover: no folder {}",
                                 internal::PartsFolder(file).string()));
  }
  return internal::PackSeries(file, "", true);
}

}  // namespace plumbline
