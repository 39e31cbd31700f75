#include "apps/internal/option_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <fstream>

#include "calib/error.h"
#include "tests/support/shared_data.h"

namespace plumbline::internal {
namespace {

using ::testing::HasSubstr;

// A command with one option of each kind.
struct Example {
  std::string name = "a \"quoted\" name";
  std::string kind = "one";
  int step = 3;
  std::uint64_t seed = 1;
  double length = 0.1;
  bool flag = false;
  std::optional<int> low;
  std::optional<double> high;

  CLI::App app;
  OptionTable table{app, "try"};

  Example() {
    table.Add({.name = "name", .help = "a text"}, &name);
    table.Add({.name = "kind", .help = "a choice", .choices = {"one", "two"}}, &kind);
    table.Add({.name = "step", .help = "a step", .unit = "px", .min = 1, .max = 10}, &step);
    table.Add({.name = "seed", .help = "a seed"}, &seed);
    table.Add({.name = "length", .help = "a length", .unit = "mm", .min = 0}, &length);
    table.Add({.name = "flag", .help = "a flag", .short_name = "f"}, &flag);
    table.Add({.name = "low", .help = "found or given", .unit = "px"}, &low);
    table.Add({.name = "high", .help = "found or given", .unit = "mm"}, &high);
  }

  void Parse(std::vector<std::string> arguments, const std::filesystem::path& recipe = {}) {
    std::reverse(arguments.begin(), arguments.end());
    app.parse(std::move(arguments));
    if (!recipe.empty()) table.ReadRecipe(recipe);
    table.Finish();
  }
};

std::filesystem::path WriteRecipe(const std::string& text) {
  const auto file = testing::TestFolder() / "recipe.toml";
  std::ofstream(file) << text;
  return file;
}

template <typename E, typename F>
std::string MessageOf(const F& f) {
  try {
    f();
  } catch (const E& error) {
    return error.what();
  }
  return "nothing was thrown";
}

TEST(OptionTable, KeepsDefaultsAndTakesWhatIsGiven) {
  Example example;
  example.Parse({"--step", "7", "-f", "--high", "12.5", "--kind", "two"});
  EXPECT_EQ(example.step, 7);
  EXPECT_TRUE(example.flag);
  EXPECT_EQ(example.high, 12.5);
  EXPECT_EQ(example.kind, "two");
  EXPECT_EQ(example.length, 0.1);
  EXPECT_FALSE(example.low.has_value());
}

TEST(OptionTable, ARunsRecipeGivesWhatNobodySays) {
  const std::string stored =
      "[try]\nstep = 2\nlength = 3\nflag = true\nlow = 4\nkind = \"two\"\nof_old = 1\n";
  Example example;
  std::vector<std::string> arguments = {"7", "--step"};
  example.app.parse(std::move(arguments));
  example.table.ReadRecipe(WriteRecipe("[try]\nlength = 5\n"));
  EXPECT_FALSE(example.table.ReadStored("no [ TOML", "try"));
  EXPECT_FALSE(example.table.ReadStored(stored, "other"));
  EXPECT_TRUE(example.table.ReadStored(stored, "try", {"flag"}));
  EXPECT_EQ(example.table.Text("step"), "7");
  EXPECT_EQ(example.table.Text("low"), "4");
  EXPECT_EQ(example.table.Text("high"), std::nullopt);
  example.table.Set("low", "-1");
  example.table.Finish();
  EXPECT_EQ(example.step, 7);      // on the command line
  EXPECT_EQ(example.length, 5);    // in a recipe
  EXPECT_EQ(example.kind, "two");  // in that of the run
  EXPECT_FALSE(example.flag);
  EXPECT_EQ(example.low, -1);
  Example wrong;
  wrong.table.ReadStored("[try]\nstep = 99\n", "try");
  EXPECT_THAT(MessageOf<UsageError>([&] { wrong.table.Finish(); }),
              HasSubstr("step of the run's recipe takes"));
}

TEST(OptionTable, RecipeGivesWhatTheCommandLineLeavesOut) {
  Example example;
  example.Parse({"--step", "7"}, WriteRecipe("[try]\nstep = 2\nlength = 3\nflag = true\nlow = -4\n"
                                             "[other]\nx = 1\n"));
  EXPECT_EQ(example.step, 7);
  EXPECT_EQ(example.length, 3);
  EXPECT_TRUE(example.flag);
  EXPECT_EQ(example.low, -4);
}

TEST(OptionTable, TheFullRecipeGivesTheSameRunAgain) {
  Example first;
  first.Parse(
      {"--step", "7", "-f", "--high", "0.30000000000000004", "--seed", "18446744073709551615"});
  const std::string text = first.table.Recipe();
  EXPECT_THAT(text, HasSubstr("[try]"));
  EXPECT_THAT(text, HasSubstr("step = 7  # px"));
  EXPECT_THAT(text, HasSubstr("low = 'auto'  # px"));
  Example second;
  // TOML's integers end at 2^63 - 1; larger seeds are quoted.
  second.Parse({}, WriteRecipe(text));
  EXPECT_EQ(second.table.Recipe(), text);
  EXPECT_EQ(second.high, first.high);
  EXPECT_EQ(second.seed, first.seed);
  EXPECT_EQ(second.name, first.name);
  EXPECT_TRUE(second.flag);
}

TEST(OptionTable, SaysWhatAnOptionTakes) {
  const auto message = [](std::vector<std::string> arguments) {
    return MessageOf<UsageError>([&] { Example().Parse(std::move(arguments)); });
  };
  EXPECT_EQ(message({"--step", "11"}), "--step takes a whole number of px from 1 to 10, not '11'.");
  EXPECT_EQ(message({"--step", "2.5"}),
            "--step takes a whole number of px from 1 to 10, not '2.5'.");
  EXPECT_EQ(message({"--length", "nan"}), "--length takes a number of mm, 0 or more, not 'nan'.");
  EXPECT_EQ(message({"--high", "tall"}), "--high takes a number of mm, or auto, not 'tall'.");
  EXPECT_EQ(message({"--kind", "three"}), "--kind takes one or two, not 'three'.");
}

TEST(OptionTable, NamesFileAndLineOfWhatARecipeHasWrong) {
  const auto message = [](const std::string& recipe) {
    return MessageOf<UsageError>([&] { Example().Parse({}, WriteRecipe(recipe)); });
  };
  EXPECT_THAT(message("[try]\nlenght = 3\n"),
              HasSubstr("line 2: lenght is no option of try; do you mean length?"));
  EXPECT_THAT(message("[try]\n\nstep = 'many'\n"), HasSubstr("line 3: step takes a whole number"));
  EXPECT_THAT(message("[try]\nstep = [1, 2]\n"), HasSubstr("must be one text, number"));
  EXPECT_THAT(message("step = 2\n"), HasSubstr("put 'step' below a line [try]"));
  EXPECT_THAT(message("[other]\nstep = 2\n"), HasSubstr("it needs a line [try]"));
  EXPECT_THAT(MessageOf<InputError>([] { Example().Parse({}, WriteRecipe("[try\n")); }),
              HasSubstr("is not TOML: line 1"));
  EXPECT_THAT(MessageOf<InputError>([] { Example().Parse({}, "/nowhere/r.toml"); }),
              HasSubstr("There is no recipe '/nowhere/r.toml'"));
}

}  // namespace
}  // namespace plumbline::internal
