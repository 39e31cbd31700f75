#include "calib/internal/dot_candidates.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <optional>

namespace plumbline::internal {
namespace {

constexpr double kLeastContrast = 8;  // grey levels of 255

struct Blob {
  DotCandidate dot;
  double misfit = 0;  // rms distance of the contour from the ellipse, in radii
};

// The ellipse with the second moments of the contour's area.
std::optional<Ellipse> MomentEllipse(const std::vector<cv::Point>& contour) {
  const cv::Moments m = cv::moments(contour);
  if (m.m00 < 12) return std::nullopt;
  Ellipse out;
  out.centre = {m.m10 / m.m00, m.m01 / m.m00};
  // The contour runs through the centres of the outermost pixels: the blob is half a pixel larger.
  Eigen::Matrix2d moments;
  moments << m.mu20, m.mu11, m.mu11, m.mu02;
  moments /= m.m00;
  if (!(moments.determinant() > 0)) return std::nullopt;
  const double radius = std::sqrt(m.m00 / std::numbers::pi);
  const double grown = (radius + 0.5) / radius;
  out.shape = (4 * grown * grown * moments).inverse();
  return out;
}

double Misfit(const Ellipse& ellipse, const std::vector<cv::Point>& contour) {
  const double radius = ellipse.MeanRadiusPx(), on_edge = radius / (radius + 0.5);
  double sum = 0;
  for (const cv::Point& p : contour) {
    const double off = ellipse.NormalisedRadius({p.x, p.y}) - on_edge;
    sum += off * off;
  }
  return std::sqrt(sum / static_cast<double>(contour.size()));
}

// Mean grey values at the centre, on the dot, and around it.
struct Profile {
  double middle = 0, on = 0, around = 0;
};

std::optional<Profile> MeasureProfile(const cv::Mat& image, const Ellipse& ellipse) {
  // A circle of unit normalised radius, mapped by the inverse square root of the shape.
  const Eigen::LLT<Eigen::Matrix2d> root(ellipse.shape.inverse().eval());
  const Eigen::Matrix2d L = root.matrixL();
  const auto mean = [&](double rho) -> std::optional<double> {
    constexpr int kDirections = 16;
    double sum = 0;
    int count = 0;
    for (int k = 0; k < kDirections; ++k) {
      const double angle = 2 * std::numbers::pi * k / kDirections;
      const Eigen::Vector2d p =
          ellipse.centre + L * Eigen::Vector2d(rho * std::cos(angle), rho * std::sin(angle));
      const int x = static_cast<int>(std::lround(p.x())), y = static_cast<int>(std::lround(p.y()));
      if (x < 0 || y < 0 || x >= image.cols || y >= image.rows) continue;
      sum += image.at<std::uint8_t>(y, x);
      ++count;
    }
    if (count < kDirections / 2) return std::nullopt;
    return sum / count;
  };
  const auto middle = mean(0.08), on = mean(0.62), around = mean(1.3);
  if (!middle || !on || !around) return std::nullopt;
  return Profile{*middle, *on, *around};
}

std::optional<Blob> Judge(const cv::Mat& image, const std::vector<cv::Point>& contour, bool dark) {
  const auto ellipse = MomentEllipse(contour);
  if (!ellipse) return std::nullopt;
  const Eigen::Vector2d axes =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(ellipse->shape).eigenvalues();
  const double longest = 1 / std::sqrt(axes[0]), shortest = 1 / std::sqrt(axes[1]);
  if (shortest < 1.5 || longest > 0.15 * image.rows || shortest < 0.25 * longest) {
    return std::nullopt;
  }
  Blob blob;
  blob.misfit = Misfit(*ellipse, contour);
  if (blob.misfit > 0.06 + 0.45 / shortest) return std::nullopt;
  const auto profile = MeasureProfile(image, *ellipse);
  if (!profile) return std::nullopt;
  const double sign = dark ? 1 : -1;
  blob.dot.ellipse = *ellipse;
  blob.dot.contrast = sign * (profile->around - profile->on);
  if (blob.dot.contrast < kLeastContrast) return std::nullopt;
  blob.dot.ring = sign * (profile->middle - profile->on) > 0.35 * blob.dot.contrast;
  return blob;
}

void CollectBlobs(const cv::Mat& image, int block, bool dark, std::vector<Blob>& blobs,
                  int& clipped) {
  cv::Mat mean, mask;
  cv::boxFilter(image, mean, CV_8U, {block, block}, {-1, -1}, true, cv::BORDER_REFLECT);
  const cv::Scalar least(kLeastContrast / 2);
  if (dark) {
    cv::subtract(mean, image, mask);
  } else {
    cv::subtract(image, mean, mask);
  }
  cv::compare(mask, least, mask, cv::CMP_GT);
  std::vector<std::vector<cv::Point>> contours;
  std::vector<cv::Vec4i> hierarchy;
  cv::findContours(mask, contours, hierarchy, cv::RETR_CCOMP, cv::CHAIN_APPROX_NONE);
  for (std::size_t i = 0; i < contours.size(); ++i) {
    const auto& contour = contours[i];
    if (hierarchy[i][3] >= 0) continue;  // a hole
    if (contour.size() < 10 || contour.size() > static_cast<std::size_t>(image.rows)) continue;
    const cv::Rect box = cv::boundingRect(contour);
    const bool touches = box.x <= 0 || box.y <= 0 || box.x + box.width >= image.cols ||
                         box.y + box.height >= image.rows;
    if (touches) {
      clipped += box.width < 3 * box.height && box.height < 3 * box.width;
      continue;
    }
    if (const auto blob = Judge(image, contour, dark)) blobs.push_back(*blob);
  }
}

// One candidate for each place: of blobs with the centre inside one another, the most elliptic.
std::vector<DotCandidate> WithoutDoubles(std::vector<Blob> blobs) {
  std::sort(blobs.begin(), blobs.end(), [](const Blob& a, const Blob& b) {
    return a.dot.ellipse.centre.x() < b.dot.ellipse.centre.x();
  });
  std::vector<bool> dropped(blobs.size());
  for (std::size_t i = 0; i < blobs.size(); ++i) {
    const Ellipse& a = blobs[i].dot.ellipse;
    for (std::size_t j = i + 1; j < blobs.size(); ++j) {
      const Ellipse& b = blobs[j].dot.ellipse;
      const double radius = std::min(a.MeanRadiusPx(), b.MeanRadiusPx());
      if (b.centre.x() - a.centre.x() > std::max(a.MeanRadiusPx(), 4.0)) break;
      if ((b.centre - a.centre).norm() > radius) continue;
      dropped[blobs[i].misfit <= blobs[j].misfit ? j : i] = true;
    }
  }
  std::vector<DotCandidate> dots;
  for (std::size_t i = 0; i < blobs.size(); ++i) {
    if (!dropped[i]) dots.push_back(blobs[i].dot);
  }
  return dots;
}

}  // namespace

DotCandidates FindDotCandidates(const cv::Mat& image, bool dark) {
  cv::Mat smooth;
  cv::GaussianBlur(image, smooth, {3, 3}, 0.7);
  std::vector<Blob> blobs;
  DotCandidates out;
  for (const int divisor : {40, 12, 4}) {
    int clipped = 0;
    CollectBlobs(smooth, std::max(7, image.rows / divisor | 1), dark, blobs, clipped);
    out.clipped = std::max(out.clipped, clipped);
  }
  out.dots = WithoutDoubles(std::move(blobs));
  return out;
}

}  // namespace plumbline::internal
