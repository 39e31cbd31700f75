#include "apps/internal/command.h"

namespace plumbline::internal {

std::vector<std::unique_ptr<Command>> AllCommands() {
  std::vector<std::unique_ptr<Command>> commands;
  commands.push_back(MakeCalibrateCommand());
  commands.push_back(MakeReferenceCommand());
  commands.push_back(MakeMeasureCommand());
  commands.push_back(MakeCorrelateCommand());
  commands.push_back(MakeAnalyseCommand());
  commands.push_back(MakeDisparityCommand());
  commands.push_back(MakeNoiseCommand());
  commands.push_back(MakeSpeckleCommand());
  commands.push_back(MakeSimulateCommand());
  commands.push_back(MakeCompareCommand());
  commands.push_back(MakeInfoCommand());
  commands.push_back(MakeValidateCommand());
  commands.push_back(MakeExportCommand());
  commands.push_back(MakeMergeCommand());
  commands.push_back(MakeRecoverCommand());
  commands.push_back(MakeDemoCommand());
  return commands;
}

}  // namespace plumbline::internal
