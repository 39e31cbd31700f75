#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera_file.h"

namespace pugi {
class xml_document;
}

namespace plumbline::internal {

// A camera as other programs describe it, before it is known whether one of our models fits.
struct ForeignCamera {
  double fx = 0, fy = 0, cx = 0, cy = 0;  // px
  double skew_px = 0;                     // x += skew_px * y / z
  Eigen::Matrix<double, 8, 1> distortion = Eigen::Matrix<double, 8, 1>::Zero();  // OpenCV's order
  int coefficient_count = 4;  // 4, 5 or 8: how many the file means
  std::optional<ImageSize> size;
};

// What a foreign file holds: one camera or two.
struct ForeignCalibration {
  std::string format;
  std::vector<ForeignCamera> cameras;
  Rigid3 right_from_left;  // mm, where there are two cameras
  std::vector<std::string> notes;
};

// Context for messages.
struct ForeignSource {
  std::string name;  // of the file
  ForeignCalibrationOptions options;
  [[noreturn]] void Refuse(const std::string& why) const;  // InputError "name: why"
};

// Turns it into one of our cameras; notes what was left out. Refuses what does not map.
Camera ToCamera(const ForeignCamera& camera, const std::string& which, const ForeignSource& source,
                std::vector<std::string>& notes);

// R = Rz(gamma) Ry(beta) Rx(alpha), angles in degrees.
Eigen::Matrix3d RotationFromEulerDegrees(double alpha, double beta, double gamma);

// A rotation as read from text: refuses what is no rotation to 1e-3, and removes the rounding.
Eigen::Matrix3d CleanRotation(const Eigen::Matrix3d& matrix, const ForeignSource& source);

// One finite number and nothing else; a decimal comma is accepted.
std::optional<double> ParseNumber(std::string_view text);

// Every number in a text, whatever stands between them.
std::vector<double> ParseNumbers(std::string_view text);

// The formats. Each throws InputError through `source`.
ForeignCalibration ReadOpenCvCalibration(const std::string& text, const ForeignSource& source);
ForeignCalibration ReadDiceCalibration(const pugi::xml_document& xml, const ForeignSource& source);
ForeignCalibration ReadVic3dCalibration(const pugi::xml_document& xml, const ForeignSource& source);
ForeignCalibration ReadMatchIdCalibration(const std::string& text, const ForeignSource& source);

}  // namespace plumbline::internal
