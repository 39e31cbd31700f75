#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <charconv>
#include <filesystem>
#include <numbers>

#include "apps/calibrate_session.h"
#include "apps/internal/calibration_extras.h"
#include "apps/internal/command.h"
#include "apps/interrupt.h"
#include "calib/calibrate.h"
#include "calib/calibration_report.h"
#include "calib/camera_file.h"
#include "calib/error.h"
#include "io/rig_file.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

constexpr double kDegrees = 180 / std::numbers::pi;

// "3:24:70.02" or "3:24:70.02:0.01".
KnownDistance ParseKnownDistance(const std::string& text) {
  KnownDistance known;
  std::vector<std::string> parts;
  std::size_t begin = 0;
  for (std::size_t i = 0; i <= text.size(); ++i) {
    if (i < text.size() && text[i] != ':') continue;
    parts.push_back(text.substr(begin, i - begin));
    begin = i + 1;
  }
  const auto read = [&](std::size_t k, auto& value) {
    const std::string& part = parts[k];
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    return error == std::errc() && end == part.data() + part.size();
  };
  const bool good = (parts.size() == 3 || parts.size() == 4) && read(0, known.first_id) &&
                    read(1, known.second_id) && read(2, known.distance_mm) &&
                    (parts.size() == 3 || read(3, known.sigma_mm));
  if (!good) {
    throw UsageError(fmt::format(
        "--known-distance takes ID1:ID2:MM or ID1:ID2:MM:SIGMA, for example 0:13:91.02:0.01, not "
        "'{}'.",
        text));
  }
  return known;
}

nlohmann::json PairsAsJson(const Calibration& calibration) {
  nlohmann::json pairs = nlohmann::json::array();
  for (const PairResult& pair : calibration.pairs) {
    pairs.push_back({{"left", pair.left_name},
                     {"right", pair.right_name},
                     {"used", pair.used},
                     {"problem", pair.problem},
                     {"left_points", pair.left_points},
                     {"right_points", pair.right_points},
                     {"outliers", pair.outliers},
                     {"left_rms_px", pair.left_rms_px},
                     {"right_rms_px", pair.right_rms_px},
                     {"tilt_deg", pair.tilt_rad * kDegrees}});
  }
  return pairs;
}

nlohmann::json AsJson(const Calibration& c) {
  nlohmann::json json;
  json["board"] = c.board.Word();
  json["model"] = c.rig.left.model().Name();
  json["baseline_mm"] = c.rig.baseline_mm();
  json["sigma_baseline_mm"] = c.sigma_baseline_mm;
  json["angle_deg"] = c.angle_rad * kDegrees;
  json["sigma_angle_deg"] = c.sigma_angle_rad * kDegrees;
  json["scale_sigma_relative"] = c.scale_sigma;
  json["joint_rms_px"] = c.joint_rms_px;
  json["left_rms_px"] = c.left_rms_px;
  json["right_rms_px"] = c.right_rms_px;
  json["rigid_rms_px"] = c.rigid_rms_px;
  json["points"] = c.point_count;
  json["outliers"] = c.outlier_count;
  json["working_distance_mm"] = c.working_distance_mm;
  json["target_rms_in_plane_mm"] = c.target_rms_in_plane_mm;
  json["target_rms_out_of_plane_mm"] = c.target_rms_out_of_plane_mm;
  json["modes"] = c.rig.modes.count();
  json["warnings"] = c.warnings;
  json["pairs"] = PairsAsJson(c);
  return json;
}

class CalibrateCommand : public Command {
 public:
  std::string Name() const override { return "calibrate"; }
  std::string Summary() const override {
    return "Calibrate a stereo rig from photographs of a board.";
  }
  std::string Footer() const override {
    return "Boards, in one word:\n"
           "  chessboard:12x8:5mm   inner corners across x down, side of a square\n"
           "  circles:14x10:7mm     discs across x down, pitch\n"
           "  acircles:4x11:20mm    asymmetric discs, half the pitch of a row\n"
           "  donut-dots:14x10:7mm  dots with three ring markers, as VIC-3D and DICe use\n"
           "  charuco:5x7:36.2mm:18.3mm:DICT_6X6_250\n"
           "  aprilgrid:6x6:88mm:0.3:tag36h11\n"
           "Example:\n"
           "  plumbline calibrate --board chessboard:9x6:10mm --left 'left*.jpg' --right "
           "'right*.jpg' -o rig.h5";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "board",
                 .help = "what the board is, in one word; see below",
                 .unit = "SPEC",
                 .required = true},
                &board_);
    options.Add({.name = "left",
                 .help = "photographs of the left camera: a pattern in quotes, a folder or a video",
                 .unit = "FILES",
                 .required = true},
                &left_);
    options.Add(
        {.name = "right", .help = "those of the right camera", .unit = "FILES", .required = true},
        &right_);
    options.Add({.name = "output",
                 .help = "rig file; left.cameramodel, right.cameramodel and an OpenCV YAML are "
                         "written beside it",
                 .unit = "FILE",
                 .short_name = "o"},
                &output_);
    options.Add({.name = "frames",
                 .help = "which pairs, as start:stop:step counted from 0; empty: all",
                 .unit = "A:B:C"},
                &frames_);
    options.Add({.name = "model",
                 .help = "lens model: opencv4, opencv5, opencv8, a splined one by mrcal's name, or "
                         "auto to let held-out pairs decide",
                 .unit = "NAME"},
                &model_);
    options.Add({.name = "target-sigma",
                 .help = "how far a point of the board may lie from its nominal place; 0.1 suits a "
                         "printed sheet",
                 .unit = "mm",
                 .min = 1e-6},
                &options_.target_sigma_mm);
    options.Add(
        {.name = "rigid-target", .help = "trust the board: every point at its nominal place"},
        &options_.rigid_target);
    options.Add({.name = "scale-sigma",
                 .help = "relative standard deviation of the board's overall scale, which no "
                         "photograph can tell",
                 .min = 0,
                 .max = 0.5},
                &options_.scale_sigma);
    options.Add({.name = "known-distance",
                 .help = "a length on the board that was measured, between two of its point "
                         "numbers; sets the scale",
                 .unit = "ID1:ID2:MM[:SIGMA]"},
                &known_distance_);
    options.Add({.name = "outlier-sigmas",
                 .help = "points further off than this are left out",
                 .unit = "sigmas",
                 .min = 2},
                &options_.outlier_sigmas);
  }

  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  std::string board_, left_, right_, frames_, model_ = "opencv5", known_distance_;
  std::string output_ = "rig.h5";
  CalibrationOptions options_;
};

CommandReport CalibrateCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  const BoardSpec board = BoardSpec::Parse(board_);
  CalibrationOptions options = options_;
  options.seed = common.seed;
  if (model_ != "auto") {
    try {
      options.model = LensModel::FromName(model_);
    } catch (const InputError& error) {
      throw UsageError(fmt::format("--model: {}", error.what()));
    }
  }
  if (!known_distance_.empty()) options.known_distance = ParseKnownDistance(known_distance_);
  options.Check();

  const fs::path rig_file = fs::absolute(output_);
  if (!fs::is_directory(rig_file.parent_path())) {
    throw EnvironmentError(fmt::format("There is no folder '{}' to write into; make it first.",
                                       rig_file.parent_path().string()));
  }
  ImageSourceOptions source_options;
  source_options.frames = frames_;
  const auto source = OpenImageSource(left_, right_, source_options);
  const InterruptGuard guard;
  const DetectedPairs detected = DetectPairs(board, *source, common.progress());
  for (const std::string& note : detected.notes) spdlog::info("Note: {}", note);
  if (detected.interrupted) {
    spdlog::error("Stopped; nothing was written.");
    return {"", {{"interrupted", true}}, 130};
  }
  for (const CalibrationPair& pair : detected.pairs) {
    spdlog::debug("{}: {} points{}, {}: {} points{}", pair.left_name, pair.left.ids.size(),
                  pair.left.problem.empty() ? "" : " (" + pair.left.problem + ")", pair.right_name,
                  pair.right.ids.size(),
                  pair.right.problem.empty() ? "" : " (" + pair.right.problem + ")");
  }
  const auto calibration =
      Calibrate(board, detected.left_size, detected.right_size, detected.pairs, options,
                [&](const std::string& doing) { spdlog::info("{}", doing); });

  RigFileExtras extras = CalibrationExtras(calibration);
  extras.recipe_toml = recipe_toml;
  extras.inputs = source->Files();
  const OptimizationInputs* inputs = calibration.optimization_inputs.get();
  extras.left_model_text = WriteCameraModelText(calibration.rig.left, Rigid3{}, inputs, 0);
  extras.right_model_text =
      WriteCameraModelText(calibration.rig.right, calibration.rig.right_from_left, inputs, 1);
  WriteRigFile(rig_file, calibration.rig, extras);
  const fs::path folder = rig_file.parent_path();
  const fs::path left_model = folder / "left.cameramodel";
  const fs::path right_model = folder / "right.cameramodel";
  WriteCameraModel(left_model, calibration.rig.left, Rigid3{}, inputs, 0);
  WriteCameraModel(right_model, calibration.rig.right, calibration.rig.right_from_left, inputs, 1);
  std::vector<std::string> written = {rig_file.string(), left_model.string(), right_model.string()};
  if (!calibration.rig.left.model().IsSplined()) {
    const fs::path yaml = fs::path(rig_file).replace_extension(".yaml");
    WriteOpenCvYaml(calibration.rig, yaml);
    written.push_back(yaml.string());
  }
  CommandReport report;
  report.text = CalibrationReport(calibration);
  report.text +=
      fmt::format("\nWrote {} (for plumbline measure --rig), and for other programs {}.\n",
                  written.front(), fmt::join(written.begin() + 1, written.end(), ", "));
  report.json = AsJson(calibration);
  report.json["files"] = written;
  report.json["notes"] = detected.notes;
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeCalibrateCommand() { return std::make_unique<CalibrateCommand>(); }

}  // namespace plumbline::internal
