#include "io/noise_file.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "calib/error.h"
#include "io/internal/durable_file.h"
#include "io/version.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

constexpr const char* kFormat = "plumbline-noise";

constexpr double kLargest = 1e12;
constexpr int kMostPixels = 1'000'000;

// Reads the numbers of one table, or says which is missing or out of range.
class TableReader {
 public:
  TableReader(const fs::path& path, std::string name, const toml::table& table)
      : path_(path), name_(std::move(name)), table_(table) {}

  double Number(const char* key, double min, double max) const {
    return Checked(table_[key].value<double>(), key, min, max);
  }
  int Whole(const char* key, int min, int max) const {
    return static_cast<int>(Number(key, min, max));
  }
  std::string Text(const char* key) const { return table_[key].value_or(std::string()); }
  // Element i of an array.
  double Element(const char* key, std::size_t i) const {
    return Checked(table_[key][i].value<double>(), key, 0, kLargest);
  }
  std::optional<TableReader> Inner(const char* key) const {
    const toml::table* const table = table_[key].as_table();
    if (table == nullptr) return std::nullopt;
    return TableReader(path_, fmt::format("{}.{}", name_, key), *table);
  }
  TableReader Needed(const char* key) const {
    if (const auto inner = Inner(key)) return *inner;
    throw InputError(fmt::format("The noise file {} cannot be used: [{}] needs a table {}.",
                                 path_.string(), name_, key));
  }

 private:
  double Checked(std::optional<double> value, const char* key, double min, double max) const {
    if (!value || !std::isfinite(*value) || *value < min || *value > max) {
      throw InputError(
          fmt::format("The noise file {} cannot be used: [{}] needs {} as a number from {} to {}.",
                      path_.string(), name_, key, min, max));
    }
    return *value;
  }

  const fs::path& path_;
  std::string name_;
  const toml::table& table_;
};

CameraNoise ReadTable(const TableReader& table) {
  CameraNoise noise;
  noise.bits = table.Whole("bits", 8, 16);
  noise.model = {table.Number("offset_grey2", 0, kLargest),
                 table.Number("slope_grey", 0, kLargest)};
  const double sigma_offset = table.Number("sigma_offset_grey2", 0, kLargest);
  const double sigma_slope = table.Number("sigma_slope_grey", 0, kLargest);
  const double together =
      table.Number("offset_slope_correlation", -1, 1) * sigma_offset * sigma_slope;
  noise.cov << sigma_offset * sigma_offset, together, together, sigma_slope * sigma_slope;
  noise.frames = table.Whole("frames", 0, kMostPixels);
  noise.size = {table.Whole("width", 0, kMostPixels), table.Whole("height", 0, kMostPixels)};
  noise.lowest_grey = table.Number("lowest_grey", 0, 65535);
  noise.highest_grey = table.Number("highest_grey", 0, 65535);
  noise.created = table.Text("created");
  return noise;
}

// The numbers of a component as the file holds them.
struct FloorKey {
  const char* name;
  double FloorComponent::*value;
  const char* comment;
};
constexpr FloorKey kFloorKeys[] = {
    {"noise", &FloorComponent::noise, "of the difference between two pairs, rms over points"},
    {"predicted", &FloorComponent::predicted, "the same as the sigmas have it"},
    {"sigma_ratio", &FloorComponent::sigma_ratio, "of noise over predicted"},
    {"common", &FloorComponent::common, "what all points did together since the first pair"},
    {"bias", &FloorComponent::bias, "of the later pairs' mean, from the first one"},
    {"predicted_bias", &FloorComponent::predicted_bias, "the same as the sigmas have it"},
};

template <std::size_t N>
std::array<FloorComponent, N> ReadComponents(const TableReader& table) {
  std::array<FloorComponent, N> out;
  for (const FloorKey& key : kFloorKeys) {
    for (std::size_t i = 0; i < N; ++i) out[i].*key.value = table.Element(key.name, i);
  }
  return out;
}

template <std::size_t N>
std::string ComponentsText(const char* name, const std::array<FloorComponent, N>& components) {
  std::string text = fmt::format("\n[floor.{}]\n", name);
  std::array<double, N> numbers;
  for (const FloorKey& key : kFloorKeys) {
    for (std::size_t i = 0; i < N; ++i) numbers[i] = components[i].*key.value;
    text += fmt::format("{} = [{}]  # {}\n", key.name, fmt::join(numbers, ", "), key.comment);
  }
  for (std::size_t i = 0; i < N; ++i) numbers[i] = components[i].ratio();
  return text + fmt::format("ratio = [{:.4f}]  # noise over predicted\n", fmt::join(numbers, ", "));
}

NoiseFloor ReadFloor(const TableReader& table) {
  NoiseFloor floor;
  floor.frames = table.Whole("frames", 2, kMostPixels);
  floor.points = static_cast<std::int64_t>(table.Number("points", 1, kLargest));
  floor.step_px = table.Whole("step_px", 1, kMostPixels);
  floor.subset_px = table.Whole("subset_px", 1, kMostPixels);
  floor.frame = table.Text("frame");
  floor.left_px = ReadComponents<2>(table.Needed("left_px"));
  floor.right_px = ReadComponents<2>(table.Needed("right_px"));
  floor.displacement_mm = ReadComponents<3>(table.Needed("displacement_mm"));
  const auto strain = table.Inner("strain");
  if (!strain) return floor;
  floor.strain = ReadComponents<3>(*strain);
  floor.strain_points = static_cast<std::int64_t>(strain->Number("points", 1, kLargest));
  floor.vsg_px = strain->Whole("vsg_px", 1, kMostPixels);
  floor.strain_measure = strain->Text("measure");
  return floor;
}

std::string FloorText(const NoiseFloor& floor) {
  std::string text = fmt::format(
      "\n[floor]  # of displacement and strain, from static pairs\n"
      "frames = {}\n"
      "points = {}  # that all frames have\n"
      "step_px = {}\n"
      "subset_px = {}\n"
      "frame = \"{}\"  # whose axes the displacement is told in\n",
      floor.frames, floor.points, floor.step_px, floor.subset_px, floor.frame);
  text += ComponentsText("left_px", floor.left_px) + ComponentsText("right_px", floor.right_px) +
          ComponentsText("displacement_mm", floor.displacement_mm);
  if (!floor.strain) return text;
  return text + ComponentsText("strain", *floor.strain) +
         fmt::format("points = {}\nvsg_px = {}\nmeasure = \"{}\"\n", floor.strain_points,
                     floor.vsg_px, floor.strain_measure);
}

std::string TableText(const std::string& camera, const CameraNoise& noise) {
  const double sigma_offset = std::sqrt(noise.cov(0, 0)), sigma_slope = std::sqrt(noise.cov(1, 1));
  const double product = sigma_offset * sigma_slope;
  const double correlation = product > 0 ? std::clamp(noise.cov(0, 1) / product, -1.0, 1.0) : 0;
  return fmt::format(
      "\n[{}]\n"
      "bits = {}  # of the grey levels below\n"
      "offset_grey2 = {}  # variance of a pixel at grey level 0; rounding (1/12) comes on top\n"
      "slope_grey = {}  # by which it grows a grey level: the gain, in grey levels an electron\n"
      "sigma_offset_grey2 = {}\n"
      "sigma_slope_grey = {}\n"
      "offset_slope_correlation = {}\n"
      "frames = {}\n"
      "width = {}\n"
      "height = {}\n"
      "lowest_grey = {:.1f}  # found between these levels, extrapolated outside\n"
      "highest_grey = {:.1f}\n"
      "created = \"{}\"\n",
      camera, noise.bits, noise.model.offset_grey2, noise.model.slope_grey, sigma_offset,
      sigma_slope, correlation, noise.frames, noise.size.width, noise.size.height,
      noise.lowest_grey, noise.highest_grey,
      noise.created.empty() ? internal::TimestampNow() : noise.created);
}

}  // namespace

NoiseModel CameraNoise::ForBits(int image_bits) const {
  const double scale = std::ldexp(1.0, image_bits - bits);
  return {scale * scale * model.offset_grey2, scale * model.slope_grey};
}

NoiseFile ReadNoiseFile(const fs::path& path) {
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) {
    throw InputError(fmt::format(
        "There is no noise file {}; plumbline noise makes one from still frames.", path.string()));
  }
  const auto refuse = [&](const std::string& why) {
    return InputError(
        fmt::format("{} is no noise file ({}); plumbline noise makes one from still frames.",
                    path.string(), why));
  };
  toml::table document;
  try {
    document = toml::parse_file(path.string());
  } catch (const toml::parse_error& error) {
    throw refuse(fmt::format("line {}: {}", error.source().begin.line, error.description()));
  }
  if (document["format"].value_or(std::string()) != kFormat) {
    throw refuse(fmt::format("it does not say format = \"{}\"", kFormat));
  }
  NoiseFile file;
  for (const auto& [key, node] : document) {
    if (!node.is_table()) continue;
    const std::string name(key.str());
    const TableReader table(path, name, *node.as_table());
    if (name == "floor") {
      file.floor = ReadFloor(table);
    } else {
      file.cameras[name] = ReadTable(table);
    }
  }
  if (file.cameras.empty()) throw refuse("it holds no camera");
  return file;
}

CameraNoise ReadCameraNoise(const fs::path& path, const std::string& camera) {
  const std::map<std::string, CameraNoise> cameras = ReadNoiseFile(path).cameras;
  if (cameras.size() == 1) return cameras.begin()->second;
  const auto found = cameras.find(camera);
  if (found != cameras.end()) return found->second;
  std::vector<std::string> names;
  for (const auto& [name, noise] : cameras) names.push_back(name);
  throw InputError(fmt::format(
      "The noise file {} holds several cameras ({}) and none is called '{}': say which one.",
      path.string(), fmt::join(names, ", "), camera));
}

void WriteNoiseFile(const fs::path& path, const NoiseFile& file) {
  std::string text = fmt::format(
      "# Noise of a camera: sigma^2 = offset_grey2 + slope_grey * grey level.\n"
      "format = \"{}\"\nformat_version = 1\nsoftware = \"{}\"\n",
      kFormat, SoftwareVersion());
  for (const auto& [camera, noise] : file.cameras) text += TableText(camera, noise);
  if (file.floor) text += FloorText(*file.floor);
  internal::WriteBytes(path, text);
}

}  // namespace plumbline
