#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "calib/internal/detect_families.h"
#include "calib/internal/opencv_image.h"
#include "calib/internal/saddle_fit.h"

namespace plumbline::internal {
namespace {

// OpenCV numbers its dictionaries in this order.
constexpr std::array<std::string_view, 21> kDictionaries = {
    "DICT_4X4_50",         "DICT_4X4_100",       "DICT_4X4_250",       "DICT_4X4_1000",
    "DICT_5X5_50",         "DICT_5X5_100",       "DICT_5X5_250",       "DICT_5X5_1000",
    "DICT_6X6_50",         "DICT_6X6_100",       "DICT_6X6_250",       "DICT_6X6_1000",
    "DICT_7X7_50",         "DICT_7X7_100",       "DICT_7X7_250",       "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11"};

cv::Ptr<cv::aruco::Dictionary> DictionaryOf(const BoardSpec& spec) {
  const auto at = std::find(kDictionaries.begin(), kDictionaries.end(), spec.dictionary);
  return cv::aruco::getPredefinedDictionary(static_cast<int>(at - kDictionaries.begin()));
}

struct Markers {
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> corners;
};

Markers FindMarkers(const cv::Mat& image, const cv::Ptr<cv::aruco::CharucoBoard>& board,
                    const cv::Ptr<cv::aruco::Dictionary>& dictionary) {
  const auto parameters = cv::aruco::DetectorParameters::create();
  parameters->adaptiveThreshWinSizeMax = 43;
  parameters->adaptiveThreshWinSizeStep = 8;
  Markers markers;
  std::vector<std::vector<cv::Point2f>> rejected;
  cv::aruco::detectMarkers(image, dictionary, markers.corners, markers.ids, parameters, rejected);
  if (!markers.ids.empty()) {
    cv::aruco::refineDetectedMarkers(image, board, markers.corners, markers.ids, rejected);
  }
  return markers;
}

struct Guess {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero(), along = pixel, down = pixel;
};

cv::Point2f Corner(const cv::aruco::CharucoBoard& board, std::size_t corner) {
  return {board.chessboardCorners[corner].x, board.chessboardCorners[corner].y};
}

// A corner of the board, and the steps to the next ones, through a homography.
Guess Map(const cv::Mat& H, const cv::Point2f& p, double pitch_mm) {
  const auto step = static_cast<float>(pitch_mm);
  const std::vector<cv::Point2f> board = {p, p + cv::Point2f(step, 0), p + cv::Point2f(0, step)};
  std::vector<cv::Point2f> image;
  cv::perspectiveTransform(board, image, H);
  const Eigen::Vector2d here(image[0].x, image[0].y);
  return {here, Eigen::Vector2d(image[1].x, image[1].y) - here,
          Eigen::Vector2d(image[2].x, image[2].y) - here};
}

// Where each inner corner should be, by the homographies of the markers that are next to it: their
// mean. Left out where they disagree, because one of them was misread.
std::map<int, Guess> GuessCorners(const BoardSpec& spec, const Markers& markers,
                                  const cv::aruco::CharucoBoard& board) {
  std::map<int, std::vector<Guess>> guesses;
  for (std::size_t m = 0; m < markers.ids.size(); ++m) {
    const auto listed = std::find(board.ids.begin(), board.ids.end(), markers.ids[m]);
    if (listed == board.ids.end()) continue;
    const int k = static_cast<int>(listed - board.ids.begin());
    std::vector<cv::Point2f> nominal;
    for (const cv::Point3f& p : board.objPoints[static_cast<std::size_t>(k)]) {
      nominal.push_back({p.x, p.y});
    }
    const cv::Mat H = cv::getPerspectiveTransform(nominal, markers.corners[m]);
    for (std::size_t c = 0; c < board.chessboardCorners.size(); ++c) {
      const auto& near = board.nearestMarkerIdx[c];
      if (std::find(near.begin(), near.end(), k) == near.end()) continue;
      guesses[static_cast<int>(c)].push_back(Map(H, Corner(board, c), spec.pitch_mm));
    }
  }
  std::map<int, Guess> out;
  for (const auto& [id, several] : guesses) {
    Guess mean;
    for (const Guess& guess : several) {
      const double share = 1.0 / static_cast<double>(several.size());
      mean.pixel += share * guess.pixel;
      mean.along += share * guess.along;
      mean.down += share * guess.down;
    }
    const bool agree = std::all_of(several.begin(), several.end(), [&](const Guess& guess) {
      return (guess.pixel - mean.pixel).norm() < 0.15 * mean.along.norm();
    });
    if (agree) out[id] = mean;
  }
  return out;
}

std::optional<SaddleFit> FitCorner(const BoardSpec& spec, const GrayImage& image, int id,
                                   const Guess& guess) {
  const double area = guess.along.x() * guess.down.y() - guess.along.y() * guess.down.x();
  const double clear = area / std::max(guess.along.norm(), guess.down.norm());
  if (!(clear > 0)) return std::nullopt;
  // Up to the nearest corner of a marker in the middle of the white squares.
  const double free_share = std::min(0.45, 0.63 * (1 - spec.marker_mm / spec.pitch_mm));
  const double radius = std::clamp(free_share * clear, 3.0, 20.0);
  const auto fit = FitSaddle(image, guess.pixel, guess.along, guess.down, radius);
  // The first square is black.
  const bool dark = (id % (spec.columns - 1) + id / (spec.columns - 1)) % 2 == 0;
  if (!fit || fit->dark_between != dark) return std::nullopt;
  if ((fit->pixel - guess.pixel).norm() > 0.2 * clear + 0.5) return std::nullopt;
  return fit;
}

// Corners without a marker next to them that was read: predicted by all others, and accepted where
// a corner of like contrast is found.
void AddPredicted(const BoardSpec& spec, const GrayImage& image,
                  const cv::aruco::CharucoBoard& board, std::map<int, SaddleFit>& fits) {
  if (fits.size() < 6) return;
  std::vector<cv::Point2f> nominal, pixels;
  double contrast = 0;
  for (const auto& [id, fit] : fits) {
    nominal.push_back(Corner(board, static_cast<std::size_t>(id)));
    pixels.push_back({static_cast<float>(fit.pixel.x()), static_cast<float>(fit.pixel.y())});
    contrast += fit.contrast / static_cast<double>(fits.size());
  }
  const cv::Mat H = cv::findHomography(nominal, pixels, cv::RANSAC, 3);
  if (H.empty()) return;
  for (int id = 0; id < spec.PointCount(); ++id) {
    if (fits.count(id) != 0) continue;
    const Guess guess = Map(H, Corner(board, static_cast<std::size_t>(id)), spec.pitch_mm);
    const auto fit = FitCorner(spec, image, id, guess);
    if (fit && fit->contrast > 0.5 * contrast) fits[id] = *fit;
  }
}

}  // namespace

BoardDetection DetectCharuco(const BoardSpec& spec, const GrayImage& image) {
  const cv::Mat grey = ToMat8(image);
  const auto dictionary = DictionaryOf(spec);
  const auto board =
      cv::aruco::CharucoBoard::create(spec.columns, spec.rows, static_cast<float>(spec.pitch_mm),
                                      static_cast<float>(spec.marker_mm), dictionary);
  const Markers markers = FindMarkers(grey, board, dictionary);
  const auto total = board->ids.size();
  const auto of_board = std::count_if(markers.ids.begin(), markers.ids.end(), [&](int id) {
    return id >= 0 && id < static_cast<int>(total);
  });
  if (of_board < 2) {
    return NotFound(fmt::format(
        "{} of {} markers of {} found{}; is the board in view, sharp and large enough, and the "
        "dictionary right?",
        of_board, total, spec.dictionary,
        markers.ids.empty() ? "" : fmt::format(" (and {} with other ids)", markers.ids.size())));
  }
  std::map<int, SaddleFit> fits;
  for (const auto& [id, guess] : GuessCorners(spec, markers, *board)) {
    if (const auto fit = FitCorner(spec, image, id, guess)) fits[id] = *fit;
  }
  AddPredicted(spec, image, *board, fits);
  if (fits.size() < 4) {
    return NotFound(
        fmt::format("{} of {} markers read, but only {} corners between them fit the board; check "
                    "columns, rows "
                    "and sizes in the board word, or the photograph is too blurred",
                    of_board, total, fits.size()));
  }
  BoardDetection out;
  for (const auto& [id, fit] : fits) {
    out.ids.push_back(id);
    out.pixels.push_back(fit.pixel);
    out.sigma_px.push_back(std::sqrt(fit.cov_px2.trace() / 2));
  }
  return out;
}

}  // namespace plumbline::internal
