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

// What readers can follow of a run that goes on: `<file>.parts/live.h5`, a series of virtual
// datasets over the frames up to a moment ago, written anew now and then.
struct LiveReading {
  // At most so often; more seldom as the run becomes longer (every 2 % of it). 0: never. It takes
  // as much room on the disk again as the frames do.
  double every_s = 10;
  // The thread that writes it is busy for at most this share of the time.
  double largest_load = 0.05;
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

// The text that a recipe gives an option of a command; empty where it has none.
std::string RecipeText(const std::string& recipe_toml, const std::string& command,
                       const std::string& option);

}  // namespace plumbline
