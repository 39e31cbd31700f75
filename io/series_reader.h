#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "io/series_writer.h"

namespace plumbline {

// Reads a series, also one that is not ours: nothing in the file can make it read another file, and
// sizes are checked before memory is taken.
//
// Not thread-safe.
class SeriesReader {
 public:
  // Throws InputError naming the file and what is missing or wrong in it.
  explicit SeriesReader(const std::filesystem::path& file);
  ~SeriesReader();

  const SeriesFacts& facts() const;
  StereoRig rig() const;
  Image<Eigen::Vector2f> grid_px() const;
  int step_px() const;
  int subset_px() const;
  const SeriesContents& contents() const;
  // Attributes as in SeriesHeader; those of groups that the series does not hold are the defaults
  // there.
  const std::string& grid_points() const;
  const std::string& displacement_reference() const;
  // Nothing: the series does not hold them. Throws InputError.
  std::optional<ReferenceMatches> reference() const;
  bool rigid_motion_removed() const;
  const std::string& strain_measure() const;
  const std::string& strain_axes() const;
  int vsg_px() const;
  double vsg_mm() const;
  const std::string& slip_convention() const;
  const std::optional<RightDelay>& right_delay() const;
  const std::optional<RightDelay>& estimated_right_delay() const;
  std::int64_t surveyed_frames() const;
  // By name. Throws InputError.
  std::vector<Channel> channels() const;
  std::int64_t frame_count() const;

  // Frame i of the file, 0 <= i < frame_count(). Its surface is empty where it has a problem, and
  // with it the other fields of points; else those that the series holds are of the grid's size,
  // all NaN where the frame had none. Memory: that of one frame. Throws InputError,
  // std::out_of_range.
  SeriesFrame Frame(std::int64_t i) const;
  // Of the same frame its number, time, ids, problem, placement and survey alone.
  SeriesFrame SurveyedFrame(std::int64_t i) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
