#include "io/image_sequence.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <opencv2/imgcodecs.hpp>

#include "calib/error.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::TestFolder;

void WriteImage(const fs::path& file, const cv::Mat& image) {
  ASSERT_TRUE(cv::imwrite(file.string(), image));
}

// img1.png, img2.png ... img12.png, each of its own grey level.
fs::path FolderOfTwelve() {
  const fs::path folder = TestFolder();
  for (int i = 1; i <= 12; ++i) {
    WriteImage(folder / ("img" + std::to_string(i) + ".png"), cv::Mat(6, 8, CV_8UC1, 10 * i));
  }
  return folder;
}

std::vector<std::string> Ids(ImageSequence& images) {
  std::vector<std::string> ids;
  while (const auto image = images.Next()) ids.push_back(image->id);
  return ids;
}

TEST(ImageSequence, ReadsAFolderInNaturalOrder) {
  const auto images = OpenImageSequence(FolderOfTwelve().string());
  EXPECT_EQ(images->DeclaredCount(), 12);
  for (int i = 1; i <= 12; ++i) {
    const auto image = images->Next();
    ASSERT_TRUE(image);
    EXPECT_EQ(image->index, i - 1);
    EXPECT_EQ(image->id, "img" + std::to_string(i) + ".png");
    EXPECT_EQ(image->image.grey(0, 0), 10 * i);
    EXPECT_TRUE(std::isnan(image->time_s));
  }
  EXPECT_FALSE(images->Next());
  EXPECT_EQ(images->Files().size(), 12u);
  EXPECT_TRUE(images->Notes().empty());
}

TEST(ImageSequence, TakesSlicesAndTimes) {
  ImageSourceOptions options;
  options.frames = "2:9:3";
  options.frames_per_second = 4;
  const auto images = OpenImageSequence((FolderOfTwelve() / "img*.png").string(), options);
  EXPECT_EQ(images->DeclaredCount(), 3);
  EXPECT_DOUBLE_EQ(images->Next()->time_s, 0.5);
  EXPECT_THAT(Ids(*images), ElementsAre("img6.png", "img9.png"));
  EXPECT_EQ(images->Files().size(), 3u);
}

TEST(ImageSequence, JoinsSeveralPatternsInTheirOrder) {
  const fs::path f = FolderOfTwelve();
  const auto images =
      OpenImageSequence({(f / "img12.png").string(), (f / "img1?.png").string()}, {});
  EXPECT_THAT(Ids(*images), ElementsAre("img12.png", "img10.png", "img11.png", "img12.png"));
  EXPECT_THROW(OpenImageSequence(std::vector<std::string>{}), UsageError);
}

TEST(ImageSequence, DamagedAndOddImagesAreNamedAndTheRestGoesOn) {
  const fs::path f = FolderOfTwelve();
  fs::resize_file(f / "img3.png", fs::file_size(f / "img3.png") - 14);
  WriteImage(f / "img5.png", cv::Mat(6, 9, CV_8UC1, 7));
  const auto images = OpenImageSequence(f.string());
  std::vector<std::string> problems;
  int good = 0;
  while (const auto image = images->Next()) {
    EXPECT_EQ(image->image.grey.empty(), !image->problem.empty());
    if (image->problem.empty()) ++good;
    if (!image->problem.empty()) problems.push_back(image->problem);
  }
  EXPECT_EQ(good, 10);
  ASSERT_EQ(problems.size(), 2u);
  EXPECT_THAT(problems[0], HasSubstr("img3.png"));
  EXPECT_THAT(problems[1], HasSubstr("img5.png is 9x6 px and img1.png is 8x6 px"));
}

TEST(ImageSequence, StatesColourAndBits) {
  const fs::path f = TestFolder();
  WriteImage(f / "a1.png", cv::Mat(4, 4, CV_8UC3, cv::Scalar::all(9)));
  WriteImage(f / "a2.png", cv::Mat(4, 4, CV_16UC1, cv::Scalar(3000)));
  WriteImage(f / "a3.png", cv::Mat(4, 4, CV_16UC1, cv::Scalar(900)));
  const auto images = OpenImageSequence(f.string());
  images->Next();
  images->Next();
  EXPECT_EQ(images->Next()->image.bits, 12);
  EXPECT_THAT(images->Notes(), Contains(HasSubstr("a1.png first, is in colour")));
  EXPECT_THAT(images->Notes(), Contains("the grey levels are taken as 12-bit"));
}

TEST(ImageSequence, SaysWhatIsNotThere) {
  const std::string nothing = (TestFolder() / "x*.png").string();
  try {
    OpenImageSequence(nothing);
    ADD_FAILURE() << "opened";
  } catch (const InputError& error) {
    EXPECT_EQ(std::string(error.what()), "no images: " + nothing +
                                             " is no file, no folder, and no pattern that matches "
                                             "one");
  }
  ImageSourceOptions options;
  options.frames = "one";
  EXPECT_THROW(OpenImageSequence(FolderOfTwelve().string(), options), UsageError);
  std::ofstream(TestFolder() / "b.avi") << "no video at all";
  EXPECT_THROW(OpenImageSequence((TestFolder() / "b.avi").string()), InputError);
}

TEST(ImageSequence, ReadsAVideo) {
  PLUMBLINE_SHARED_DATA(euroc, "video-stereo-euroc");
  ImageSourceOptions options;
  options.frames = "24:40:8";
  const std::string video = (euroc / "left.avi").string();
  const auto images = OpenImageSequence(video, options);
  EXPECT_EQ(images->DeclaredCount(), 2);
  const auto first = images->Next();
  ASSERT_TRUE(first);
  EXPECT_EQ(first->id, "left.avi#24");
  EXPECT_DOUBLE_EQ(first->time_s, 24 / 20.0);
  EXPECT_EQ(first->image.size(), (ImageSize{752, 480}));
  const GrayImage original = ReadImage(euroc / "png_check" / "left_24.png");
  double sum = 0;
  for (std::size_t i = 0; i < original.grey.pixel_count(); ++i) {
    sum += std::abs(double(original.grey.data()[i]) - double(first->image.grey.data()[i]));
  }
  EXPECT_LT(sum / double(original.grey.pixel_count()), 4);
  EXPECT_THAT(Ids(*images), ElementsAre("left.avi#32"));
  EXPECT_THROW(OpenImageSequence({video, video}, {}), UsageError);
}

}  // namespace
}  // namespace plumbline
