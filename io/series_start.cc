#include "io/series_start.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <array>
#include <sstream>

#include "calib/error.h"
#include "io/internal/hdf5.h"
#include "io/internal/journal.h"
#include "io/internal/series_parts.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;
namespace {

constexpr std::array kNotOfTheData = {"threads", "output", "overwrite", "resume",
                                      "shard",   "quiet",  "verbose",   "json"};

void DropOptions(toml::table* table) {
  for (const char* name : kNotOfTheData) table->erase(name);
  for (auto&& [key, node] : *table) {
    if (toml::table* below = node.as_table()) DropOptions(below);
  }
}

bool IsLocked(const fs::path& journal) {
  try {
    const internal::JournalReader reader(journal, true);
    return false;
  } catch (const InputError&) {
    return true;
  }
}

RunState UnfinishedRun(const fs::path& file) {
  RunState run{.kind = RunState::Kind::kUnfinished, .recipe_toml = {}};
  run.being_written = IsLocked(internal::JournalFile(file));
  internal::JournalReader journal(internal::JournalFile(file), false);
  if (!journal.Next()) return run;
  while (const auto payload = journal.Next()) {
    ++run.frames;
    run.last_index = internal::IndexOfRecord(*payload);
  }
  const hdf5::Id header = hdf5::OpenForeignFile(internal::HeaderFile(file));
  run.recipe_toml = hdf5::GetText(header.get(), "recipe");
  return run;
}

RunState FinishedRun(const fs::path& file) {
  const hdf5::Id id = hdf5::OpenForeignFile(file);
  if (hdf5::GetText(id.get(), "format") != "plumbline-series") throw hdf5::Error("it is no series");
  RunState run{.kind = RunState::Kind::kFinished, .recipe_toml = {}};
  const auto index = hdf5::ReadArray<std::int64_t>(id.get(), "/frames/index");
  run.frames = static_cast<std::int64_t>(index.size());
  if (!index.empty()) run.last_index = index.back();
  run.recipe_toml = hdf5::GetText(id.get(), "recipe");
  return run;
}

}  // namespace

RunState FindRun(const fs::path& file) {
  std::error_code ignored;
  try {
    if (internal::HoldsARun(file)) return UnfinishedRun(file);
    if (fs::exists(file, ignored)) return FinishedRun(file);
  } catch (const hdf5::Error& error) {
    throw InputError(fmt::format("{} cannot be read as a series: {}", file.string(), error.what()));
  }
  return {};
}

std::string RecipeOfTheData(const std::string& recipe_toml) {
  try {
    toml::table recipe = toml::parse(recipe_toml);
    DropOptions(&recipe);
    std::ostringstream out;
    out << recipe;
    return out.str();
  } catch (const toml::parse_error&) {
    return recipe_toml;
  }
}

std::string RecipeText(const std::string& recipe_toml, const std::string& command,
                       const std::string& option) {
  try {
    return toml::parse(recipe_toml)[command][option].value_or(std::string());
  } catch (const toml::parse_error&) {
    return {};
  }
}

}  // namespace plumbline
