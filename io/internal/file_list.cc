#include "io/internal/file_list.h"

#include <fmt/format.h>
#include <glob.h>

#include <algorithm>
#include <cctype>
#include <map>
#include <set>

#include "calib/error.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

bool IsDigit(char c) { return c >= '0' && c <= '9'; }
bool IsLetter(char c) { return std::isalpha(static_cast<unsigned char>(c)) != 0; }

std::string Lower(std::string_view text) {
  std::string out(text);
  for (char& c : out) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return out;
}

// A number without its leading zeros.
std::string_view Digits(std::string_view run) {
  const std::size_t first = run.find_first_not_of('0');
  return first == std::string_view::npos ? run.substr(run.size() - 1) : run.substr(first);
}

// Runs of letters (lower case) and of digits (without leading zeros); the rest separates.
std::vector<std::string> Words(const std::string& name) {
  std::vector<std::string> words;
  for (std::size_t i = 0; i < name.size();) {
    std::size_t end = i;
    const auto kind = IsDigit(name[i]) ? IsDigit : IsLetter;
    while (end < name.size() && kind(name[end])) ++end;
    if (end == i) {
      ++i;
      continue;
    }
    const std::string_view run = std::string_view(name).substr(i, end - i);
    words.push_back(IsDigit(run[0]) ? std::string(Digits(run)) : Lower(run));
    i = end;
  }
  return words;
}

using WordTable = std::vector<std::vector<std::string>>;

WordTable WordsOf(const std::vector<fs::path>& files) {
  WordTable table;
  for (const fs::path& file : files) table.push_back(Words(file.filename().string()));
  return table;
}

bool SameWordCount(const WordTable& a, const WordTable& b) {
  const std::size_t n = a.front().size();
  const auto differs = [n](const std::vector<std::string>& words) { return words.size() != n; };
  return std::none_of(a.begin(), a.end(), differs) && std::none_of(b.begin(), b.end(), differs);
}

bool IsSideWord(const std::string& word) {
  static const std::set<std::string> kWords = {"left", "right", "l", "r"};
  return kWords.count(word) != 0;
}

bool Varies(const WordTable& table, std::size_t position) {
  return std::any_of(table.begin(), table.end(),
                     [&](const auto& words) { return words[position] != table.front()[position]; });
}

// What identifies the frame in each name: the words that change within a side. Single images have
// none that change; there, all words but those of the side count, and one word may differ by being
// a pair of camera numbers.
std::vector<std::string> Keys(const WordTable& own, const WordTable& other) {
  std::vector<bool> counts(own.front().size(), true);
  const bool regular = SameWordCount(own, other);
  if (regular) {
    const bool single = own.size() == 1 && other.size() == 1;
    for (std::size_t p = 0; p < counts.size(); ++p) {
      counts[p] = single || Varies(own, p) || Varies(other, p);
    }
  }
  std::vector<std::string> keys;
  for (const auto& words : own) {
    std::string key;
    for (std::size_t p = 0; p < words.size(); ++p) {
      if (regular ? (counts[p] && !IsSideWord(words[p])) : !IsSideWord(words[p])) {
        key += words[p] + '/';
      }
    }
    keys.push_back(key);
  }
  return keys;
}

// left01 with right02: both name their side, and another number differs.
bool SinglePairIsCrossed(const std::vector<std::string>& left,
                         const std::vector<std::string>& right) {
  if (left.size() != right.size()) return false;
  bool sides = false;
  bool numbers_differ = false;
  for (std::size_t p = 0; p < left.size(); ++p) {
    if (left[p] == right[p]) continue;
    if (IsSideWord(left[p]) && IsSideWord(right[p])) {
      sides = true;
    } else if (IsDigit(left[p][0]) && IsDigit(right[p][0])) {
      numbers_differ = true;
    }
  }
  return sides && numbers_differ;
}

bool AllHaveWord(const WordTable& table, const std::string& word) {
  return std::all_of(table.begin(), table.end(), [&](const auto& words) {
    return std::find(words.begin(), words.end(), word) != words.end();
  });
}

std::string NamesOf(const std::vector<fs::path>& files) {
  std::string text;
  for (std::size_t i = 0; i < files.size() && i < 5; ++i) {
    text += (i > 0 ? ", " : "") + files[i].filename().string();
  }
  if (files.size() > 5) text += fmt::format(" and {} more", files.size() - 5);
  return text;
}

void RefuseSwappedSides(const WordTable& left, const WordTable& right) {
  if (AllHaveWord(left, "right") && AllHaveWord(right, "left") && !AllHaveWord(left, "left") &&
      !AllHaveWord(right, "right")) {
    throw InputError(
        "the images given as left are named \"right\" and those given as right \"left\": swap the "
        "two");
  }
}

[[noreturn]] void RefuseUnpaired(std::size_t n_left, std::size_t n_right,
                                 const std::vector<fs::path>& alone) {
  std::string message = fmt::format("{} left and {} right images do not pair", n_left, n_right);
  if (!alone.empty()) message += fmt::format(": no partner for {}", NamesOf(alone));
  throw InputError(message + "; remove the ones that are alone, or add what is missing");
}

}  // namespace

bool NaturalLess(std::string_view a, std::string_view b) {
  std::size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (IsDigit(a[i]) && IsDigit(b[j])) {
      std::size_t i_end = i, j_end = j;
      while (i_end < a.size() && IsDigit(a[i_end])) ++i_end;
      while (j_end < b.size() && IsDigit(b[j_end])) ++j_end;
      const std::string_view x = Digits(a.substr(i, i_end - i));
      const std::string_view y = Digits(b.substr(j, j_end - j));
      if (x != y) return x.size() != y.size() ? x.size() < y.size() : x < y;
      i = i_end;
      j = j_end;
    } else {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
    }
  }
  if ((i == a.size()) != (j == b.size())) return i == a.size();
  return a < b;  // img1 and img01: any order, but always the same
}

bool HasImageExtension(const fs::path& file) {
  static const std::set<std::string> kEndings = {".png", ".tif", ".tiff", ".jpg", ".jpeg",
                                                 ".bmp", ".pgm", ".ppm",  ".pnm"};
  return kEndings.count(Lower(file.extension().string())) != 0;
}

bool HasVideoExtension(const fs::path& file) {
  static const std::set<std::string> kEndings = {".avi",  ".mp4", ".mkv", ".mov", ".m4v",
                                                 ".mpeg", ".mpg", ".wmv", ".webm"};
  return kEndings.count(Lower(file.extension().string())) != 0;
}

std::vector<fs::path> ListFiles(const std::string& pattern, std::string_view camera) {
  const std::string side = camera.empty() ? "" : std::string(camera) + ' ';
  std::vector<fs::path> files;
  std::error_code ignored;
  if (fs::is_directory(pattern, ignored)) {
    std::error_code failed;
    for (fs::directory_iterator it(pattern, failed), end; !failed && it != end;
         it.increment(failed)) {
      if (it->is_regular_file(ignored) && HasImageExtension(it->path())) {
        files.push_back(it->path());
      }
    }
    if (failed) {
      throw InputError(
          fmt::format("the {}folder {} cannot be read: {}", side, pattern, failed.message()));
    }
    if (files.empty()) {
      throw InputError(fmt::format("the {}folder {} holds no PNG, TIFF, JPEG, BMP or PGM images",
                                   side, pattern));
    }
  } else if (fs::exists(pattern, ignored)) {
    files.emplace_back(pattern);
  } else {
    glob_t found{};
    if (glob(pattern.c_str(), 0, nullptr, &found) == 0) {
      for (std::size_t i = 0; i < found.gl_pathc; ++i) {
        if (fs::is_regular_file(found.gl_pathv[i], ignored)) files.emplace_back(found.gl_pathv[i]);
      }
    }
    globfree(&found);
    if (files.empty()) {
      throw InputError(fmt::format(
          "no {}images: {} is no file, no folder, and no pattern that matches one", side, pattern));
    }
  }
  std::sort(files.begin(), files.end(), [](const fs::path& a, const fs::path& b) {
    return NaturalLess(a.string(), b.string());
  });
  return files;
}

PairedFiles PairByName(const std::vector<fs::path>& left, const std::vector<fs::path>& right) {
  const WordTable left_words = WordsOf(left);
  const WordTable right_words = WordsOf(right);
  RefuseSwappedSides(left_words, right_words);
  PairedFiles pairs{left, right, ""};
  if (left.size() == 1 && right.size() == 1) {
    if (SinglePairIsCrossed(left_words[0], right_words[0])) {
      throw InputError(fmt::format("{} and {} carry different numbers: they are no pair",
                                   left[0].filename().string(), right[0].filename().string()));
    }
    return pairs;
  }

  const std::vector<std::string> left_keys = Keys(left_words, right_words);
  const std::vector<std::string> right_keys = Keys(right_words, left_words);
  std::map<std::string, std::size_t> right_of_key;
  for (std::size_t i = 0; i < right.size(); ++i) right_of_key.emplace(right_keys[i], i);
  std::set<std::size_t> used;
  std::vector<fs::path> alone;
  std::vector<fs::path> partners;
  for (std::size_t i = 0; i < left.size(); ++i) {
    const auto it = right_of_key.find(left_keys[i]);
    if (it == right_of_key.end() || !used.insert(it->second).second) {
      alone.push_back(left[i]);
    } else {
      partners.push_back(right[it->second]);
    }
  }
  for (std::size_t i = 0; i < right.size(); ++i) {
    if (used.count(i) == 0) alone.push_back(right[i]);
  }
  if (alone.empty()) {
    pairs.right = partners;
    return pairs;
  }
  if (!partners.empty() || left.size() != right.size()) {
    RefuseUnpaired(left.size(), right.size(), partners.empty() ? std::vector<fs::path>{} : alone);
  }
  pairs.note = fmt::format(
      "the names of left and right images have nothing in common ({} and {}): they are paired in "
      "order",
      left[0].filename().string(), right[0].filename().string());
  return pairs;
}

}  // namespace plumbline::internal
