#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "calib/board.h"
#include "calib/image.h"

namespace plumbline::testing {

// A photograph of a flat board through a homography: the truth that detections are compared with.
struct SyntheticPhoto {
  // Share of white, 0 to 1, at a place of the board (mm).
  std::function<double(const Eigen::Vector2d&)> albedo;
  Eigen::Matrix3d image_from_board = Eigen::Matrix3d::Identity();
  ImageSize size{640, 480};
  double dark = 30, bright = 200;  // grey levels
  Eigen::Vector2d shading{0, 0};   // relative change of light, per pixel
  double blur_px = 0.6;            // besides the pixel's own area
  double noise = 0;                // grey levels
  std::uint64_t seed = 1;

  Eigen::Vector2d Map(const Eigen::Vector2d& board_mm) const {
    const Eigen::Vector3d p = image_from_board * board_mm.homogeneous();
    return p.hnormalized();
  }

  // Blurred on a grid kSamples times finer, then averaged over each pixel; then shading, noise and
  // rounding.
  GrayImage Render() const {
    const Eigen::Matrix3d board_from_image = image_from_board.inverse();
    constexpr int kSamples = 5;
    cv::Mat fine(size.height * kSamples, size.width * kSamples, CV_32F);
    for (int y = 0; y < fine.rows; ++y) {
      for (int x = 0; x < fine.cols; ++x) {
        const Eigen::Vector3d p((x + 0.5) / kSamples - 0.5, (y + 0.5) / kSamples - 0.5, 1);
        const double white = albedo((board_from_image * p).hnormalized());
        fine.at<float>(y, x) = static_cast<float>(dark + (bright - dark) * white);
      }
    }
    const double fine_blur = blur_px * kSamples;
    cv::GaussianBlur(fine, fine, {0, 0}, fine_blur, fine_blur, cv::BORDER_REFLECT);
    cv::Mat image;
    cv::resize(fine, image, {size.width, size.height}, 0, 0, cv::INTER_AREA);
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal(0, 1);
    GrayImage out{Image<std::uint16_t>(size), 8};
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        const double light =
            1 + shading.x() * (x - size.width / 2) + shading.y() * (y - size.height / 2);
        const double grey = image.at<float>(y, x) * light + noise * normal(random);
        out.grey(y, x) = static_cast<std::uint16_t>(std::clamp(std::lround(grey), 0L, 255L));
      }
    }
    return out;
  }
};

// Rotation in the image (degrees) about the board's middle, tilts (perspective), scale, and where
// the middle goes.
inline Eigen::Matrix3d BoardHomography(const Eigen::Vector2d& middle_mm, double px_per_mm,
                                       double roll_deg, double tilt_x_deg, double tilt_y_deg,
                                       const Eigen::Vector2d& middle_px, double distance_mm = 500) {
  const double d = std::numbers::pi / 180;
  const double cr = std::cos(roll_deg * d), sr = std::sin(roll_deg * d);
  const double cx = std::cos(tilt_x_deg * d), sx = std::sin(tilt_x_deg * d);
  const double cy = std::cos(tilt_y_deg * d), sy = std::sin(tilt_y_deg * d);
  Eigen::Matrix3d Rz, Rx, Ry;
  Rz << cr, -sr, 0, sr, cr, 0, 0, 0, 1;
  Rx << 1, 0, 0, 0, cx, -sx, 0, sx, cx;
  Ry << cy, 0, sy, 0, 1, 0, -sy, 0, cy;
  const Eigen::Matrix3d R = Rz * Rx * Ry;
  const double f = px_per_mm * distance_mm;
  Eigen::Matrix3d K, board;
  K << f, 0, middle_px.x(), 0, f, middle_px.y(), 0, 0, 1;
  board.col(0) = R.col(0);
  board.col(1) = R.col(1);
  board.col(2) = Eigen::Vector3d(0, 0, distance_mm) - R.leftCols<2>() * middle_mm;
  return K * board;
}

// Black discs on white at a board's points; donut-dots boards get their rings.
inline std::function<double(const Eigen::Vector2d&)> DiscAlbedo(const BoardSpec& spec,
                                                                double radius_mm,
                                                                bool white_dots = false) {
  const bool rings = spec.kind == BoardSpec::Kind::kDonutDots;
  const DonutMarkers markers = rings ? MarkersOf(spec) : DonutMarkers{-1, -1, -1};
  std::vector<Eigen::Vector2d> points;
  for (int id = 0; id < spec.PointCount(); ++id) points.push_back(spec.NominalPoint(id).head<2>());
  return [=](const Eigen::Vector2d& p) {
    double white = 1;
    // Only the rows and columns next to the place can cover it.
    for (int r = static_cast<int>(std::floor(p.y() / spec.pitch_mm)) - 1, k = 0; k < 3; ++k, ++r) {
      if (r < 0 || r >= spec.rows) continue;
      for (int c = 0; c < spec.columns; ++c) {
        const int id = r * spec.columns + c;
        const double distance = (points[static_cast<std::size_t>(id)] - p).norm();
        const bool ring = id == markers.origin || id == markers.along_x || id == markers.along_y;
        if (distance < radius_mm && !(ring && distance < 0.36 * radius_mm)) white = 0;
      }
    }
    return white_dots ? 1 - white : white;
  };
}

// A chessboard with a white margin; its first inner square (points 0, 1, columns) is black.
inline std::function<double(const Eigen::Vector2d&)> ChessboardAlbedo(const BoardSpec& spec) {
  return [=](const Eigen::Vector2d& p) {
    const int c = static_cast<int>(std::floor(p.x() / spec.pitch_mm));
    const int r = static_cast<int>(std::floor(p.y() / spec.pitch_mm));
    if (c < -1 || r < -1 || c >= spec.columns || r >= spec.rows) return 1.0;
    return (c + r) % 2 == 0 ? 0.0 : 1.0;
  };
}

// Centroid of the image of a disc: area integral over its outline.
inline Eigen::Vector2d DiscCentroid(const SyntheticPhoto& photo, const Eigen::Vector2d& centre_mm,
                                    double radius_mm) {
  constexpr int kSides = 2000;
  const Eigen::Vector2d base = photo.Map(centre_mm);
  Eigen::Vector2d sum = Eigen::Vector2d::Zero(), last;
  double area = 0;
  for (int k = 0; k <= kSides; ++k) {
    const double a = 2 * std::numbers::pi * k / kSides;
    const Eigen::Vector2d p =
        photo.Map(centre_mm + radius_mm * Eigen::Vector2d(std::cos(a), std::sin(a))) - base;
    if (k > 0) {
      const double cross = last.x() * p.y() - p.x() * last.y();
      area += cross / 2;
      sum += (last + p) * cross / 6;
    }
    last = p;
  }
  return base + sum / area;
}

}  // namespace plumbline::testing
