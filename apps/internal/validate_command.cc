#include <fmt/format.h>

#include "apps/internal/command.h"
#include "apps/internal/result_file.h"
#include "io/inspect.h"
#include "io/wheel_file.h"

namespace plumbline::internal {
namespace {

class ValidateCommand : public Command {
 public:
  std::string Name() const override { return "validate"; }
  std::string Summary() const override {
    return "Check that a run, a rig or a wheel file is whole: everything is read.";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "FILE",
                 .help = "a run, a rig or a wheel file (.h5)",
                 .required = true,
                 .positional = true},
                &file_);
  }

  CommandReport Run(const CommonOptions&, const std::string&) override {
    // What cannot be opened at all is refused in words; damage further in is listed.
    const std::string_view what =
        IsWheelFile(file_) ? "the reference of a wheel" : WhatIs(OpenResultFile(file_));
    const std::vector<std::string> faults = Validate(file_);
    CommandReport report;
    report.json = {{"file", file_}, {"valid", faults.empty()}, {"faults", faults}};
    if (faults.empty()) {
      report.text = fmt::format("{} is whole: {}.\n", file_, what);
      return report;
    }
    report.text = fmt::format("{} is damaged:\n", file_);
    for (const std::string& fault : faults) report.text += "  " + fault + "\n";
    report.exit_code = 3;
    return report;
  }

 private:
  static std::string_view WhatIs(const ResultFile& file) {
    if (file.planar) return "a run of one camera, every frame read";
    return file.series ? "a run with its rig, every frame read" : "a rig file";
  }

  std::string file_;
};

}  // namespace

std::unique_ptr<Command> MakeValidateCommand() { return std::make_unique<ValidateCommand>(); }

}  // namespace plumbline::internal
