#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "apps/internal/command.h"
#include "apps/pipeline.h"
#include "calib/image.h"

namespace plumbline::internal {

// "1920x1200". Throws UsageError.
ImageSize ParseImageSize(const std::string& text);

// Gathers what `measure` says at its end, without keeping the frames.
class MeasureReport {
 public:
  MeasureReport(std::filesystem::path output, std::int64_t declared_frames, bool has_calibration);

  void Add(const MeasuredFrame& measured);
  void SetInterrupted() { interrupted_ = true; }

  std::int64_t frames() const { return static_cast<std::int64_t>(frames_.size()); }
  std::int64_t measured() const;
  bool interrupted() const { return interrupted_; }

  // Exit code 0; 3 when no frame could be measured; 130 after Ctrl-C.
  CommandReport Make() const;

 private:
  struct Row {
    std::int64_t index = 0;
    std::string left_id, problem;
    FrameSummary summary;
    GroundRecord ground;
  };
  std::string FrameText(const Row& row) const;
  std::string Text() const;
  nlohmann::json Json() const;

  std::filesystem::path output_;
  std::int64_t declared_frames_;
  bool has_calibration_;
  bool interrupted_ = false;
  std::vector<Row> frames_;
};

}  // namespace plumbline::internal
