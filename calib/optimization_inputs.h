#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "calib/camera.h"
#include "calib/image.h"

namespace plumbline {

// Everything a calibration by mrcal is made of: where it starts on input, its optimum on output.
//
// The same fields, order and meaning as the keyword arguments of mrcal.optimize() in Python, which
// .cameramodel files carry as `optimization_inputs`.
//
// Units:   METRES (as mrcal's tools expect in those files), rad, px. The rest of this project is in
//          mm: conversions are in camera_file.cc, the calibration and projection_uncertainty.cc.
// Frames:  `ref` is where camera 0 usually stands; a board's own frame has x along its columns, y
//          along its rows and corner (0, 0) at its origin.
// Poses:   rows of (rotation vector, translation), as mrcal's rt transforms.
struct OptimizationInputs {
  using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using RowMatrix6 = Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>;
  using RowMatrix3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
  using IndexMatrix3 = Eigen::Matrix<int, Eigen::Dynamic, 3, Eigen::RowMajor>;

  LensModel lens_model;
  std::vector<ImageSize> image_sizes;  // one a camera

  RowMatrix intrinsics;              // (cameras, parameters of lens_model)
  RowMatrix6 extrinsics_rt_fromref;  // (poses of cameras that are not the reference)
  RowMatrix6 frames_rt_toref;        // (board poses)
  RowMatrix3 points;                 // (points), in ref; usually none
  int fixed_points = 0;              // how many of them, at the end, are not solved for

  // Board observations: camera i_cam saw board pose i_frame. Each is a row (i_frame, i_cam,
  // i_extrinsics), i_extrinsics = -1 for a camera at the reference; sorted by i_frame, then i_cam.
  IndexMatrix3 indices_frame_camintrinsics_camextrinsics;
  int board_rows = 0;     // H of the grid of corners
  int board_columns = 0;  // W
  // (x, y, weight) of corner (r, c) of observation o at row (o * H + r) * W + c. Residuals are
  // multiplied by the weight; a negative weight marks an outlier, or a corner that was not seen
  // (mrcal writes these as (-1, -1, -1)): it takes no part. A weight of exactly 0 would count as a
  // perfect inlier and is refused.
  RowMatrix3 observations_board;
  double calibration_object_spacing = 0;          // m between neighbouring corners
  std::optional<Eigen::Vector2d> calobject_warp;  // m; absent: a flat board

  // Observations of single points: rows (i_point, i_cam, i_extrinsics) and (x, y, weight).
  IndexMatrix3 indices_point_camintrinsics_camextrinsics;
  RowMatrix3 observations_point;
  double point_min_range = 0;
  double point_max_range = 0;

  bool do_optimize_intrinsics_core = true;
  bool do_optimize_intrinsics_distortions = true;
  bool do_optimize_extrinsics = true;
  bool do_optimize_frames = true;
  bool do_optimize_calobject_warp = false;
  bool do_apply_regularization = true;
  bool do_apply_outlier_rejection = true;

  int camera_count() const { return static_cast<int>(intrinsics.rows()); }
  int frame_count() const { return static_cast<int>(frames_rt_toref.rows()); }
  int board_observation_count() const {
    return static_cast<int>(indices_frame_camintrinsics_camextrinsics.rows());
  }
  int point_observation_count() const {
    return static_cast<int>(indices_point_camintrinsics_camextrinsics.rows());
  }

  // Row of a corner in observations_board.
  Eigen::Index CornerRow(int observation, int row, int column) const {
    return (static_cast<Eigen::Index>(observation) * board_rows + row) * board_columns + column;
  }

  // Where a camera stands: a row of extrinsics_rt_fromref, or -1 for the reference. Throws
  // InputError if it moves between its observations, or has none.
  int ExtrinsicsOfCamera(int camera) const;

  // One camera's lens. Throws std::invalid_argument as Camera does when the values are no camera.
  Camera CameraAt(int camera) const;

  // Throws InputError naming the first field whose shape, index, order or value does not fit.
  void Check() const;
};

}  // namespace plumbline
