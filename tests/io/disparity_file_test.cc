#include "io/disparity_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <string>

#include "calib/error.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

Image<float> Ramp(float first, float step) {
  Image<float> image({5, 3});
  for (std::size_t i = 0; i < image.pixel_count(); ++i) {
    image.data()[i] = first + step * static_cast<float>(i);
  }
  image(1, 2) = kNaN;
  return image;
}

TEST(DisparityFile, PfmIsReadByOpenCvAndByUs) {
  const Image<float> image = Ramp(-3.25F, 1.7F);
  const auto file = testing::TestFolder() / "map.pfm";
  WritePfm(file, image);
  const Image<float> back = ReadPfm(file);
  ASSERT_EQ(back.size(), image.size());
  for (std::size_t i = 0; i < image.pixel_count(); ++i) {
    if (std::isnan(image.data()[i])) {
      EXPECT_TRUE(std::isnan(back.data()[i]));
    } else {
      EXPECT_EQ(back.data()[i], image.data()[i]);
    }
  }
  const auto foreign = testing::RunPython(
      "import cv2, sys, numpy as np\n"
      "a = cv2.imread(sys.argv[1], -1)\n"
      "print(a.shape, a.dtype, '%.4f %.4f' % (a[0, 0], a[2, 4]), np.isinf(a[1, 2]))\n",
      file.string());
  EXPECT_EQ(foreign.output, "(3, 5) float32 -3.2500 20.5500 True\n");
}

TEST(DisparityFile, PngStatesItsScale) {
  const Image<float> image = Ramp(-300.5F, 30.25F);
  const DisparityPngScale scale = ChooseDisparityPngScale(image);
  EXPECT_EQ(scale.offset_px, -302);
  EXPECT_EQ(scale.steps_per_px, 128);
  const auto file = testing::TestFolder() / "map.png";
  WriteDisparityPng(file, image, scale);
  const auto foreign = testing::RunPython(
      "import cv2, sys, struct\n"
      "a = cv2.imread(sys.argv[1], -1)\n"
      "d = a.astype(float) / 128 - 302\n"
      "b = open(sys.argv[1], 'rb').read()\n"
      "print(a.dtype, '%.3f %.3f' % (d[0, 0], d[2, 4]), a[1, 2])\n"
      "print(b[b.index(b'tEXt') + 4:].split(b';')[0])\n",
      file.string());
  EXPECT_EQ(foreign.output,
            "uint16 -300.500 123.000 0\nb'Description\\x00disparity_px = grey / 128 + -302'\n");
}

TEST(DisparityFile, PngKeepsTheUsualScaleWhereItFits) {
  const DisparityPngScale scale = ChooseDisparityPngScale(Ramp(1, 10));
  EXPECT_EQ(scale.steps_per_px, 256);
  EXPECT_EQ(scale.offset_px, 0);
  EXPECT_THROW(WriteDisparityPng(testing::TestFolder() / "map.png", Ramp(-1, 1), scale),
               UsageError);
}

TEST(DisparityFile, NamesWhatCannotBeWrittenOrRead) {
  const auto folder = testing::TestFolder();
  EXPECT_THROW(WritePfm(folder / "none" / "map.pfm", Ramp(0, 1)), EnvironmentError);
  EXPECT_THROW(WriteDisparityPng(folder / "none" / "map.png", Ramp(1, 1), {}), EnvironmentError);
  EXPECT_THROW((void)ReadPfm(folder / "none.pfm"), InputError);
  const auto refuses = [&](const std::string& content, const std::string& reason) {
    std::ofstream(folder / "bad.pfm", std::ios::binary) << content;
    try {
      (void)ReadPfm(folder / "bad.pfm");
      ADD_FAILURE() << "accepted: " << content;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find(reason), std::string::npos) << error.what();
    }
  };
  refuses("", "no portable float map");
  refuses("P5\n2 2\n255\n", "no portable float map");
  refuses("Pf\n2 -2\n-1.0\n", "no portable float map");
  refuses("Pf\n60000 60000\n-1.0\n", "no portable float map");
  refuses("Pf\n2 2\n-1.0\n123", "cut off");
  refuses("PF\n2 2\n-1.0\n123", "colour");
}

}  // namespace
}  // namespace plumbline
