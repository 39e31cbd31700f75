#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "io/internal/point_layout.h"
#include "io/series_start.h"

namespace plumbline::internal {

// A series of either kind while it is being written: the parts folder with header and journal, and
// the packing at its end. SeriesWriter tells what it promises.
//
// Not thread-safe.
class SeriesRun {
 public:
  // write_header writes header.h5 under the name that it is given. Throws EnvironmentError,
  // InputError where the start is refused (see SeriesStart), and what write_header throws; nothing
  // is left behind or changed then.
  SeriesRun(const std::filesystem::path& file, const SeriesShape& shape,
            const std::vector<std::filesystem::path>& inputs,
            const std::function<void(const std::filesystem::path&)>& write_header,
            SeriesStart start = SeriesStart::kNew, const LiveReading& live = {});

  // Without Close(): keeps the parts if a frame was committed.
  ~SeriesRun();
  SeriesRun(const SeriesRun&) = delete;
  SeriesRun& operator=(const SeriesRun&) = delete;

  const SeriesShape& shape() const;
  std::int64_t committed() const;
  std::optional<std::int64_t> last_index() const;
  std::string live_problem() const;

  // What the packer of this kind of series decodes. Throws EnvironmentError.
  void Commit(std::span<const std::uint8_t> record);

  // Throws EnvironmentError; the parts then stay.
  void Close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline::internal
