#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <filesystem>

#include "apps/internal/command.h"
#include "apps/interrupt.h"
#include "apps/progress.h"
#include "io/merge_series.h"

namespace plumbline::internal {
namespace {

class MergeCommand : public Command {
 public:
  std::string Name() const override { return "merge"; }
  std::string Summary() const override {
    return "Join the shards of a run (--shard) into one file.";
  }
  std::string Footer() const override {
    return "Without --copy the output names the shards, which have to stay in its folder or below "
           "it; it is written in no time and takes no room. With --copy it is a file of its own.";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "SHARDS",
                 .help = "all shards of one run, in any order",
                 .required = true,
                 .positional = true},
                &shards_);
    options.Add(
        {.name = "output", .help = "the whole run (.h5)", .short_name = "o", .required = true},
        &output_);
    options.Add({.name = "copy", .help = "copy the values instead of naming the shards"}, &copy_);
  }

  CommandReport Run(const CommonOptions& common, const std::string&) override {
    const InterruptGuard guard;
    Progress progress("merge", 2 * static_cast<std::int64_t>(shards_.size()), common.progress());
    int shown = 0;
    const MergedSeries merged = MergeSeries({shards_.begin(), shards_.end()}, output_,
                                            {.copy = copy_,
                                             .progress =
                                                 [&](int done, int) {
                                                   progress.Advance(done - shown);
                                                   shown = done;
                                                 },
                                             .stop = InterruptGuard::Requested});
    CommandReport report;
    report.json = {{"output", output_},
                   {"frames", merged.frames},
                   {"shards", merged.shards},
                   {"copy", copy_},
                   {"interrupted", merged.stopped}};
    if (merged.stopped) {
      spdlog::error("Stopped; nothing was written. The shards are as they were.");
      report.exit_code = 130;
      return report;
    }
    report.text = fmt::format("Joined {} frames of {} shards into {}.\n", merged.frames,
                              merged.shards, output_);
    if (!copy_)
      report.text += "It takes its values from the shards: move them together, or use --copy.\n";
    return report;
  }

 private:
  std::vector<std::string> shards_;
  std::string output_;
  bool copy_ = false;
};

}  // namespace

std::unique_ptr<Command> MakeMergeCommand() { return std::make_unique<MergeCommand>(); }

}  // namespace plumbline::internal
