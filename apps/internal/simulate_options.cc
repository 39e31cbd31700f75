#include "apps/internal/simulate_options.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <sstream>

#include "apps/internal/measure_report.h"
#include "apps/rig_input.h"
#include "calib/error.h"

namespace plumbline::internal {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kWheelbase_mm = 2794;  // of a Land Rover 110

std::vector<double> NumbersOf(const std::string& text, const std::string& option) {
  std::vector<double> numbers;
  std::istringstream in(text);
  for (std::string item; std::getline(in, item, ',');) {
    std::size_t used = 0;
    double value = 0;
    try {
      value = std::stod(item, &used);
    } catch (const std::exception&) {
    }
    if (used == 0 || used != item.size() || !std::isfinite(value)) {
      throw UsageError(fmt::format("--{} takes numbers between commas, not '{}'.", option, text));
    }
    numbers.push_back(value);
  }
  return numbers;
}

template <typename T>
void Set(const std::optional<T>& from, T& to, double factor = 1) {
  if (from) to = static_cast<T>(*from * factor);
}

}  // namespace

void SimulateOptions::Declare(OptionTable& options) {
  options.Add({.name = "scenario",
               .help = "what is recorded; 'list' names all scenarios",
               .required = true,
               .positional = true},
              &scenario_);
  options.Add({.name = "frame-count", .help = "frames exposed", .min = 1, .max = 1e6},
              &frame_count_);
  options.Add({.name = "fps", .help = "frames a second", .unit = "1/s", .min = 1e-6}, &fps_);
  options.Add({.name = "drop", .help = "frames that are lost, by index, as 3,7", .unit = "LIST"},
              &dropped_);
  options.Add({.name = "images",
               .help = "how images are written: PNG folders, or lossless video (FFV1)",
               .choices = {"png", "mkv", "avi"}},
              &images_);
  options.Add({.name = "step",
               .help = "distance between the truth's points",
               .unit = "px",
               .min = 1,
               .max = 10000},
              &step_);
  options.Add({.name = "points",
               .help = "the truth's points: the same pixels in every frame, or the material seen "
                       "there in the first one",
               .choices = {"auto", "image", "material"}},
              &points_);
  DeclareCameras(options);
  DeclareTyre(options);
  DeclareCalibration(options);
}

void SimulateOptions::DeclareCameras(OptionTable& options) {
  options.Add({.name = "cameras",
               .help = "wide640 and wide1280: a 3.5 mm lens in a tyre, 640x480 and 1280x1024; "
                       "laboratory: 25 mm, half a metre away",
               .choices = {"auto", "wide640", "wide1280", "laboratory"}},
              &cameras_);
  options.Add({.name = "image-size", .help = "another size of image", .unit = "WxH px"},
              &image_size_);
  options.Add({.name = "lens", .help = "another focal length", .unit = "mm", .min = 1e-3},
              &lens_mm_);
  options.Add({.name = "pixel", .help = "another size of pixel", .unit = "um", .min = 1e-3},
              &pixel_um_);
  options.Add({.name = "baseline",
               .help = "another distance between the cameras",
               .unit = "mm",
               .min = 1e-3},
              &baseline_mm_);
  options.Add(
      {.name = "distance", .help = "another distance from the surface", .unit = "mm", .min = 1e-3},
      &distance_mm_);
  options.Add(
      {.name = "rig",
       .help = "the true cameras from a rig file, as for plumbline measure, instead of these",
       .unit = "FILE"},
      &rig_);
  options.Add({.name = "bits", .help = "bits of a grey level", .min = 8, .max = 16}, &bits_);
  options.Add({.name = "gain", .help = "grey levels (of 8 bits) an electron", .min = 1e-6}, &gain_);
  options.Add(
      {.name = "read-noise", .help = "sigma of the read noise", .unit = "grey levels", .min = 0},
      &read_noise_);
  options.Add({.name = "noise-free", .help = "no noise at all, but for the rounding"},
              &noise_free_);
  options.Add(
      {.name = "exposure", .help = "exposure time; 0: no motion blur", .unit = "ms", .min = 0},
      &exposure_ms_);
  options.Add(
      {.name = "right-delay", .help = "by how much the right camera exposes later", .unit = "ms"},
      &right_delay_ms_);
  options.Add({.name = "psf",
               .help = "sigma of the lens's point-spread function",
               .unit = "px",
               .min = 0,
               .max = 5},
              &psf_);
  options.Add(
      {.name = "samples", .help = "samples across a pixel, in each direction", .min = 1, .max = 32},
      &samples_);
  options.Add(
      {.name = "brightness",
       .help = "of a white surface in full light, black level apart; the sensor clips at 255",
       .unit = "grey levels",
       .min = 1,
       .max = 10000},
      &brightness_);
  options.Add({.name = "flicker",
               .help = "sigma of the light between frames, relative",
               .min = 0,
               .max = 0.3},
              &flicker_);
  options.Add({.name = "vignetting",
               .help = "loss of light at the image's corner, relative",
               .min = 0,
               .max = 0.99},
              &vignetting_);
  options.Add({.name = "ambient",
               .help = "share of the light that comes evenly from everywhere",
               .min = 0,
               .max = 1},
              &ambient_);
  options.Add({.name = "speckle",
               .help = "mean diameter of a speckle; auto: 4.4 px in the middle",
               .unit = "mm",
               .min = 1e-3},
              &speckle_mm_);
  options.Add({.name = "speckle-coverage",
               .help = "share of the surface that speckles cover",
               .min = 0.01,
               .max = 5},
              &speckle_coverage_);
  options.Add({.name = "speckle-edge",
               .help = "width of a speckle's soft edge, in radii",
               .min = 0.01,
               .max = 2},
              &speckle_edge_);
}

void SimulateOptions::DeclareTyre(OptionTable& options) {
  options.Add({.name = "speed", .help = "of the vehicle", .unit = "m/s", .min = 0, .max = 100},
              &speed_m_s_);
  options.Add({.name = "speed-swing",
               .help = "amplitude of a change of speed once a second",
               .unit = "m/s"},
              &speed_swing_m_s_);
  options.Add({.name = "start",
               .help = "way of the wheel axis ahead of the first obstacle's place",
               .unit = "mm"},
              &start_mm_);
  options.Add({.name = "slip-ratio",
               .help = "longitudinal slip, ISO 8855 (braking: negative)",
               .min = -0.1,
               .max = 0.1},
              &slip_ratio_);
  options.Add(
      {.name = "slip-angle", .help = "slip angle, ISO 8855", .unit = "deg", .min = -7, .max = 7},
      &slip_angle_deg_);
  options.Add({.name = "tags",
               .help = "AprilTags evenly around the inner surface, at 40 mm to both sides of its "
                       "middle in turn, as 36h11:12:24mm; empty: none",
               .unit = "FAMILY:COUNT:SIZE"},
              &tags_);
  options.Add({.name = "mounting",
               .help = "how the rig is turned against looking straight down: rotation vector in "
                       "the ground's axes; empty: the scenario's",
               .unit = "X,Y,Z deg"},
              &mounting_deg_);
  options.Add({.name = "flexure",
               .help = "pitch of the torque arm an acceleration of 1 m/s2",
               .unit = "deg"},
              &flexure_deg_);
  options.Add({.name = "vehicle-pitch",
               .help = "whether the vehicle pitches as the axle rises; auto: the scenario's",
               .choices = {"auto", "on", "off"}},
              &vehicle_pitch_);
  options.Add({.name = "vibration",
               .help = "amplitude of the right camera against the left one",
               .unit = "deg",
               .min = 0},
              &vibration_deg_);
  options.Add({.name = "channel-rate",
               .help = "samples a second of channels.csv",
               .unit = "Hz",
               .min = 1e-3,
               .max = 1e5},
              &channel_rate_hz_);
  options.Add({.name = "channel-offset",
               .help = "clock of channels.csv less that of the cameras",
               .unit = "s"},
              &channel_offset_s_);
}

void SimulateOptions::DeclareCalibration(OptionTable& options) {
  options.Add({.name = "calibration",
               .help = "pairs of photographs of a calibration board; 0: none",
               .min = 0,
               .max = 10000},
              &calibration_pairs_);
  options.Add({.name = "board",
               .help = "the board, as for plumbline calibrate; empty: one that suits the cameras",
               .unit = "SPEC"},
              &board_);
  options.Add(
      {.name = "careless",
       .help = "the board is held as one should not: frontal, in the middle, at one distance"},
      &careless_);
  options.Add({.name = "bend", .help = "depth of the board's bend", .unit = "mm"}, &bend_mm_);
  options.Add({.name = "misprint",
               .help = "rms distance of its points from their places",
               .unit = "mm",
               .min = 0},
              &misprint_mm_);
  options.Add({.name = "white-on-black", .help = "the board has white dots on black"},
              &white_on_black_);
  options.Add({.name = "min-distance",
               .help = "of the board from the left camera",
               .unit = "mm",
               .min = 1e-3},
              &min_distance_mm_);
  options.Add({.name = "max-distance",
               .help = "of the board from the left camera",
               .unit = "mm",
               .min = 1e-3},
              &max_distance_mm_);
}

Scenario SimulateOptions::OnItsCameras() const {
  RigDesign design = DesignOf(cameras_ == "wide640"      ? RigKind::kWide640
                              : cameras_ == "wide1280"   ? RigKind::kWide1280
                              : cameras_ == "laboratory" ? RigKind::kLaboratory
                                                         : RigOf(scenario_));
  const bool designed = lens_mm_ || pixel_um_ || baseline_mm_ || !image_size_.empty();
  if (!rig_.empty()) {
    if (designed || cameras_ != "auto") {
      throw UsageError(
          "--rig says all of the cameras: leave out --cameras, --image-size, --lens, --pixel and "
          "--baseline.");
    }
    RigInput input = OpenRig(rig_);
    input.rig.modes = {};  // these cameras are the truth
    if (!distance_mm_ && !input.working_distance_mm) {
      throw UsageError(
          fmt::format("'{}' does not say how far away its cameras look; give --distance.", rig_));
    }
    return MakeScenario(scenario_, input.rig,
                        distance_mm_ ? *distance_mm_ : *input.working_distance_mm);
  }
  if (!image_size_.empty()) design.image_size = ParseImageSize(image_size_);
  Set(lens_mm_, design.lens_mm);
  Set(pixel_um_, design.pixel_um);
  Set(baseline_mm_, design.baseline_mm);
  Set(distance_mm_, design.distance_mm);
  return MakeScenario(scenario_, MakeRig(design), design.distance_mm);
}

VirtualRig SimulateOptions::Rig(std::uint64_t seed) const {
  Scenario scenario = OnItsCameras();
  scenario.seed = scenario.speckle.seed = seed;
  ApplyTo(scenario);
  ApplyToTyre(scenario);
  return VirtualRig(std::move(scenario));
}

VirtualRig SimulateOptions::RigAgain(const std::filesystem::path& rig_file, std::uint64_t seed) {
  if (!rig_.empty()) rig_ = rig_file.string();
  return Rig(seed);
}

void SimulateOptions::ApplyTo(Scenario& scenario) const {
  if (auto* specimen = std::get_if<SpecimenOptions>(&scenario.surface)) {
    // As many frames and as fast as it may be, the last one has the full deformation.
    const double frames = std::max(2, frame_count_.value_or(scenario.frames));
    specimen->end_time_s = (frames - 1) / fps_.value_or(scenario.frames_per_second);
  }
  Set(frame_count_, scenario.frames);
  Set(fps_, scenario.frames_per_second);
  Set(step_, scenario.step_px);
  if (points_ != "auto") scenario.follow_material = points_ == "material";
  if (!dropped_.empty()) {
    scenario.dropped.clear();
    for (const double index : NumbersOf(dropped_, "drop")) {
      if (index != std::floor(index) || std::abs(index) > 1e9) {
        throw UsageError(fmt::format("--drop takes whole numbers, not '{}'.", dropped_));
      }
      scenario.dropped.push_back(static_cast<int>(index));
    }
  } else {
    // Of a shorter run the scenario's own.
    std::erase_if(scenario.dropped, [&](int index) { return index >= scenario.frames; });
  }
  Set(bits_, scenario.sensor.bits);
  Set(gain_, scenario.sensor.gain_grey);
  Set(read_noise_, scenario.sensor.read_noise_grey);
  if (noise_free_) scenario.sensor.noise = false;
  Set(exposure_ms_, scenario.exposure_s, 1e-3);
  Set(right_delay_ms_, scenario.right_delay_s, 1e-3);
  Set(psf_, scenario.render.psf_sigma_px);
  Set(samples_, scenario.render.samples_per_px);
  Set(brightness_, scenario.render.full_scale_grey);
  Set(flicker_, scenario.lighting.flicker);
  Set(vignetting_, scenario.lighting.vignetting);
  Set(ambient_, scenario.lighting.ambient);
  Set(speckle_mm_, scenario.speckle.diameter_mm);
  Set(speckle_coverage_, scenario.speckle.coverage);
  Set(speckle_edge_, scenario.speckle.edge);
  if (!mounting_deg_.empty()) {
    const std::vector<double> turn = NumbersOf(mounting_deg_, "mounting");
    if (turn.size() != 3) throw UsageError("--mounting takes three angles, as 0,1.5,0.");
    scenario.motion.mounting_rad = kDegree * Eigen::Vector3d(turn[0], turn[1], turn[2]);
  }
  Set(vibration_deg_, scenario.motion.vibration_rad, kDegree);
}

void SimulateOptions::ApplyToTyre(Scenario& scenario) const {
  auto* tyre = std::get_if<TyreOptions>(&scenario.surface);
  if (tyre == nullptr) {
    if (speed_m_s_ || speed_swing_m_s_ || start_mm_ || slip_ratio_ || slip_angle_deg_ ||
        flexure_deg_ || vehicle_pitch_ != "auto" || !tags_.empty()) {
      throw UsageError(fmt::format(
          "There is no tyre in the scenario '{}': leave out --speed, --speed-swing, --start, "
          "--slip-ratio, --slip-angle, --flexure, --vehicle-pitch and --tags.",
          scenario.name));
    }
    return;
  }
  Set(speed_m_s_, tyre->speed_mm_s, 1000);
  Set(speed_swing_m_s_, tyre->speed_swing_mm_s, 1000);
  Set(start_mm_, tyre->start_travel_mm);
  Set(slip_ratio_, tyre->slip_ratio);
  Set(slip_angle_deg_, tyre->slip_angle_rad, kDegree);
  if (!tags_.empty()) scenario.tags = WheelTagOptions::Parse(tags_);
  Set(flexure_deg_, scenario.motion.flexure_rad_per_m_s2, kDegree);
  if (vehicle_pitch_ != "auto") {
    scenario.motion.wheelbase_mm = vehicle_pitch_ == "on" ? kWheelbase_mm : 0;
  }
}

RecordingOptions SimulateOptions::Recording(const Scenario& scenario, std::uint64_t seed) const {
  RecordingOptions options;
  options.images = images_ == "png"   ? RecordingOptions::Images::kPng
                   : images_ == "mkv" ? RecordingOptions::Images::kMkv
                                      : RecordingOptions::Images::kAvi;
  options.channels.rate_hz = channel_rate_hz_;
  options.channels.clock_offset_s = channel_offset_s_;
  options.channels.noise = scenario.sensor.noise;
  options.channels.seed = seed;
  if (calibration_pairs_ == 0) {
    if (!board_.empty() || careless_ || white_on_black_ || bend_mm_ != 0 || misprint_mm_ != 0 ||
        min_distance_mm_ || max_distance_mm_) {
      throw UsageError(
          "Options of the board want photographs of it: say how many pairs with --calibration.");
    }
    return options;
  }
  const double distance = scenario.distance_mm;
  const bool wide = scenario.rig.left.parameters()[0] < scenario.rig.left.size().width;
  CalibrationPhotographs photographs;
  photographs.board = BoardSpec::Parse(!board_.empty() ? board_
                                       : wide          ? "charuco:11x8:12mm:9mm:DICT_5X5_100"
                                                       : "donut-dots:14x10:7mm");
  photographs.print.white_on_black = white_on_black_;
  photographs.print.background = scenario.render.background_albedo;
  photographs.flaws = {.bend_mm = bend_mm_, .misprint_mm = misprint_mm_, .seed = seed};
  photographs.poses.style =
      careless_ ? BoardPoseOptions::Style::kCareless : BoardPoseOptions::Style::kCareful;
  photographs.poses.count = calibration_pairs_;
  photographs.poses.min_distance_mm = min_distance_mm_.value_or((wide ? 0.7 : 0.94) * distance);
  photographs.poses.max_distance_mm = max_distance_mm_.value_or((wide ? 1.3 : 1.06) * distance);
  photographs.poses.seed = seed;
  options.calibration = photographs;
  return options;
}

VirtualRig ReopenVirtualRig(const std::string& folder) {
  const std::filesystem::path recipe = std::filesystem::path(folder) / "recipe.toml";
  if (!std::filesystem::exists(recipe)) {
    throw InputError(fmt::format(
        "There is no recipe.toml in '{}'; name the folder that plumbline simulate wrote.", folder));
  }
  CLI::App app;
  OptionTable table(app, "simulate");
  SimulateOptions options;
  std::uint64_t seed = 1;
  int threads = 0;  // in every recipe; images do not depend on it
  options.Declare(table);
  table.Add({.name = "seed", .help = "seed of every random choice"}, &seed);
  table.Add({.name = "threads", .help = "how many threads were used"}, &threads);
  table.ReadRecipe(recipe);
  table.Finish();
  return options.RigAgain(std::filesystem::path(folder) / "rig.h5", seed);
}

}  // namespace plumbline::internal
