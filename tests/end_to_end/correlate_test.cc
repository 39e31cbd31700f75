// plumbline correlate and analyse on images in files, as a user runs them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>

#include "io/planar_series_reader.h"
#include "tests/support/plumbline_json.h"
#include "tests/support/speckle_files.h"

namespace plumbline {
namespace {

namespace fs = std::filesystem;
using testing::CommandResult;
using ::testing::HasSubstr;
using testing::RunJson;
using testing::RunPlumbline;
using testing::RunPython;
using testing::TestFolder;

// Small subsets, as the images are small.
constexpr const char* kSettings = " --subset 21 --step 6 --strain-window 7";

std::string Images(const fs::path& folder) {
  return "correlate --reference " + (folder / "image_0.png").string() + " --deformed '" +
         (folder / "image_[1-9].png").string() + "' -o " + (folder / "field.h5").string();
}

TEST(Correlate, MeasuresWhatMovedIntoAFileThatOthersRead) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 2);
  const auto json = RunJson(Images(folder) + kSettings);
  ASSERT_EQ(json["frames_correlated"], 2);
  const auto& last = json["frames"][1];
  // Some leave the image.
  EXPECT_GE(last["ok_points"].get<int>() + last["by_status"].value("outside_image", 0),
            last["attempted_points"].get<int>() - 5);
  EXPECT_NEAR(last["displacement_px"]["median"][0].get<double>(), 2.6, 0.03);
  EXPECT_NEAR(last["displacement_px"]["median"][1].get<double>(), -1.2, 0.003);
  EXPECT_NEAR(last["strain"]["median"][0].get<double>(), 0.004 + 0.004 * 0.004 / 2, 3e-5);
  EXPECT_EQ(json["vsg_px"], 6 * 6 + 21);
  EXPECT_GT(json["points_per_second"].get<double>(), 0);
  const CommandResult python = RunPython(
      "import sys, json, h5py, numpy as np\n"
      "f = h5py.File(sys.argv[1])\n"
      "d, s = f['displacement/value'], f['displacement/status'][()]\n"
      "assert d.shape[0] == 2 and d.attrs['units'] == 'pixel'\n"
      "x = f['grid/pixel'][()]\n"
      "for k in 0, 1:\n"
      "    n = k + 1\n"
      "    true = np.stack([1.3 * n + .002 * n * (x[..., 0] - 110), -.6 * n + 0 * x[..., 0]], -1)\n"
      "    ok = s[k] == 0\n"
      "    e = (d[k] - true)[ok] / f['displacement/value_errors'][k][ok]\n"
      "    assert ok.mean() > .9 and .8 < e.std() < 1.2, (ok.mean(), e.std())\n"
      "    ok = f['strain/status'][k] == 0\n"
      "    exx = f['strain/value'][k, ..., 0][ok]\n"
      "    e = (exx - (.002 * n + (.002 * n)**2 / 2)) / f['strain/value_errors'][k, ..., 0][ok]\n"
      "    assert ok.mean() > .5 and .7 < e.std() < 1.3, (ok.mean(), e.std())\n"
      "assert f['strain'].attrs['vsg_px'] == 57\n"
      "assert f['grid'].attrs['prefilter'] == 'low-pass'\n"
      "inputs = json.loads(f.attrs['inputs'])\n"
      "assert [i['path'][-5] for i in inputs] == ['0', '1', '2'], inputs\n"
      "assert 'subset = 21' in f.attrs['recipe']\n"
      "print('read')\n",
      (folder / "field.h5").string());
  EXPECT_EQ(python.output, "read\n");
  EXPECT_EQ(RunPlumbline("validate " + (folder / "field.h5").string()).exit_code, 0);
}

TEST(Correlate, SaysWhatItFoundInWords) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 1);
  const CommandResult result = RunPlumbline(Images(folder) + kSettings);
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_THAT(result.output, HasSubstr("virtual gauges of 57 px (VSG; 7 by 7 points)"));
  EXPECT_THAT(result.output, HasSubstr("Frame 0 (image_1.png): "));
  EXPECT_THAT(result.output, HasSubstr(" points found ("));
  EXPECT_THAT(result.output, HasSubstr("px, median."));
  EXPECT_THAT(result.output, HasSubstr("1 of 1 frames correlated; "));
  const CommandResult again = RunPlumbline(Images(folder));
  EXPECT_EQ(again.exit_code, 3);
  EXPECT_THAT(again.output, HasSubstr("is there already; choose another name with -o"));
}

TEST(Correlate, DoesNotDependOnTheNumberOfThreads) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 2);
  RunJson(Images(folder) + kSettings + " --threads 1");
  const PlanarSeriesReader one(folder / "field.h5");
  fs::rename(folder / "field.h5", folder / "one.h5");
  RunJson(Images(folder) + kSettings + " --threads 3");
  const PlanarSeriesReader three(folder / "field.h5");
  for (int k = 0; k < 2; ++k) {
    const PlanarSeriesFrame a = one.Frame(k);
    const PlanarSeriesFrame b = three.Frame(k);
    EXPECT_EQ(a.field.status.values(), b.field.status.values());
    for (std::size_t i = 0; i < a.field.status.pixel_count(); ++i) {
      if (a.field.status.data()[i] != Status::kOk) continue;
      EXPECT_EQ(a.field.displacement_px.data()[i], b.field.displacement_px.data()[i]);
    }
  }
}

TEST(Correlate, GoesOnPastDamagedAndOddImages) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 4);
  WritePng(folder / "image_1.png", testing::SpecimenImage(1, 1, {100, 90}));
  fs::resize_file(folder / "image_3.png", 900);
  const auto json = RunJson(Images(folder) + kSettings);
  EXPECT_EQ(json["frames_correlated"], 2);
  EXPECT_THAT(json["frames"][0]["problem"].get<std::string>(),
              HasSubstr("image_1.png is 100x90 px and the reference is 220x180 px"));
  EXPECT_THAT(json["frames"][2]["problem"].get<std::string>(), HasSubstr("image_3.png"));
  EXPECT_NEAR(json["frames"][3]["displacement_px"]["median"][1].get<double>(), -2.4, 0.005);
}

TEST(Correlate, UpdatesTheReferenceAndCountsFromTheFirst) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 4);
  const auto json =
      RunJson(Images(folder) + kSettings + " --reference-mode every --update-every 2");
  EXPECT_EQ(json["frames"][1]["reference_index"], -1);
  EXPECT_EQ(json["frames"][2]["reference_index"], 1);
  EXPECT_NEAR(json["frames"][3]["displacement_px"]["median"][1].get<double>(), -2.4, 0.005);
}

TEST(Correlate, TakesTheNoiseFromAFile) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 1);
  std::ofstream(folder / "noise.toml")
      << "format = \"plumbline-noise\"\n[camera]\nbits = 8\noffset_grey2 = 16\nslope_grey = 0\n"
         "sigma_offset_grey2 = 0.1\nsigma_slope_grey = 0\noffset_slope_correlation = 0\n"
         "frames = 8\nwidth = 220\nheight = 180\nlowest_grey = 20\nhighest_grey = 230\n";
  const auto found = RunJson(Images(folder) + kSettings);
  const auto told = RunJson(Images(folder) + kSettings + " --overwrite --noise " +
                            (folder / "noise.toml").string());
  const auto sigma = [](const nlohmann::json& json) {
    return json["frames"][0]["displacement_px"]["median_sigma"].get<double>();
  };
  EXPECT_NEAR(sigma(told) / sigma(found), 4, 0.4);  // the images have a noise of 1 grey level
  EXPECT_EQ(PlanarSeriesReader(folder / "field.h5").header().camera.noise.offset_grey2, 16);
}

TEST(Correlate, ReadsItsRecipeAgain) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 1);
  std::ofstream(folder / "r.toml")
      << "[correlate]\nreference = \"" << (folder / "image_0.png").string() << "\"\ndeformed = [\""
      << (folder / "image_1.png").string() << "\"]\nsubset = 21\noutput = \""
      << (folder / "field.h5").string() << "\"\n";
  RunJson("correlate --recipe " + (folder / "r.toml").string());
  const PlanarSeriesReader made(folder / "field.h5");
  EXPECT_EQ(made.header().subset_px, 21);
  std::ofstream(folder / "again.toml") << made.header().recipe_toml;
  RunJson("correlate --overwrite --step 30 --recipe " + (folder / "again.toml").string());
  EXPECT_EQ(PlanarSeriesReader(folder / "field.h5").header().subset_px, 21);
}

struct BadInput {
  const char* arguments;
  int exit_code;
  const char* words;
};

TEST(Correlate, RefusesBadInputInOneSentence) {
  const fs::path f = TestFolder();
  const GrayImage image = testing::SpecimenImage(0, 1, {90, 80});
  WritePng(f / "a.png", image);
  WritePng(f / "b.png", testing::SpecimenImage(1, 1, {90, 80}));
  GrayImage even = image;
  for (auto& grey : even.grey.values()) grey = 90;
  WritePng(f / "blank.png", even);
  for (auto& grey : even.grey.values()) grey = 255;
  WritePng(f / "white.png", even);
  for (auto& grey : even.grey.values()) grey = 0;
  WritePng(f / "black.png", even);
  WritePng(f / "small.png", testing::SpecimenImage(0, 1, {60, 60}));
  WritePng(f / "five.png", testing::SpecimenImage(0, 1, {5, 5}));
  std::ofstream(f / "text.png") << "no image\n";
  for (const BadInput& bad : std::vector<BadInput>{
           {"--reference blank.png --deformed b.png", 3, "No point was found: "},
           {"--reference a.png --deformed blank.png", 3, "No point was found: "},
           {"--reference white.png --deformed white.png", 3, "saturated"},
           {"--reference five.png --deformed five.png", 3, "does not fit into the reference image"},
           {"--reference a.png --deformed b.png --subset 85", 3, "take a smaller --subset"},
           {"--reference a.png --deformed b.png --subset 20", 2, "A subset is an odd number"},
           {"--reference a.png --deformed b.png --step 0", 2, "--step takes a whole number"},
           {"--reference a.png --deformed b.png --strain-window 4", 2, "odd"},
           {"--reference a.png --deformed b.png --prefilter box", 2, "--prefilter takes low-pass"},
           {"--reference a.png --deformed b.png --mask black.png", 3, "is 0 everywhere"},
           {"--reference a.png --deformed b.png --mask small.png", 3, "The mask is 60x60 px"},
           {"--reference a.png --deformed b.png --roi 90,0,50,50", 3, "lies outside the image"},
           {"--reference a.png --deformed b.png --roi 0,0,20,20", 3, "less than one subset"},
           {"--reference a.png --deformed small.png", 3, "the reference is 90x80 px"},
           {"--reference no.png --deformed b.png", 3, "no.png"},
           {"--reference a.png --deformed no.png", 3, "no.png"},
           {"--reference text.png --deformed b.png", 3, "not an image of a known format"},
           {"--reference a.png --deformed text.png", 3, "not an image of a known format"},
           {"--reference a.png", 2, "--deformed is missing"},
           {"--reference a.png --deformed b.png -o no/such/f.h5", 4, "make it first"},
           {"--reference a.png --deformed b.png -o /proc/f.h5", 4, "/proc/f.h5"}}) {
    const CommandResult result = testing::RunCommand(
        "cd " + f.string() + " && " + PLUMBLINE_BINARY_DIR +
        "/plumbline correlate -q --subset 21 --overwrite -o out.h5 " + bad.arguments);
    EXPECT_EQ(result.exit_code, bad.exit_code) << bad.arguments << "\n" << result.output;
    EXPECT_THAT(result.output, HasSubstr(bad.words)) << bad.arguments;
    EXPECT_LE(std::count(result.output.begin(), result.output.end(), '\n'), 1) << result.output;
  }
}

// --- analyse -------------------------------------------------------------------------------------

TEST(Analyse, ChangesTheGaugeAndNothingElse) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 2);
  RunJson(Images(folder) + kSettings);
  const std::string file = (folder / "field.h5").string();
  const std::string to = " -o " + (folder / "strain.h5").string();
  const auto same = RunJson("analyse " + file + to + " --strain-window 7");
  EXPECT_EQ(same["notes"].size(), 0U);
  const PlanarSeriesReader before(file);
  {
    const PlanarSeriesReader after(folder / "strain.h5");
    ASSERT_EQ(after.frame_count(), 2);
    const PlanarSeriesFrame a = before.Frame(1);
    const PlanarSeriesFrame b = after.Frame(1);
    EXPECT_EQ(a.strain.status.values(), b.strain.status.values());
    for (std::size_t i = 0; i < a.strain.status.pixel_count(); ++i) {
      if (a.strain.status.data()[i] != Status::kOk) continue;
      EXPECT_EQ(a.strain.strain.data()[i], b.strain.strain.data()[i]);
      EXPECT_EQ(a.strain.covariance.data()[i], b.strain.covariance.data()[i]);
      EXPECT_EQ(a.field.displacement_px.data()[i], b.field.displacement_px.data()[i]);
    }
  }
  const auto wider =
      RunJson("analyse " + file + to + " --overwrite --strain-window 11 --strain-measure hencky");
  EXPECT_EQ(wider["vsg_px"], 10 * 6 + 21);
  EXPECT_LT(wider["frames"][1]["strain"]["median_sigma"][0].get<double>(),
            0.7 * same["frames"][1]["strain"]["median_sigma"][0].get<double>());
  const PlanarSeriesReader after(folder / "strain.h5");
  EXPECT_EQ(after.header().strain_measure, "hencky");
  EXPECT_THAT(after.header().recipe_toml, HasSubstr("[correlate]\n"));
  EXPECT_THAT(after.header().recipe_toml, HasSubstr("[analyse]\n"));
  EXPECT_EQ(RunPlumbline("validate " + (folder / "strain.h5").string()).exit_code, 0);
}

TEST(Analyse, SaysThatTheReferenceImageIsGone) {
  const fs::path folder = TestFolder();
  testing::WriteSpecimen(folder, 1);
  RunJson(Images(folder) + kSettings);
  WritePng(folder / "image_0.png", testing::SpecimenImage(0, 3));
  const auto json = RunJson("analyse " + (folder / "field.h5").string() + " -o " +
                            (folder / "strain.h5").string());
  ASSERT_EQ(json["notes"].size(), 1U);
  EXPECT_THAT(json["notes"][0].get<std::string>(), HasSubstr("is not the file that was read then"));
}

TEST(Analyse, AsksForARunOfOneCamera) {
  const fs::path folder = TestFolder();
  std::ofstream(folder / "field.h5") << "no such thing";
  EXPECT_EQ(RunPlumbline("analyse " + (folder / "field.h5").string() + " -o x.h5").exit_code, 3);
  EXPECT_EQ(RunPlumbline("analyse nothing.h5 -o x.h5").exit_code, 3);
}

// --- real images ---------------------------------------------------------------------------------

TEST(Correlate, FindsTheKnownShiftOfTheChallenge) {
  PLUMBLINE_SHARED_DATA(challenge, "dic2d-challenge-S5-known-shift");
  const fs::path folder = TestFolder();
  const auto json =
      RunJson("correlate --reference " + (challenge / "Sample5_Reference.png").string() +
              " --deformed " + (challenge / "Sample5-000_X0.00_Y0.00_N2_C75_R10.png").string() +
              " " + (challenge / "Sample5-001_X0.10_Y0.10_N2_C100_R20.png").string() + " -o " +
              (folder / "field.h5").string() + " --roi 100,100,300,300");
  ASSERT_EQ(json["frames_correlated"], 2);
  for (int k = 0; k < 2; ++k) {
    const auto& frame = json["frames"][k];
    const double sigma = frame["displacement_px"]["median_sigma"].get<double>();
    std::cout << frame["displacement_px"] << "\n";
    EXPECT_EQ(frame["ok_points"], frame["attempted_points"]);
    EXPECT_NEAR(frame["displacement_px"]["median"][0].get<double>(), 0.1 * k, 0.004);
    EXPECT_NEAR(frame["displacement_px"]["median"][1].get<double>(), 0.1 * k, 0.004);
    EXPECT_LT(sigma, 0.03);
  }
}

}  // namespace
}  // namespace plumbline
