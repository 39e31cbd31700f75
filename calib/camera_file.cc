#include "calib/camera_file.h"

#include <fmt/format.h>

#include "calib/error.h"
#include "calib/internal/npz.h"
#include "calib/internal/optimization_inputs_npz.h"
#include "calib/internal/python_literal.h"
#include "calib/internal/text_file.h"

namespace plumbline {
namespace {

using internal::PythonValue;

constexpr double kMillimetresPerMetre = 1000;

std::string NumberList(const Eigen::VectorXd& numbers) {
  std::string out = "[";
  for (const double number : numbers) out += fmt::format(" {:.17g},", number);
  return out + " ]";
}

// The first of several keys that the dictionary has.
const PythonValue* FindAny(const PythonValue& model, std::initializer_list<std::string_view> keys) {
  for (const std::string_view key : keys) {
    if (const PythonValue* found = model.Find(key)) return found;
  }
  return nullptr;
}

// A required list of `count` numbers; -1: any count.
Eigen::VectorXd Numbers(const PythonValue& model, std::string_view key, Eigen::Index count,
                        const std::string& name) {
  const PythonValue* value = model.Find(key);
  const PythonValue::List* list = value == nullptr ? nullptr : value->AsList();
  if (list == nullptr) throw InputError(fmt::format("{}: the list '{}' is missing", name, key));
  Eigen::VectorXd out(static_cast<Eigen::Index>(list->size()));
  for (std::size_t i = 0; i < list->size(); ++i) {
    const double* number = (*list)[i].AsNumber();
    if (number == nullptr) {
      throw InputError(fmt::format("{}: '{}' holds something that is no number", name, key));
    }
    out[static_cast<Eigen::Index>(i)] = *number;
  }
  if (count >= 0 && out.size() != count) {
    throw InputError(
        fmt::format("{}: '{}' has {} numbers where {} are needed", name, key, out.size(), count));
  }
  return out;
}

Camera ReadCamera(const PythonValue& model, const std::string& name) {
  const PythonValue* lens = FindAny(model, {"lensmodel", "lens_model", "distortion_model"});
  if (lens == nullptr || lens->AsString() == nullptr) {
    throw InputError(name + ": it names no 'lensmodel', so it is no camera model of mrcal");
  }
  std::string lens_name = *lens->AsString();
  if (lens_name.rfind("DISTORTION_", 0) == 0) lens_name.replace(0, 10, "LENSMODEL");
  Eigen::VectorXd parameters = Numbers(model, "intrinsics", -1, name);
  if ((lens_name == "LENSMODEL_PINHOLE" || lens_name == "LENSMODEL_NONE") &&
      parameters.size() == 4) {
    lens_name = "LENSMODEL_OPENCV4";
    parameters.conservativeResizeLike(Eigen::VectorXd::Zero(8));
  }
  const Eigen::VectorXd size = Numbers(model, "imagersize", 2, name);
  if (!(size.array() >= 1 && size.array() <= 1e6).all() ||
      size.cast<int>().cast<double>() != size) {
    throw InputError(name + ": 'imagersize' is not two positive whole numbers");
  }
  try {
    return Camera(LensModel::FromName(lens_name),
                  {static_cast<int>(size[0]), static_cast<int>(size[1])}, std::move(parameters));
  } catch (const std::exception& error) {
    throw InputError(name + ": " + error.what());
  }
}

}  // namespace

std::string WriteCameraModelText(const Camera& camera, const Rigid3& camera_from_reference,
                                 const OptimizationInputs* inputs, int camera_index_in_inputs) {
  Eigen::VectorXd rt(6);
  rt << camera_from_reference.RotationVector(),
      camera_from_reference.translation_mm / kMillimetresPerMetre;
  std::string out = fmt::format(
      "# Written by Plumbline; lengths in metres.\n"
      "{{\n"
      "    'lensmodel':  '{}',\n\n"
      "    # fx,fy,cx,cy, then the parameters of the lens model\n"
      "    'intrinsics': {},\n\n"
      "    # rotation vector and translation of camera_from_reference\n"
      "    'extrinsics': {},\n\n"
      "    'imagersize': [ {}, {} ],\n",
      camera.model().Name(), NumberList(camera.parameters()), NumberList(rt), camera.size().width,
      camera.size().height);
  if (inputs != nullptr) {
    inputs->Check();
    if (camera_index_in_inputs < 0 || camera_index_in_inputs >= inputs->camera_count()) {
      throw InputError(
          fmt::format("the optimization inputs have no camera {}", camera_index_in_inputs));
    }
    out += fmt::format(
        "\n    'icam_intrinsics': {},\n\n"
        "    # Everything the calibration was computed from: base-85 of a numpy .npz archive.\n"
        "    'optimization_inputs': b'{}',\n",
        camera_index_in_inputs,
        internal::EncodeBase85(internal::WriteNpz(internal::ToNpz(*inputs))));
  }
  return out + "}\n";
}

CameraModelFile ReadCameraModelText(std::string_view text, const std::string& name_for_messages) {
  const std::string& name = name_for_messages;
  const PythonValue model = internal::ParsePythonLiteral(text, name);
  if (model.AsDict() == nullptr) throw InputError(name + ": it is no camera model of mrcal");
  CameraModelFile file{ReadCamera(model, name), {}, std::nullopt, 0};
  const Eigen::VectorXd rt = Numbers(model, "extrinsics", 6, name);
  file.camera_from_reference =
      Rigid3::FromRotationVector(rt.head<3>(), rt.tail<3>() * kMillimetresPerMetre);

  const PythonValue* inputs = model.Find("optimization_inputs");
  if (inputs == nullptr || inputs->IsNone()) return file;
  const PythonValue* index =
      FindAny(model, {"icam_intrinsics", "icam_intrinsics_optimization_inputs"});
  if (inputs->AsString() == nullptr || index == nullptr || index->AsNumber() == nullptr) {
    throw InputError(name +
                     ": 'optimization_inputs' is given without the text or 'icam_intrinsics'");
  }
  const std::string archive = internal::DecodeBase85(*inputs->AsString(), name);
  file.inputs = internal::FromNpz(internal::ReadNpz(archive, name), name);
  const double camera = *index->AsNumber();
  if (!(camera >= 0 && camera < file.inputs->camera_count())) {
    throw InputError(name + ": 'icam_intrinsics' names a camera that its inputs do not have");
  }
  file.camera_index_in_inputs = static_cast<int>(camera);
  return file;
}

void WriteCameraModel(const std::filesystem::path& path, const Camera& camera,
                      const Rigid3& camera_from_reference, const OptimizationInputs* inputs,
                      int camera_index_in_inputs) {
  internal::WriteTextFile(
      path, WriteCameraModelText(camera, camera_from_reference, inputs, camera_index_in_inputs));
}

CameraModelFile ReadCameraModel(const std::filesystem::path& path) {
  return ReadCameraModelText(internal::ReadTextFile(path), path.string());
}

StereoRig ReadCameraModelPair(const std::filesystem::path& left,
                              const std::filesystem::path& right) {
  const CameraModelFile l = ReadCameraModel(left), r = ReadCameraModel(right);
  return {l.camera, r.camera, r.camera_from_reference * l.camera_from_reference.Inverse(), {}, ""};
}

}  // namespace plumbline
