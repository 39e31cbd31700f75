#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "apps/internal/command.h"
#include "apps/planar_run.h"

namespace plumbline::internal {

// Gathers what `correlate` says at its end, without keeping the frames.
class PlanarReport {
 public:
  PlanarReport(std::filesystem::path output, std::int64_t declared_frames,
               const PlanarSeriesHeader& header, ReferenceMode mode);

  void Add(const CorrelatedFrame& frame);
  void SetInterrupted() { interrupted_ = true; }

  std::int64_t frames() const { return static_cast<std::int64_t>(rows_.size()); }
  bool interrupted() const { return interrupted_; }

  // Why no point of any frame was found, in one sentence; empty where some were.
  std::string Complaint() const;

  // Exit code 0; 3 when no point of any frame was found; 130 after Ctrl-C.
  CommandReport Make(const std::vector<std::string>& notes) const;

 private:
  struct Row {
    std::int64_t index = 0, reference_index = -1;
    std::string id, problem;
    FieldCounts counts;
    PlanarSummary summary;
    std::int64_t lost_at_updates = 0;
    double seconds = 0;
  };
  std::string FrameText(const Row& row) const;
  std::string Text(const std::vector<std::string>& notes) const;
  std::string GoOnText() const;
  nlohmann::json FrameJson(const Row& row) const;
  nlohmann::json Json(const std::vector<std::string>& notes) const;
  double PointsPerSecond() const;
  std::int64_t Bad() const;
  std::int64_t Found() const;  // points, over all frames

  std::filesystem::path output_;
  std::int64_t declared_frames_;
  PlanarSeriesHeader header_;
  ReferenceMode mode_;
  bool interrupted_ = false;
  std::vector<Row> rows_;
};

// One sentence on the strain gauge, for people.
std::string GaugeText(const PlanarSeriesHeader& header);

// Median strains with their sigmas; what to do where there is none.
std::string StrainText(const PlanarSummary& summary, const PlanarSeriesHeader& header);

// A number or null: JSON has no NaN.
nlohmann::json FiniteJson(double value);

// The same numbers for scripts.
nlohmann::json StrainJson(const PlanarSummary& summary);

}  // namespace plumbline::internal
