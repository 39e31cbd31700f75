#include "io/internal/series_pack.h"

#include <fmt/format.h>

#include <limits>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/frame_packer.h"
#include "io/internal/hdf5.h"
#include "io/internal/journal.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_parts.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

using hdf5::Id;

fs::path PackedFile(const fs::path& series) { return PartsFolder(series) / "packed.h5"; }

// What was written is half a file.
EnvironmentError NoRoom(const fs::path& series, const std::string& reason) {
  std::error_code ignored;
  fs::remove(PackedFile(series), ignored);
  return EnvironmentError(
      fmt::format("cannot write {}: {}; its frames are kept in {}: make room and say plumbline "
                  "recover {}",
                  series.string(), reason, PartsFolder(series).string(), series.string()));
}

}  // namespace

std::int64_t PackRecords(const fs::path& file_name, const fs::path& header, JournalReader& journal,
                         const SeriesShape& shape, std::int64_t most, const std::string& inputs) {
  fs::copy_file(header, file_name, fs::copy_options::overwrite_existing);
  Id file = hdf5::OpenFile(file_name, true);
  // Records of points go by their place in the table of this version.
  if (VersionOf(file.get()) != (IsPlanar(file.get()) ? 1 : kFormatVersion)) {
    throw hdf5::Error(
        fmt::format("the run was begun by {}, whose records this program does not know",
                    hdf5::GetText(file.get(), "software")));
  }
  std::int64_t frames = 0;
  const std::unique_ptr<FramePacker> packer = MakeFramePacker(file.get(), shape);
  while (frames < most) {
    const auto payload = journal.Next();
    if (!payload) break;
    packer->Add(*payload);
    ++frames;
  }
  packer->Finish();
  hdf5::SetText(file.get(), "inputs", inputs);
  file.Close("closing the file");
  return frames;
}

RecoveredSeries PackSeries(const fs::path& series, const std::string& inputs, bool lock) {
  const fs::path packed = PackedFile(series);
  RecoveredSeries result;
  try {
    JournalReader journal(JournalFile(series), lock);
    const auto first = journal.Next();
    if (!first || !fs::exists(HeaderFile(series))) {
      throw InputError(
          fmt::format("{} holds no frames: that run ended before its first one; delete "
                      "the folder",
                      PartsFolder(series).string()));
    }
    const JournalStart start = DecodeStart(*first);
    result.frames = PackRecords(packed, HeaderFile(series), journal, start.shape,
                                std::numeric_limits<std::int64_t>::max(),
                                inputs.empty() ? DescribeInputs(start.InputPaths()) : inputs);
    result.bytes_dropped = journal.size() - journal.position();
    SyncPath(packed);
    fs::rename(packed, series);
    SyncPath(series.parent_path());
    RemoveParts(series);
  } catch (const hdf5::Error& error) {
    throw NoRoom(series, error.what());
  } catch (const fs::filesystem_error& error) {
    throw NoRoom(series, error.code().message());
  }
  return result;
}

}  // namespace plumbline::internal
