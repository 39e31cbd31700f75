#include "io/internal/series_parts.h"

#include <initializer_list>
#include <system_error>

namespace plumbline::internal {
namespace fs = std::filesystem;

fs::path PartsFolder(const fs::path& series) { return series.string() + ".parts"; }
fs::path JournalFile(const fs::path& series) { return PartsFolder(series) / "journal"; }
fs::path HeaderFile(const fs::path& series) { return PartsFolder(series) / "header.h5"; }

fs::path LiveFile(const fs::path& series) { return PartsFolder(series) / "live.h5"; }

bool HoldsARun(const fs::path& series) {
  std::error_code ignored;
  return fs::exists(JournalFile(series), ignored);
}

namespace {

// Removes the files of the parts folder whose names begin with one of these.
void RemoveFiles(const fs::path& folder, std::initializer_list<const char*> beginnings) {
  std::error_code ignored;
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder, ignored)) {
    const std::string name = entry.path().filename().string();
    for (const char* beginning : beginnings) {
      if (name.rfind(beginning, 0) == 0) files.push_back(entry.path());
    }
  }
  for (const fs::path& file : files) fs::remove(file, ignored);
}

}  // namespace

void RemoveLiveFiles(const fs::path& series) {
  RemoveFiles(PartsFolder(series), {"live.h5", "segment-"});
}

void RemoveParts(const fs::path& series) {
  std::error_code ignored;
  fs::remove(JournalFile(series), ignored);
  RemoveFiles(PartsFolder(series), {"header.h5", "packed.h5", "live.h5", "segment-"});
  fs::remove(PartsFolder(series), ignored);
}

JournalStart JournalStart::Of(const SeriesShape& shape, const std::vector<fs::path>& inputs) {
  JournalStart start{shape, {}};
  for (const fs::path& input : inputs) {
    std::error_code failed;
    const std::uintmax_t size = fs::file_size(input, failed);
    start.inputs.push_back({input.string(), failed ? 0 : size});
  }
  return start;
}

std::vector<fs::path> JournalStart::InputPaths() const {
  std::vector<fs::path> paths;
  for (const Input& input : inputs) paths.emplace_back(input.path);
  return paths;
}

std::vector<std::uint8_t> Encode(const JournalStart& start) {
  ByteWriter out;
  out.Put(start.shape);
  out.Put(static_cast<std::uint64_t>(start.inputs.size()));
  for (const JournalStart::Input& input : start.inputs) {
    out.Put(input.path);
    out.Put(input.size);
  }
  return std::move(out.bytes());
}

JournalStart DecodeStart(std::span<const std::uint8_t> bytes) {
  ByteReader in(bytes);
  JournalStart start;
  start.shape = in.Get<SeriesShape>();
  const auto count = in.Get<std::uint64_t>();
  for (std::uint64_t i = 0; i < count; ++i) {
    std::string path = in.GetText();
    start.inputs.push_back({std::move(path), in.Get<std::uint64_t>()});
  }
  return start;
}

std::int64_t IndexOfRecord(std::span<const std::uint8_t> payload) {
  return ByteReader(payload).Get<std::int64_t>();
}

}  // namespace plumbline::internal
