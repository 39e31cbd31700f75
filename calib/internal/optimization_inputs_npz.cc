#include "calib/internal/optimization_inputs_npz.h"

#include <optional>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

using Shape = std::vector<std::int64_t>;

template <typename Matrix>
NpyArray Doubles(const Matrix& matrix, Shape shape) {
  return {std::move(shape), std::vector<double>(matrix.data(), matrix.data() + matrix.size())};
}

template <typename Matrix>
NpyArray Integers(const Matrix& matrix, Shape shape) {
  return {std::move(shape),
          std::vector<std::int64_t>(matrix.data(), matrix.data() + matrix.size())};
}

NpyArray Text(std::string text) { return {{}, std::move(text)}; }
NpyArray Flag(bool flag) { return {{}, std::vector<bool>{flag}}; }
NpyArray Scalar(double value) { return {{}, std::vector<double>{value}}; }

// Typed access to the entries, with messages.
class Reader {
 public:
  Reader(const NpzArchive& archive, const std::string& name) : archive_(archive), name_(name) {}

  [[noreturn]] void Fail(const std::string& key, const std::string& what) const {
    throw InputError(name_ + ": optimization_inputs['" + key + "'] " + what);
  }

  // nullptr where the entry is absent or None.
  const NpyArray* Find(const std::string& key) const {
    const auto found = archive_.find(key);
    if (found == archive_.end()) return nullptr;
    const auto* text = std::get_if<std::string>(&found->second.values);
    return text != nullptr && text->empty() ? nullptr : &found->second;
  }

  std::vector<double> Numbers(const std::string& key, const NpyArray& array) const {
    if (const auto* doubles = std::get_if<std::vector<double>>(&array.values)) return *doubles;
    if (const auto* integers = std::get_if<std::vector<std::int64_t>>(&array.values)) {
      return {integers->begin(), integers->end()};
    }
    if (const auto* bools = std::get_if<std::vector<bool>>(&array.values)) {
      return {bools->begin(), bools->end()};
    }
    Fail(key, "is text where numbers were expected");
  }

  // A matrix whose last dimension is `columns` (-1: any), the others flattened. Empty if absent.
  OptimizationInputs::RowMatrix Matrix(const std::string& key, std::int64_t columns) const {
    const NpyArray* array = Find(key);
    if (array == nullptr)
      return OptimizationInputs::RowMatrix(0, std::max<std::int64_t>(columns, 0));
    if (array->shape.size() < 2 || (columns >= 0 && array->shape.back() != columns)) {
      Fail(key, "does not have the shape mrcal gives it");
    }
    const std::vector<double> numbers = Numbers(key, *array);
    const Eigen::Index n = array->shape.back();
    const Eigen::Index rows = n == 0 ? 0 : static_cast<Eigen::Index>(numbers.size()) / n;
    return Eigen::Map<const OptimizationInputs::RowMatrix>(numbers.data(), rows, n);
  }

  double Number(const std::string& key, double otherwise) const {
    const NpyArray* array = Find(key);
    if (array == nullptr) return otherwise;
    const std::vector<double> numbers = Numbers(key, *array);
    if (numbers.size() != 1) Fail(key, "is not one number");
    return numbers[0];
  }
  bool Boolean(const std::string& key, const std::string& old_key, bool otherwise) const {
    return Number(key, Number(old_key, otherwise ? 1 : 0)) != 0;
  }

 private:
  const NpzArchive& archive_;
  const std::string& name_;
};

void ReadLens(const Reader& in, OptimizationInputs& out) {
  const NpyArray* lens = in.Find("lensmodel");
  const auto* name = lens == nullptr ? nullptr : std::get_if<std::string>(&lens->values);
  if (name == nullptr) in.Fail("lensmodel", "is missing");
  out.intrinsics = in.Matrix("intrinsics", -1);
  if (*name == "LENSMODEL_PINHOLE") {
    out.lens_model.kind = LensModel::Kind::kOpenCv4;
    out.intrinsics.conservativeResizeLike(
        OptimizationInputs::RowMatrix::Zero(out.intrinsics.rows(), 8));
    out.do_optimize_intrinsics_distortions = false;
  } else {
    out.lens_model = LensModel::FromName(*name);
  }
  const OptimizationInputs::RowMatrix sizes = in.Matrix("imagersizes", 2);
  for (Eigen::Index c = 0; c < sizes.rows(); ++c) {
    if (!(sizes.row(c).array() > 0 && sizes.row(c).array() < 1e6).all()) {
      in.Fail("imagersizes", "is not positive");
    }
    out.image_sizes.push_back({static_cast<int>(sizes(c, 0)), static_cast<int>(sizes(c, 1))});
  }
}

}  // namespace

NpzArchive ToNpz(const OptimizationInputs& inputs) {
  const NpyArray none = Text("");
  NpzArchive out;
  std::vector<std::int64_t> sizes;
  for (const ImageSize& size : inputs.image_sizes) {
    sizes.push_back(size.width);
    sizes.push_back(size.height);
  }
  const std::int64_t cameras = inputs.camera_count();
  const std::int64_t boards = inputs.board_observation_count();
  const std::int64_t points = inputs.point_observation_count();
  out["lensmodel"] = Text(inputs.lens_model.Name());
  out["intrinsics"] = Doubles(inputs.intrinsics, {cameras, inputs.intrinsics.cols()});
  out["imagersizes"] = {{cameras, 2}, sizes};
  out["extrinsics_rt_fromref"] =
      Doubles(inputs.extrinsics_rt_fromref, {inputs.extrinsics_rt_fromref.rows(), 6});
  out["frames_rt_toref"] = Doubles(inputs.frames_rt_toref, {inputs.frames_rt_toref.rows(), 6});
  out["points"] =
      inputs.points.rows() == 0 ? none : Doubles(inputs.points, {inputs.points.rows(), 3});
  out["indices_frame_camintrinsics_camextrinsics"] =
      Integers(inputs.indices_frame_camintrinsics_camextrinsics, {boards, 3});
  out["observations_board"] =
      Doubles(inputs.observations_board, {boards, inputs.board_rows, inputs.board_columns, 3});
  out["calibration_object_spacing"] = Scalar(inputs.calibration_object_spacing);
  out["calobject_warp"] = inputs.calobject_warp ? Doubles(*inputs.calobject_warp, {2}) : none;
  out["indices_point_camintrinsics_camextrinsics"] =
      points == 0 ? none : Integers(inputs.indices_point_camintrinsics_camextrinsics, {points, 3});
  out["observations_point"] = points == 0 ? none : Doubles(inputs.observations_point, {points, 3});
  if (points > 0) {
    out["point_min_range"] = Scalar(inputs.point_min_range);
    out["point_max_range"] = Scalar(inputs.point_max_range);
    out["Npoints_fixed"] = {{}, std::vector<std::int64_t>{inputs.fixed_points}};
  }
  out["do_optimize_intrinsics_core"] = Flag(inputs.do_optimize_intrinsics_core);
  out["do_optimize_intrinsics_distortions"] = Flag(inputs.do_optimize_intrinsics_distortions);
  out["do_optimize_extrinsics"] = Flag(inputs.do_optimize_extrinsics);
  out["do_optimize_frames"] = Flag(inputs.do_optimize_frames);
  out["do_optimize_calobject_warp"] = Flag(inputs.do_optimize_calobject_warp);
  out["do_apply_regularization"] = Flag(inputs.do_apply_regularization);
  out["do_apply_outlier_rejection"] = Flag(inputs.do_apply_outlier_rejection);
  out["verbose"] = Flag(false);
  return out;
}

OptimizationInputs FromNpz(const NpzArchive& archive, const std::string& name) {
  const Reader in(archive, name);
  OptimizationInputs out;
  out.do_optimize_intrinsics_distortions =
      in.Boolean("do_optimize_intrinsics_distortions", "do_optimize_intrinsic_distortions", true);
  ReadLens(in, out);
  out.extrinsics_rt_fromref = in.Matrix("extrinsics_rt_fromref", 6);
  out.frames_rt_toref = in.Matrix("frames_rt_toref", 6);
  out.points = in.Matrix("points", 3);
  out.fixed_points = static_cast<int>(in.Number("Npoints_fixed", 0));
  out.indices_frame_camintrinsics_camextrinsics =
      in.Matrix("indices_frame_camintrinsics_camextrinsics", 3).cast<int>();
  out.observations_board = in.Matrix("observations_board", 3);
  if (const NpyArray* observations = in.Find("observations_board")) {
    if (observations->shape.size() != 4) {
      in.Fail("observations_board", "does not have the shape mrcal gives it");
    }
    out.board_rows = static_cast<int>(observations->shape[1]);
    out.board_columns = static_cast<int>(observations->shape[2]);
  }
  out.calibration_object_spacing = in.Number("calibration_object_spacing", 0);
  if (const NpyArray* warp = in.Find("calobject_warp")) {
    const std::vector<double> numbers = in.Numbers("calobject_warp", *warp);
    if (numbers.size() != 2) in.Fail("calobject_warp", "does not have 2 elements");
    out.calobject_warp = Eigen::Vector2d(numbers[0], numbers[1]);
  }
  out.indices_point_camintrinsics_camextrinsics =
      in.Matrix("indices_point_camintrinsics_camextrinsics", 3).cast<int>();
  out.observations_point = in.Matrix("observations_point", 3);
  out.point_min_range = in.Number("point_min_range", 0);
  out.point_max_range = in.Number("point_max_range", 0);
  out.do_optimize_intrinsics_core =
      in.Boolean("do_optimize_intrinsics_core", "do_optimize_intrinsic_core", true);
  out.do_optimize_extrinsics = in.Boolean("do_optimize_extrinsics", "", true);
  out.do_optimize_frames = in.Boolean("do_optimize_frames", "", true);
  out.do_optimize_calobject_warp =
      in.Boolean("do_optimize_calobject_warp", "", out.calobject_warp.has_value());
  out.do_apply_regularization = in.Boolean("do_apply_regularization", "", true);
  out.do_apply_outlier_rejection = in.Boolean("do_apply_outlier_rejection", "", true);
  try {
    out.Check();
  } catch (const InputError& error) {
    throw InputError(name + ": " + error.what());
  }
  return out;
}

}  // namespace plumbline::internal
