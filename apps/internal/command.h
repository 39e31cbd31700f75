#pragma once

#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "apps/internal/option_table.h"
#include "apps/progress.h"

namespace plumbline::internal {

// Options that mean the same everywhere.
struct CommonOptions {
  std::string recipe;
  bool json = false;
  bool quiet = false;
  bool verbose = false;
  int threads = 0;  // 0: all
  std::uint64_t seed = 1;

  ProgressStyle progress() const { return quiet ? ProgressStyle::kNone : ProgressStyleOfStderr(); }
};

// What a command hands back: words for people, the same for scripts.
struct CommandReport {
  std::string text;
  nlohmann::json json = nlohmann::json::object();
  int exit_code = 0;
};

// One command of `plumbline`: a file <name>_command.cc each.
class Command {
 public:
  virtual ~Command() = default;
  virtual std::string Name() const = 0;
  virtual std::string Summary() const = 0;  // one line of --help
  virtual std::string Footer() const { return {}; }
  virtual void Declare(OptionTable& options) = 0;

  // Once command line and recipe are read, before values are converted: for what else tells them.
  virtual void Complete(OptionTable& /*options*/) {}

  // `recipe_toml`: all options of this run, defaults filled in.
  virtual CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) = 0;
};

std::unique_ptr<Command> MakeCalibrateCommand();
std::unique_ptr<Command> MakeReferenceCommand();
std::unique_ptr<Command> MakeMeasureCommand();
std::unique_ptr<Command> MakeCorrelateCommand();
std::unique_ptr<Command> MakeAnalyseCommand();
std::unique_ptr<Command> MakeDisparityCommand();
std::unique_ptr<Command> MakeNoiseCommand();
std::unique_ptr<Command> MakeSpeckleCommand();
std::unique_ptr<Command> MakeSimulateCommand();
std::unique_ptr<Command> MakeCompareCommand();
std::unique_ptr<Command> MakeInfoCommand();
std::unique_ptr<Command> MakeValidateCommand();
std::unique_ptr<Command> MakeExportCommand();
std::unique_ptr<Command> MakeMergeCommand();
std::unique_ptr<Command> MakeRecoverCommand();
std::unique_ptr<Command> MakeDemoCommand();

// In the order of --help.
std::vector<std::unique_ptr<Command>> AllCommands();

}  // namespace plumbline::internal
