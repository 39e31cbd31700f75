#include "calib/optimization_inputs.h"

#include <cmath>
#include <string>

#include "calib/error.h"

namespace plumbline {
namespace {

void Require(bool condition, const std::string& what) {
  if (!condition) throw InputError("optimization inputs: " + what);
}

// Indices (i, i_cam, i_extrinsics) within their arrays.
void CheckIndices(const OptimizationInputs::IndexMatrix3& indices, Eigen::Index count, int cameras,
                  Eigen::Index extrinsics, const std::string& name) {
  for (Eigen::Index o = 0; o < indices.rows(); ++o) {
    const std::string where = name + "[" + std::to_string(o) + "]";
    Require(indices(o, 0) >= 0 && indices(o, 0) < count, where + " points outside its array");
    Require(indices(o, 1) >= 0 && indices(o, 1) < cameras, where + " names a camera not there");
    Require(indices(o, 2) >= -1 && indices(o, 2) < extrinsics,
            where + " names a camera pose not there");
  }
}

void CheckObservations(const OptimizationInputs::RowMatrix3& observations,
                       const std::string& name) {
  for (Eigen::Index i = 0; i < observations.rows(); ++i) {
    const std::string where = name + ", entry " + std::to_string(i);
    Require(observations.row(i).allFinite(),
            where + " is not finite: give what was not seen as (-1, -1, -1)");
    Require(observations(i, 2) != 0, where + " has weight 0: use -1 for what is to be left out");
  }
}

}  // namespace

int OptimizationInputs::ExtrinsicsOfCamera(int camera) const {
  std::optional<int> found;
  const auto look = [&](const IndexMatrix3& indices) {
    for (Eigen::Index o = 0; o < indices.rows(); ++o) {
      if (indices(o, 1) != camera) continue;
      Require(!found || *found == indices(o, 2), "camera " + std::to_string(camera) +
                                                     " moves between its observations; only "
                                                     "cameras that stand still are supported");
      found = indices(o, 2);
    }
  };
  look(indices_frame_camintrinsics_camextrinsics);
  look(indices_point_camintrinsics_camextrinsics);
  Require(found.has_value(), "camera " + std::to_string(camera) + " has no observation");
  return *found;
}

Camera OptimizationInputs::CameraAt(int camera) const {
  Require(camera >= 0 && camera < camera_count(), "no camera " + std::to_string(camera));
  return Camera(lens_model, image_sizes[static_cast<std::size_t>(camera)],
                intrinsics.row(camera).transpose());
}

void OptimizationInputs::Check() const {
  Require(camera_count() > 0, "no camera");
  Require(intrinsics.cols() == lens_model.ParameterCount(),
          "intrinsics has " + std::to_string(intrinsics.cols()) + " columns, not the " +
              std::to_string(lens_model.ParameterCount()) + " of " + lens_model.Name());
  Require(image_sizes.size() == static_cast<std::size_t>(camera_count()),
          "as many image sizes as cameras are needed");
  for (const ImageSize& size : image_sizes) {
    Require(size.width > 0 && size.height > 0, "an image size is not positive");
  }
  Require(intrinsics.allFinite() && extrinsics_rt_fromref.allFinite() &&
              frames_rt_toref.allFinite() && points.allFinite(),
          "a parameter is not a finite number");
  Require((intrinsics.leftCols<2>().array() > 0).all(), "a focal length is not positive");
  Require(!calobject_warp || calobject_warp->allFinite(), "calobject_warp is not finite");

  const auto& boards = indices_frame_camintrinsics_camextrinsics;
  Require(board_rows >= 0 && board_columns >= 0, "the board's rows and columns are negative");
  Require(boards.rows() == 0 || (board_rows > 1 && board_columns > 1 && frame_count() > 0),
          "a board has at least 2 rows and 2 columns of corners, and a pose");
  Require(boards.rows() == 0 ||
              (std::isfinite(calibration_object_spacing) && calibration_object_spacing > 0),
          "calibration_object_spacing is not positive");
  Require(observations_board.rows() == boards.rows() * board_rows * board_columns,
          "observations_board does not have (observations x rows x columns) entries");
  Require(observations_point.rows() == indices_point_camintrinsics_camextrinsics.rows(),
          "observations_point and its indices have different lengths");
  Require(boards.rows() + observations_point.rows() > 0, "no observation");
  Require(fixed_points >= 0 && fixed_points <= points.rows(), "Npoints_fixed is out of range");
  CheckIndices(boards, frames_rt_toref.rows(), camera_count(), extrinsics_rt_fromref.rows(),
               "indices_frame_camintrinsics_camextrinsics");
  CheckIndices(indices_point_camintrinsics_camextrinsics, points.rows(), camera_count(),
               extrinsics_rt_fromref.rows(), "indices_point_camintrinsics_camextrinsics");
  for (Eigen::Index o = 1; o < boards.rows(); ++o) {
    const bool sorted = boards(o - 1, 0) < boards(o, 0) ||
                        (boards(o - 1, 0) == boards(o, 0) && boards(o - 1, 1) < boards(o, 1));
    Require(sorted, "board observations are not sorted by frame, then camera, at entry " +
                        std::to_string(o));
  }
  CheckObservations(observations_board, "observations_board");
  CheckObservations(observations_point, "observations_point");
}

}  // namespace plumbline
