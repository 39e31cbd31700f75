// info, validate, export and recover on the series of one camera, as a user runs them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/io/planar_fixture.h"
#include "tests/support/plumbline_command.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::BadPlanarFrame;
using testing::CommandResult;
using ::testing::HasSubstr;
using testing::PlanarFrame;
using testing::PlanarHeader;
using testing::RunPlumbline;
using testing::TestFolder;

fs::path WriteThreeFrames() {
  const fs::path file = TestFolder() / "field.h5";
  testing::WritePlanar(file, PlanarHeader(), {PlanarFrame(0), BadPlanarFrame(), PlanarFrame(2)});
  return file;
}

TEST(PlanarCommands, InfoTellsWhatIsInIt) {
  const fs::path file = WriteThreeFrames();
  const std::string text = RunPlumbline("info --with-recipe " + file.string()).output;
  EXPECT_THAT(text, HasSubstr("a run of one camera, 3 frames, 5 by 7 points a frame, every 8 px, "
                              "subset 33 px, order 2.\n"));
  EXPECT_THAT(text, HasSubstr("640x480 px, 12 bits; noise variance 2.5 + 0.03 g at grey level g, "
                              "from static frames\n"));
  EXPECT_THAT(text, HasSubstr("strain: hencky, gauge of 65 px, 5 by 5 points\n"));
  EXPECT_THAT(text, HasSubstr("frame 11 (image1.png) at 0.000 s: bad. image1.png is truncated\n"));
  EXPECT_THAT(text, HasSubstr("frame 12 (image2.png) at 0.100 s: 28 points, 28 with strain\n"));
  EXPECT_THAT(text, HasSubstr("Recipe:\nstep = 8\n"));
  const auto json = nlohmann::json::parse(RunPlumbline("info --json " + file.string()).output);
  EXPECT_EQ(json["geometry"], "planar");
  EXPECT_EQ(json["reference_id"], "first.png");
  EXPECT_EQ(json["frames"][2]["reference_index"], 11);
  EXPECT_EQ(json["frames"][1]["valid_points"], 0);
}

TEST(PlanarCommands, ValidateReadsEveryFrame) {
  const fs::path file = WriteThreeFrames();
  const CommandResult whole = RunPlumbline("validate " + file.string());
  EXPECT_EQ(whole.exit_code, 0);
  EXPECT_THAT(whole.output, HasSubstr("is whole: a run of one camera, every frame read."));
  const auto made = testing::RunPython(
      "import sys, h5py\nh5py.File(sys.argv[1], 'r+')['displacement/value'][2, 0, 3] = 5\n",
      file.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  const CommandResult damaged = RunPlumbline("validate " + file.string());
  EXPECT_EQ(damaged.exit_code, 3);
  EXPECT_THAT(damaged.output, HasSubstr("frame 2: 1 points have a displacement that their status"));
}

TEST(PlanarCommands, ExportWritesEveryFrameAsCsv) {
  const fs::path file = WriteThreeFrames();
  const CommandResult result = RunPlumbline("export " + file.string() + " --format csv");
  EXPECT_EQ(result.exit_code, 0) << result.output;
  EXPECT_THAT(result.output, HasSubstr("1 frames are marked as bad"));
  std::ifstream in(TestFolder() / "field_0002.csv");
  std::string heading;
  std::getline(in, heading);
  EXPECT_THAT(heading, HasSubstr("x_px,y_px,u_px,v_px,sigma_u_px,sigma_v_px,zncc,strain_xx"));
  EXPECT_THAT(heading, ::testing::EndsWith(",status"));
  EXPECT_FALSE(fs::exists(TestFolder() / "field_0001.csv"));
  const std::string named = (TestFolder() / "named").string();
  EXPECT_EQ(RunPlumbline("export " + file.string() + " --format csv -o " + named).exit_code, 0);
  EXPECT_TRUE(fs::exists(named + "_0002.csv"));  // the ending of the format
  const CommandResult refused = RunPlumbline("export " + file.string() + " --format ply");
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.output, HasSubstr("--format csv"));
}

TEST(PlanarCommands, RecoverPacksWhatAKilledRunLeft) {
  const fs::path file = TestFolder() / "field.h5";
  {
    PlanarSeriesWriter writer(file, PlanarHeader());
    writer.Commit(PlanarFrame(0));
  }
  EXPECT_THAT(RunPlumbline("info " + file.string()).output, HasSubstr("plumbline recover"));
  EXPECT_THAT(RunPlumbline("recover " + file.string()).output, HasSubstr("Recovered 1 frames"));
  testing::ExpectSamePlanarFrame(PlanarFrame(0), PlanarSeriesReader(file).Frame(0));
}

}  // namespace
}  // namespace plumbline
