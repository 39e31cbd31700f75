#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace plumbline::internal {

// One option: `--name` on the command line, `name` in the command's table of a TOML recipe.
struct OptionSpec {
  std::string name;
  std::string help;
  std::string unit = "";        // "px", "mm": shown in --help, written beside the value in a recipe
  std::string short_name = "";  // "o" for -o
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();
  std::vector<std::string> choices = {};
  bool required = false;
  bool positional = false;
  bool in_recipe = true;
};

// Where the value goes. An optional without a value is `auto`: found by the program. A list takes
// one word or several (as the shell makes of a pattern), in a recipe a text or an array of them.
using OptionTarget =
    std::variant<bool*, int*, std::uint64_t*, double*, std::string*, std::optional<int>*,
                 std::optional<double>*, std::vector<std::string>*>;

// The options of one command: declared once, they are read from the command line, else from a
// recipe, else keep the default that the target holds; and they write the full recipe.
//
// CLI11 splits the command line and prints the help; values are converted here, so that a recipe
// and the command line are judged alike and in the same words.
class OptionTable {
 public:
  OptionTable(CLI::App& app, std::string command);

  void Add(const OptionSpec& spec, OptionTarget target);

  // What the command line gives for an option, as text; nothing where it is left out.
  std::optional<std::string> Given(const std::string& name) const;

  // Takes from the recipe's table of this command what the command line left out. Throws InputError
  // when the file cannot be read, UsageError naming file and line of what this command does not
  // know.
  void ReadRecipe(const std::filesystem::path& recipe);

  // What the command line or the recipe gives for an option, as text.
  std::optional<std::string> Text(const std::string& name) const;

  // Takes from a table of a recipe that a run has stored what neither the command line nor a recipe
  // gives; options that this command does not know, and those of `without`, are passed over. A
  // recipe that is no TOML, or lacks the table, gives nothing. False: that was so.
  bool ReadStored(const std::string& recipe_toml, const std::string& table,
                  const std::vector<std::string>& without = {});

  // In place of all that was given.
  void Set(const std::string& name, const std::string& text);

  // Converts and stores all values. Throws UsageError naming the option, its value and what would
  // be right, or what is missing.
  void Finish();

  // Every option with the value in force, as TOML that ReadRecipe() takes.
  std::string Recipe() const;

  // The option that a mistyped one may mean; empty if none is near.
  std::string Nearest(std::string_view mistyped) const;

 private:
  struct Entry {
    OptionSpec spec;
    OptionTarget target;
    CLI::Option* option = nullptr;
    std::string default_text;
    std::optional<std::string> text;  // as given; of a list the first
    std::vector<std::string> list;    // as given
    std::string origin;               // "--step", or "step in r.toml"
  };

  CLI::App& app_;
  std::string command_;
  std::vector<Entry> entries_;
};

}  // namespace plumbline::internal
