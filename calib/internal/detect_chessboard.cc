#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "calib/internal/detect_families.h"
#include "calib/internal/opencv_image.h"
#include "calib/internal/point_grid.h"
#include "calib/internal/saddle_fit.h"

namespace plumbline::internal {
namespace {

// Corners row by row, `columns` in a row, rows clockwise from columns in the image.
struct CornerGrid {
  int columns = 0, rows = 0;
  std::vector<Eigen::Vector2d> pixels;

  const Eigen::Vector2d& at(int c, int r) const {
    return pixels[static_cast<std::size_t>(r * columns + c)];
  }
  // The step along a row (dc = 1) or down a column at a corner, by central differences where
  // possible.
  Eigen::Vector2d Step(int c, int r, int dc, int dr) const {
    const int c0 = std::max(c - dc, 0), c1 = std::min(c + dc, columns - 1);
    const int r0 = std::max(r - dr, 0), r1 = std::min(r + dr, rows - 1);
    return (at(c1, r1) - at(c0, r0)) / (c1 - c0 + r1 - r0);
  }
};

CornerGrid ToGrid(const std::vector<cv::Point2f>& corners, int columns, int rows) {
  CornerGrid grid{columns, rows, {}};
  for (const cv::Point2f& p : corners) grid.pixels.push_back({p.x, p.y});
  const Eigen::Vector2d along = grid.at(columns - 1, 0) - grid.at(0, 0);
  const Eigen::Vector2d down = grid.at(0, rows - 1) - grid.at(0, 0);
  if (along.x() * down.y() - along.y() * down.x() < 0) {
    for (int r = 0; r < rows; ++r) {
      const auto row = grid.pixels.begin() + r * columns;
      std::reverse(row, row + columns);
    }
  }
  return grid;
}

// Both of OpenCV's finders: the sector-based one first, then the classic one, which copes better
// with small pictures.
std::optional<CornerGrid> Find(const cv::Mat& image, int columns, int rows) {
  std::vector<cv::Point2f> corners;
  const cv::Size size(columns, rows);
  if (cv::findChessboardCornersSB(image, size, corners, cv::CALIB_CB_NORMALIZE_IMAGE)) {
    return ToGrid(corners, columns, rows);
  }
  if (cv::findChessboardCorners(
          image, size, corners,
          cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_FAST_CHECK)) {
    return ToGrid(corners, columns, rows);
  }
  if (cv::findChessboardCornersSB(image, size, corners,
                                  cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_EXHAUSTIVE)) {
    return ToGrid(corners, columns, rows);
  }
  return std::nullopt;
}

// What else is there: the largest chessboard in view.
std::string WhyNone(const BoardSpec& spec, const cv::Mat& image) {
  std::vector<cv::Point2f> corners;
  cv::Mat meta;
  const bool found = cv::findChessboardCornersSB(
      image, cv::Size(3, 3), corners, cv::CALIB_CB_LARGER | cv::CALIB_CB_NORMALIZE_IMAGE, meta);
  if (!found || meta.empty()) {
    return fmt::format(
        "no chessboard found; is all of the {}x{} board in view, sharp, lit evenly and with a "
        "white "
        "margin?",
        spec.columns, spec.rows);
  }
  int a = std::max(meta.cols, meta.rows), b = std::min(meta.cols, meta.rows);
  if (spec.columns < spec.rows) std::swap(a, b);
  std::string text = fmt::format("found a chessboard of {}x{} inner corners where {}x{} was asked",
                                 a, b, spec.columns, spec.rows);
  const float margin = 1.5F * static_cast<float>(cv::norm(corners[1] - corners[0]));
  const bool edge = std::any_of(corners.begin(), corners.end(), [&](const cv::Point2f& p) {
    return p.x < margin || p.y < margin || p.x > static_cast<float>(image.cols) - 1 - margin ||
           p.y > static_cast<float>(image.rows) - 1 - margin;
  });
  return text +
         (edge && a * b < spec.columns * spec.rows
              ? "; the board is cut off by the image's edge"
              : "; check the board word (inner corners, not squares), and that nothing covers "
                "the board");
}

std::vector<std::optional<SaddleFit>> Refine(const GrayImage& image, const CornerGrid& grid) {
  std::vector<std::optional<SaddleFit>> fits;
  for (int r = 0; r < grid.rows; ++r) {
    for (int c = 0; c < grid.columns; ++c) {
      const Eigen::Vector2d along = grid.Step(c, r, 1, 0), down = grid.Step(c, r, 0, 1);
      // Not beyond the lines through the neighbouring corners.
      const double area = std::abs(along.x() * down.y() - along.y() * down.x());
      const double clear = area / std::max(along.norm(), down.norm());
      const double radius = std::clamp(0.45 * clear, 3.0, 20.0);
      fits.push_back(FitSaddle(image, grid.at(c, r), along, down, radius));
    }
  }
  return fits;
}

// Whether the square between points 0, 1, columns and columns + 1 is black, by the vote of all
// corners.
bool FirstSquareIsDark(const CornerGrid& grid, const std::vector<std::optional<SaddleFit>>& fits) {
  int vote = 0;
  for (std::size_t i = 0; i < fits.size(); ++i) {
    if (!fits[i]) continue;
    const int k = static_cast<int>(i);
    const bool even = (k % grid.columns + k / grid.columns) % 2 == 0;
    vote += fits[i]->dark_between == even ? 1 : -1;
  }
  return vote > 0;
}

// The corner of the grid that is board point (c, r) when the board is turned by quarters.
int TurnedIndex(const CornerGrid& grid, int turns, int c, int r) {
  const int n = grid.columns, m = grid.rows;
  switch (turns) {
    case 1:
      return c * n + (n - 1 - r);
    case 2:
      return (m - 1 - r) * n + (n - 1 - c);
    case 3:
      return (m - 1 - c) * n + r;
    default:
      return r * n + c;
  }
}

// The turn that makes the first square black and the rows lie along the image's, or -1.
int ChooseTurn(const BoardSpec& spec, const CornerGrid& grid, bool first_dark) {
  std::vector<int> turns;
  std::vector<double> angles;
  for (int turn = 0; turn < 4; ++turn) {
    if (turn % 2 == 1 && spec.columns != spec.rows) continue;
    // Squares between corners: a turn moves the first one to another corner of the board.
    const int first = TurnedIndex(grid, turn, 0, 0), next = TurnedIndex(grid, turn, 1, 0);
    const int c = std::clamp(first % grid.columns, 0, grid.columns - 2);
    const int r = std::clamp(first / grid.columns, 0, grid.rows - 2);
    const bool dark = first_dark == ((c + r) % 2 == 0);
    if (!dark && spec.SymmetryOrder() != (spec.columns == spec.rows ? 4 : 2)) continue;
    const Eigen::Vector2d along =
        grid.pixels[static_cast<std::size_t>(next)] - grid.pixels[static_cast<std::size_t>(first)];
    turns.push_back(turn);
    angles.push_back(std::atan2(along.y(), along.x()));
  }
  const int chosen = NearestToImageAxes(angles);
  return chosen < 0 ? -1 : turns[static_cast<std::size_t>(chosen)];
}

}  // namespace

BoardDetection DetectChessboard(const BoardSpec& spec, const GrayImage& image) {
  const cv::Mat grey = ToMat8(image);
  const auto grid = Find(grey, spec.columns, spec.rows);
  if (!grid) return NotFound(WhyNone(spec, grey));
  const auto fits = Refine(image, *grid);
  const int turn = ChooseTurn(spec, *grid, FirstSquareIsDark(*grid, fits));
  if (turn < 0) {
    return NotFound(fmt::format(
        "{} looks the same when turned, and its rows are too far from the image's rows here to "
        "tell "
        "which way round it is; hold it with its rows along the image's, or use a board with one "
        "odd and one even count",
        spec.Word()));
  }
  BoardDetection out;
  for (int id = 0; id < spec.PointCount(); ++id) {
    const int index = TurnedIndex(*grid, turn, id % spec.columns, id / spec.columns);
    const auto& fit = fits[static_cast<std::size_t>(index)];
    if (!fit) continue;
    out.ids.push_back(id);
    out.pixels.push_back(fit->pixel);
    out.sigma_px.push_back(std::sqrt(fit->cov_px2.trace() / 2));
  }
  if (10 * static_cast<int>(out.ids.size()) < 9 * spec.PointCount()) {
    return NotFound(fmt::format("only {} of {} corners could be fitted; too blurred or too small?",
                                out.ids.size(), spec.PointCount()));
  }
  return out;
}

}  // namespace plumbline::internal
