#include "io/internal/rig_group.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "calib/camera_file.h"
#include "io/internal/durable_file.h"
#include "io/version.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;
using hdf5::Shape;
using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// 16 by 11 control points and more fit; a rig file with more is not one.
constexpr hsize_t kMaxParameters = 200'000;
constexpr hsize_t kMaxModeValues = 100'000'000;

std::span<const double> Span(const Eigen::VectorXd& v) {
  return {v.data(), static_cast<std::size_t>(v.size())};
}

std::vector<std::string> IntrinsicNames(const LensModel& model) {
  std::vector<std::string> names = {"fx", "fy", "cx", "cy"};
  if (model.IsSplined()) {
    for (int y = 0; y < model.knots_y; ++y) {
      for (int x = 0; x < model.knots_x; ++x) {
        names.push_back(fmt::format("knot_{}_{}_x", y, x));
        names.push_back(fmt::format("knot_{}_{}_y", y, x));
      }
    }
  } else {
    for (const char* name : {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"}) names.push_back(name);
  }
  names.resize(static_cast<std::size_t>(model.ParameterCount()));
  return names;
}

std::vector<std::string> ParameterNames(const StereoRig& rig) {
  std::vector<std::string> names;
  for (const std::string& name : IntrinsicNames(rig.left.model())) names.push_back("left_" + name);
  for (const std::string& name : IntrinsicNames(rig.right.model())) {
    names.push_back("right_" + name);
  }
  for (const char* part : {"rotation_rad", "translation_mm"}) {
    for (const char* axis : {"x", "y", "z"}) {
      names.push_back(fmt::format("right_from_left_{}_{}", part, axis));
    }
  }
  return names;
}

void WriteCamera(hid_t file, const std::string& side, const Camera& camera,
                 const std::string& model_text) {
  const std::string path = "/rig/" + side;
  const Id group = hdf5::CreateGroup(file, path);
  hdf5::SetText(group.get(), "NX_class", "NXcollection");
  hdf5::SetText(group.get(), "lens_model", camera.model().Name());
  const Id text = hdf5::WriteTexts(
      file,
      {path + "/cameramodel", "1", "the camera as mrcal's .cameramodel text (in metres)", {}, {}},
      {model_text});
  const std::vector<std::int32_t> size = {camera.size().width, camera.size().height};
  Id dataset = hdf5::WriteArray<std::int32_t>(
      file, {path + "/image_size", "pixel", "width and height of its images", {2}, {}}, size);
  hdf5::AttachScales(file, dataset, {hdf5::IndexScale(file, 2)});
  const auto n = static_cast<hsize_t>(camera.parameter_count());
  const Id names = hdf5::WriteTexts(
      file,
      {path + "/parameter", "1", "names of the intrinsics; order and formulas of mrcal", {n}, {}},
      IntrinsicNames(camera.model()));
  hdf5::MakeScale(names, "parameter");
  dataset = hdf5::WriteArray<double>(file,
                                     {path + "/intrinsics",
                                      "1",
                                      "intrinsics: fx, fy, cx, cy in px, the rest without unit",
                                      {n},
                                      {}},
                                     Span(camera.parameters()));
  hdf5::AttachScales(file, dataset, {path + "/parameter"});
}

void WriteModes(hid_t file, const StereoRig& rig) {
  const auto P = static_cast<hsize_t>(rig.ParameterCount());
  const auto K = static_cast<hsize_t>(rig.modes.count());
  const std::string unit_note = "px for focal lengths and centres, rad, mm; see /rig/parameter";
  const Id names = hdf5::WriteTexts(
      file, {"/rig/parameter", "1", "names of the rig's parameters", {P}, {}}, ParameterNames(rig));
  hdf5::MakeScale(names, "parameter");
  Id dataset = hdf5::WriteArray<double>(
      file, {"/rig/parameters", "1", "the rig's parameters (" + unit_note + ")", {P}, {}},
      Span(rig.Parameters()));
  hdf5::AttachScales(file, dataset, {"/rig/parameter"});

  std::vector<std::int32_t> numbers(K);
  for (std::size_t k = 0; k < numbers.size(); ++k) numbers[k] = static_cast<std::int32_t>(k);
  const Id mode = hdf5::WriteArray<std::int32_t>(
      file, {"/rig/mode", "1", "number of the calibration mode", {K}, {}}, numbers);
  hdf5::MakeScale(mode, "mode");
  const RowMatrix modes = rig.modes.modes;
  dataset = hdf5::WriteArray<double>(
      file,
      {"/rig/modes",
       "1",
       "calibration modes: row k is one standard deviation of mode k (" + unit_note + ")",
       {K, P},
       {}},
      {modes.data(), static_cast<std::size_t>(K * P)});
  hdf5::SetInteger(dataset.get(), "has_scale_mode", rig.modes.has_scale_mode ? 1 : 0);
  hdf5::AttachScales(file, dataset, {"/rig/mode", "/rig/parameter"});
}

void WriteExtra(hid_t file, const NamedArray& extra) {
  const Shape shape(extra.shape.begin(), extra.shape.end());
  if (hdf5::ElementCount(shape) != extra.values.size() || extra.name.empty()) {
    throw std::invalid_argument("WriteRigFile: size and shape of '" + extra.name + "' disagree");
  }
  if (hdf5::Exists(file, "/rig/" + extra.name)) {
    throw std::invalid_argument("WriteRigFile: '" + extra.name + "' is there twice");
  }
  hdf5::WriteArray<double>(file, {"/rig/" + extra.name, extra.units, extra.long_name, shape, {}},
                           extra.values);
}

void AttachExtraScales(hid_t file, const RigFileExtras& extras) {
  const auto is_axis = [&](const std::string& name) {
    return std::any_of(extras.arrays.begin(), extras.arrays.end(), [&](const NamedArray& other) {
      return std::find(other.axes.begin(), other.axes.end(), name) != other.axes.end();
    });
  };
  for (const NamedArray& extra : extras.arrays) {
    if (is_axis(extra.name) && extra.shape.size() == 1) {
      hdf5::MakeScale(hdf5::OpenDataset(file, "/rig/" + extra.name), extra.name);
    }
  }
  for (const NamedArray& extra : extras.arrays) {
    if (is_axis(extra.name)) continue;
    std::vector<std::string> scales;
    for (std::size_t d = 0; d < extra.shape.size(); ++d) {
      const bool named = d < extra.axes.size() && !extra.axes[d].empty();
      scales.push_back(named ? "/rig/" + extra.axes[d] : hdf5::IndexScale(file, extra.shape[d]));
    }
    hdf5::AttachScales(file, hdf5::OpenDataset(file, "/rig/" + extra.name), scales);
  }
}

Camera ReadCamera(hid_t file, const std::string& side) {
  const std::string path = "/rig/" + side;
  const Id group = hdf5::OpenGroup(file, path);
  const LensModel model = LensModel::FromName(hdf5::GetText(group.get(), "lens_model"));
  const auto size = hdf5::ReadArray<std::int32_t>(file, path + "/image_size", nullptr, 2);
  if (size.size() != 2) throw hdf5::Error(path + "/image_size does not hold two numbers");
  const auto values = hdf5::ReadArray<double>(file, path + "/intrinsics", nullptr, kMaxParameters);
  return Camera(
      model, {size[0], size[1]},
      Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size())));
}

}  // namespace

void WriteRigGroup(hid_t file, const StereoRig& rig, const RigFileExtras& extras) {
  const Id group = hdf5::CreateGroup(file, "/rig");
  hdf5::SetText(group.get(), "NX_class", "NXcollection");
  hdf5::SetText(group.get(), "board", rig.board);
  for (const auto& [name, text] : extras.texts) {
    if (!hdf5::HasAttribute(group.get(), name)) hdf5::SetText(group.get(), name, text);
  }
  WriteCamera(file, "left", rig.left,
              extras.left_model_text.empty() ? WriteCameraModelText(rig.left, Rigid3{})
                                             : extras.left_model_text);
  WriteCamera(file, "right", rig.right,
              extras.right_model_text.empty() ? WriteCameraModelText(rig.right, rig.right_from_left)
                                              : extras.right_model_text);
  const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> matrix = rig.right_from_left.Matrix();
  const Id dataset = hdf5::WriteArray<double>(
      file,
      {"/rig/right_from_left",
       "mm",
       "rigid motion from left to right camera: rotation (without unit), translation in mm",
       {4, 4},
       {}},
      {matrix.data(), 16});
  hdf5::AttachScales(file, dataset, {hdf5::IndexScale(file, 4), hdf5::IndexScale(file, 4)});
  WriteModes(file, rig);
  for (const NamedArray& extra : extras.arrays) WriteExtra(file, extra);
  AttachExtraScales(file, extras);
}

StereoRig ReadRigGroup(hid_t file) {
  if (!hdf5::Exists(file, "/rig/left") || !hdf5::Exists(file, "/rig/right")) {
    throw hdf5::Error("it holds no group /rig with two cameras");
  }
  StereoRig rig{ReadCamera(file, "left"), ReadCamera(file, "right"), {}, {}, ""};
  const auto values = hdf5::ReadArray<double>(file, "/rig/right_from_left", nullptr, 16);
  if (values.size() != 16) throw hdf5::Error("/rig/right_from_left is not of 4 by 4");
  const Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> matrix(values.data());
  rig.right_from_left.rotation = matrix.topLeftCorner<3, 3>();
  rig.right_from_left.translation_mm = matrix.topRightCorner<3, 1>();
  const Eigen::Matrix3d& R = rig.right_from_left.rotation;
  const double skew = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  // Written so that NaN is refused too.
  if (!(skew < 1e-6 && R.determinant() > 0 && rig.right_from_left.translation_mm.allFinite())) {
    throw hdf5::Error("/rig/right_from_left is no rigid motion");
  }
  Shape shape;
  const auto modes = hdf5::ReadArray<double>(file, "/rig/modes", &shape, kMaxModeValues);
  if (shape.size() != 2 || shape[1] != static_cast<hsize_t>(rig.ParameterCount())) {
    throw hdf5::Error("/rig/modes does not have one column a parameter of the rig");
  }
  rig.modes.modes = Eigen::Map<const RowMatrix>(modes.data(), static_cast<Eigen::Index>(shape[0]),
                                                static_cast<Eigen::Index>(shape[1]));
  if (!rig.modes.modes.allFinite())
    throw hdf5::Error("/rig/modes holds values that are no numbers");
  const Id dataset = hdf5::OpenDataset(file, "/rig/modes");
  rig.modes.has_scale_mode = hdf5::GetNumber(dataset.get(), "has_scale_mode", 0) != 0;
  const Id group = hdf5::OpenGroup(file, "/rig");
  rig.board = hdf5::GetText(group.get(), "board");
  return rig;
}

void WriteRootAttributes(hid_t file, const std::string& format, const std::string& recipe_toml,
                         const std::string& inputs, std::int64_t format_version) {
  hdf5::SetText(file, "format", format);
  hdf5::SetInteger(file, "format_version", format_version);
  hdf5::SetText(file, "created", TimestampNow());
  hdf5::SetText(file, "software", SoftwareVersion());
  hdf5::SetText(file, "recipe", recipe_toml);
  hdf5::SetText(file, "NX_class", "NXroot");
  if (!inputs.empty()) hdf5::SetText(file, "inputs", inputs);
}

}  // namespace plumbline::internal
