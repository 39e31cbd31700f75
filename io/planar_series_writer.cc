#include "io/planar_series_writer.h"

#include <stdexcept>

#include "io/internal/planar_header.h"
#include "io/internal/planar_layout.h"
#include "io/internal/series_run.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

internal::SeriesShape CheckedShape(const PlanarSeriesHeader& header) {
  internal::CheckPlanarHeader(header);
  return internal::PlanarShape(header.grid, header.contents);
}

}  // namespace

struct PlanarSeriesWriter::Impl {
  PlanarSeriesHeader header;
  internal::SeriesRun run;
};

PlanarSeriesWriter::PlanarSeriesWriter(const fs::path& file, const PlanarSeriesHeader& header,
                                       SeriesStart start, const LiveReading& live)
    : impl_(new Impl{header, internal::SeriesRun(
                                 file, CheckedShape(header), header.inputs,
                                 [&](const fs::path& temporary) {
                                   internal::WritePlanarHeader(temporary, header);
                                 },
                                 start, live)}) {}

PlanarSeriesWriter::~PlanarSeriesWriter() = default;

void PlanarSeriesWriter::Commit(const PlanarSeriesFrame& frame) {
  const PlanarField& field = frame.field;
  const PlanarSeriesHeader& header = impl_->header;
  if (frame.problem.empty() && !field.displacement_px.empty() &&
      (field.first_px != header.first_px || field.step_px != header.step_px ||
       field.subset_px != header.subset_px || field.order != header.order)) {
    throw std::invalid_argument(
        "PlanarSeriesWriter: the field's first_px, step_px, subset_px or order is not the series'");
  }
  impl_->run.Commit(internal::EncodePlanarFrame(frame, impl_->run.shape()));
}

std::int64_t PlanarSeriesWriter::committed() const { return impl_->run.committed(); }
std::optional<std::int64_t> PlanarSeriesWriter::last_index() const {
  return impl_->run.last_index();
}

std::string PlanarSeriesWriter::live_problem() const { return impl_->run.live_problem(); }

void PlanarSeriesWriter::Close() { impl_->run.Close(); }

}  // namespace plumbline
