#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <string>
#include <utility>

#include "apps/stereo_run.h"
#include "fit/ground_plane.h"
#include "tests/support/consistency.h"
#include "tests/support/rendered_surface.h"

namespace plumbline::testing {

// The rig and how it may be wrong, in sizes that calibrations come to: one standard deviation a
// mode, the last one the scale.
inline StereoRig WithModes(StereoRig rig) {
  const int p = rig.ParameterCount(), right = rig.left.parameter_count(), pose = p - 6;
  rig.modes.modes = Eigen::MatrixXd::Zero(11, p);
  const auto set = [&rig](int k, std::initializer_list<std::pair<int, double>> values) {
    for (const auto& [parameter, sigma] : values) rig.modes.modes(k, parameter) = sigma;
  };
  set(0, {{0, 0.15}, {1, 0.15}});  // focal lengths, px
  set(1, {{right, 0.15}, {right + 1, 0.15}});
  set(2, {{2, 1}, {right + 2, 1}});  // principal points, px
  set(3, {{3, 1}, {right + 3, 1}});
  set(4, {{right + 2, 0.3}});
  set(5, {{4, 0.05}, {right + 4, -0.03}});                                    // distortion
  for (int axis = 0; axis < 3; ++axis) set(6 + axis, {{pose + axis, 1e-4}});  // rad
  set(9, {{pose + 3, 0.005}, {pose + 4, 0.01}, {pose + 5, 0.02}});            // mm
  rig.modes.modes.row(10).tail<3>() = 1e-4 * rig.right_from_left.translation_mm.transpose();
  rig.modes.has_scale_mode = true;
  return rig;
}

// A photographed pair, as an image source delivers it.
inline StereoFrame PairOf(const StereoRig& rig, const SpeckledSheet& sheet, double noise_grey,
                          std::uint32_t seed, std::int64_t index,
                          const RenderedSpeckleOptions& speckle = {}) {
  StereoFrame pair;
  pair.index = index;
  pair.time_s = 0.5 * static_cast<double>(index);
  pair.left_id = "left_" + std::to_string(index);
  pair.right_id = "right_" + std::to_string(index);
  pair.left = sheet.Left(rig, noise_grey, 2 * seed, speckle);
  pair.right = sheet.Right(rig, noise_grey, 2 * seed + 1, speckle);
  return pair;
}

// Of a flat sheet, in the rig frame; only normal, offset and centroid are set.
inline GroundPlane PlaneOf(const SpeckledSheet& sheet) {
  GroundPlane plane;
  plane.normal = -sheet.rig_from_sheet.rotation.col(2);
  plane.centroid = sheet.rig_from_sheet.translation_mm;
  plane.offset_mm = plane.normal.dot(plane.centroid);
  return plane;
}

// As a series holds it.
inline GroundPlane PlaneOf(const GroundRecord& record) {
  GroundPlane plane;
  plane.normal = record.normal_in_rig;
  plane.offset_mm = record.offset_mm;
  plane.centroid = record.centroid_in_rig_mm;
  plane.e1 = record.e1_in_rig;
  plane.e2 = record.e2_in_rig;
  return plane;
}

// The frame that the positions of a flat sheet would be told in without errors. Its origin is the
// point of the sheet that is found at the origin: the centroid of what the plane was fitted to.
// at_rest: the reference pair as measured from images that true_rig took.
inline Rigid3 TrueGroundFromRig(const SpeckledSheet& sheet, const StereoRig& true_rig,
                                const Image<Eigen::Vector2f>& grid_px, const SeriesFrame& at_rest) {
  // The sheet in the rig frame as an affine function of the measured x and y.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero(), rhs = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < grid_px.pixel_count(); ++i) {
    const Eigen::Vector3d measured = at_rest.surface.position_mm.data()[i].cast<double>();
    if (!measured.allFinite()) continue;
    const Eigen::Vector3d row(1, measured.x(), measured.y());
    const Eigen::Vector2d pixel = grid_px.data()[i].cast<double>();
    normal += row * row.transpose();
    rhs += row * sheet.PointInRig(sheet.MaterialAt(true_rig, pixel)).transpose();
  }
  const Eigen::Matrix3d affine = normal.ldlt().solve(rhs);
  return GroundFromRig(PlaneOf(sheet), Eigen::Vector3d::Zero(), affine.row(0).transpose());
}

}  // namespace plumbline::testing
