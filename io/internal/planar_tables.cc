#include "io/internal/planar_tables.h"

#include <string>
#include <utility>
#include <vector>

#include "io/internal/planar_layout.h"
#include "io/internal/point_groups.h"
#include "io/internal/series_datasets.h"

namespace plumbline::internal {
namespace {

class PlanarPacker : public FramePacker {
 public:
  PlanarPacker(hid_t file, const SeriesShape& shape)
      : file_(file), shape_(shape), points_(file, PlanarPoints(), shape) {}

  void Add(std::span<const std::uint8_t> payload) override {
    FrameRecord<PlanarSeriesFrame> record = DecodePlanarFrame(payload, shape_);
    points_.Add(record.chunks);
    status_.push_back(record.has_points ? 0 : 1);
    frames_.push_back(std::move(record.frame));
  }

  void Finish() override {
    WriteFrameIndex(file_, Column<std::int64_t>(frames_, [](const auto& f) { return f.index; }));
    WriteNumberColumn(file_, "/frames/time_s", "s", "time of the frame",
                      Column<double>(frames_, [](const auto& f) { return f.time_s; }));
    WriteTextColumn(file_, "/frames/id", "deformed image",
                    Column<std::string>(frames_, [](const auto& f) { return f.id; }));
    WriteTextColumn(file_, "/frames/problem",
                    "why there is no displacement field; empty if there is one",
                    Column<std::string>(frames_, [](const auto& f) { return f.problem; }));
    WriteNumberColumn(
        file_, "/frames/dropped_before", "1", "frames lost just before this one",
        Column<std::int32_t>(frames_, [](const auto& f) { return f.dropped_before; }));
    WriteNumberColumn(
        file_, "/frames/reference_index", "1",
        "frame that this one was correlated with, as /frames/index; -1: the reference image",
        Column<std::int64_t>(frames_, [](const auto& f) { return f.reference_index; }));
    WriteEnumColumn(file_, "/frames/status", "whether the frame holds a displacement field",
                    kPlanarFrameStatusNames, status_);
    points_.Finish();
  }

 private:
  hid_t file_;
  SeriesShape shape_;
  PointGroups points_;
  std::vector<PlanarSeriesFrame> frames_;
  std::vector<std::uint8_t> status_;
};

}  // namespace

std::unique_ptr<FramePacker> MakePlanarPacker(hid_t file, const SeriesShape& shape) {
  return std::make_unique<PlanarPacker>(file, shape);
}

}  // namespace plumbline::internal
