#include "calib/internal/python_literal.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

constexpr int kMaxDepth = 20;  // deeper nesting is an attack on the stack, not a camera model

class Parser {
 public:
  Parser(std::string_view text, const std::string& name) : text_(text), name_(name) {}

  PythonValue Whole() {
    PythonValue value = Value(0);
    SkipBlank();
    if (at_ != text_.size()) Fail("there is text after the end of the dictionary");
    return value;
  }

 private:
  [[noreturn]] void Fail(const std::string& what) const {
    const auto line =
        1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at_), '\n');
    throw InputError(name_ + ", line " + std::to_string(line) + ": " + what);
  }

  char Peek() const { return at_ < text_.size() ? text_[at_] : '\0'; }

  void SkipBlank() {
    while (at_ < text_.size()) {
      if (text_[at_] == '#') {
        at_ = std::min(text_.find('\n', at_), text_.size());
      } else if (std::isspace(static_cast<unsigned char>(text_[at_])) != 0) {
        ++at_;
      } else {
        return;
      }
    }
  }

  bool Take(char c) {
    SkipBlank();
    if (Peek() != c) return false;
    ++at_;
    return true;
  }

  bool TakeWord(std::string_view word) {
    if (text_.substr(at_, word.size()) != word) return false;
    at_ += word.size();
    return true;
  }

  bool AtString() const {
    const char c = Peek();
    const char next = at_ + 1 < text_.size() ? text_[at_ + 1] : '\0';
    return c == '\'' || c == '"' ||
           ((c == 'b' || c == 'r' || c == 'u') && (next == '\'' || next == '"'));
  }

  PythonValue Value(int depth) {
    if (depth > kMaxDepth) Fail("it is nested too deeply");
    SkipBlank();
    PythonValue out;
    if (AtString()) {
      out.value = String();
    } else if (Take('{')) {
      out.value = Dict(depth);
    } else if (Take('[')) {
      out.value = List(']', depth);
    } else if (Take('(')) {
      out.value = List(')', depth);
    } else if (TakeWord("None")) {
      return out;
    } else if (TakeWord("True")) {
      out.value = true;
    } else if (TakeWord("False")) {
      out.value = false;
    } else {
      out.value = Number();
    }
    return out;
  }

  // One or more neighbouring string literals, joined as Python does.
  std::string String() {
    std::string out;
    while (AtString()) {
      if (Peek() != '\'' && Peek() != '"') ++at_;  // the prefix
      const char quote = text_[at_++];
      while (true) {
        if (at_ >= text_.size()) Fail("a string does not end");
        const char c = text_[at_++];
        if (c == quote) break;
        if (c == '\n') Fail("a string runs over the end of its line");
        if (c == '\\') {
          const char escaped = Peek();
          if (escaped != '\\' && escaped != '\'' && escaped != '"') {
            Fail("a string has an escape that is not supported");
          }
          out += escaped;
          ++at_;
        } else {
          out += c;
        }
      }
      SkipBlank();
    }
    return out;
  }

  double Number() {
    if (Peek() == '+') ++at_;
    double number = 0;
    const char* begin = text_.data() + at_;
    const auto [end, error] = std::from_chars(begin, text_.data() + text_.size(), number);
    if (error != std::errc() || !std::isfinite(number)) Fail("a finite number was expected");
    at_ += static_cast<std::size_t>(end - begin);
    return number;
  }

  PythonValue::List List(char close, int depth) {
    PythonValue::List out;
    while (!Take(close)) {
      out.push_back(Value(depth + 1));
      if (Take(',')) continue;
      if (Take(close)) break;
      Fail(std::string("',' or '") + close + "' was expected");
    }
    return out;
  }

  PythonValue::Dict Dict(int depth) {
    PythonValue::Dict out;
    while (!Take('}')) {
      SkipBlank();
      if (!AtString()) Fail("a key in quotes was expected");
      std::string key = String();
      if (!Take(':')) Fail("':' was expected after '" + key + "'");
      out.emplace_back(std::move(key), Value(depth + 1));
      if (Take(',')) continue;
      if (Take('}')) break;
      Fail("',' or '}' was expected");
    }
    return out;
  }

  std::string_view text_;
  const std::string& name_;
  std::size_t at_ = 0;
};

}  // namespace

const PythonValue* PythonValue::Find(std::string_view key) const {
  const Dict* dict = AsDict();
  if (dict == nullptr) return nullptr;
  const auto found = std::find_if(dict->rbegin(), dict->rend(),
                                  [&](const auto& entry) { return entry.first == key; });
  return found == dict->rend() ? nullptr : &found->second;
}

PythonValue ParsePythonLiteral(std::string_view text, const std::string& name) {
  return Parser(text, name).Whole();
}

}  // namespace plumbline::internal
