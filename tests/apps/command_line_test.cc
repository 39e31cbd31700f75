#include "apps/command_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/support/plumbline_command.h"

namespace plumbline {
namespace {

using testing::CommandResult;
using ::testing::HasSubstr;
using ::testing::Not;
using testing::RunPlumbline;
using testing::TestFolder;

constexpr const char* kCommands[] = {"calibrate", "measure",  "disparity", "noise",   "speckle",
                                     "info",      "validate", "export",    "recover", "reference"};

// The complaint, one sentence on one line, with this exit code.
void ExpectComplaint(const std::string& arguments, int exit_code, const std::string& part) {
  const CommandResult result = RunPlumbline(arguments);
  EXPECT_EQ(result.exit_code, exit_code) << arguments << "\n" << result.output;
  EXPECT_THAT(result.output, HasSubstr(part)) << arguments;
  EXPECT_EQ(std::count(result.output.begin(), result.output.end(), '\n'), 1) << result.output;
}

TEST(CommandLine, TellsItsVersion) {
  const CommandResult result = RunPlumbline("--version");
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_THAT(result.output, ::testing::StartsWith("plumbline 0."));
}

TEST(CommandLine, HelpListsEveryCommand) {
  const CommandResult result = RunPlumbline("--help");
  EXPECT_EQ(result.exit_code, 0);
  for (const char* command : kCommands) EXPECT_THAT(result.output, HasSubstr(command));
}

TEST(CommandLine, WithoutACommandItShowsTheHelpAndFails) {
  const CommandResult result = RunPlumbline("");
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.output, HasSubstr("calibrate"));
}

TEST(CommandLine, EveryCommandHasHelpWithTheCommonOptions) {
  for (const char* command : kCommands) {
    const CommandResult result = RunPlumbline(std::string(command) + " --help");
    EXPECT_EQ(result.exit_code, 0) << command;
    for (const char* option :
         {"--json", "--threads", "--seed", "--quiet", "--verbose", "--recipe"}) {
      EXPECT_THAT(result.output, HasSubstr(option)) << command;
    }
  }
}

TEST(CommandLine, HelpGivesUnitsAndDefaults) {
  const std::string calibrate = RunPlumbline("calibrate --help").output;
  EXPECT_THAT(calibrate, HasSubstr("--target-sigma mm [0.1]"));
  EXPECT_THAT(calibrate, HasSubstr("--model NAME [opencv5]"));
  const std::string measure = RunPlumbline("measure --help").output;
  EXPECT_THAT(measure, HasSubstr("--step px ["));
  EXPECT_THAT(measure, HasSubstr("--min-distance mm [auto]"));
}

TEST(CommandLine, WrongUsageIsExitCodeTwo) {
  ExpectComplaint("mesure", 2, "There is no command 'mesure'");
  ExpectComplaint("measure --stpe 3", 2, "There is no option --stpe; do you mean --step?");
  ExpectComplaint("measure --step", 2, "step");
  ExpectComplaint("measure --left a --right b", 2, "--rig is missing");
  ExpectComplaint("measure --rig r --left a --right b --step 0", 2,
                  "--step takes a whole number of px from 1");
  ExpectComplaint("measure --rig r --left a --right b --matcher orb", 2,
                  "--matcher takes auto, sgbm, dic, not 'orb'");
  ExpectComplaint("measure --rig r --left a --right b --roi 1,2,3", 2, "A region is x,y,w,h");
  ExpectComplaint("measure --rig r --left a --right b --min-distance 300", 2, "together");
  ExpectComplaint("measure --rig r a.png b.png", 2, "one word too many");
  ExpectComplaint("calibrate --board chessbord:9x6:10mm --left a --right b", 2, "chessboard:");
  ExpectComplaint("calibrate --board chessboard:9x6:10mm --left a --right b --model fisheye", 2,
                  "--model");
  ExpectComplaint("calibrate --board chessboard:9x6:10mm --left a --right b --known-distance 3:4",
                  2, "ID1:ID2:MM");
  ExpectComplaint("disparity a.png b.png -o d.tif", 2, ".h5, .png or .pfm");
  ExpectComplaint("info", 2, "FILE is missing");
}

TEST(CommandLine, BadInputIsExitCodeThree) {
  ExpectComplaint("info /nowhere/run.h5", 3, "There is no file '/nowhere/run.h5'");
  ExpectComplaint(
      "measure --rig /nowhere/rig.h5 --left a --right b -o " + (TestFolder() / "run.h5").string(),
      3, "There is no rig file '/nowhere/rig.h5'");
  ExpectComplaint(
      "calibrate --board chessboard:9x6:10mm --left '/nowhere/l*.png' --right "
      "'/nowhere/r*.png' -o " +
          (TestFolder() / "rig.h5").string(),
      3, "/nowhere/l*.png");
  ExpectComplaint("measure --recipe /nowhere/r.toml", 3, "There is no recipe");
  const auto text = TestFolder() / "text.h5";
  std::ofstream(text) << "not a file of ours";
  ExpectComplaint("info " + text.string(), 3, "text.h5");
  ExpectComplaint("validate " + text.string(), 3, "text.h5");
  ExpectComplaint("recover " + text.string(), 3, "text.h5");
}

TEST(CommandLine, AnExistingResultIsNotOverwrittenUnasked) {
  const auto there = TestFolder() / "there.h5";
  std::ofstream(there) << "somebody's week of work";
  ExpectComplaint("measure --rig r --left a --right b -o " + there.string(), 3, "is there already");
  EXPECT_EQ(std::filesystem::file_size(there), 23U);
}

TEST(CommandLine, AMissingFolderIsExitCodeFour) {
  ExpectComplaint("calibrate --board chessboard:9x6:10mm --left a --right b -o /nowhere/rig.h5", 4,
                  "There is no folder '/nowhere'");
}

TEST(CommandLine, ComplaintsAreJsonToo) {
  const CommandResult result = RunPlumbline("info /nowhere/run.h5 --json 2>/dev/null");
  EXPECT_EQ(result.exit_code, 3);
  const auto json = nlohmann::json::parse(result.output);
  EXPECT_EQ(json["error"]["exit_code"], 3);
  EXPECT_THAT(json["error"]["message"].get<std::string>(), HasSubstr("/nowhere/run.h5"));
}

TEST(CommandLine, RecipesGiveOptionsAndTheCommandLineWins) {
  const auto recipe = TestFolder() / "r.toml";
  std::ofstream(recipe) << "[measure]\nrig = \"/nowhere/a.h5\"\nleft = \"l\"\nright = \"r\"\n";
  const std::string common =
      "measure --recipe " + recipe.string() + " -o " + (TestFolder() / "run.h5").string();
  ExpectComplaint(common, 3, "/nowhere/a.h5");
  ExpectComplaint(common + " --rig /nowhere/b.h5", 3, "/nowhere/b.h5");
}

}  // namespace
}  // namespace plumbline
