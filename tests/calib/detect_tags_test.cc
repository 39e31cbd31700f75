#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/board.h"
#include "calib/internal/find_tags.h"
#include "tests/support/real_photos.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;

// RMS distance (2-D, px) of the detected points from the board's layout under the homography that
// fits best: small only when every point has the right id.
double LayoutRms(const BoardSpec& spec, const BoardDetection& detection) {
  std::vector<cv::Point2f> board, image, mapped;
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    const Eigen::Vector3d p = spec.NominalPoint(detection.ids[k]);
    board.push_back({static_cast<float>(p.x()), static_cast<float>(p.y())});
    image.push_back(
        {static_cast<float>(detection.pixels[k].x()), static_cast<float>(detection.pixels[k].y())});
  }
  const cv::Mat H = cv::findHomography(board, image);
  cv::perspectiveTransform(board, mapped, H);
  // Not mirrored: the board is seen from its front.
  EXPECT_GT(cv::determinant(H(cv::Rect(0, 0, 2, 2))), 0);
  double sum = 0;
  for (std::size_t k = 0; k < mapped.size(); ++k)
    sum += std::pow(cv::norm(mapped[k] - image[k]), 2);
  return std::sqrt(sum / static_cast<double>(mapped.size()));
}

TEST(DetectAprilGrid, FindsRealBoardsWithEveryTagInItsPlace) {
  PLUMBLINE_SHARED_DATA(folder, "aprilgrid-euroc-tumvi");
  const BoardSpec spec = BoardSpec::Parse("aprilgrid:6x6:88mm:0.3:tag36h11");
  // Lens distortion is in these figures, strong in the two fisheye pictures; a wrong id would add
  // tens of pixels.
  const std::pair<const char*, double> cases[] = {
      {"images/EuRoC.png", 3},
      {"images/TUM_VI.png", 4},
      {"images/r45.png", 6},
      {"images/two_boards.png", 1},
      {"euroc_stereo_pair/cam0_1403709395937837056.png", 2},
      {"euroc_stereo_pair/cam1_1403709395937837056.png", 2}};
  for (const auto& [name, limit_px] : cases) {
    const auto detection = DetectBoard(spec, testing::ReadPhoto(folder / name));
    EXPECT_GE(detection.ids.size(), 140U) << name << detection.problem;
    EXPECT_LT(LayoutRms(spec, detection), limit_px) << name;
  }
}

// The published lists belong to frames that are not here; what can be compared is the numbering of
// tags and corners, and where they put them on the board.
TEST(DetectAprilGrid, NumbersPointsAsThePublishedListsDo) {
  PLUMBLINE_SHARED_DATA(folder, "aprilgrid-euroc-tumvi");
  const BoardSpec spec = BoardSpec::Parse("aprilgrid:6x6:88mm:0.3:tag36h11");
  const double height = 6 * 1.3 * 88 - 0.3 * 88;
  int lists = 0;
  for (const auto& file :
       testing::PhotosIn(folder / "euroc_cam_april_detections" / "cam0", ".csv")) {
    std::ifstream in(file);
    std::string line;
    BoardDetection published;
    while (std::getline(in, line)) {
      double x, y, px, py;
      int tag, corner;
      if (std::sscanf(line.c_str(), "%*[^,],%*d,%*d,%*f,%*f,%lf,%lf,%lf,%lf,%*f,%d,%d", &x, &y, &px,
                      &py, &tag, &corner) != 6) {
        continue;
      }
      published.ids.push_back(4 * tag + corner);
      published.pixels.push_back({x, y});
      const Eigen::Vector3d nominal = spec.NominalPoint(4 * tag + corner);
      EXPECT_NEAR(nominal.x(), 1000 * px, 1e-6);
      EXPECT_NEAR(height - nominal.y(), 1000 * py, 1e-6);
    }
    if (published.ids.size() < 8) continue;
    EXPECT_LT(LayoutRms(spec, published), 5) << file;
    ++lists;
  }
  EXPECT_GE(lists, 25);
}

TEST(DetectAprilGrid, SaysWhatIsWrong) {
  PLUMBLINE_SHARED_DATA(folder, "aprilgrid-euroc-tumvi");
  const GrayImage photo = testing::ReadPhoto(folder / "images" / "EuRoC.png");
  EXPECT_THAT(DetectBoard(BoardSpec::Parse("aprilgrid:5x7:88mm:0.3:tag36h11"), photo).problem,
              HasSubstr("check columns, rows and spacing"));
  const GrayImage grey{Image<std::uint16_t>({320, 240}, 128), 8};
  EXPECT_THAT(DetectBoard(BoardSpec::Parse("aprilgrid:6x6:88mm:0.3:tag36h11"), grey).problem,
              HasSubstr("no tag36h11 tag found"));
}

TEST(FindTags, AgreesWithThePublishedIdsAndCorners) {
  PLUMBLINE_SHARED_DATA(folder, "apriltag-outdoor-photos");
  for (const auto& file : testing::PhotosIn(folder, ".jpg")) {
    auto list = file;
    std::ifstream in(list.replace_extension(".txt"));
    const auto tags =
        internal::FindTags(cv::imread(file.string(), cv::IMREAD_GRAYSCALE), "tag36h11");
    std::string line;
    std::size_t expected = 0, matched = 0;
    while (std::getline(in, line)) {
      int id;
      double c[8];
      if (std::sscanf(line.c_str(), "%d, (%lf %lf), (%lf %lf), (%lf %lf), (%lf %lf)", &id, &c[0],
                      &c[1], &c[2], &c[3], &c[4], &c[5], &c[6], &c[7]) != 9) {
        continue;
      }
      ++expected;
      for (const internal::Tag& tag : tags) {
        double worst = 0;
        for (std::size_t k = 0; k < 4; ++k) {
          // The list has the library's own convention, half a pixel further.
          const Eigen::Vector2d p(c[2 * k] - 0.5, c[2 * k + 1] - 0.5);
          worst = std::max(worst, (tag.corners[k] - p).norm());
        }
        matched += tag.id == id && worst < 1.0;
      }
    }
    EXPECT_GT(expected, 5U);
    EXPECT_GE(10 * matched, 9 * expected) << file << ": " << matched << " of " << expected;
  }
}

TEST(DetectCharuco, FindsAllRealPhotographs) {
  PLUMBLINE_SHARED_DATA(folder, "cal-circlegrid-and-charuco-robot-poses");
  const BoardSpec spec = BoardSpec::Parse("charuco:5x7:36.195mm:18.256mm:DICT_6X6_250");
  int found = 0;
  for (const auto& file : testing::PhotosIn(folder / "charuco_7x5" / "images_gray", ".png")) {
    const auto detection = DetectBoard(spec, testing::ReadPhoto(file));
    if (detection.ids.size() < 12) continue;
    ++found;
    EXPECT_LT(LayoutRms(spec, detection), 2) << file;
  }
  EXPECT_EQ(found, 11);
}

// OpenCV draws the board; corners are at half-integer places of its picture by construction.
GrayImage DrawnCharuco(int columns, int rows, int square_px) {
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_5X5_100);
  const auto board = cv::aruco::CharucoBoard::create(columns, rows, 1.0F, 0.7F, dictionary);
  cv::Mat image;
  board->draw({columns * square_px, rows * square_px}, image, 0, 1);
  cv::copyMakeBorder(image, image, 40, 40, 40, 40, cv::BORDER_CONSTANT, 255);
  cv::GaussianBlur(image, image, {0, 0}, 0.8);
  return internal::FromMat(image);
}

TEST(DetectCharuco, FindsCornersWhereOpenCvDrewThem) {
  const BoardSpec spec = BoardSpec::Parse("charuco:7x5:20mm:14mm:DICT_5X5_100");
  const auto detection = DetectBoard(spec, DrawnCharuco(7, 5, 60));
  ASSERT_EQ(detection.ids.size(), 24U) << detection.problem;
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    const Eigen::Vector2d nominal = spec.NominalPoint(detection.ids[k]).head<2>() / 20 * 60;
    const Eigen::Vector2d truth = nominal + Eigen::Vector2d(99.5, 99.5);
    EXPECT_LT((detection.pixels[k] - truth).norm(), 0.02) << detection.ids[k];
  }
}

TEST(DetectCharuco, PartOfTheBoardIsEnough) {
  const BoardSpec spec = BoardSpec::Parse("charuco:7x5:20mm:14mm:DICT_5X5_100");
  const GrayImage whole = DrawnCharuco(7, 5, 60);
  const cv::Mat part = internal::ToMat16(whole)(cv::Rect(0, 0, 320, whole.height())).clone();
  const auto detection = DetectBoard(spec, internal::FromMat(part, 8));
  EXPECT_GE(detection.ids.size(), 12U) << detection.problem;
  EXPECT_LT(detection.ids.size(), 24U);
}

TEST(DetectCharuco, SaysThatMarkersAreMissing) {
  const GrayImage grey{Image<std::uint16_t>({320, 240}, 128), 8};
  EXPECT_THAT(DetectBoard(BoardSpec::Parse("charuco:7x5:20mm:14mm:DICT_5X5_100"), grey).problem,
              HasSubstr("0 of 17 markers"));
}

}  // namespace
}  // namespace plumbline
