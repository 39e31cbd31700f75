#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/image.h"
#include "calib/mode_triangulation.h"
#include "match/stereo_sequence.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// Where the points of a view's pair, matched, lie on the undeformed wheel (wheel frame); NaN where
// there is none. The covariance (xx xy xz yy yz zz) is from the noise of the matches.
struct ViewMaterial {
  Image<Eigen::Vector3d> point_mm;
  Image<Eigen::Matrix<float, 6, 1>> cov_random_mm2;
};
ViewMaterial MaterialOf(const WheelReference& wheel, const WheelReferenceView& view,
                        const StereoField& field);

// What each calibration mode does to the material angles of these points (points, modes): they are
// seen where they are, at another place of another wheel. axes_along: of the wheel, one a mode.
Eigen::MatrixXf MaterialAlongModes(const WheelReference& wheel, const WheelReferenceView& view,
                                   const Image<Eigen::Vector3d>& material_mm,
                                   const ModeTriangulation& modes,
                                   const std::vector<WheelAxis>& axes_along);

}  // namespace plumbline::internal
