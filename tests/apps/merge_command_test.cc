// merge, as a user runs it, and info and validate on what comes out.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/io/planar_fixture.h"
#include "tests/support/plumbline_command.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::CommandResult;
using ::testing::HasSubstr;
using testing::RunPlumbline;
using testing::TestFolder;

constexpr int kFrames = 5;

void WriteShards(const fs::path& folder) {
  for (int i = 0; i < 2; ++i) {
    PlanarSeriesHeader header = testing::PlanarHeader();
    header.shard = ShardOf(i, 2, kFrames);
    std::vector<PlanarSeriesFrame> frames;
    for (auto k = header.shard->first_frame; k < EndOf(*header.shard); ++k) {
      frames.push_back(testing::PlanarFrame(k, header));
    }
    testing::WritePlanar(folder / ("shard" + std::to_string(i + 1) + ".h5"), header, frames);
  }
}

TEST(MergeCommand, JoinsTheShardsOfARun) {
  const fs::path folder = TestFolder();
  WriteShards(folder);
  const std::string shards = folder.string() + "/shard*.h5";
  EXPECT_THAT(RunPlumbline("info " + (folder / "shard2.h5").string()).output,
              HasSubstr("shard 2 of 2, from frame 2 of 5"));
  const fs::path merged = folder / "run.h5";
  const CommandResult joined = RunPlumbline("merge -q --json " + shards + " -o " + merged.string());
  ASSERT_EQ(joined.exit_code, 0) << joined.output;
  const auto json = nlohmann::json::parse(joined.output);
  EXPECT_EQ(json["frames"], kFrames);
  EXPECT_EQ(json["shards"], 2);
  EXPECT_EQ(RunPlumbline("validate " + merged.string()).exit_code, 0);
  EXPECT_EQ(PlanarSeriesReader(merged).frame_count(), kFrames);
  const fs::path copy = folder / "copy/run.h5";
  fs::create_directory(folder / "copy");
  const CommandResult refused = RunPlumbline("merge " + shards + " -o " + copy.string());
  EXPECT_EQ(refused.exit_code, 3);
  EXPECT_THAT(refused.output, HasSubstr("--copy"));
  const CommandResult copied = RunPlumbline("merge --copy " + shards + " -o " + copy.string());
  EXPECT_EQ(copied.exit_code, 0) << copied.output;
  EXPECT_THAT(copied.output, HasSubstr("Joined 5 frames of 2 shards"));
  fs::remove(folder / "shard1.h5");
  EXPECT_EQ(RunPlumbline("validate " + copy.string()).exit_code, 0);
  const CommandResult gone = RunPlumbline("info " + merged.string());
  EXPECT_EQ(gone.exit_code, 3);
  EXPECT_THAT(gone.output, HasSubstr("shard1.h5 is missing"));
  const CommandResult half =
      RunPlumbline("merge " + (folder / "shard2.h5").string() + " -o " + copy.string());
  EXPECT_EQ(half.exit_code, 3);
  EXPECT_THAT(half.output, HasSubstr("these are missing: 1"));
}

}  // namespace
}  // namespace plumbline
