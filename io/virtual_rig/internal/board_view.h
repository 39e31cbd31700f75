#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "calib/board.h"
#include "calib/camera.h"
#include "calib/rigid3.h"
#include "calib/stereo_rig.h"
#include "io/virtual_rig/board_albedo.h"

namespace plumbline::internal {

// Whether a held board can be used, judged by the true cameras.
class BoardView {
 public:
  BoardView(const StereoRig& rig, const BoardSpec& spec, const BoardPrint& print,
            double edge_margin_px);

  // What a pose may do to the board.
  enum class Need { kWhole, kPart };

  // Whether detection does without some of the points.
  bool PartIsEnough() const { return part_is_enough_; }

  // Pixels of the points that can be found, by camera (left, right).
  struct Seen {
    std::vector<Eigen::Vector2d> pixels[2];
  };
  // Empty where one of the cameras cannot use what it sees.
  std::optional<Seen> Look(const Rigid3& left_from_board, Need need) const;

  // The two reasons against a pose, apart.
  bool Fits(const Rigid3& left_from_board) const;
  // Width (px) of the feature that has to be told where it is narrowest: the least over both
  // cameras, the middle and the corners of the pattern. NaN where the middle cannot be seen.
  double FeatureWidth(const Rigid3& left_from_board) const;

  // What has to be told for the board to be found.
  struct Feature {
    std::string name;  // in the plural
    double size_mm = 0;
    double least_px = 0;
  };
  const Feature& feature() const { return feature_; }

  // Middle of the pattern, board frame.
  const Eigen::Vector3d& middle_mm() const { return middle_mm_; }

 private:
  void ChooseFeature(const BoardSpec& spec, const BoardPrint& print);
  bool InImage(const Camera& camera, const Eigen::Vector3d& point, Eigen::Vector2d& pixel) const;
  bool SeesAll(const Camera& camera, const Rigid3& camera_from_board,
               const std::vector<Eigen::Vector3d>& places) const;
  bool FacesCamera(const Rigid3& camera_from_board) const;
  double FeatureWidthIn(const Camera& camera, const Rigid3& camera_from_board) const;
  Rigid3 FromBoard(int camera, const Rigid3& left_from_board) const;
  const Camera& CameraAt(int camera) const { return camera == 0 ? rig_.left : rig_.right; }

  const StereoRig& rig_;
  double edge_margin_px_;
  bool part_is_enough_;
  Eigen::Vector3d middle_mm_;
  std::vector<Eigen::Vector3d> points_;    // of the board
  std::vector<Eigen::Vector3d> outline_;   // of the pattern, corners first
  std::vector<Eigen::Vector3d> required_;  // around the markers that must be in view
  std::size_t points_together_ = 1;        // a tag is seen whole or not at all
  Feature feature_;
};

}  // namespace plumbline::internal
