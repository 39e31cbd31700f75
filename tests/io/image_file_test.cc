#include <gtest/gtest.h>

#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "calib/error.h"
#include "io/image_source.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::TestFolder;

cv::Mat Speckle(int type, int rows = 61, int columns = 83) {
  cv::Mat image(rows, columns, type);
  cv::RNG rng(7);
  rng.fill(image, cv::RNG::UNIFORM, 0, CV_MAT_DEPTH(type) == CV_16U ? 4096 : 256);
  cv::GaussianBlur(image, image, {5, 5}, 1);
  return image;
}

std::string Bytes(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void WriteBytes(const fs::path& file, const std::string& bytes) {
  std::ofstream(file, std::ios::binary) << bytes;
}

std::string Refusal(const fs::path& file, std::int64_t max_pixels = 200'000'000) {
  try {
    ReadImage(file, nullptr, max_pixels);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

class EveryFormat : public ::testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Formats, EveryFormat,
                         ::testing::Values("png", "tif", "bmp", "pgm", "jpg"));

TEST_P(EveryFormat, GivesTheGreyLevelsThatWereWritten) {
  const fs::path file = TestFolder() / (std::string("a.") + GetParam());
  const cv::Mat written = Speckle(CV_8UC1);
  ASSERT_TRUE(cv::imwrite(file.string(), written));
  const cv::Mat expected = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
  bool colour = true;
  const GrayImage image = ReadImage(file, &colour);
  EXPECT_FALSE(colour);
  EXPECT_EQ(image.bits, 8);
  ASSERT_EQ(image.size(), (ImageSize{written.cols, written.rows}));
  for (int r = 0; r < written.rows; ++r) {
    for (int c = 0; c < written.cols; ++c) {
      ASSERT_EQ(image.grey(r, c), expected.at<unsigned char>(r, c)) << r << ", " << c;
    }
  }
}

TEST_P(EveryFormat, NamesATruncatedFile) {
  const fs::path file = TestFolder() / (std::string("a.") + GetParam());
  cv::imwrite(file.string(), Speckle(CV_8UC1));
  const std::string whole = Bytes(file);
  for (const double share : {0.999, 0.9, 0.5, 0.1}) {
    const auto n = std::min<std::size_t>(whole.size() - 3,
                                         static_cast<std::size_t>(share * double(whole.size())));
    WriteBytes(file, whole.substr(0, n));
    const std::string message = Refusal(file);
    EXPECT_NE(message.find(file.string()), std::string::npos) << share << ": " << message;
    EXPECT_TRUE(message.find("truncated") != std::string::npos ||
                message.find("damaged") != std::string::npos)
        << message;
  }
}

TEST_P(EveryFormat, SurvivesGarbledBytes) {
  const fs::path file = TestFolder() / (std::string("a.") + GetParam());
  cv::imwrite(file.string(), Speckle(CV_8UC1));
  const std::string whole = Bytes(file);
  std::mt19937 rng(3);
  int refused = 0;
  for (int k = 0; k < 200; ++k) {
    std::string bytes = whole;
    const std::size_t reach = k % 2 == 0 ? std::min<std::size_t>(bytes.size(), 300) : bytes.size();
    for (int n = 0; n < 1 + k % 5; ++n) bytes[rng() % reach] = static_cast<char>(rng());
    WriteBytes(file, bytes);
    if (!Refusal(file, 1'000'000).empty()) ++refused;
  }
  EXPECT_GT(refused, 0);
}

TEST_P(EveryFormat, RefusesAnImageAboveTheCapBeforeDecodingIt) {
  const fs::path file = TestFolder() / (std::string("a.") + GetParam());
  cv::imwrite(file.string(), Speckle(CV_8UC1));
  EXPECT_NE(Refusal(file, 5000).find("83 x 61 pixels are more than the 5000"), std::string::npos)
      << Refusal(file, 5000);
}

TEST(ReadImage, TurnsColourIntoRec601GreyAndSaysSo) {
  const fs::path folder = TestFolder();
  const cv::Mat colour = Speckle(CV_8UC3);
  cv::Mat grey;
  cv::cvtColor(colour, grey, cv::COLOR_BGR2GRAY);
  for (const char* ending : {"png", "tif", "bmp", "ppm"}) {
    const fs::path file = folder / (std::string("c.") + ending);
    cv::imwrite(file.string(), colour);
    bool was_colour = false;
    const GrayImage image = ReadImage(file, &was_colour);
    EXPECT_TRUE(was_colour) << ending;
    for (int r = 0; r < grey.rows; ++r) {
      for (int c = 0; c < grey.cols; ++c) {
        ASSERT_NEAR(image.grey(r, c), grey.at<unsigned char>(r, c), 1) << ending;
      }
    }
  }
}

TEST(ReadImage, KeepsTwelveBitsInSixteen) {
  const fs::path folder = TestFolder();
  const cv::Mat deep = Speckle(CV_16UC1);
  for (const char* ending : {"png", "tif", "pgm"}) {
    const fs::path file = folder / (std::string("deep.") + ending);
    cv::imwrite(file.string(), deep);
    const GrayImage image = ReadImage(file);
    EXPECT_EQ(image.bits, ending == std::string("pgm") ? 16 : 12) << ending;  // maxval 65535
    for (int r = 0; r < deep.rows; ++r) {
      for (int c = 0; c < deep.cols; ++c) ASSERT_EQ(image.grey(r, c), deep.at<ushort>(r, c));
    }
  }
}

TEST(ReadImage, BelievesTheBitsThatPngAndTiffState) {
  const fs::path folder = TestFolder();
  const auto made = testing::RunPython(R"py(
import sys, struct, zlib, numpy as np
folder = sys.argv[1]
a = np.arange(40 * 30, dtype='>u2').reshape(30, 40) % 900          # darker than its 12 bits
def chunk(name, data):
    return struct.pack('>I', len(data)) + name + data + struct.pack('>I', zlib.crc32(name + data))
raw = b''.join(b'\0' + row.astype('>u2').tobytes() for row in a)
open(folder + '/s.png', 'wb').write(b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', 40, 30, 16, 0, 0, 0, 0))
    + chunk(b'sBIT', bytes([12])) + chunk(b'IDAT', zlib.compress(raw)) + chunk(b'IEND', b''))
data = a.astype('<u2').tobytes()
tags = [(256, 3, 40), (257, 3, 30), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1),
        (278, 3, 30), (279, 4, len(data)), (281, 3, 4095)]
ifd = struct.pack('<H', len(tags)) + b''.join(struct.pack('<HHII', t, k, 1, v) for t, k, v in tags) + struct.pack('<I', 0)
open(folder + '/s.tif', 'wb').write(struct.pack('<2sHI', b'II', 42, 8 + len(data)) + data + ifd)
)py",
                                       folder.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  for (const char* name : {"s.png", "s.tif"}) {
    const GrayImage image = ReadImage(folder / name);
    EXPECT_EQ(image.bits, 12) << name;
    EXPECT_EQ(image.grey(29, 39), 1199 % 900) << name;
  }
}

TEST(ReadImage, RefusesABombFromItsHeaderAlone) {
  const fs::path folder = TestFolder();
  const auto made = testing::RunPython(R"py(
import sys, struct, zlib
def chunk(name, data):
    return struct.pack('>I', len(data)) + name + data + struct.pack('>I', zlib.crc32(name + data))
open(sys.argv[1] + '/bomb.png', 'wb').write(b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', 30000, 30000, 8, 2, 0, 0, 0))
    + chunk(b'IDAT', zlib.compress(bytes(10_000_000))) + chunk(b'IEND', b''))
)py",
                                       folder.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  EXPECT_NE(Refusal(folder / "bomb.png").find("30000 x 30000"), std::string::npos);
}

TEST(ReadImage, NamesWhatIsNoImage) {
  const fs::path folder = TestFolder();
  WriteBytes(folder / "a.png", "");
  WriteBytes(folder / "b.png", "hello, I am a text");
  EXPECT_NE(Refusal(folder / "a.png").find("empty"), std::string::npos);
  EXPECT_NE(Refusal(folder / "b.png").find("known format"), std::string::npos);
  EXPECT_NE(Refusal(folder / "none.png").find("cannot be opened"), std::string::npos);
  EXPECT_NE(Refusal(folder).find("folder"), std::string::npos);
}

// Every real photograph of the collection is whole, and equals what OpenCV reads.
TEST(ReadImage, ReadsTheRealPhotographs) {
  PLUMBLINE_SHARED_DATA(root, ".");
  int count = 0;
  for (const auto& entry : fs::recursive_directory_iterator(root)) {
    const std::string ending = entry.path().extension().string();
    if (ending != ".png" && ending != ".jpg" && ending != ".jpeg" && ending != ".tif" &&
        ending != ".tiff" && ending != ".bmp") {
      continue;
    }
    if (++count % 9 != 0) continue;
    bool colour = false;
    GrayImage image;
    ASSERT_NO_THROW(image = ReadImage(entry.path(), &colour)) << entry.path();
    const cv::Mat mat =
        cv::imread(entry.path().string(), cv::IMREAD_ANYDEPTH | cv::IMREAD_IGNORE_ORIENTATION);
    ASSERT_EQ(image.size(), (ImageSize{mat.cols, mat.rows})) << entry.path();
    double worst = 0;
    for (int r = 0; r < mat.rows; ++r) {
      for (int c = 0; c < mat.cols; ++c) {
        const double v = mat.depth() == CV_16U ? mat.at<ushort>(r, c) : mat.at<uchar>(r, c);
        worst = std::max(worst, std::abs(v - image.grey(r, c)));
      }
    }
    EXPECT_LE(worst, colour ? 1.5 : 0) << entry.path();
  }
  EXPECT_GT(count, 100);
}

}  // namespace
}  // namespace plumbline
