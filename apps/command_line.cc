#include "apps/command_line.h"

#include <fmt/format.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <tbb/global_control.h>
#include <tbb/info.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <new>
#include <optional>

#include "apps/internal/command.h"
#include "calib/error.h"
#include "io/version.h"

namespace plumbline {
namespace {

using internal::Command;
using internal::CommandReport;
using internal::CommonOptions;
using internal::OptionTable;

constexpr int kFault = 1;
constexpr int kUsage = 2;
constexpr int kInput = 3;
constexpr int kEnvironment = 4;

// A command with its options as CLI11 knows them.
struct Registered {
  std::unique_ptr<Command> command;
  CLI::App* app = nullptr;
  std::unique_ptr<OptionTable> options;
};

void DeclareCommon(OptionTable& options, CommonOptions& common) {
  options.Add({.name = "recipe",
               .help = "take options from this TOML file; those on the command line win",
               .unit = "FILE",
               .in_recipe = false},
              &common.recipe);
  options.Add({.name = "threads",
               .help = "how many threads to use; 0: all. Results do not depend on it",
               .unit = "N",
               .min = 0,
               .max = 1024},
              &common.threads);
  options.Add({.name = "seed",
               .help = "seed of every random choice; the same seed gives the same result",
               .unit = "N"},
              &common.seed);
  options.Add({.name = "json", .help = "print the result as JSON on stdout", .in_recipe = false},
              &common.json);
  options.Add({.name = "quiet",
               .help = "say nothing but complaints (and the JSON, with --json)",
               .short_name = "q",
               .in_recipe = false},
              &common.quiet);
  options.Add({.name = "verbose",
               .help = "say more about what is being done",
               .short_name = "v",
               .in_recipe = false},
              &common.verbose);
}

void SetUpLog(const CommonOptions& common) {
  const auto logger = spdlog::get("plumbline") != nullptr ? spdlog::get("plumbline")
                                                          : spdlog::stderr_color_mt("plumbline");
  logger->set_pattern("%v");
  logger->set_level(common.quiet     ? spdlog::level::err
                    : common.verbose ? spdlog::level::debug
                                     : spdlog::level::info);
  spdlog::set_default_logger(logger);
}

// One complaint, on stderr, and for scripts on stdout.
int Complain(const std::string& who, int code, const std::string& message, bool json) {
  fmt::print(stderr, "{}: {}\n", who, message);
  if (json) {
    const nlohmann::json error = {{"error", {{"exit_code", code}, {"message", message}}}};
    fmt::print("{}\n", error.dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
  }
  return code;
}

std::string Capitalised(std::string text) {
  if (!text.empty() && text.back() != '.') text += '.';
  return text;
}

// CLI11's complaint about the command line in our words.
std::string UsageMessage(const CLI::ParseError& error, const std::vector<Registered>& commands,
                         const CLI::App& root) {
  for (const Registered& entry : commands) {
    if (!root.got_subcommand(entry.app)) continue;
    const std::vector<std::string> extra = entry.app->remaining();
    if (!extra.empty()) {
      const std::string nearest = entry.options->Nearest(extra.front());
      if (extra.front().rfind("-", 0) != 0) {
        return fmt::format(
            "'{}' is one word too many; a list of files is given as a pattern in quotes, '*.png'.",
            extra.front());
      }
      return fmt::format("There is no option {}{} See plumbline {} --help.", extra.front(),
                         nearest.empty() ? "." : "; do you mean --" + nearest + "?",
                         entry.command->Name());
    }
    return Capitalised(error.what());
  }
  const std::vector<std::string> extra = root.remaining();
  if (!extra.empty()) {
    return fmt::format("There is no command '{}'. See plumbline --help.", extra.front());
  }
  return Capitalised(error.what());
}

int RunCommand(Registered& entry, CommonOptions& common) {
  if (const auto recipe = entry.options->Given("recipe")) entry.options->ReadRecipe(*recipe);
  entry.command->Complete(*entry.options);
  entry.options->Finish();
  SetUpLog(common);
  std::optional<tbb::global_control> limit;
  if (common.threads > 0) {
    limit.emplace(tbb::global_control::max_allowed_parallelism,
                  static_cast<std::size_t>(common.threads));
  }
  const CommandReport report = entry.command->Run(common, entry.options->Recipe());
  if (common.json) {
    fmt::print("{}\n", report.json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
  } else if (!common.quiet) {
    fmt::print("{}", report.text);
  }
  std::fflush(stdout);
  return report.exit_code;
}

int RunChecked(const std::vector<std::string>& arguments) {
  CLI::App root("Plumbline: shape and motion from stereo images, each number with its error bar.",
                "plumbline");
  root.set_version_flag("--version", SoftwareVersion());
  root.get_formatter()->column_width(34);
  root.footer("plumbline COMMAND --help tells the options of a command.");
  CommonOptions common;
  std::vector<Registered> commands;
  for (auto& command : internal::AllCommands()) {
    Registered entry;
    entry.app = root.add_subcommand(command->Name(), command->Summary());
    entry.app->footer(command->Footer());
    entry.options = std::make_unique<OptionTable>(*entry.app, command->Name());
    command->Declare(*entry.options);
    DeclareCommon(*entry.options, common);
    entry.command = std::move(command);
    commands.push_back(std::move(entry));
  }
  const bool json = std::find(arguments.begin(), arguments.end(), "--json") != arguments.end();
  try {
    std::vector<std::string> reversed(arguments.rbegin(), arguments.rend());
    root.parse(std::move(reversed));
  } catch (const CLI::Success& wish) {  // --help, --version
    return root.exit(wish) == 0 ? 0 : kUsage;
  } catch (const CLI::ParseError& error) {
    return Complain("plumbline", kUsage, UsageMessage(error, commands, root), json);
  }
  for (Registered& entry : commands) {
    if (!root.got_subcommand(entry.app)) continue;
    const std::string who = "plumbline " + entry.command->Name();
    try {
      return RunCommand(entry, common);
    } catch (const UsageError& error) {
      return Complain(who, kUsage, error.what(), json);
    } catch (const InputError& error) {
      return Complain(who, kInput, error.what(), json);
    } catch (const EnvironmentError& error) {
      return Complain(who, kEnvironment, error.what(), json);
    } catch (const std::filesystem::filesystem_error& error) {
      return Complain(who, kEnvironment, Capitalised(error.what()), json);
    } catch (const std::bad_alloc&) {
      return Complain(who, kEnvironment,
                      "The memory does not suffice; choose a region with --roi or a larger --step.",
                      json);
    } catch (const std::exception& error) {
      return Complain(who, kFault,
                      fmt::format("This is a fault in {}, not in your input: {}", SoftwareVersion(),
                                  Capitalised(error.what())),
                      json);
    }
  }
  fmt::print(stderr, "{}", root.help());
  return kUsage;
}

}  // namespace

int RunCommandLine(const std::vector<std::string>& arguments) noexcept {
  try {
    return RunChecked(arguments);
  } catch (const std::exception& error) {
    std::fputs("plumbline: ", stderr);
    std::fputs(error.what(), stderr);
    std::fputs("\n", stderr);
    return kFault;
  }
}

}  // namespace plumbline
