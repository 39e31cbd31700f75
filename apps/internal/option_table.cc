#include "apps/internal/option_table.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <numeric>
#include <sstream>
#include <type_traits>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

template <typename T>
constexpr bool kIsOptional = false;
template <typename T>
constexpr bool kIsOptional<std::optional<T>> = true;

template <typename T>
constexpr bool kIsList = std::is_same_v<T, std::vector<std::string>>;

// Shortest text that reads back as the same number.
std::string NumberText(double value) { return fmt::format("{}", value); }

std::string ValueText(const OptionTarget& target) {
  return std::visit(
      [](const auto* value) -> std::string {
        using T = std::decay_t<decltype(*value)>;
        if constexpr (std::is_same_v<T, bool>) {
          return *value ? "true" : "false";
        } else if constexpr (std::is_same_v<T, std::string>) {
          return *value;
        } else if constexpr (kIsList<T>) {
          return fmt::format("{}", fmt::join(*value, " "));
        } else if constexpr (kIsOptional<T>) {
          return value->has_value() ? NumberText(static_cast<double>(**value)) : "auto";
        } else if constexpr (std::is_same_v<T, double>) {
          return NumberText(*value);
        } else {
          return fmt::format("{}", *value);
        }
      },
      target);
}

template <typename T>
std::optional<T> ParseNumber(std::string_view text) {
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  if constexpr (std::is_floating_point_v<T>) {
    if (!std::isfinite(value)) return std::nullopt;
  }
  return value;
}

std::string WithUnit(const std::string& unit) { return unit.empty() ? "" : " of " + unit; }

std::string Wanted(const OptionSpec& spec, bool whole, bool may_be_auto) {
  std::string text = whole ? "a whole number" : "a number";
  text += WithUnit(spec.unit);
  const bool low = std::isfinite(spec.min);
  const bool high = std::isfinite(spec.max);
  if (low && high) {
    text += fmt::format(" from {} to {}", spec.min, spec.max);
  } else if (low) {
    text += fmt::format(", {} or more", spec.min);
  } else if (high) {
    text += fmt::format(", at most {}", spec.max);
  }
  return may_be_auto ? text + ", or auto" : text;
}

template <typename T>
T Number(const OptionSpec& spec, const std::string& origin, const std::string& text,
         bool may_be_auto) {
  const auto value = ParseNumber<T>(text);
  if (!value || static_cast<double>(*value) < spec.min || static_cast<double>(*value) > spec.max) {
    throw UsageError(fmt::format("{} takes {}, not '{}'.", origin,
                                 Wanted(spec, std::is_integral_v<T>, may_be_auto), text));
  }
  return *value;
}

struct Assign {
  const OptionSpec& spec;
  const std::string& origin;
  const std::string& text;
  const std::vector<std::string>& list;

  void operator()(std::vector<std::string>* target) const { *target = list; }
  void operator()(bool* target) const {
    if (text != "true" && text != "false") {
      throw UsageError(fmt::format("{} takes true or false, not '{}'.", origin, text));
    }
    *target = text == "true";
  }
  void operator()(std::string* target) const {
    const auto& choices = spec.choices;
    if (!choices.empty() && std::find(choices.begin(), choices.end(), text) == choices.end()) {
      throw UsageError(fmt::format("{} takes {}, not '{}'.", origin,
                                   fmt::join(choices, choices.size() > 2 ? ", " : " or "), text));
    }
    *target = text;
  }
  void operator()(int* target) const { *target = Number<int>(spec, origin, text, false); }
  void operator()(std::uint64_t* target) const {
    *target = Number<std::uint64_t>(spec, origin, text, false);
  }
  void operator()(double* target) const { *target = Number<double>(spec, origin, text, false); }
  template <typename T>
  void operator()(std::optional<T>* target) const {
    if (text == "auto") {
      target->reset();
    } else {
      *target = Number<T>(spec, origin, text, true);
    }
  }
};

std::string TomlText(const toml::node& node, const std::string& where) {
  if (const auto* v = node.as_string()) return v->get();
  if (const auto* v = node.as_integer()) return fmt::format("{}", v->get());
  if (const auto* v = node.as_floating_point()) return NumberText(v->get());
  if (const auto* v = node.as_boolean()) return v->get() ? "true" : "false";
  throw UsageError(where + " must be one text, number, true or false.");
}

// A text, or an array of them.
std::vector<std::string> TomlList(const toml::node& node, const std::string& where) {
  const toml::array* const array = node.as_array();
  if (array == nullptr) return {TomlText(node, where)};
  std::vector<std::string> list;
  for (const toml::node& item : *array) list.push_back(TomlText(item, where));
  return list;
}

bool IsList(const OptionTarget& target) {
  return std::holds_alternative<std::vector<std::string>*>(target);
}

std::string Quoted(const std::string& text) {
  std::ostringstream out;
  out << toml::value<std::string>(text);
  return out.str();
}

std::size_t EditDistance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substitute = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, substitute});
    }
  }
  return row[b.size()];
}

}  // namespace

OptionTable::OptionTable(CLI::App& app, std::string command)
    : app_(app), command_(std::move(command)) {}

void OptionTable::Add(const OptionSpec& spec, OptionTarget target) {
  Entry entry;
  entry.spec = spec;
  entry.target = target;
  entry.default_text = ValueText(target);
  // A constant: CLI11 takes a variable here for the place where the value goes.
  const std::string help = spec.choices.empty()
                               ? spec.help
                               : fmt::format("{}: {}", spec.help, fmt::join(spec.choices, ", "));
  if (spec.positional) {
    entry.option = app_.add_option(spec.name, help);
    entry.option->type_name(spec.unit)->option_text(" ");
  } else if (std::holds_alternative<bool*>(target)) {
    const std::string names =
        (spec.short_name.empty() ? "" : "-" + spec.short_name + ",") + "--" + spec.name;
    entry.option = app_.add_flag(names, help);
  } else {
    const std::string names =
        (spec.short_name.empty() ? "" : "-" + spec.short_name + ",") + "--" + spec.name;
    entry.option = app_.add_option(names, help);
    std::string text = spec.unit.empty() ? "" : spec.unit + " ";
    if (spec.required) {
      text += "(required)";
    } else {
      text += entry.default_text.empty() ? "" : "[" + entry.default_text + "]";
    }
    entry.option->option_text(text.empty() ? " " : text);
  }
  if (IsList(target)) {
    entry.option->expected(1, 1 << 24);
    if (spec.positional) entry.option->allow_extra_args();
  } else {
    entry.option->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  }
  entries_.push_back(std::move(entry));
}

std::optional<std::string> OptionTable::Given(const std::string& name) const {
  for (const Entry& entry : entries_) {
    if (entry.spec.name == name && entry.option->count() > 0) return entry.option->results().back();
  }
  return std::nullopt;
}

void OptionTable::ReadRecipe(const std::filesystem::path& recipe) {
  toml::table document;
  if (!std::filesystem::is_regular_file(recipe)) {
    throw InputError(fmt::format("There is no recipe '{}'.", recipe.string()));
  }
  try {
    document = toml::parse_file(recipe.string());
  } catch (const toml::parse_error& error) {
    throw InputError(fmt::format("The recipe '{}' is not TOML: line {}: {}.", recipe.string(),
                                 error.source().begin.line, error.description()));
  }
  for (const auto& [key, node] : document) {
    if (node.is_table()) continue;
    throw UsageError(fmt::format("{}, line {}: put '{}' below a line [{}].", recipe.string(),
                                 node.source().begin.line, std::string(key.str()), command_));
  }
  const toml::table* table = document[command_].as_table();
  if (table == nullptr) {
    throw UsageError(
        fmt::format("The recipe '{}' has nothing for this command: it needs a line [{}].",
                    recipe.string(), command_));
  }
  for (const auto& [key, node] : *table) {
    const std::string name(key.str());
    const auto entry = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& e) {
      return e.spec.name == name && e.spec.in_recipe;
    });
    const std::string where =
        fmt::format("{}, line {}: {}", recipe.string(), node.source().begin.line, name);
    if (entry == entries_.end()) {
      const std::string nearest = Nearest(name);
      throw UsageError(fmt::format("{} is no option of {}{}", where, command_,
                                   nearest.empty() ? "." : "; do you mean " + nearest + "?"));
    }
    if (entry->option->count() > 0) continue;  // the command line wins
    if (IsList(entry->target)) {
      entry->list = TomlList(node, where);
      entry->text = entry->list.empty() ? "" : entry->list.front();
    } else {
      entry->text = TomlText(node, where);
    }
    entry->origin = where;
  }
}

std::optional<std::string> OptionTable::Text(const std::string& name) const {
  if (const auto given = Given(name)) return given;
  for (const Entry& entry : entries_) {
    if (entry.spec.name == name) return entry.text;
  }
  return std::nullopt;
}

bool OptionTable::ReadStored(const std::string& recipe_toml, const std::string& table,
                             const std::vector<std::string>& without) {
  toml::table document;
  try {
    document = toml::parse(recipe_toml);
  } catch (const toml::parse_error&) {
    return false;
  }
  const toml::table* const stored = document[table].as_table();
  if (stored == nullptr) return false;
  for (Entry& entry : entries_) {
    const toml::node* const node = stored->get(entry.spec.name);
    const bool left_out =
        std::find(without.begin(), without.end(), entry.spec.name) != without.end();
    if (node == nullptr || entry.text || entry.option->count() > 0 || !entry.spec.in_recipe ||
        left_out) {
      continue;
    }
    entry.origin = fmt::format("{} of the run's recipe", entry.spec.name);
    if (IsList(entry.target)) {
      entry.list = TomlList(*node, entry.origin);
      entry.text = entry.list.empty() ? "" : entry.list.front();
    } else {
      entry.text = TomlText(*node, entry.origin);
    }
  }
  return true;
}

void OptionTable::Set(const std::string& name, const std::string& text) {
  for (Entry& entry : entries_) {
    if (entry.spec.name == name) entry.text = text;
  }
}

void OptionTable::Finish() {
  for (Entry& entry : entries_) {
    if (entry.option->count() > 0) {
      const std::string name = entry.spec.positional ? entry.spec.name : "--" + entry.spec.name;
      const bool flag = std::holds_alternative<bool*>(entry.target);
      entry.text = flag ? "true" : entry.option->results().back();
      if (IsList(entry.target)) entry.list = entry.option->results();
      entry.origin = name;
    }
    const bool missing = !entry.text && ValueText(entry.target).empty();
    if (entry.spec.required && (missing || (entry.text && entry.text->empty()))) {
      throw UsageError(fmt::format("{} is missing: {}. See plumbline {} --help.",
                                   entry.spec.positional ? entry.spec.name : "--" + entry.spec.name,
                                   entry.spec.help, command_));
    }
    if (entry.text)
      std::visit(Assign{entry.spec, entry.origin, *entry.text, entry.list}, entry.target);
  }
}

std::string OptionTable::Recipe() const {
  std::string recipe = fmt::format("[{}]\n", command_);
  for (const Entry& entry : entries_) {
    if (!entry.spec.in_recipe) continue;
    if (IsList(entry.target)) {
      std::vector<std::string> quoted;
      for (const std::string& item : *std::get<std::vector<std::string>*>(entry.target)) {
        quoted.push_back(Quoted(item));
      }
      recipe += fmt::format("{} = [{}]\n", entry.spec.name, fmt::join(quoted, ", "));
      continue;
    }
    const std::string text = ValueText(entry.target);
    auto* const* seed = std::get_if<std::uint64_t*>(&entry.target);
    const bool too_large = seed != nullptr && **seed > std::numeric_limits<std::int64_t>::max();
    const bool bare = !std::holds_alternative<std::string*>(entry.target) && text != "auto" &&
                      !too_large;  // TOML's integers are signed
    recipe += fmt::format(
        "{} = {}{}\n", entry.spec.name, bare ? text : Quoted(text),
        entry.spec.unit.empty() || entry.spec.positional ? "" : "  # " + entry.spec.unit);
  }
  return recipe;
}

std::string OptionTable::Nearest(std::string_view mistyped) const {
  while (!mistyped.empty() && mistyped.front() == '-') mistyped.remove_prefix(1);
  std::string best;
  std::size_t best_distance = 3;  // more than two typing errors is another word
  for (const Entry& entry : entries_) {
    const std::size_t distance = EditDistance(mistyped, entry.spec.name);
    if (distance < best_distance && distance < entry.spec.name.size()) {
      best_distance = distance;
      best = entry.spec.name;
    }
  }
  return best;
}

}  // namespace plumbline::internal
