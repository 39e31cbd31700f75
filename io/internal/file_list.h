#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace plumbline::internal {

// img2 before img10: runs of digits compare as numbers.
bool NaturalLess(std::string_view a, std::string_view b);

// Whether a name ends as image files (videos) do.
bool HasImageExtension(const std::filesystem::path& file);
bool HasVideoExtension(const std::filesystem::path& file);

// The files that a glob, a folder (its image files) or a path names, sorted naturally; `camera` is
// the word for messages ("left"), empty where there is one only. Throws InputError when there are
// none.
std::vector<std::filesystem::path> ListFiles(const std::string& pattern, std::string_view camera);

struct PairedFiles {
  std::vector<std::filesystem::path> left, right;  // of one length
  std::string note;                                // empty, or how they were paired
};

// Pairs two naturally sorted lists by the changing parts of the names; see OpenImageSource().
// Throws InputError naming the files that have no partner.
PairedFiles PairByName(const std::vector<std::filesystem::path>& left,
                       const std::vector<std::filesystem::path>& right);

}  // namespace plumbline::internal
