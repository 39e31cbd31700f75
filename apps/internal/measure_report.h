#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "apps/internal/command.h"
#include "apps/internal/rolling_report.h"
#include "apps/pipeline.h"
#include "apps/stereo_run.h"
#include "apps/surface_evaluation.h"
#include "calib/image.h"

namespace plumbline::internal {

// "1920x1200". Throws UsageError.
ImageSize ParseImageSize(const std::string& text);

// One frame, of whatever matcher, with what there is to say of it.
struct ReportedFrame {
  SeriesFrame frame;
  FrameSummary summary;
  std::optional<SurfaceSummary> motion;  // of stereo-DIC
  double seconds = 0;                    // that it took
};

ReportedFrame Reported(StereoRunFrame measured);

// "Frame 7: the cameras have moved ...".
std::string AlarmText(std::int64_t frame, const RigWatchRecord& watch);

// What a run that ends before its last frame leaves, and how to go on.
std::string KeptText(std::int64_t frames, const std::filesystem::path& output);

// Gathers what `measure` says at its end, without keeping the frames.
class MeasureReport {
 public:
  MeasureReport(std::filesystem::path output, std::int64_t declared_frames, bool has_calibration);

  void Add(const ReportedFrame& measured);
  void SetSeconds(double seconds) { seconds_ = seconds; }
  // By Ctrl-C. kept: what there is of the run, a sentence; whole: the output file was written.
  void SetInterrupted(const std::string& kept, bool whole) {
    interrupted_ = true;
    kept_ = kept;
    written_ = whole;
  }

  std::int64_t frames() const { return static_cast<std::int64_t>(frames_.size()); }
  std::int64_t measured() const;
  bool interrupted() const { return interrupted_; }

  // "97.2 % valid": of the points so far.
  std::string ShareText() const;

  // Exit code 0; 3 when no frame could be measured; 130 after Ctrl-C.
  CommandReport Make() const;

 private:
  struct Row {
    std::int64_t index = 0;
    std::string left_id, problem;
    FrameSummary summary;
    GroundRecord ground;
    RigWatchRecord watch;
    std::optional<SurfaceSummary> motion;
    std::optional<RollingReport> rolling;
  };
  std::string FrameText(const Row& row) const;
  std::string MotionText(const Row& row) const;
  std::string VibrationText() const;
  nlohmann::json MotionJson(const Row& row) const;
  std::string Text() const;
  nlohmann::json Json() const;

  std::filesystem::path output_;
  std::int64_t declared_frames_;
  bool has_calibration_;
  bool interrupted_ = false, written_ = true;
  std::string kept_;
  double seconds_ = 0;
  std::vector<Row> frames_;
};

}  // namespace plumbline::internal
