#include "io/virtual_rig/board_albedo.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "tests/support/real_photos.h"
#include "tests/support/synthetic_board.h"

namespace plumbline {
namespace {

using testing::SyntheticPhoto;

float At(const Albedo& albedo, const Eigen::Vector2d& p) {
  float value = -1;
  albedo.Evaluate({&p, 1}, {&value, 1});
  return value;
}

// The whole sheet, turned and tilted, as large as fits.
SyntheticPhoto Photo(const BoardSpec& spec, const BoardPrint& print, double roll_deg,
                     double tilt_deg) {
  SyntheticPhoto photo;
  const std::shared_ptr<const Albedo> albedo = MakeBoardAlbedo(spec, print);
  photo.albedo = [albedo](const Eigen::Vector2d& p) { return At(*albedo, p); };
  photo.dark = 0;
  photo.bright = 220;
  photo.shading = {0.0004, -0.0003};
  const BoardRectangle sheet = BoardOutline(spec, print);
  const Eigen::Vector2d size = sheet[2] - sheet[0];
  const double angle = roll_deg * std::numbers::pi / 180;
  const double c = std::abs(std::cos(angle)), s = std::abs(std::sin(angle));
  const double px_per_mm =
      std::min(600 / (c * size.x() + s * size.y()), 450 / (s * size.x() + c * size.y()));
  photo.image_from_board = testing::BoardHomography((sheet[0] + sheet[2]) / 2, px_per_mm, roll_deg,
                                                    tilt_deg, -0.6 * tilt_deg, {320.3, 239.6});
  return photo;
}

// Every point found, each with its id, as near to the truth as asked.
void ExpectAllFound(const BoardSpec& spec, const BoardPrint& print, double roll_deg,
                    double limit_px) {
  const SyntheticPhoto photo = Photo(spec, print, roll_deg, 18);
  const BoardDetection detection = DetectBoard(spec, photo.Render());
  ASSERT_EQ(static_cast<int>(detection.ids.size()), spec.PointCount())
      << spec.Word() << " at " << roll_deg << ": " << detection.problem;
  double worst = 0;
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    const Eigen::Vector2d nominal = spec.NominalPoint(detection.ids[k]).head<2>();
    const Eigen::Vector2d truth =
        spec.HasDiscs() ? testing::DiscCentroid(photo, nominal,
                                                PrintedDiscRadius(spec, print, detection.ids[k]))
                        : photo.Map(nominal);
    worst = std::max(worst, (detection.pixels[k] - truth).norm());
  }
  EXPECT_LT(worst, limit_px) << spec.Word() << " at " << roll_deg;
  if (spec.HasDiscs()) {
    const double radius = PrintedDiscRadius(spec, print, 0);
    EXPECT_NEAR(detection.disc_radius_mm, radius, 0.01 * radius) << spec.Word();
  }
}

TEST(BoardAlbedo, EveryKindOfBoardIsDetectedWholeAndInItsPlace) {
  for (const char* word :
       {"chessboard:9x6:10mm", "acircles:4x11:8mm", "donut-dots:14x10:7mm",
        "charuco:7x5:20mm:14mm:DICT_5X5_100", "charuco:5x7:20mm:14mm:DICT_6X6_250",
        "charuco:6x5:20mm:15mm:DICT_APRILTAG_36h11", "aprilgrid:3x2:20mm:0.3:tag36h11",
        "aprilgrid:2x3:20mm:0.3:tag25h9"}) {
    for (const double roll : {-12.0, 160.0}) ExpectAllFound(BoardSpec::Parse(word), {}, roll, 0.01);
  }
  for (const double roll : {-25.0, 8.0}) {
    ExpectAllFound(BoardSpec::Parse("circles:9x7:10mm"), {}, roll, 0.01);
  }
}

TEST(BoardAlbedo, WhiteDiscsOnBlackAreDetectedToo) {
  BoardPrint print;
  print.white_on_black = true;
  for (const char* word : {"donut-dots:14x10:7mm", "circles:9x7:10mm", "acircles:4x11:8mm"}) {
    ExpectAllFound(BoardSpec::Parse(word), print, 5, 0.01);
  }
}

TEST(BoardAlbedo, BigCornerDiscTellsWhichWayRound) {
  BoardPrint print;
  print.big_corner_disc = true;
  print.disc_share = 0.24;
  const BoardSpec spec = BoardSpec::Parse("circles:9x7:10mm");
  EXPECT_DOUBLE_EQ(PrintedDiscRadius(spec, print, 54), 1.8 * 2.4);
  EXPECT_DOUBLE_EQ(PrintedDiscRadius(spec, print, 0), 2.4);
  for (const double roll : {4.0, 100.0, 184.0}) ExpectAllFound(spec, print, roll, 0.01);
}

// A picture of 1 px = 1 mm, compared away from the edges.
void ExpectOpenCvsPicture(const char* word, int columns, int rows, double square_mm,
                          double marker_mm, int dictionary_number) {
  const auto dictionary = cv::aruco::getPredefinedDictionary(dictionary_number);
  const auto board = cv::aruco::CharucoBoard::create(columns, rows, static_cast<float>(square_mm),
                                                     static_cast<float>(marker_mm), dictionary);
  cv::Mat drawn;
  const int scale = 10;
  board->draw(
      {columns * static_cast<int>(square_mm) * scale, rows * static_cast<int>(square_mm) * scale},
      drawn, 0, 1);
  const auto albedo = MakeBoardAlbedo(BoardSpec::Parse(word), {});
  int compared = 0, unlike = 0;
  for (int y = 3; y < drawn.rows - 3; ++y) {
    for (int x = 3; x < drawn.cols - 3; ++x) {
      double low = 0, high = 0;
      cv::minMaxLoc(drawn(cv::Rect(x - 2, y - 2, 5, 5)), &low, &high);
      if (low != high) continue;  // an edge, within the drawing's rounding
      const Eigen::Vector2d p((x + 0.5) / scale - square_mm, (y + 0.5) / scale - square_mm);
      unlike += std::abs(At(*albedo, p) - (low > 127 ? 0.9F : 0.05F)) > 1e-6F;
      ++compared;
    }
  }
  EXPECT_EQ(unlike, 0) << word;
  EXPECT_GT(compared, drawn.rows * drawn.cols / 2);
}

TEST(BoardAlbedo, CharucoIsThePictureThatOpenCvDraws) {
  ExpectOpenCvsPicture("charuco:7x5:20mm:14mm:DICT_5X5_100", 7, 5, 20, 14, cv::aruco::DICT_5X5_100);
  ExpectOpenCvsPicture("charuco:5x6:20mm:16mm:DICT_6X6_250", 5, 6, 20, 16, cv::aruco::DICT_6X6_250);
}

TEST(BoardAlbedo, AprilGridHasKalibrsBorderAndBlackSquares) {
  const auto albedo = MakeBoardAlbedo(BoardSpec::Parse("aprilgrid:3x2:20mm:0.3:tag36h11"), {});
  // Modules of 2 mm: two black rings, then bits of both colours.
  int white = 0;
  for (int row = 0; row < 10; ++row) {
    for (int column = 0; column < 10; ++column) {
      const bool bit = At(*albedo, {2 * column + 1, 2 * row + 1}) > 0.5F;
      const bool border = column < 2 || row < 2 || column > 7 || row > 7;
      EXPECT_FALSE(border && bit) << column << ' ' << row;
      white += bit;
    }
  }
  EXPECT_GT(white, 8);
  EXPECT_LT(white, 28);
  // Squares at all corners of all tags, the outer ones too; white beside the tags.
  for (const double x : {-3.0, 23.0, 49.0, 75.0}) {
    for (const double y : {-3.0, 23.0, 49.0}) EXPECT_FLOAT_EQ(At(*albedo, {x, y}), 0.05F);
    EXPECT_FLOAT_EQ(At(*albedo, {x, 10}), 0.9F);
  }
  EXPECT_FLOAT_EQ(At(*albedo, {10, -3}), 0.9F);
  EXPECT_FLOAT_EQ(At(*albedo, {-7, -3}), 0.9F);
}

// The bits, their order and the way up, against a photograph of a board that Kalibr printed.
TEST(BoardAlbedo, AprilGridIsTheBoardOfARealPhotograph) {
  PLUMBLINE_SHARED_DATA(folder, "aprilgrid-euroc-tumvi");
  const BoardSpec spec = BoardSpec::Parse("aprilgrid:6x6:88mm:0.3:tag36h11");
  const auto albedo = MakeBoardAlbedo(spec, {});
  const GrayImage photo = testing::ReadPhoto(folder / "images" / "EuRoC.png");
  const BoardDetection detection = DetectBoard(spec, photo);
  std::map<int, std::vector<std::pair<cv::Point2f, cv::Point2f>>> tags;  // board, image
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    const Eigen::Vector2f p = spec.NominalPoint(detection.ids[k]).head<2>().cast<float>();
    const Eigen::Vector2f q = detection.pixels[k].cast<float>();
    tags[detection.ids[k] / 4].push_back({{p.x(), p.y()}, {q.x(), q.y()}});
  }
  int modules = 0, alike = 0;
  for (const auto& [tag, corners] : tags) {
    if (corners.size() != 4) continue;
    std::vector<cv::Point2f> board, image;
    for (const auto& [p, q] : corners) {
      board.push_back(p);
      image.push_back(q);
    }
    const cv::Mat H = cv::getPerspectiveTransform(board, image);
    const Eigen::Vector2d top_left = spec.NominalPoint(4 * tag + 3).head<2>();
    std::vector<double> grey;
    std::vector<bool> white;
    for (int i = 0; i < 100; ++i) {
      const Eigen::Vector2d p = top_left + 8.8 * Eigen::Vector2d(i % 10 + 0.5, i / 10 + 0.5);
      std::vector<cv::Point2f> q;
      cv::perspectiveTransform(
          std::vector<cv::Point2f>{{static_cast<float>(p.x()), static_cast<float>(p.y())}}, q, H);
      grey.push_back(photo.grey(cvRound(q[0].y), cvRound(q[0].x)));
      white.push_back(At(*albedo, p) > 0.5F);
    }
    const auto [low, high] = std::minmax_element(grey.begin(), grey.end());
    for (std::size_t i = 0; i < 100; ++i) alike += (grey[i] > (*low + *high) / 2) == white[i];
    modules += 100;
  }
  EXPECT_GE(modules, 3000);
  EXPECT_GT(alike, 0.98 * modules);
}

// Places of a row are given the shade of the patch that they stand on together: no place may tell.
TEST(BoardAlbedo, OfARowIsThatOfEachOfItsPlacesAlone) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> share(0, 1);
  for (const char* word :
       {"chessboard:9x6:10mm", "acircles:4x11:8mm", "circles:9x7:10mm", "donut-dots:14x10:7mm",
        "charuco:5x7:20mm:14mm:DICT_6X6_250", "aprilgrid:3x2:20mm:0.3:tag36h11"}) {
    const BoardSpec spec = BoardSpec::Parse(word);
    BoardPrint print;
    print.big_corner_disc = spec.kind == BoardSpec::Kind::kCircles;
    if (print.big_corner_disc) print.disc_share = 0.24;
    const auto albedo = MakeBoardAlbedo(spec, print);
    const BoardRectangle sheet = BoardOutline(spec, print);
    const auto anywhere = [&]() -> Eigen::Vector2d {
      return sheet[0] + (sheet[2] - sheet[0])
                            .cwiseProduct(Eigen::Vector2d(share(random), share(random)) * 1.1 -
                                          Eigen::Vector2d::Constant(0.05));
    };
    int unlike = 0;
    for (int line = 0; line < 60; ++line) {
      const Eigen::Vector2d from = anywhere(), to = anywhere();
      const int count = 200 << line % 4;  // from nearly a pixel apart to a fraction of it
      std::vector<Eigen::Vector2d> row;
      for (int k = 0; k < count; ++k) row.push_back(from + (to - from) * k / count);
      row[static_cast<std::size_t>(count / 2)].x() = std::numeric_limits<double>::quiet_NaN();
      std::vector<float> values(row.size());
      albedo->Evaluate(row, values);
      for (std::size_t k = 0; k < row.size(); ++k) unlike += values[k] != At(*albedo, row[k]);
    }
    EXPECT_EQ(unlike, 0) << word;
  }
}

TEST(BoardAlbedo, EdgesAreSmoothAndOfTheWidthAsked) {
  BoardPrint print;
  print.edge_mm = 0.4;
  for (const char* word :
       {"chessboard:9x6:10mm", "acircles:4x11:8mm", "circles:9x7:10mm", "donut-dots:14x10:7mm",
        "charuco:5x7:20mm:14mm:DICT_6X6_250", "aprilgrid:3x2:20mm:0.3:tag36h11"}) {
    const BoardSpec spec = BoardSpec::Parse(word);
    const auto albedo = MakeBoardAlbedo(spec, print);
    const BoardRectangle sheet = BoardOutline(spec, print);
    // Along lines across everything that is printed; the ramp's steepest slope is 1.5 / width, and
    // its slope changes by at most 6 / width^2.
    std::vector<Eigen::Vector2d> line;
    const double step = 0.004;
    for (const double share : {0.31, 0.503, 0.77}) {
      line.clear();
      const Eigen::Vector2d from = sheet[0] - Eigen::Vector2d(2, 2);
      const double width = sheet[2].x() - sheet[0].x() + 4, height = sheet[2].y() - sheet[0].y();
      const double y = sheet[0].y() + share * height;
      for (double x = 0; x < width; x += step) line.push_back({from.x() + x, y});
      std::vector<float> values(line.size());
      albedo->Evaluate(line, values);
      float low = 1, high = 0;
      for (std::size_t i = 2; i < values.size(); ++i) {
        const double first = (values[i] - values[i - 1]) / step;
        const double second = first - (values[i - 1] - values[i - 2]) / step;
        // Where two edges cross, one multiplies the other.
        ASSERT_LT(std::abs(first), 1.5 / 0.4 * 0.85 * 1.3) << word << line[i].transpose();
        ASSERT_LT(std::abs(second), 0.85 * 3 * 6 / 0.16 * step) << word << line[i].transpose();
        low = std::min(low, values[i]);
        high = std::max(high, values[i]);
      }
      EXPECT_FLOAT_EQ(high, 0.9F) << word;
      EXPECT_GE(low, 0.05F - 1e-6F) << word;
      EXPECT_FLOAT_EQ(values.front(), 0.3F);
      EXPECT_FLOAT_EQ(values.back(), 0.3F);
    }
  }
  // Half way at the edge itself; over at half the width.
  const auto chess = MakeBoardAlbedo(BoardSpec::Parse("chessboard:9x6:10mm"), print);
  EXPECT_NEAR(At(*chess, {10, 5}), (0.9 + 0.05) / 2, 1e-6);
  EXPECT_FLOAT_EQ(At(*chess, {9.79, 5}), 0.05F);
  EXPECT_FLOAT_EQ(At(*chess, {10.21, 5}), 0.9F);
  EXPECT_LT(At(*chess, {9.95, 5}), At(*chess, {10.05, 5}) - 0.1F);
}

TEST(BoardAlbedo, SheetHasItsMarginAndEndsInTheBackground) {
  const BoardSpec spec = BoardSpec::Parse("chessboard:9x6:10mm");
  BoardPrint print;
  const BoardRectangle pattern = PatternOutline(spec, print), sheet = BoardOutline(spec, print);
  EXPECT_EQ(pattern[0], Eigen::Vector2d(-10, -10));
  EXPECT_EQ(pattern[2], Eigen::Vector2d(90, 60));
  EXPECT_EQ(sheet[0], Eigen::Vector2d(-20, -20));
  EXPECT_EQ(sheet[1], Eigen::Vector2d(100, -20));
  EXPECT_EQ(sheet[2], Eigen::Vector2d(100, 70));
  EXPECT_EQ(sheet[3], Eigen::Vector2d(-20, 70));
  print.margin_mm = 4;
  EXPECT_EQ(BoardOutline(spec, print)[3], Eigen::Vector2d(-14, 64));
  const auto albedo = MakeBoardAlbedo(spec, print);
  EXPECT_FLOAT_EQ(At(*albedo, {-13.9, 5}), 0.9F);
  EXPECT_FLOAT_EQ(At(*albedo, {-14.1, 5}), 0.3F);
  EXPECT_FLOAT_EQ(At(*albedo, {40, 64.1}), 0.3F);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FLOAT_EQ(At(*albedo, {nan, 5}), 0.3F);
  EXPECT_FLOAT_EQ(At(*albedo, {5, nan}), 0.3F);
  EXPECT_FLOAT_EQ(At(*albedo, {1e300, -1e300}), 0.3F);
  // Discs: from their rims.
  const BoardSpec discs = BoardSpec::Parse("acircles:4x11:8mm");
  EXPECT_LT((BoardOutline(discs, {})[2] - Eigen::Vector2d(56, 80) -
             Eigen::Vector2d::Constant(8 * (1 + 0.27 * std::numbers::sqrt2)))
                .norm(),
            1e-9);
}

TEST(BoardAlbedo, RefusesWhatCannotBePrinted) {
  const auto refused = [](const char* word, const std::function<void(BoardPrint&)>& change) {
    BoardPrint print;
    change(print);
    EXPECT_THROW(MakeBoardAlbedo(BoardSpec::Parse(word), print), UsageError) << word;
  };
  const char *chess = "chessboard:9x6:10mm", *circles = "circles:9x7:10mm",
             *donuts = "donut-dots:14x10:7mm";
  refused(chess, [](BoardPrint& p) { p.black = 0.95; });
  refused(chess, [](BoardPrint& p) { p.background = -0.1; });
  refused(chess, [](BoardPrint& p) { p.edge_mm = 0; });
  refused(chess, [](BoardPrint& p) { p.edge_mm = 11; });
  refused(chess, [](BoardPrint& p) { p.margin_mm = -1; });
  refused(chess, [](BoardPrint& p) { p.white_on_black = true; });
  refused(donuts, [](BoardPrint& p) { p.big_corner_disc = true; });
  refused(donuts, [](BoardPrint& p) { p.hole_share = 1; });
  refused(circles, [](BoardPrint& p) { p.disc_share = 0.5; });
  refused(circles, [](BoardPrint& p) {
    p.disc_share = 0.3;
    p.big_corner_disc = true;
  });
  refused("charuco:7x5:20mm:14mm:DICT_5X5_100", [](BoardPrint& p) { p.edge_mm = 2.5; });
}

}  // namespace
}  // namespace plumbline
