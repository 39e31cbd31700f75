#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "calib/image.h"
#include "calib/rigid3.h"
#include "calib/status.h"
#include "calib/stereo_rig.h"
#include "calib/triangulate.h"
#include "match/stereo_sequence.h"

namespace plumbline {

// Where the points of a grid are in space at one instant, and how their errors came about: what
// displacement and strain carry on. All images have the size of the grid; NaN where a point has no
// position.
//
// Every match finds the subset of one reference image again. Its error, told in pixels (u, v) of
// that image, is the sum of what the noise of the reference image does, the same in all matches of
// the point, and of what that of the other image does. A match's covariance there is
// scale^2 cov_px2, with cov_px2 the point's own (UnitCovariance()), and `share` of it is the
// reference's.
struct SurfaceState {
  Image<Eigen::Vector3d> point_mm;
  // d point / d error of the left and of the right match (mm / px). Zero where a match has no
  // error: on the left of the reference pair, where the point is defined.
  Image<Eigen::Matrix<float, 3, 2>> d_left, d_right;
  Image<float> scale_left, scale_right;
  Image<float> share_left, share_right;
  // Covariance of what the subsets' shape functions do not follow (SubsetSmoothing; mm^2, xx xy xz
  // yy yz zz). Empty: not told.
  Image<Eigen::Matrix<float, 6, 1>> cov_left_out_mm2;
  // What one standard deviation of each calibration mode does to the points (mm). Empty: unknown.
  std::vector<Image<Eigen::Vector3f>> along_modes_mm;

  ImageSize size() const { return point_mm.size(); }
};

// The frame that positions are told in, and where it goes along each calibration mode: a frame that
// is fixed to the surface moves with it.
struct MeasurementFrame {
  Rigid3 frame_from_rig;
  std::vector<Rigid3> along_modes;  // frame_from_rig of each; as many as the rig has modes
};

// Variance of a match's error in pixels of the reference image (uu, uv, vv; px^2): that of the
// right match of the reference pair, or of `now`'s left one where there is none. NaN without both.
Image<Eigen::Vector3f> UnitCovariance(const StereoField& reference, const StereoField& now);

struct EpipolarOptions {
  // A point further from its epipolar line than the trend of all points, by this and so many sigmas
  // (its own and the points' scatter about the trend together), is mismatched: a subset that lies
  // half on something else, say. What all points have in common is the cameras', not the match's.
  double tolerance_px = 0.02;
  double sigmas = 5;
};

// The points of one pair.
struct StereoSurface {
  SurfaceState instant;
  // Signed distance of the right pixel from the epipolar line of the left one, px, and its sigma
  // from the noise of the images.
  Image<float> epipolar_px, sigma_epipolar_px;
  Image<Status> status;
};

// The points that have both matches, one of them at least with noise in every direction, as row *
// columns + column.
[[nodiscard]] std::vector<std::size_t> ObservedPlaces(const StereoField& field,
                                                      const Image<Eigen::Vector3f>& cov_px2);

// The matches of such points, with the joint covariance of both pixels.
[[nodiscard]] std::vector<StereoObservation> ObservationsAt(std::span<const std::size_t> places,
                                                            const StereoField& field,
                                                            const Image<Eigen::Vector3f>& cov_px2);
// Of all ObservedPlaces().
[[nodiscard]] std::vector<StereoObservation> ObservationsOf(const StereoField& field,
                                                            const Image<Eigen::Vector3f>& cov_px2);

// Triangulates both pixels of each point and carries the errors of both matches, without those of
// the calibration (AddModes). cov_px2: UnitCovariance().
//
// Status: the left match's where it is not kOk, else the right one's, else that of Triangulate(),
// or kEpipolarViolation.
// Throws InputError where the images differ in size.
[[nodiscard]] StereoSurface TriangulateField(const StereoRig& rig, const StereoField& field,
                                             const Image<Eigen::Vector3f>& cov_px2,
                                             const EpipolarOptions& options = {});

// The instant told in another frame.
[[nodiscard]] SurfaceState InFrame(const SurfaceState& in_rig, const MeasurementFrame& frame);

}  // namespace plumbline
