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

// Reads the numbers of one camera's table, or says which is missing or out of range.
class TableReader {
 public:
  TableReader(const fs::path& path, std::string camera, const toml::table& table)
      : path_(path), camera_(std::move(camera)), table_(table) {}

  double Number(const char* key, double min, double max) const {
    const std::optional<double> value = table_[key].value<double>();
    if (!value || !std::isfinite(*value) || *value < min || *value > max) {
      throw InputError(
          fmt::format("The noise file {} cannot be used: [{}] needs {} as a number from {} to {}.",
                      path_.string(), camera_, key, min, max));
    }
    return *value;
  }
  int Whole(const char* key, int min, int max) const {
    return static_cast<int>(Number(key, min, max));
  }
  std::string Text(const char* key) const { return table_[key].value_or(std::string()); }

 private:
  const fs::path& path_;
  std::string camera_;
  const toml::table& table_;
};

CameraNoise ReadTable(const TableReader& table) {
  constexpr double kLargest = 1e12;
  constexpr int kMostPixels = 1'000'000;
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
    const std::string camera(key.str());
    file[camera] = ReadTable(TableReader(path, camera, *node.as_table()));
  }
  if (file.empty()) throw refuse("it holds no camera");
  return file;
}

CameraNoise ReadCameraNoise(const fs::path& path, const std::string& camera) {
  const NoiseFile file = ReadNoiseFile(path);
  if (file.size() == 1) return file.begin()->second;
  const auto found = file.find(camera);
  if (found != file.end()) return found->second;
  std::vector<std::string> names;
  for (const auto& [name, noise] : file) names.push_back(name);
  throw InputError(fmt::format(
      "The noise file {} holds several cameras ({}) and none is called '{}': say which one.",
      path.string(), fmt::join(names, ", "), camera));
}

void WriteNoiseFile(const fs::path& path, const NoiseFile& file) {
  std::string text = fmt::format(
      "# Noise of a camera: sigma^2 = offset_grey2 + slope_grey * grey level.\n"
      "format = \"{}\"\nformat_version = 1\nsoftware = \"{}\"\n",
      kFormat, SoftwareVersion());
  for (const auto& [camera, noise] : file) {
    text += TableText(camera, noise);
  }
  internal::WriteBytes(path, text);
}

}  // namespace plumbline
