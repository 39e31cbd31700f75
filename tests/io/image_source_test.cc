#include "io/image_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "calib/error.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using testing::TestFolder;

// A tiny image whose grey level tells which one it is.
void WriteImage(const fs::path& file, int level, int channels = 1) {
  cv::imwrite(file.string(), cv::Mat(6, 8, CV_8UC(channels), cv::Scalar::all(level)));
}

fs::path Folder(const std::vector<std::string>& names) {
  const fs::path folder = TestFolder();
  for (std::size_t i = 0; i < names.size(); ++i) {
    fs::create_directories((folder / names[i]).parent_path());
    WriteImage(folder / names[i], static_cast<int>(i));
  }
  return folder;
}

std::string Refusal(const std::string& left, const std::string& right,
                    const ImageSourceOptions& options = {}) {
  try {
    OpenImageSource(left, right, options);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

std::vector<std::string> PairNames(ImageSource& source) {
  std::vector<std::string> names;
  while (const auto frame = source.Next()) names.push_back(frame->left_id + "+" + frame->right_id);
  return names;
}

TEST(ImageSource, PairsGlobsInNaturalOrder) {
  const fs::path f = Folder({"left10.png", "left2.png", "left1.png", "right1.png", "right02.png",
                             "right10.png", "notes.png"});
  const auto source = OpenImageSource((f / "left*.png").string(), (f / "right*.png").string());
  EXPECT_EQ(source->DeclaredCount(), 3);
  EXPECT_THAT(PairNames(*source),
              ::testing::ElementsAre("left1.png+right1.png", "left2.png+right02.png",
                                     "left10.png+right10.png"));
}

TEST(ImageSource, PairsTheUsualNames) {
  const std::vector<std::pair<std::string, std::string>> patterns = {
      {"a%_0.png", "a%_1.png"}, {"cam0_%.png", "cam1_%.png"},     {"%_left.png", "%_right.png"},
      {"L%.png", "R%.png"},     {"cam0/17%.png", "cam1/17%.png"}, {"s00412_%.png", "s00987_%.png"}};
  for (const auto& [left, right] : patterns) {
    std::vector<std::string> names;
    for (const char* number : {"3", "4", "12"}) {
      for (std::string name : {left, right})
        names.push_back(name.replace(name.find('%'), 1, number));
    }
    fs::remove_all(TestFolder());
    const fs::path f = Folder(names);
    const auto glob = [&](std::string p) { return (f / p.replace(p.find('%'), 1, "*")).string(); };
    const auto source = OpenImageSource(glob(left), glob(right));
    EXPECT_EQ(PairNames(*source).size(), 3u) << left;
    EXPECT_TRUE(source->Notes().empty()) << source->Notes()[0];
  }
}

TEST(ImageSource, NamesTheImagesWithoutPartner) {
  const fs::path f =
      Folder({"left01.png", "left02.png", "left03.png", "right01.png", "right03.png"});
  const std::string message = Refusal((f / "left*.png").string(), (f / "right*.png").string());
  EXPECT_THAT(message, HasSubstr("3 left and 2 right"));
  EXPECT_THAT(message, HasSubstr("left02.png"));
}

TEST(ImageSource, RefusesEqualCountsThatDoNotPair) {
  const fs::path f = Folder({"left01.png", "left02.png", "right01.png", "right03.png"});
  const std::string message = Refusal((f / "left*.png").string(), (f / "right*.png").string());
  EXPECT_THAT(message, HasSubstr("left02.png, right03.png"));
}

TEST(ImageSource, RefusesSwappedSidesCrossedSinglesAndOneSideTwice) {
  const fs::path f = Folder({"left01.png", "left02.png", "right01.png", "right02.png"});
  const auto path = [&](const char* name) { return (f / name).string(); };
  EXPECT_THAT(Refusal(path("right*.png"), path("left*.png")), HasSubstr("swap"));
  EXPECT_THAT(Refusal(path("left01.png"), path("right02.png")), HasSubstr("no pair"));
  EXPECT_THAT(Refusal(path("left*.png"), path("left*.png")), HasSubstr("same file"));
  EXPECT_THAT(Refusal(path("left*.tif"), path("right*.png")), HasSubstr("left*.tif"));
}

TEST(ImageSource, PairsUnrelatedNamesInOrderAndSaysSo) {
  const fs::path f = Folder({"a/1001.png", "a/1051.png", "b/1003.png", "b/1049.png"});
  const auto source = OpenImageSource((f / "a").string(), (f / "b").string());
  EXPECT_EQ(source->DeclaredCount(), 2);
  EXPECT_THAT(source->Notes(), Contains(HasSubstr("paired in order")));
}

TEST(ImageSource, DamagedImageIsAMarkedFrameAndTheRunGoesOn) {
  const fs::path f =
      Folder({"left1.png", "right1.png", "left2.png", "right2.png", "left3.png", "right3.png"});
  fs::resize_file(f / "right2.png", fs::file_size(f / "right2.png") - 14);
  const auto source = OpenImageSource((f / "left*").string(), (f / "right*").string());
  std::vector<StereoFrame> frames;
  while (auto frame = source->Next()) frames.push_back(std::move(*frame));
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_TRUE(frames[0].problem.empty());
  EXPECT_THAT(frames[1].problem, HasSubstr("right2.png"));
  EXPECT_TRUE(frames[1].left.grey.empty());
  EXPECT_EQ(frames[2].left.grey(0, 0), 4);
}

TEST(ImageSource, SlicesAsPythonDoes) {
  std::vector<std::string> names;
  for (int i = 0; i < 10; ++i) {
    names.push_back("left" + std::to_string(i) + ".png");
    names.push_back("right" + std::to_string(i) + ".png");
  }
  const fs::path f = Folder(names);
  const auto indices = [&](const std::string& frames) {
    ImageSourceOptions options;
    options.frames = frames;
    const auto source = OpenImageSource((f / "left*").string(), (f / "right*").string(), options);
    std::vector<std::int64_t> found;
    while (const auto frame = source->Next()) found.push_back(frame->index);
    EXPECT_EQ(source->DeclaredCount(), static_cast<std::int64_t>(found.size()));
    return found;
  };
  using V = std::vector<std::int64_t>;
  EXPECT_EQ(indices("2:9:3"), (V{2, 5, 8}));
  EXPECT_EQ(indices(":3"), (V{0, 1, 2}));
  EXPECT_EQ(indices("-2:"), (V{8, 9}));
  EXPECT_EQ(indices("::4"), (V{0, 4, 8}));
  EXPECT_EQ(indices("7"), (V{7}));
  EXPECT_EQ(indices("5:2"), V{});
  for (const char* wrong : {"a", "1:2:0", "::-1", "1:2:3:4", ":x"}) {
    EXPECT_THROW(indices(wrong), UsageError) << wrong;
  }
}

TEST(ImageSource, TakesTimesFromTableOrRate) {
  const fs::path f = Folder({"left1.png", "right1.png", "left2.png", "right2.png"});
  const auto second_time = [&](const ImageSourceOptions& options) {
    const auto source = OpenImageSource((f / "left*").string(), (f / "right*").string(), options);
    source->Next();
    return source->Next()->time_s;
  };
  ImageSourceOptions options;
  EXPECT_TRUE(std::isnan(second_time(options)));
  options.frames_per_second = 20;
  EXPECT_DOUBLE_EQ(second_time(options), 0.05);
  std::ofstream(f / "t.csv")
      << "frame,timestamp_ns\n0,1403715274262142976\n1,1403715274312143104\n";
  options.timestamps_csv = f / "t.csv";
  EXPECT_DOUBLE_EQ(second_time(options), 0.050000128);
  std::ofstream(f / "t.csv") << "12.5\n13.75\n";
  EXPECT_DOUBLE_EQ(second_time(options), 1.25);
  std::ofstream(f / "t.csv") << "time_s\n1\nnoon\n";
  EXPECT_THROW(second_time(options), InputError);
}

TEST(ImageSource, StatesColour) {
  const fs::path f = Folder({"left1.png", "right1.png"});
  WriteImage(f / "left1.png", 9, 3);
  const auto source = OpenImageSource((f / "left*").string(), (f / "right*").string());
  source->Next();
  EXPECT_THAT(source->Notes(),
              Contains(::testing::AllOf(HasSubstr("left1.png"), HasSubstr("colour"))));
}

TEST(ImageSource, GivesBothSidesOneNumberOfBits) {
  const fs::path f = TestFolder();
  cv::imwrite((f / "left1.png").string(), cv::Mat(4, 4, CV_16UC1, cv::Scalar(3000)));
  cv::imwrite((f / "right1.png").string(), cv::Mat(4, 4, CV_16UC1, cv::Scalar(900)));
  const auto frame = OpenImageSource((f / "left*").string(), (f / "right*").string())->Next();
  EXPECT_EQ(frame->left.bits, 12);
  EXPECT_EQ(frame->right.bits, 12);
  EXPECT_EQ(frame->right.grey(0, 0), 900);
}

TEST(VideoSource, ReadsTheRealPair) {
  PLUMBLINE_SHARED_DATA(euroc, "video-stereo-euroc");
  ImageSourceOptions options;
  options.timestamps_csv = euroc / "frame_timestamps_ns.csv";
  for (const std::string ending : {".avi", ".mp4"}) {
    const auto source = OpenImageSource((euroc / ("left" + ending)).string(),
                                        (euroc / ("right" + ending)).string(), options);
    EXPECT_EQ(source->DeclaredCount(), 48);
    int count = 0;
    while (const auto frame = source->Next()) {
      ASSERT_TRUE(frame->problem.empty()) << frame->problem;
      ASSERT_EQ(frame->left.size(), (ImageSize{752, 480}));
      EXPECT_EQ(frame->index, count);
      EXPECT_NEAR(frame->time_s, 0.05 * count, 1e-3);
      if (count == 24) {
        const GrayImage original = ReadImage(euroc / "png_check" / "left_24.png");
        double sum = 0;
        for (std::size_t i = 0; i < original.grey.pixel_count(); ++i) {
          sum += std::abs(double(original.grey.data()[i]) - double(frame->left.grey.data()[i]));
        }
        EXPECT_LT(sum / double(original.grey.pixel_count()), 4) << ending;
      }
      ++count;
    }
    EXPECT_EQ(count, 48);
    for (const std::string& note : source->Notes()) {
      EXPECT_THAT(note, ::testing::Not(HasSubstr("declare"))) << note;
    }
  }
}

fs::path Truncated(const fs::path& from, double share) {
  const fs::path to = TestFolder() / from.filename();
  fs::copy_file(from, to, fs::copy_options::overwrite_existing);
  fs::permissions(to, fs::perms::owner_all);
  fs::resize_file(to, static_cast<std::uintmax_t>(share * double(fs::file_size(to))));
  return to;
}

TEST(VideoSource, ReportsATruncatedVideoAndDeliversWhatItHolds) {
  PLUMBLINE_SHARED_DATA(euroc, "video-stereo-euroc");
  const fs::path left = Truncated(euroc / "left.avi", 0.5);
  const auto source = OpenImageSource(left.string(), (euroc / "right.avi").string());
  EXPECT_EQ(source->DeclaredCount(), 48);
  int count = 0;
  while (source->Next()) ++count;
  EXPECT_GE(count, 22);
  EXPECT_LE(count, 26);
  EXPECT_THAT(source->Notes(), Contains("left.avi: " + std::to_string(count) +
                                        " of the 48 frames it declares could be read"));
  EXPECT_THAT(source->Notes(), Contains(HasSubstr("up to the shorter")));
}

TEST(VideoSource, SlicesAndTakesTheRateOfTheVideo) {
  PLUMBLINE_SHARED_DATA(euroc, "video-stereo-euroc");
  ImageSourceOptions options;
  options.frames = "10:20:5";
  const auto source =
      OpenImageSource((euroc / "left.avi").string(), (euroc / "right.avi").string(), options);
  EXPECT_EQ(source->DeclaredCount(), 2);
  const auto first = source->Next();
  const auto second = source->Next();
  EXPECT_EQ(first->index, 10);
  EXPECT_EQ(first->left_id, "left.avi#10");
  EXPECT_DOUBLE_EQ(second->time_s, 0.75);
  EXPECT_FALSE(source->Next());
}

TEST(VideoSource, RefusesVideoWithImagesAndFilesThatAreNone) {
  const fs::path f = Folder({"a.png"});
  std::ofstream(f / "b.avi") << "no video at all";
  std::ofstream(f / "c.avi") << "nor this";
  EXPECT_THAT(Refusal((f / "a.png").string(), (f / "b.avi").string()), HasSubstr("both"));
  EXPECT_THAT(Refusal((f / "b.avi").string(), (f / "c.avi").string()), HasSubstr("b.avi"));
}

TEST(VideoSource, SurvivesGarbledBytes) {
  PLUMBLINE_SHARED_DATA(euroc, "video-stereo-euroc");
  const fs::path left = Truncated(euroc / "left.avi", 0.2);
  const fs::path right = Truncated(euroc / "right.avi", 0.2);
  const auto size = static_cast<std::int64_t>(fs::file_size(left));
  std::mt19937 rng(5);
  for (int k = 0; k < 25; ++k) {
    {
      std::fstream file(left, std::ios::in | std::ios::out | std::ios::binary);
      for (int n = 0; n < 6; ++n) {
        file.seekp(static_cast<std::int64_t>(rng()) % (k % 2 == 0 ? 6000 : size));
        file.put(static_cast<char>(rng()));
      }
    }
    try {
      ImageSourceOptions options;
      options.max_pixels = 4'000'000;
      const auto source = OpenImageSource(left.string(), right.string(), options);
      while (source->Next()) {
      }
    } catch (const InputError&) {
    }
  }
}

}  // namespace
}  // namespace plumbline
