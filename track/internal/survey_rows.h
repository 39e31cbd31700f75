#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "calib/relative_pose.h"
#include "calib/triangulate.h"
#include "track/right_delay.h"
#include "track/rolling_angles.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// The time of a frame, or without a clock its number.
double TimeOf(const RollingFrame& frame);

// The right pixel of what a view shows at a pixel of its left image, from its points around; NaN
// where these do not surround it.
Eigen::Vector2d RightPixelAt(const PlanarField& right, const Eigen::Vector2d& left_px);

// What the frames of a survey say of the wheel's angle, and what the pose of their cameras was told
// by, so that both can be told again when the right pixels have moved. One entry a frame.
struct SurveyRows {
  struct PoseMatches {
    std::optional<RelativePose> view;              // of the reference image; nothing: not refined
    std::vector<StereoObservation> observations;   // of the frame
    std::vector<std::size_t> places;               // of each on the grid, row * columns + column
    std::vector<Eigen::Vector2d> right_flow_px;    // of each, a radian
    std::vector<Eigen::Vector2d> right_common_px;  // of each, as MotionSince(); or empty
    double alike_points = 1;                       // of RelativePoseOptions

    static PoseMatches Of(const RelativePose& view, const StereoField& field,
                          const Image<Eigen::Vector3f>& unit_covariance,
                          const Image<Eigen::Vector2d>& right_flow_px, double alike_points);
  };

  std::vector<std::vector<RollingObservation>> observations;
  std::vector<Eigen::MatrixXf> psi_along;  // (observations, modes)
  std::vector<PoseMatches> poses;
  std::vector<GroundPitch> pitch;  // empty: the deformation stays as it is under the rig

  void Push(Eigen::Index modes);
  void ClearLast();

  // Angles go on beyond a turn, at the speed that the wheel had.
  void Unwrap(std::vector<RollingFrame>* frames);
  // The poses of the cameras in the frames that have kept the calibrated one, and the points that
  // follow.
  void RefineAll(const WheelReference& reference, std::vector<RollingFrame>* frames);
  // The angles of frames that are placed, out of the observations and the tags on the rim.
  void FindAngles(const WheelReference& reference, const RollingAnglesOptions& angles,
                  const AngleSmootherOptions& smoother, RollingWheel* wheel) const;
  // The right pixels where they would be, had both cameras exposed together; the poses and points
  // that follow, and what one sigma of the delay does to the angles. Throws InputError where a
  // frame that is placed has no speed.
  void MoveBack(const WheelReference& reference, const RightDelay& delay, PoseRefinement refinement,
                RollingWheel* wheel);

 private:
  // The observations, with their places over the ground where that is known.
  std::vector<std::vector<RollingObservation>> OverGround() const;
  // What one sigma of how far the deformation follows the ground does to the angles; slope: of it,
  // in the mean over each frame.
  Eigen::RowVectorXd AlongPitch(const std::vector<double>& slope) const;
  // The pose of a frame's cameras and its points by its pixels as they are now; returns the rig.
  StereoRig TriangulateAnew(const WheelReference& reference, PoseRefinement refinement,
                            std::size_t f, RollingFrame* frame);
};

}  // namespace plumbline::internal
