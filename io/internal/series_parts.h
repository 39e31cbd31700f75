#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "io/internal/point_layout.h"

// What lies in the parts folder of a run that is going on, or was killed.
namespace plumbline::internal {

std::filesystem::path PartsFolder(const std::filesystem::path& series);
std::filesystem::path JournalFile(const std::filesystem::path& series);
std::filesystem::path HeaderFile(const std::filesystem::path& series);

std::filesystem::path LiveFile(const std::filesystem::path& series);

// Whether the folder holds a run: its journal is the first that is made and the first that goes.
bool HoldsARun(const std::filesystem::path& series);

// Removes live.h5 and its segments.
void RemoveLiveFiles(const std::filesystem::path& series);

// Removes what a run puts there, the journal first, and the folder if nothing else is in it.
void RemoveParts(const std::filesystem::path& series);

// Root attribute of live.h5: the run goes on, and what follows is not in it yet.
inline constexpr const char* kGoesOn = "run_goes_on";

// The journal's first record.
struct JournalStart {
  struct Input {
    std::string path;
    std::uint64_t size = 0;  // when the run began; 0: it cannot be read

    friend bool operator==(const Input&, const Input&) = default;
  };

  SeriesShape shape;
  std::vector<Input> inputs;

  static JournalStart Of(const SeriesShape& shape,
                         const std::vector<std::filesystem::path>& inputs);
  std::vector<std::filesystem::path> InputPaths() const;
};
std::vector<std::uint8_t> Encode(const JournalStart& start);
// Throws std::runtime_error on what Encode() did not write.
JournalStart DecodeStart(std::span<const std::uint8_t> bytes);

// SeriesFrame::index of one of the other records, which each kind of series begins with.
std::int64_t IndexOfRecord(std::span<const std::uint8_t> payload);

}  // namespace plumbline::internal
