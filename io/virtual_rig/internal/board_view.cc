#include "io/virtual_rig/internal/board_view.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "io/virtual_rig/internal/board_ink.h"

namespace plumbline::internal {
namespace {

constexpr double kLargestIncidence_rad = 60 * std::numbers::pi / 180;
constexpr double kPartShare = 0.6;  // of the points, in each image
constexpr int kStepsPerSide = 8;    // of the outline, which a lens bends

}  // namespace

BoardView::BoardView(const StereoRig& rig, const BoardSpec& spec, const BoardPrint& print,
                     double edge_margin_px)
    : rig_(rig), edge_margin_px_(edge_margin_px) {
  using Kind = BoardSpec::Kind;
  part_is_enough_ =
      spec.kind == Kind::kDonutDots || spec.kind == Kind::kCharuco || spec.kind == Kind::kAprilGrid;
  points_together_ = spec.kind == Kind::kAprilGrid ? 4 : 1;
  for (int id = 0; id < spec.PointCount(); ++id) points_.push_back(spec.NominalPoint(id));
  const BoardRectangle pattern = PatternOutline(spec, print);
  const auto lift = [](const Eigen::Vector2d& p) { return Eigen::Vector3d(p.x(), p.y(), 0); };
  for (const Eigen::Vector2d& corner : pattern) outline_.push_back(lift(corner));
  for (std::size_t side = 0; side < 4; ++side) {
    for (int k = 1; k < kStepsPerSide; ++k) {
      const double share = static_cast<double>(k) / kStepsPerSide;
      outline_.push_back(lift((1 - share) * pattern[side] + share * pattern[(side + 1) % 4]));
    }
  }
  middle_mm_ = lift((pattern[0] + pattern[2]) / 2);
  if (spec.kind == Kind::kDonutDots) {
    const DonutMarkers markers = MarkersOf(spec);
    const double reach = 0.6 * spec.pitch_mm;
    for (const int id : {markers.origin, markers.along_x, markers.along_y}) {
      for (const double x : {-reach, reach}) {
        for (const double y : {-reach, reach}) {
          required_.push_back(spec.NominalPoint(id) + Eigen::Vector3d(x, y, 0));
        }
      }
    }
  }
  ChooseFeature(spec, print);
}

// Widths at which detection of tilted, slightly blurred boards is still sure: see
// tests/io/virtual_rig/board_poses_test.cc.
void BoardView::ChooseFeature(const BoardSpec& spec, const BoardPrint& print) {
  using Kind = BoardSpec::Kind;
  switch (spec.kind) {
    case Kind::kChessboard:
      feature_ = {"squares", spec.pitch_mm, 7};
      break;
    case Kind::kDonutDots:
      feature_ = {"ring holes", 2 * PrintedDiscRadius(spec, print, 0) * print.hole_share, 2.4};
      break;
    case Kind::kAsymmetricCircles:
    case Kind::kCircles:
      feature_ = {"discs", 2 * PrintedDiscRadius(spec, print, 0), 6};
      break;
    case Kind::kCharuco:
      feature_ = {"marker modules", spec.marker_mm / ModulesPerSide(spec), 1.6};
      break;
    case Kind::kAprilGrid:
      feature_ = {"tag modules", spec.pitch_mm / ModulesPerSide(spec), 2};
      break;
  }
}

Rigid3 BoardView::FromBoard(int camera, const Rigid3& left_from_board) const {
  return camera == 0 ? left_from_board : rig_.right_from_left * left_from_board;
}

bool BoardView::InImage(const Camera& camera, const Eigen::Vector3d& point,
                        Eigen::Vector2d& pixel) const {
  pixel = camera.Project(point);
  const ImageSize size = camera.size();
  return pixel.x() >= edge_margin_px_ && pixel.y() >= edge_margin_px_ &&
         pixel.x() <= size.width - 1 - edge_margin_px_ &&
         pixel.y() <= size.height - 1 - edge_margin_px_;
}

bool BoardView::SeesAll(const Camera& camera, const Rigid3& camera_from_board,
                        const std::vector<Eigen::Vector3d>& places) const {
  Eigen::Vector2d pixel;
  return std::all_of(places.begin(), places.end(), [&](const Eigen::Vector3d& place) {
    return InImage(camera, camera_from_board * place, pixel);
  });
}

bool BoardView::FacesCamera(const Rigid3& camera_from_board) const {
  const Eigen::Vector3d ray = (camera_from_board * middle_mm_).normalized();
  return camera_from_board.rotation.col(2).dot(ray) > std::cos(kLargestIncidence_rad);
}

double BoardView::FeatureWidthIn(const Camera& camera, const Rigid3& camera_from_board) const {
  double least = std::numeric_limits<double>::infinity();
  const auto measure = [&](const Eigen::Vector3d& place) {
    const auto projection = camera.ProjectWithJacobians(camera_from_board * place);
    const Eigen::Matrix2d J = projection.d_pixel_d_point * camera_from_board.rotation.leftCols<2>();
    if (!J.allFinite()) {
      least = std::numeric_limits<double>::quiet_NaN();
      return;
    }
    const double width =
        feature_.size_mm * Eigen::JacobiSVD<Eigen::Matrix2d>(J).singularValues()[1];
    // Written so that NaN stays.
    if (width < least) least = width;
  };
  measure(middle_mm_);
  for (std::size_t corner = 0; corner < 4; ++corner) {
    // Parts that stick out of the image need not be told.
    Eigen::Vector2d pixel;
    if (InImage(camera, camera_from_board * outline_[corner], pixel)) measure(outline_[corner]);
  }
  return least;
}

bool BoardView::Fits(const Rigid3& left_from_board) const {
  for (const int camera : {0, 1}) {
    const Rigid3 camera_from_board = FromBoard(camera, left_from_board);
    if (!FacesCamera(camera_from_board) ||
        !SeesAll(CameraAt(camera), camera_from_board, outline_)) {
      return false;
    }
  }
  return true;
}

double BoardView::FeatureWidth(const Rigid3& left_from_board) const {
  const double left = FeatureWidthIn(rig_.left, left_from_board);
  const double right = FeatureWidthIn(rig_.right, FromBoard(1, left_from_board));
  return std::isnan(left) || left < right ? left : right;
}

std::optional<BoardView::Seen> BoardView::Look(const Rigid3& left_from_board, Need need) const {
  Seen seen;
  for (const int k : {0, 1}) {
    const Rigid3 camera_from_board = FromBoard(k, left_from_board);
    if (!FacesCamera(camera_from_board)) return std::nullopt;
    const bool whole = need == Need::kWhole || !part_is_enough_;
    if (!SeesAll(CameraAt(k), camera_from_board, whole ? outline_ : required_)) return std::nullopt;
  }
  if (!(FeatureWidth(left_from_board) >= feature_.least_px)) return std::nullopt;
  for (const int k : {0, 1}) {
    const Camera& camera = CameraAt(k);
    const Rigid3 camera_from_board = FromBoard(k, left_from_board);
    std::vector<Eigen::Vector2d> group;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      if (i % points_together_ == 0) group.clear();
      const Eigen::Vector3d in_camera = camera_from_board * points_[i];
      Eigen::Vector2d pixel;
      if (!InImage(camera, in_camera, pixel)) continue;
      // A lens model may fold back into the image what it does not really show.
      if (!(camera.Unproject(pixel).dot(in_camera.normalized()) > 1 - 1e-9)) return std::nullopt;
      group.push_back(pixel);
      if (group.size() < points_together_) continue;
      seen.pixels[k].insert(seen.pixels[k].end(), group.begin(), group.end());
    }
    const double share =
        static_cast<double>(seen.pixels[k].size()) / static_cast<double>(points_.size());
    if (share < kPartShare) return std::nullopt;
  }
  return seen;
}

}  // namespace plumbline::internal
