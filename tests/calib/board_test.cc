#include "calib/board.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "calib/error.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;

std::string RefusalOf(std::string_view word) {
  try {
    BoardSpec::Parse(word);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(BoardSpec, WordsRoundTrip) {
  for (const std::string word :
       {"chessboard:12x8:5mm", "acircles:4x11:20mm", "circles:14x10:7mm", "donut-dots:14x10:7mm",
        "charuco:5x7:36.2mm:18.3mm:DICT_6X6_250", "aprilgrid:6x6:88mm:0.3:tag36h11"}) {
    const BoardSpec spec = BoardSpec::Parse(word);
    EXPECT_EQ(spec.Word(), word);
    EXPECT_EQ(BoardSpec::Parse(spec.Word()), spec);
  }
}

TEST(BoardSpec, ReadsCentimetresAndMetres) {
  EXPECT_DOUBLE_EQ(BoardSpec::Parse("aprilgrid:6x6:8.8cm:0.3:tag36h11").pitch_mm, 88);
  EXPECT_DOUBLE_EQ(BoardSpec::Parse("chessboard:9x6:0.025m").pitch_mm, 25);
}

TEST(BoardSpec, RefusalsNameTheFaultAndShowARightWord) {
  const std::pair<std::string, std::string> cases[] = {
      {"checkers:9x6:5mm", "'checkers' is no kind of board"},
      {"chessboard:9x6", "2 fields"},
      {"chessboard:9by6:5mm", "'9by6' is not a size"},
      {"chessboard:9x6:5", "has no unit"},
      {"chessboard:9x6:5in", "the unit 'in'"},
      {"chessboard:9x6:-5mm", "not positive"},
      {"chessboard:9x6:nanmm", "not positive"},
      {"chessboard:2x6:5mm", "too small"},
      {"chessboard:9x60000:5mm", "more than 1000"},
      {"donut-dots:5x10:7mm", "too small"},
      {"charuco:5x7:18mm:36mm:DICT_6X6_250", "do not fit"},
      {"charuco:5x7:36mm:18mm:DICT_6X6_25", "is none of"},
      {"charuco:20x20:36mm:18mm:DICT_6X6_50", "needs 200 markers"},
      {"aprilgrid:6x6:88mm:zero:tag36h11", "'zero' is not a ratio"},
      {"aprilgrid:6x6:88mm:0.3:tag99", "is none of"},
      {"", "is no kind of board"},
  };
  for (const auto& [word, fault] : cases) {
    EXPECT_THAT(RefusalOf(word), HasSubstr(fault)) << word;
    EXPECT_THAT(RefusalOf(word), HasSubstr("a right word is")) << word;
  }
}

TEST(BoardSpec, PointsLieRowByRow) {
  const BoardSpec chessboard = BoardSpec::Parse("chessboard:12x8:5mm");
  EXPECT_EQ(chessboard.PointCount(), 96);
  EXPECT_EQ(chessboard.NominalPoint(0), Eigen::Vector3d(0, 0, 0));
  EXPECT_EQ(chessboard.NominalPoint(13), Eigen::Vector3d(5, 5, 0));
  const BoardSpec asymmetric = BoardSpec::Parse("acircles:4x11:20mm");
  EXPECT_EQ(asymmetric.NominalPoint(4), Eigen::Vector3d(20, 20, 0));
  EXPECT_EQ(asymmetric.NominalPoint(9), Eigen::Vector3d(40, 40, 0));
  const BoardSpec charuco = BoardSpec::Parse("charuco:5x7:10mm:5mm:DICT_6X6_250");
  EXPECT_EQ(charuco.PointCount(), 24);
  EXPECT_EQ(charuco.NominalPoint(5), Eigen::Vector3d(10, 10, 0));
  EXPECT_THROW((void)chessboard.NominalPoint(96), std::out_of_range);
}

TEST(BoardSpec, AprilGridCornersAreKalibrs) {
  const BoardSpec spec = BoardSpec::Parse("aprilgrid:6x6:88mm:0.3:tag36h11");
  EXPECT_EQ(spec.PointCount(), 144);
  const double height = 5 * 88 * 1.3 + 88;
  // Tag 0 at the bottom left; corners bottom left, bottom right, top right, top left.
  EXPECT_TRUE(spec.NominalPoint(0).isApprox(Eigen::Vector3d(0, height, 0)));
  EXPECT_TRUE(spec.NominalPoint(1).isApprox(Eigen::Vector3d(88, height, 0)));
  EXPECT_TRUE(spec.NominalPoint(2).isApprox(Eigen::Vector3d(88, height - 88, 0)));
  EXPECT_TRUE(spec.NominalPoint(3).isApprox(Eigen::Vector3d(0, height - 88, 0)));
  // Tag 7 is the second of the second row from below.
  EXPECT_TRUE(spec.NominalPoint(28).isApprox(Eigen::Vector3d(114.4, height - 114.4, 0)));
}

TEST(BoardSpec, DonutMarkersAreWhereDiceHasThem) {
  const BoardSpec spec = BoardSpec::Parse("donut-dots:14x10:7mm");
  const DonutMarkers markers = MarkersOf(spec);
  const Eigen::Vector3d origin = spec.NominalPoint(markers.origin);
  // Origin (2, 2) counted from the bottom left; the tenth dot along x and the sixth along y.
  EXPECT_EQ(origin, Eigen::Vector3d(2 * 7, (9 - 2) * 7, 0));
  EXPECT_EQ(spec.NominalPoint(markers.along_x) - origin, Eigen::Vector3d(9 * 7, 0, 0));
  EXPECT_EQ(spec.NominalPoint(markers.along_y) - origin, Eigen::Vector3d(0, -5 * 7, 0));
  EXPECT_THROW(MarkersOf(BoardSpec::Parse("circles:14x10:7mm")), std::invalid_argument);
}

TEST(BoardSpec, KnowsWhichBoardsLookTheSameWhenTurned) {
  EXPECT_EQ(BoardSpec::Parse("chessboard:9x6:5mm").SymmetryOrder(), 1);
  EXPECT_EQ(BoardSpec::Parse("chessboard:12x8:5mm").SymmetryOrder(), 2);
  EXPECT_EQ(BoardSpec::Parse("chessboard:7x7:5mm").SymmetryOrder(), 2);
  EXPECT_EQ(BoardSpec::Parse("chessboard:8x8:5mm").SymmetryOrder(), 4);
  EXPECT_EQ(BoardSpec::Parse("circles:5x6:5mm").SymmetryOrder(), 2);
  EXPECT_EQ(BoardSpec::Parse("circles:5x5:5mm").SymmetryOrder(), 4);
  EXPECT_EQ(BoardSpec::Parse("acircles:4x11:5mm").SymmetryOrder(), 1);
  EXPECT_EQ(BoardSpec::Parse("acircles:4x10:5mm").SymmetryOrder(), 2);
  EXPECT_EQ(BoardSpec::Parse("donut-dots:14x10:7mm").SymmetryOrder(), 1);
}

TEST(BoardSpec, HalfTurnMapsTheBoardOntoItself) {
  for (const char* word : {"chessboard:12x8:5mm", "circles:5x6:5mm", "acircles:4x10:5mm"}) {
    const BoardSpec spec = BoardSpec::Parse(word);
    const Eigen::Vector3d sum = spec.NominalPoint(0) + spec.NominalPoint(spec.PointCount() - 1);
    for (int id = 0; id < spec.PointCount(); ++id) {
      const Eigen::Vector3d turned = sum - spec.NominalPoint(id);
      EXPECT_EQ(spec.NominalPoint(*spec.HalfTurnId(id)), turned) << word << " " << id;
    }
  }
  EXPECT_FALSE(BoardSpec::Parse("donut-dots:14x10:7mm").HalfTurnId(3));
}

}  // namespace
}  // namespace plumbline
