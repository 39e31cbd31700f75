#include <fmt/format.h>

#include "apps/internal/command.h"
#include "io/series_writer.h"

namespace plumbline::internal {
namespace {

class RecoverCommand : public Command {
 public:
  std::string Name() const override { return "recover"; }
  std::string Summary() const override {
    return "Pack what a killed run left behind into its file.";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "FILE",
                 .help = "the file that the run was to write; FILE.parts lies beside it",
                 .required = true,
                 .positional = true},
                &file_);
  }

  CommandReport Run(const CommonOptions&, const std::string&) override {
    // People name what they see, which is the folder.
    std::string file = file_;
    while (file.size() > 1 && file.back() == '/') file.pop_back();
    if (file.size() > 6 && file.ends_with(".parts")) file.resize(file.size() - 6);
    const RecoveredSeries recovered = RecoverSeries(file);
    CommandReport report;
    report.json = {
        {"output", file}, {"frames", recovered.frames}, {"bytes_dropped", recovered.bytes_dropped}};
    report.text = fmt::format("Recovered {} frames into {}.\n", recovered.frames, file);
    if (recovered.bytes_dropped > 0) {
      report.text += "The frame that was being written when the run ended is lost.\n";
    }
    return report;
  }

 private:
  std::string file_;
};

}  // namespace

std::unique_ptr<Command> MakeRecoverCommand() { return std::make_unique<RecoverCommand>(); }

}  // namespace plumbline::internal
