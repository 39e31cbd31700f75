#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

namespace plumbline::internal {

// A value of a Python literal: what ast.literal_eval() returns for text made of dicts with string
// keys, lists, tuples, strings, bytes, numbers, True, False and None.
struct PythonValue {
  using List = std::vector<PythonValue>;                          // list or tuple
  using Dict = std::vector<std::pair<std::string, PythonValue>>;  // in the order of the text
  std::variant<std::monostate, bool, double, std::string, List, Dict> value;

  bool IsNone() const { return std::holds_alternative<std::monostate>(value); }
  const bool* AsBool() const { return std::get_if<bool>(&value); }
  const double* AsNumber() const { return std::get_if<double>(&value); }
  const std::string* AsString() const { return std::get_if<std::string>(&value); }  // also bytes
  const List* AsList() const { return std::get_if<List>(&value); }
  const Dict* AsDict() const { return std::get_if<Dict>(&value); }

  // A dict's entry, the last one where the text repeats the key; nullptr if there is none.
  const PythonValue* Find(std::string_view key) const;
};

// Parses one literal; comments run from # to the end of the line. Throws InputError with the line
// number, `name` saying which file it was.
PythonValue ParsePythonLiteral(std::string_view text, const std::string& name);

}  // namespace plumbline::internal
