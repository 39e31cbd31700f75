// What the shape of the tree promises: the direction of includes, public headers free of
// third-party types, files of a readable size, one format.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;

constexpr std::array<const char*, 6> kLayers = {"calib", "match", "fit", "track", "io", "apps"};

fs::path Root() { return PLUMBLINE_SOURCE_DIR; }

std::vector<fs::path> Sources(const fs::path& folder) {
  std::vector<fs::path> out;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.path().extension() == ".h" || entry.path().extension() == ".cc")
      out.push_back(entry.path());
  }
  std::sort(out.begin(), out.end());
  return out;
}

std::vector<std::string> Lines(const fs::path& file) {
  std::ifstream in(file);
  std::vector<std::string> out;
  for (std::string line; std::getline(in, line);) out.push_back(line);
  return out;
}

// "file:line: text" of every include in a folder that runs to one further right in the order of
// layers.
std::vector<std::string> IncludesAgainstTheFlow(const fs::path& root, std::size_t layer) {
  std::vector<std::string> found;
  const std::regex include(R"re(^\s*#\s*include\s*["<](?:plumbline/)?(\w+)/)re");
  for (const fs::path& file : Sources(root / kLayers[layer])) {
    int number = 0;
    for (const std::string& line : Lines(file)) {
      ++number;
      std::smatch match;
      if (!std::regex_search(line, match, include)) continue;
      const auto target = std::find(kLayers.begin(), kLayers.end(), match[1].str());
      if (target != kLayers.end() && static_cast<std::size_t>(target - kLayers.begin()) > layer) {
        found.push_back(file.string() + ":" + std::to_string(number) + ": " + line);
      }
    }
  }
  return found;
}

TEST(Layers, IncludesGoOneWay) {
  for (std::size_t layer = 0; layer < kLayers.size(); ++layer) {
    EXPECT_THAT(IncludesAgainstTheFlow(Root(), layer), ::testing::IsEmpty());
  }
}

TEST(Layers, AnIncludeTheOtherWayIsFound) {
  const fs::path root = testing::TestFolder();
  fs::create_directories(root / "calib");
  std::ofstream(root / "calib" / "bad.h")
      << "#include \"calib/image.h\"\n#include \"io/series_writer.h\"\n";
  EXPECT_THAT(IncludesAgainstTheFlow(root, 0),
              ::testing::ElementsAre(::testing::HasSubstr("bad.h:2:")));
}

// "a/b/internal/x.h" is for what lies below a/b.
TEST(Layers, InternalHeadersStayInTheirFolder) {
  for (const char* layer : kLayers) {
    for (const fs::path& file : Sources(Root() / layer)) {
      const std::string place = fs::relative(file, Root()).string();
      for (const std::string& line : Lines(file)) {
        const auto at = line.find("/internal/");
        if (line.rfind("#include \"", 0) != 0 || at == std::string::npos) continue;
        const std::string owner = line.substr(10, at - 10) + "/";
        EXPECT_EQ(place.rfind(owner, 0), 0U) << file << ": " << line;
      }
    }
  }
}

TEST(PublicHeaders, NameNoThirdPartyTypes) {
  const std::regex foreign(R"(\b(cv::|pcl::|hid_t|mrcal_|ceres::|CLI::|toml::|fmt::|tbb::))");
  for (const char* layer : kLayers) {
    for (const fs::path& file : Sources(Root() / layer)) {
      if (file.extension() != ".h" || file.string().find("/internal/") != std::string::npos)
        continue;
      for (const std::string& line : Lines(file)) {
        const std::string code = line.substr(0, line.find("//"));
        EXPECT_FALSE(std::regex_search(code, foreign)) << file << ": " << line;
      }
    }
  }
}

TEST(Files, StayOfAReadableSize) {
  for (const char* layer : kLayers) {
    for (const fs::path& file : Sources(Root() / layer)) {
      EXPECT_LE(Lines(file).size(), file.extension() == ".h" ? 300u : 500u) << file;
    }
  }
}

TEST(Files, EveryHeaderIsGuarded) {
  for (const char* layer : kLayers) {
    for (const fs::path& file : Sources(Root() / layer)) {
      if (file.extension() == ".h") {
        EXPECT_THAT(Lines(file), ::testing::Contains("#pragma once")) << file;
      }
    }
  }
}

TEST(Files, AreFormatted) {
  std::ostringstream files;
  for (const char* folder : {"calib", "match", "fit", "track", "io", "apps", "tests"}) {
    for (const fs::path& file : Sources(Root() / folder)) files << ' ' << file.string();
  }
  const auto result = testing::RunCommand("clang-format --dry-run -Werror" + files.str());
  EXPECT_EQ(result.exit_code, 0) << result.output.substr(0, 4000);
}

}  // namespace
}  // namespace plumbline
