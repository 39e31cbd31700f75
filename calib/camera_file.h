#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera.h"
#include "calib/optimization_inputs.h"
#include "calib/rigid3.h"
#include "calib/stereo_rig.h"

namespace plumbline {

// ---------------------------------------------------------------------------------------------
// mrcal's .cameramodel
//
// A Python dictionary: lens model, intrinsics, rt_fromref, image size and, if wished, everything
// the calibration was made of, as base-85 text of an .npz archive. The files are in metres; this is
// the one place where they meet our millimetres. Text is written with 17 digits, so that reading
// gives the same bits back; mrcal's own C writer keeps six decimals, up to 7e-4 px of error.
// ---------------------------------------------------------------------------------------------

struct CameraModelFile {
  Camera camera;
  Rigid3 camera_from_reference;              // mm
  std::optional<OptimizationInputs> inputs;  // metres, see OptimizationInputs
  int camera_index_in_inputs = 0;            // which of the inputs' cameras this one is
};

// The text of a .cameramodel file. `inputs` may describe a solve whose optimum differs from
// `camera` (a later refinement): mrcal's tools then compute uncertainties from the inputs alone.
//
// Throws InputError if the inputs are not consistent or have no such camera.
std::string WriteCameraModelText(const Camera& camera, const Rigid3& camera_from_reference,
                                 const OptimizationInputs* inputs = nullptr,
                                 int camera_index_in_inputs = 0);

// Reads such a text, ours or mrcal's (also the older key names it still accepts). PINHOLE models
// are read as OPENCV4 without distortion, which is the same lens.
//
// Throws InputError, naming the file by `name_for_messages`, when it is no camera model, or its
// lens model is not one of ours.
CameraModelFile ReadCameraModelText(std::string_view text, const std::string& name_for_messages);

// The same on files. Writing goes to a temporary name and is renamed when complete.
//
// Throws EnvironmentError where the file cannot be opened or written, and as above.
void WriteCameraModel(const std::filesystem::path& path, const Camera& camera,
                      const Rigid3& camera_from_reference,
                      const OptimizationInputs* inputs = nullptr, int camera_index_in_inputs = 0);
CameraModelFile ReadCameraModel(const std::filesystem::path& path);

// A rig from two such files that share a reference; without calibration modes.
StereoRig ReadCameraModelPair(const std::filesystem::path& left,
                              const std::filesystem::path& right);

// ---------------------------------------------------------------------------------------------
// Calibrations of other programs
//
//   OpenCV YAML, XML, JSON   stereo: (M1 D1 M2 D2 R T) and its usual other spellings; mono:
//                            camera_matrix and distortion_coefficients. Key names:
//                            foreign_opencv.cc
//   DICe XML                 camera system files; LENS_DISTORTION_MODEL none, OPENCV or
//                            K1R3_K2R5_K3R7; rotations as matrix or as Euler angles
//   VIC-3D project XML       <camera id="0">cx cy fx fy skew k1 k2 k3<orientation>...
//   MatchID .caldat          lines 'Cam0_Fx [pixels];1234.5'; cameras numbered 0 and 1, or 1 and 2
//
// Rotations from Euler angles (DICe, VIC-3D, MatchID), in degrees: R = Rz(gamma) Ry(beta)
// Rx(alpha). Two cameras with poses in a world are reduced to the right one seen from the left one;
// camera 0 is taken as the left one, wherever it stands.
//
// What has no counterpart among OPENCV4, 5 and 8 is refused with the reason: thin prism and tilted
// sensor terms, fisheye models, distortion in odd powers. A skew is left out, with a note, as long
// as its largest effect within the image is at most kMaxNeglectedSkew_px; else refused.
// ---------------------------------------------------------------------------------------------

inline constexpr double kMaxNeglectedSkew_px = 0.1;

struct ForeignCalibrationOptions {
  // For files that do not hold it (plain OpenCV ones, MatchID); must agree with a file that does.
  std::optional<ImageSize> image_size;
  // How many mm the file's unit of length is: OpenCV files come in the unit of the board they were
  // made with, often metres (1000). The other formats are in mm.
  double length_unit_mm = 1;
};

struct StereoCalibrationFile {
  StereoRig rig;                   // no calibration modes: those files carry no covariance
  std::string format;              // "OpenCV", "DICe", "VIC-3D", "MatchID"
  std::vector<std::string> notes;  // a sentence each: what was assumed or left out
};

// Reads a calibration of two cameras, finding out itself which program wrote it. Throws InputError
// naming the file, what is missing or does not map, and what to do; EnvironmentError if it cannot
// be opened.
StereoCalibrationFile ReadStereoCalibrationFile(const std::filesystem::path& path,
                                                const ForeignCalibrationOptions& options = {});
StereoRig ReadStereoCalibration(const std::filesystem::path& path,
                                const ForeignCalibrationOptions& options = {});

// Reads a calibration of one camera: .cameramodel, OpenCV or DICe. Throws as above.
Camera ReadCameraCalibration(const std::filesystem::path& path,
                             const ForeignCalibrationOptions& options = {});

// Writes what OpenCV's stereo programs read: M1, D1, M2, D2, R, T (mm), image_width, image_height.
//
// Throws InputError for splined models, which OpenCV does not have; EnvironmentError where the file
// cannot be written.
void WriteOpenCvYaml(const StereoRig& rig, const std::filesystem::path& path);

}  // namespace plumbline
