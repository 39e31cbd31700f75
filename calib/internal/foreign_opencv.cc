#include <fmt/format.h>

#include <cmath>
#include <opencv2/core.hpp>

#include "calib/error.h"
#include "calib/internal/foreign_calibration.h"
#include "calib/internal/text_file.h"

namespace plumbline {
namespace internal {
namespace {

using Names = std::vector<std::string>;

// Spellings met in the field, left and right at the same place of their lists. A dot descends.
const Names kLeftMatrix = {"M1",
                           "K1",
                           "cameraMatrix1",
                           "camera_matrix_1",
                           "camera_matrix1",
                           "left_camera_matrix",
                           "camera_matrix_left",
                           "cameraMatrixL",
                           "LEFT.K",
                           "left.camera_matrix",
                           "KL",
                           "K_left",
                           "mtxL"};
const Names kRightMatrix = {"M2",
                            "K2",
                            "cameraMatrix2",
                            "camera_matrix_2",
                            "camera_matrix2",
                            "right_camera_matrix",
                            "camera_matrix_right",
                            "cameraMatrixR",
                            "RIGHT.K",
                            "right.camera_matrix",
                            "KR",
                            "K_right",
                            "mtxR"};
const Names kLeftDistortion = {"D1",
                               "distCoeffs1",
                               "dist_coeffs_1",
                               "distortion_coefficients_1",
                               "distortion_coefficients1",
                               "left_distortion_coefficients",
                               "distortion_coefficients_left",
                               "distCoeffsL",
                               "LEFT.D",
                               "left.distortion_coefficients",
                               "DL",
                               "D_left",
                               "distL"};
const Names kRightDistortion = {"D2",
                                "distCoeffs2",
                                "dist_coeffs_2",
                                "distortion_coefficients_2",
                                "distortion_coefficients2",
                                "right_distortion_coefficients",
                                "distortion_coefficients_right",
                                "distCoeffsR",
                                "RIGHT.D",
                                "right.distortion_coefficients",
                                "DR",
                                "D_right",
                                "distR"};
const Names kMatrix = {"camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "mtx", "intrinsics"};
const Names kDistortion = {
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "dist"};
const Names kRotation = {"R", "rotation", "rotation_matrix", "R_stereo"};
const Names kTranslation = {"T", "translation", "translation_vector", "t", "T_stereo"};

class OpenCvReader {
 public:
  OpenCvReader(const std::string& text, const ForeignSource& source) : source_(source) {
    try {
      storage_.open(text, cv::FileStorage::READ | cv::FileStorage::MEMORY);
    } catch (const cv::Exception& error) {
      source.Refuse("OpenCV cannot parse it: " + error.err);
    }
    if (!storage_.isOpened()) source.Refuse("it is no calibration file that is known here");
  }

  cv::FileNode Find(const std::string& name) const {
    const std::size_t dot = name.find('.');
    // Some programs do write the dot into the name itself.
    cv::FileNode node = storage_[name];
    if (!node.empty() || dot == std::string::npos) return node;
    const cv::FileNode outer = storage_[name.substr(0, dot)];
    return outer.isMap() ? outer[name.substr(dot + 1)] : cv::FileNode();
  }

  // The first name that is there; empty if none is.
  std::string FirstOf(const Names& names) const {
    for (const std::string& name : names) {
      if (!Find(name).empty()) return name;
    }
    return "";
  }

  // The numbers of a matrix or a list. Every one is checked to be a number: OpenCV itself reads
  // what is not there as 0.
  std::vector<double> Numbers(const std::string& name) const {
    const cv::FileNode node = Find(name);
    if (node.empty()) source_.Refuse("'" + name + "' is missing");
    std::vector<double> numbers;
    Collect(node.isMap() ? node["data"] : node, name, numbers);
    return numbers;
  }

  int Count(const cv::FileNode& node, const std::string& name) const {
    if (!node.isInt() || static_cast<int>(node) <= 0) {
      source_.Refuse("'" + name + "' is no positive whole number");
    }
    return static_cast<int>(node);
  }

  std::optional<ImageSize> Size() const {
    const std::pair<const char*, const char*> pairs[] = {{"image_width", "image_height"},
                                                         {"image_Width", "image_Height"},
                                                         {"width", "height"},
                                                         {"LEFT.width", "LEFT.height"},
                                                         {"left.image_width", "left.image_height"},
                                                         {"Camera.width", "Camera.height"}};
    for (const auto& [width, height] : pairs) {
      if (Find(width).empty() && Find(height).empty()) continue;
      return ImageSize{Count(Find(width), width), Count(Find(height), height)};
    }
    for (const char* name :
         {"imageSize", "image_size", "Image_size", "img_size", "size", "resolution"}) {
      if (Find(name).empty()) continue;
      const std::vector<double> wh = Numbers(name);
      if (wh.size() != 2 || !(wh[0] >= 1 && wh[1] >= 1 && wh[0] < 1e6 && wh[1] < 1e6)) {
        source_.Refuse(std::string("'") + name + "' is not a width and a height");
      }
      return ImageSize{static_cast<int>(wh[0]), static_cast<int>(wh[1])};
    }
    return std::nullopt;
  }

  void RefuseOtherLenses() const {
    for (const char* name :
         {"distortion_model", "camera_model", "model", "Camera.type", "fisheye"}) {
      const cv::FileNode node = Find(name);
      if (!node.isString()) continue;
      const std::string value = static_cast<std::string>(node);
      for (const char* known : {"plumb_bob", "rational_polynomial", "radial-tangential", "radtan",
                                "pinhole", "Pinhole", "PinHole", "PINHOLE", "brown"}) {
        if (value == known) return;
      }
      source_.Refuse(fmt::format(
          "'{}' is '{}', and only OpenCV's pinhole models with 4, 5 or 8 coefficients map to ours",
          name, value));
    }
  }

  ForeignCamera ReadCamera(const std::string& matrix, const std::string& distortion) const {
    ForeignCamera camera;
    const std::vector<double> k = Numbers(matrix);
    if (k.size() == 4) {  // fx fy cx cy, as EuRoC and Kalibr write it
      camera.fx = k[0], camera.fy = k[1], camera.cx = k[2], camera.cy = k[3];
    } else if (k.size() == 9 && k[3] == 0 && k[6] == 0 && k[7] == 0 && k[8] == 1) {
      camera.fx = k[0], camera.skew_px = k[1], camera.cx = k[2], camera.fy = k[4], camera.cy = k[5];
    } else {
      source_.Refuse("'" + matrix + "' is no camera matrix (fx s cx; 0 fy cy; 0 0 1)");
    }
    ReadDistortion(distortion, camera);
    camera.size = Size();
    return camera;
  }

  void ReadDistortion(const std::string& name, ForeignCamera& camera) const {
    const std::vector<double> d = Numbers(name);
    const std::size_t n = d.size();
    if (n != 4 && n != 5 && n != 8 && n != 12 && n != 14) {
      source_.Refuse(
          fmt::format("'{}' has {} coefficients; OpenCV has 4, 5, 8, 12 or 14", name, n));
    }
    for (std::size_t i = 8; i < n; ++i) {
      if (d[i] != 0) {
        source_.Refuse(
            fmt::format("'{}' has {} terms, which none of our lens models has; calibrate "
                        "again with 4, 5 or 8 coefficients",
                        name, i < 12 ? "thin prism" : "tilted sensor"));
      }
    }
    for (std::size_t i = 0; i < std::min<std::size_t>(n, 8); ++i) {
      camera.distortion[static_cast<Eigen::Index>(i)] = d[i];
    }
    camera.coefficient_count = static_cast<int>(std::min<std::size_t>(n, 8));
  }

 private:
  void Collect(const cv::FileNode& node, const std::string& name, std::vector<double>& out) const {
    if (node.isInt() || node.isReal()) {
      out.push_back(static_cast<double>(node));
      if (!std::isfinite(out.back()))
        source_.Refuse("'" + name + "' holds a value that is not finite");
      return;
    }
    if (!node.isSeq()) source_.Refuse("'" + name + "' holds something that is no number");
    for (const cv::FileNode& element : node) Collect(element, name, out);
  }

  cv::FileStorage storage_;
  const ForeignSource& source_;
};

Rigid3 ReadPose(const OpenCvReader& in, const ForeignSource& source) {
  const std::string rotation = in.FirstOf(kRotation), translation = in.FirstOf(kTranslation);
  if (rotation.empty() || translation.empty()) {
    source.Refuse(
        "it has no R and T of the second camera (OpenCV's stereo_calib writes these into a "
        "file of their own, extrinsics.yml: put both into one file)");
  }
  const std::vector<double> r = in.Numbers(rotation), t = in.Numbers(translation);
  if (t.size() != 3) source.Refuse("'" + translation + "' is not three numbers");
  const Eigen::Vector3d t_mm = Eigen::Vector3d(t[0], t[1], t[2]) * source.options.length_unit_mm;
  if (r.size() == 3) return Rigid3::FromRotationVector({r[0], r[1], r[2]}, t_mm);
  if (r.size() != 9)
    source.Refuse("'" + rotation + "' is neither a 3x3 matrix nor a rotation vector");
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> matrix(r.data());
  return {CleanRotation(matrix, source), t_mm};
}

}  // namespace

ForeignCalibration ReadOpenCvCalibration(const std::string& text, const ForeignSource& source) {
  const std::size_t start = text.find_first_not_of(" \t\r\n\xEF\xBB\xBF");
  const char first = text[start];
  // OpenCV wants the YAML header that other programs leave out.
  const bool bare_yaml = first != '<' && first != '{' && text.compare(start, 5, "%YAML") != 0;
  const OpenCvReader in(bare_yaml ? "%YAML:1.0\n---\n" + text : text.substr(start), source);
  in.RefuseOtherLenses();
  ForeignCalibration out;
  out.format = "OpenCV";
  const std::string left = in.FirstOf(kLeftMatrix), right = in.FirstOf(kRightMatrix);
  if (left.empty() && right.empty()) {
    const std::string matrix = in.FirstOf(kMatrix), distortion = in.FirstOf(kDistortion);
    if (matrix.empty()) {
      source.Refuse(
          "it has neither the camera matrices of two cameras (M1 and M2, cameraMatrix1 and "
          "cameraMatrix2, ...) nor one camera_matrix");
    }
    if (distortion.empty()) source.Refuse("'distortion_coefficients' is missing");
    out.cameras.push_back(in.ReadCamera(matrix, distortion));
    return out;
  }
  if (left.empty()) source.Refuse("there is a '" + right + "' but no matrix of the other camera");
  if (right.empty()) source.Refuse("there is a '" + left + "' but no matrix of the other camera");
  const std::string left_d = in.FirstOf(kLeftDistortion), right_d = in.FirstOf(kRightDistortion);
  if (left_d.empty() || right_d.empty()) {
    source.Refuse("the distortion coefficients (D1 and D2) are missing");
  }
  out.cameras = {in.ReadCamera(left, left_d), in.ReadCamera(right, right_d)};
  out.right_from_left = ReadPose(in, source);
  if (source.options.length_unit_mm == 1) {
    out.notes.push_back("the file does not say its unit of length: mm was assumed");
  }
  return out;
}

}  // namespace internal

namespace {

template <typename Matrix>
std::string YamlMatrix(const std::string& name, const Matrix& matrix) {
  std::string data;
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) {
      data += fmt::format("{}{:.17e}", data.empty() ? "" : ", ", matrix(r, c));
    }
  }
  return fmt::format("{}: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [ {} ]\n",
                     name, matrix.rows(), matrix.cols(), data);
}

std::string YamlCamera(const Camera& camera, const std::string& number) {
  if (camera.model().IsSplined()) {
    throw InputError(
        "OpenCV has no splined lens model: write a .cameramodel, or calibrate with OPENCV8");
  }
  const Eigen::VectorXd& p = camera.parameters();
  Eigen::Matrix3d matrix;
  matrix << p[0], 0, p[2], 0, p[1], p[3], 0, 0, 1;
  return YamlMatrix("M" + number, matrix) +
         YamlMatrix("D" + number, p.tail(p.size() - 4).transpose().eval());
}

}  // namespace

void WriteOpenCvYaml(const StereoRig& rig, const std::filesystem::path& path) {
  std::string text = "%YAML:1.0\n---\n# Stereo rig by Plumbline; T in mm, x2 = R x1 + T\n";
  text += fmt::format("image_width: {}\nimage_height: {}\n", rig.left.size().width,
                      rig.left.size().height);
  if (!(rig.left.size() == rig.right.size())) {
    throw InputError("the two cameras have different image sizes, which this format cannot say");
  }
  text += YamlCamera(rig.left, "1") + YamlCamera(rig.right, "2");
  text += YamlMatrix("R", rig.right_from_left.rotation);
  text += YamlMatrix("T", rig.right_from_left.translation_mm);
  internal::WriteTextFile(path, text);
}

}  // namespace plumbline
