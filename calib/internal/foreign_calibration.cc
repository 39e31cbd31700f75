#include "calib/internal/foreign_calibration.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>
#include <pugixml.hpp>

#include "calib/error.h"
#include "calib/internal/text_file.h"

namespace plumbline::internal {
namespace {

constexpr std::size_t kMaxFileBytes = std::size_t{64}
                                      << 20;  // VIC-3D projects list all their images

ForeignCalibration ReadForeign(const std::filesystem::path& path, const ForeignSource& source) {
  const std::string text = ReadTextFile(path, kMaxFileBytes);
  const std::size_t start = text.find_first_not_of(" \t\r\n\xEF\xBB\xBF");
  if (start == std::string::npos) source.Refuse("the file is empty");
  if (text[start] != '<') {
    const bool key_value =
        text.find("_Fx") != std::string::npos && text.find(';') != std::string::npos;
    return key_value ? ReadMatchIdCalibration(text, source) : ReadOpenCvCalibration(text, source);
  }
  pugi::xml_document xml;
  const pugi::xml_parse_result parsed = xml.load_buffer(text.data(), text.size());
  if (!parsed) {
    source.Refuse(
        fmt::format("it is no sound XML: {} at byte {}", parsed.description(), parsed.offset));
  }
  const std::string root = xml.document_element().name();
  if (root == "opencv_storage") return ReadOpenCvCalibration(text, source);
  if (root == "ParameterList") return ReadDiceCalibration(xml, source);
  if (!xml.select_node("//camera/orientation").node().empty())
    return ReadVic3dCalibration(xml, source);
  source.Refuse(
      "this XML is no calibration of OpenCV (<opencv_storage>), DICe (<ParameterList>) or "
      "VIC-3D (<camera> with <orientation>)");
}

}  // namespace

void ForeignSource::Refuse(const std::string& why) const { throw InputError(name + ": " + why); }

std::optional<double> ParseNumber(std::string_view text) {
  std::string cleaned(text);
  const std::size_t first = cleaned.find_first_not_of(" \t\r\n\"");
  if (first == std::string::npos) return std::nullopt;
  cleaned = cleaned.substr(first, cleaned.find_last_not_of(" \t\r\n\"") - first + 1);
  std::replace(cleaned.begin(), cleaned.end(), ',', '.');
  if (cleaned[0] == '+') cleaned.erase(0, 1);
  double number = 0;
  const char* end = cleaned.data() + cleaned.size();
  const auto [last, error] = std::from_chars(cleaned.data(), end, number);
  if (error != std::errc() || last != end || !std::isfinite(number)) return std::nullopt;
  return number;
}

std::vector<double> ParseNumbers(std::string_view text) {
  std::vector<double> numbers;
  constexpr std::string_view kSeparators = " \t\r\n,;{}[]()";
  for (std::size_t at = 0;
       (at = text.find_first_not_of(kSeparators, at)) != std::string_view::npos;) {
    const std::size_t end = std::min(text.find_first_of(kSeparators, at), text.size());
    const auto number = ParseNumber(text.substr(at, end - at));
    if (!number) return {};
    numbers.push_back(*number);
    at = end;
  }
  return numbers;
}

Eigen::Matrix3d RotationFromEulerDegrees(double alpha, double beta, double gamma) {
  const double degree = std::numbers::pi / 180;
  return (Eigen::AngleAxisd(gamma * degree, Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(beta * degree, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(alpha * degree, Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

Eigen::Matrix3d CleanRotation(const Eigen::Matrix3d& matrix, const ForeignSource& source) {
  const double defect = (matrix.transpose() * matrix - Eigen::Matrix3d::Identity()).norm();
  if (!(defect < 1e-3) || !(matrix.determinant() > 0)) {
    source.Refuse("its rotation matrix is no rotation (R'R differs from 1)");
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(matrix, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

Camera ToCamera(const ForeignCamera& camera, const std::string& which, const ForeignSource& source,
                std::vector<std::string>& notes) {
  const auto& wanted = source.options.image_size;
  if (!camera.size && !wanted) {
    source.Refuse("it does not hold the image size; give it with --image-size WIDTHxHEIGHT");
  }
  if (camera.size && wanted && !(*camera.size == *wanted)) {
    source.Refuse(fmt::format("it is for images of {}x{}, not of {}x{}", camera.size->width,
                              camera.size->height, wanted->width, wanted->height));
  }
  const ImageSize size = camera.size ? *camera.size : *wanted;
  if (camera.skew_px != 0) {
    // x = fx u + skew v + cx: the effect grows with the height above or below the centre.
    const double effect_px =
        std::abs(camera.skew_px / camera.fy) * std::max(camera.cy, size.height - 1 - camera.cy);
    if (!(effect_px <= kMaxNeglectedSkew_px)) {
      source.Refuse(
          fmt::format("{} has a skew of {:.4g} px, worth {:.3g} px at the edge of its image, and "
                      "none of our lens "
                      "models has skew (up to {} px is left out); calibrate again without it",
                      which, camera.skew_px, effect_px, kMaxNeglectedSkew_px));
    }
    notes.push_back(
        fmt::format("{}: the skew of {:.4g} px was left out; it is worth at most {:.2g} px", which,
                    camera.skew_px, effect_px));
  }
  LensModel model;
  const auto& d = camera.distortion;
  int count = camera.coefficient_count;
  if (count < 8 && (d.tail<3>().array() != 0).any()) count = 8;
  if (count < 5 && d[4] != 0) count = 5;
  model.kind = count == 8   ? LensModel::Kind::kOpenCv8
               : count == 5 ? LensModel::Kind::kOpenCv5
                            : LensModel::Kind::kOpenCv4;
  Eigen::VectorXd parameters(4 + count);
  parameters << camera.fx, camera.fy, camera.cx, camera.cy, d.head(count);
  try {
    return Camera(model, size, std::move(parameters));
  } catch (const std::invalid_argument& error) {
    source.Refuse(which + ": " + error.what());
  }
}

}  // namespace plumbline::internal

namespace plumbline {

StereoCalibrationFile ReadStereoCalibrationFile(const std::filesystem::path& path,
                                                const ForeignCalibrationOptions& options) {
  const internal::ForeignSource source{path.string(), options};
  internal::ForeignCalibration file = internal::ReadForeign(path, source);
  if (file.cameras.size() != 2) {
    source.Refuse(
        fmt::format("it holds {} camera(s), and a stereo rig has two", file.cameras.size()));
  }
  if (!(file.right_from_left.translation_mm.norm() > 0)) {
    source.Refuse("both cameras stand at the same place, so nothing can be triangulated");
  }
  const Camera left = internal::ToCamera(file.cameras[0], "the left camera", source, file.notes);
  const Camera right = internal::ToCamera(file.cameras[1], "the right camera", source, file.notes);
  return {StereoRig{left, right, file.right_from_left, {}, ""}, file.format, std::move(file.notes)};
}

StereoRig ReadStereoCalibration(const std::filesystem::path& path,
                                const ForeignCalibrationOptions& options) {
  return ReadStereoCalibrationFile(path, options).rig;
}

Camera ReadCameraCalibration(const std::filesystem::path& path,
                             const ForeignCalibrationOptions& options) {
  const internal::ForeignSource source{path.string(), options};
  if (path.extension() == ".cameramodel") return ReadCameraModel(path).camera;
  internal::ForeignCalibration file = internal::ReadForeign(path, source);
  if (file.cameras.size() != 1) {
    source.Refuse(fmt::format("it holds {} cameras where one is wanted", file.cameras.size()));
  }
  return internal::ToCamera(file.cameras[0], "the camera", source, file.notes);
}

}  // namespace plumbline
