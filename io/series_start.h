#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace plumbline {

// How a writer of a series begins.
enum class SeriesStart : std::uint8_t {
  kNew = 0,  // from the first frame; refuses where an unfinished run of that name is there
  // Goes on with the unfinished run of that name, or begins where there is none. Refuses a run that
  // was begun with another header, recipe (but for RecipeOfTheData()), software or other inputs,
  // one that another process is writing, and one that is finished: see FindRun().
  kResume,
};

// What there is of a run that was to write `file`.
struct RunState {
  enum class Kind : std::uint8_t { kNone = 0, kUnfinished, kFinished };
  Kind kind = Kind::kNone;
  std::int64_t frames = 0;       // committed
  std::int64_t last_index = -1;  // of the last of them; -1: there is none
  std::string recipe_toml;
  bool being_written = false;  // unfinished, and a process has it open
};

// An unfinished run counts before a finished one of the same name. Throws InputError where the file
// is there and no series.
RunState FindRun(const std::filesystem::path& file);

// A recipe without the options that change no number of the result: threads, output, overwrite,
// resume, shard, quiet, verbose, json, whichever table they are in. Two runs with the same rest do
// the same. What is no TOML is given back as it is.
std::string RecipeOfTheData(const std::string& recipe_toml);

}  // namespace plumbline
