#include "io/internal/series_run.h"

#include <fmt/format.h>

#include <atomic>
#include <cstring>
#include <future>
#include <stdexcept>
#include <string>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/hdf5_tree.h"
#include "io/internal/journal.h"
#include "io/internal/live_view.h"
#include "io/internal/series_pack.h"
#include "io/internal/series_parts.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

// Makes the folder; what is left of one that a finished run did not get to remove goes.
void MakePartsFolder(const fs::path& file) {
  const fs::path folder = PartsFolder(file);
  if (!HoldsARun(file)) RemoveParts(file);
  std::error_code failed;
  if (fs::create_directory(folder, failed)) return;
  if (failed) ThrowSystemError("cannot create the folder", folder, failed.value());
  throw InputError(fmt::format(
      "{0} holds the frames of a run that was not finished; go on with it (--resume), recover them "
      "(plumbline recover {1}) or delete that folder",
      folder.string(), file.string()));
}

// Where its first frame begins; nothing: it was killed before one could be committed, and there is
// nothing to go on with.
std::optional<JournalPlace> FirstFrame(const fs::path& file) {
  JournalReader journal(JournalFile(file), true);
  if (journal.Next()) {
    if (!fs::exists(HeaderFile(file))) return std::nullopt;
    return JournalPlace{journal.index(), journal.position()};
  }
  if (journal.at_end()) return std::nullopt;
  throw InputError(fmt::format("{} is damaged at its beginning, and nothing behind it can be read",
                               JournalFile(file).string()));
}

// Throws InputError where the header is not that of the run that is to be gone on with.
void CheckSameRun(const fs::path& file, const std::function<void(const fs::path&)>& write_header) {
  const fs::path header = TemporaryName(HeaderFile(file));
  std::optional<std::string> difference;
  std::string begun_by;
  try {
    write_header(header);
    const hdf5::Id before = hdf5::OpenForeignFile(HeaderFile(file));
    const hdf5::Id now = hdf5::OpenFile(header, false);
    begun_by = hdf5::GetText(before.get(), "software");
    difference = hdf5::FirstDifference(
        before.get(), now.get(), [](const std::string& path, const std::string& attribute) {
          return path != "/" || (attribute != "created" && attribute != "recipe");
        });
    if (!difference && RecipeOfTheData(hdf5::GetText(before.get(), "recipe")) !=
                           RecipeOfTheData(hdf5::GetText(now.get(), "recipe"))) {
      difference = "the recipe";
    }
  } catch (...) {
    std::error_code ignored;
    fs::remove(header, ignored);
    throw;
  }
  fs::remove(header);
  if (!difference) return;
  throw InputError(fmt::format(
      "the run in {} cannot be gone on with: {} is not as it was when it was begun (by {}); give "
      "the same options and inputs again, or recover its frames (plumbline recover {})",
      PartsFolder(file).string(), *difference, begun_by, file.string()));
}

void CheckSameStart(const fs::path& file, const JournalStart& before, const JournalStart& now) {
  std::string difference;
  if (std::memcmp(&before.shape, &now.shape, sizeof now.shape) != 0) {
    difference = "its grid or its contents are others";
  } else if (before.inputs.size() != now.inputs.size()) {
    difference =
        fmt::format("it has {} inputs and had {}", now.inputs.size(), before.inputs.size());
  } else {
    for (std::size_t i = 0; i < now.inputs.size() && difference.empty(); ++i) {
      const auto &was = before.inputs[i], &is = now.inputs[i];
      if (was.path != is.path) difference = fmt::format("{} was {}", is.path, was.path);
      if (was.path == is.path && was.size != is.size) {
        difference = fmt::format("{} has {} bytes and had {}", is.path, is.size, was.size);
      }
    }
  }
  if (difference.empty()) return;
  throw InputError(fmt::format("the run in {} cannot be gone on with: {}",
                               PartsFolder(file).string(), difference));
}

}  // namespace

struct SeriesRun::Impl {
  fs::path file;
  SeriesShape shape;
  std::unique_ptr<JournalWriter> journal;
  std::int64_t committed = 0;
  std::optional<std::int64_t> last_index;
  JournalPlace first_frame;
  bool closed = false;
  std::atomic<bool> stop{false};
  std::future<std::string> inputs;  // hashed while the run goes on
  std::unique_ptr<LiveView> live;

  using WriteHeader = std::function<void(const fs::path&)>;

  void Begin(const JournalStart& start, const WriteHeader& write_header) {
    MakePartsFolder(file);
    try {
      journal = std::make_unique<JournalWriter>(JournalFile(file));
      WriteDurably(HeaderFile(file), write_header);
      journal->Append(Encode(start));
      first_frame = journal->end();
      SyncPath(PartsFolder(file));
      SyncPath(file.parent_path());
    } catch (...) {
      journal.reset();
      RemoveParts(file);
      throw;
    }
  }

  void GoOn(const JournalStart& start, const WriteHeader& write_header) {
    CheckSameRun(file, write_header);
    std::optional<JournalStart> before;
    const auto visit = [&](std::span<const std::uint8_t> payload) {
      if (!before) {
        before = DecodeStart(payload);
        CheckSameStart(file, *before, start);
        return;
      }
      ++committed;
      last_index = IndexOfRecord(payload);
    };
    journal = std::make_unique<JournalWriter>(JournalFile(file), visit);
  }

  ~Impl() {
    stop = true;
    if (inputs.valid()) inputs.wait();
    live.reset();
    if (closed || !journal) return;
    journal.reset();
    if (committed == 0) RemoveParts(file);
  }
};

SeriesRun::SeriesRun(const fs::path& file, const SeriesShape& shape,
                     const std::vector<fs::path>& inputs,
                     const std::function<void(const fs::path&)>& write_header, SeriesStart start,
                     const LiveReading& live)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = file;
  impl_->shape = shape;
  const JournalStart first = JournalStart::Of(shape, inputs);
  try {
    std::optional<JournalPlace> begun;
    if (start == SeriesStart::kResume && HoldsARun(file)) begun = FirstFrame(file);
    if (begun) {
      impl_->first_frame = *begun;
      impl_->GoOn(first, write_header);
    } else {
      if (start == SeriesStart::kResume) {
        RemoveParts(file);
        if (fs::exists(file)) {
          throw InputError(
              fmt::format("{} is finished: there is nothing to go on with", file.string()));
        }
      }
      impl_->Begin(first, write_header);
    }
  } catch (const hdf5::Error& error) {
    throw EnvironmentError(fmt::format("cannot write {}: {}", file.string(), error.what()));
  }
  impl_->live = std::make_unique<LiveView>(file, shape, impl_->first_frame, live);
  impl_->inputs = std::async(std::launch::async, [impl = impl_.get(), inputs] {
    return DescribeInputs(inputs, [impl] { return impl->stop.load(); });
  });
}

SeriesRun::~SeriesRun() = default;

const SeriesShape& SeriesRun::shape() const { return impl_->shape; }
std::int64_t SeriesRun::committed() const { return impl_->committed; }
std::string SeriesRun::live_problem() const { return impl_->live ? impl_->live->problem() : ""; }
std::optional<std::int64_t> SeriesRun::last_index() const { return impl_->last_index; }

void SeriesRun::Commit(std::span<const std::uint8_t> record) {
  if (impl_->closed) throw std::logic_error("a frame was committed to a series after Close");
  impl_->journal->Append(record);
  ++impl_->committed;
  impl_->last_index = IndexOfRecord(record);
  if (impl_->live) impl_->live->Committed(impl_->journal->end());
}

void SeriesRun::Close() {
  if (impl_->closed) return;
  const std::string inputs = impl_->inputs.valid() ? impl_->inputs.get() : "";
  impl_->live.reset();
  PackSeries(impl_->file, inputs, false);
  impl_->closed = true;
}

}  // namespace plumbline::internal
