#include "io/internal/planar_header.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "io/internal/planar_layout.h"
#include "io/internal/rig_group.h"
#include "io/internal/series_header.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;

constexpr const char* kNoCalibration =
    "none: pixels of one camera have no part from a calibration; _errors is _errors_random";

Image<Eigen::Vector2f> PixelsOf(const PlanarSeriesHeader& header) {
  Image<Eigen::Vector2f> pixels(header.grid, Eigen::Vector2f::Zero());
  for (int r = 0; r < header.grid.height; ++r) {
    for (int c = 0; c < header.grid.width; ++c) {
      pixels(r, c) = (header.first_px + header.step_px * Eigen::Vector2i(c, r)).cast<float>();
    }
  }
  return pixels;
}

void WriteCamera(hid_t file, const PlanarCamera& camera) {
  const Id group = hdf5::CreateGroup(file, "/camera");
  hdf5::SetText(group.get(), "noise_source", camera.noise_source);
  hdf5::SetInteger(group.get(), "bits", camera.bits);
  const std::array<std::int32_t, 2> size = {camera.image_size.width, camera.image_size.height};
  hdf5::AttachScales(file,
                     hdf5::WriteArray<std::int32_t>(
                         file, {"/camera/image_size", "pixel", "width and height", {2}, {}}, size),
                     {hdf5::IndexScale(file, 2)});
  const auto number = [&](const char* name, const char* long_name, double value) {
    hdf5::WriteArray<double>(file, {name, "1", long_name, {}, {}}, {&value, 1});
  };
  number("/camera/noise_offset",
         "variance of a dark pixel, in squared grey levels; that of a pixel of grey level g is "
         "noise_offset + noise_slope g, rounding not included",
         camera.noise.offset_grey2);
  number("/camera/noise_slope", "growth of the variance with the grey level, in grey levels",
         camera.noise.slope_grey);
}

void WriteGroupAttributes(hid_t file, const PlanarSeriesHeader& header) {
  const Id displacement = hdf5::CreateGroup(file, "/displacement");
  hdf5::SetText(displacement.get(), "reference", header.reference);
  hdf5::SetText(displacement.get(), "reference_id", header.reference_id);
  hdf5::SetText(displacement.get(), "errors_calibration", kNoCalibration);
  if (!header.contents.strain) return;
  const Id strain = hdf5::CreateGroup(file, "/strain");
  hdf5::SetText(strain.get(), "measure", header.strain_measure);
  hdf5::SetText(strain.get(), "strain_axes", "image");
  hdf5::SetInteger(strain.get(), "vsg_px", header.vsg_px);
  hdf5::SetInteger(strain.get(), "window", header.window_points);
  hdf5::SetText(strain.get(), "errors_calibration", kNoCalibration);
}

// An attribute that has to be a whole number in this range.
int Whole(hid_t object, const char* name, int least, int most) {
  const double value = hdf5::GetNumber(object, name, std::numeric_limits<double>::quiet_NaN());
  if (!(value >= least && value <= most) || value != std::floor(value)) {
    throw hdf5::Error(fmt::format("its attribute {} is missing or out of range", name));
  }
  return static_cast<int>(value);
}

double OneNumber(hid_t file, const char* name) {
  const auto values = hdf5::ReadArray<double>(file, name, nullptr, 1);
  if (values.empty()) throw hdf5::Error(fmt::format("{} is empty", name));
  return values[0];
}

PlanarCamera ReadCamera(hid_t file) {
  const Id group = hdf5::OpenGroup(file, "/camera");
  PlanarCamera camera;
  const auto size = hdf5::ReadArray<std::int32_t>(file, "/camera/image_size", nullptr, 2);
  if (size.size() != 2) throw hdf5::Error("/camera/image_size is not (2)");
  camera.image_size = {size[0], size[1]};
  camera.bits = Whole(group.get(), "bits", 1, 16);
  camera.noise = {OneNumber(file, "/camera/noise_offset"), OneNumber(file, "/camera/noise_slope")};
  camera.noise_source = hdf5::GetText(group.get(), "noise_source");
  return camera;
}

// The field's grid is regular: where it begins tells it all.
void ReadGrid(hid_t file, const GridFacts& grid, PlanarSeriesHeader* header) {
  constexpr int kMost = 1 << 24;  // whole numbers up to here are exact in 32 bits
  header->grid = grid.pixel.size();
  header->step_px = grid.step_px;
  header->subset_px = grid.subset_px;
  if (grid.pixel.empty() || !(grid.pixel(0, 0).array().abs() <= kMost).all() || grid.step_px < 1 ||
      grid.step_px > kMost / std::max(header->grid.width, header->grid.height)) {
    throw hdf5::Error("/grid is empty or out of range");
  }
  header->first_px = grid.pixel(0, 0).cast<int>();
  if (PixelsOf(*header).values() != grid.pixel.values()) {
    throw hdf5::Error("/grid/pixel is no regular grid of whole pixels, step_px apart");
  }
  const Id group = hdf5::OpenGroup(file, "/grid");
  header->order = Whole(group.get(), "order", 0, 2);
  header->subset_shape = hdf5::GetText(group.get(), "subset_shape");
  header->interpolation = hdf5::GetText(group.get(), "interpolation");
  header->prefilter = hdf5::GetText(group.get(), "prefilter");
  header->prefilter_sigma_px = hdf5::GetNumber(group.get(), "prefilter_sigma_px", 0);
}

// Throws std::invalid_argument naming the member.
void Require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(fmt::format("PlanarSeriesHeader::{}", what));
}

}  // namespace

bool IsPlanarReference(const std::string& text) {
  return text == "image" || (text != "wheel" && IsDisplacementReference(text));
}

void CheckPlanarHeader(const PlanarSeriesHeader& header) {
  Require(header.grid.width > 0 && header.grid.height > 0, "grid is empty");
  Require(header.step_px >= 1, "step_px is less than 1");
  Require(header.subset_px >= 1, "subset_px is less than 1");
  Require(header.order >= 0 && header.order <= 2, "order is none of 0, 1, 2");
  Require(header.subset_shape == "square" || header.subset_shape == "circle",
          "subset_shape is neither square nor circle");
  Require(header.prefilter == "low-pass" || header.prefilter == "gaussian" ||
              header.prefilter == "none",
          "prefilter is none of low-pass, gaussian, none");
  Require(header.prefilter_sigma_px >= 0 && std::isfinite(header.prefilter_sigma_px),
          "prefilter_sigma_px is negative or no number");
  Require(IsPlanarReference(header.reference), "reference is none of image, frame N, previous");
  Require(IsStrainMeasure(header.strain_measure),
          "strain_measure is none of green_lagrange, small, hencky, almansi");
  Require(header.vsg_px >= 0 && header.window_points >= 0, "vsg_px or window_points is negative");
  Require(header.camera.bits >= 1 && header.camera.bits <= 16, "camera.bits is not in 1 to 16");
  CheckShard(header.shard);
}

void WritePlanarHeader(const std::filesystem::path& path, const PlanarSeriesHeader& header) {
  Id file = hdf5::CreateFile(path);
  WriteRootAttributes(file.get(), "plumbline-series", header.recipe_toml, "");
  WriteShardAttributes(file.get(), header.shard);
  hdf5::SetText(file.get(), "geometry", kPlanar);
  hdf5::SetText(file.get(), "default", "displacement");
  WriteCamera(file.get(), header.camera);
  const Id grid = WriteGrid(
      file.get(), {PixelsOf(header), header.step_px, header.subset_px},
      "where the points sit in the reference image; (0, 0) is the centre of the top-left pixel");
  hdf5::SetText(grid.get(), "points", "material");
  hdf5::SetInteger(grid.get(), "order", header.order);
  hdf5::SetText(grid.get(), "subset_shape", header.subset_shape);
  hdf5::SetText(grid.get(), "interpolation", header.interpolation);
  hdf5::SetText(grid.get(), "prefilter", header.prefilter);
  hdf5::SetNumber(grid.get(), "prefilter_sigma_px", header.prefilter_sigma_px);
  WriteGroupAttributes(file.get(), header);
  file.Close("closing the file");
}

PlanarSeriesHeader ReadPlanarHeader(hid_t file, const GridFacts& grid) {
  PlanarSeriesHeader header;
  header.contents = ContentsOf<PlanarContents>(file);
  ReadGrid(file, grid, &header);
  header.shard = ReadShardAttributes(file);
  header.camera = ReadCamera(file);
  const Id displacement = hdf5::OpenGroup(file, "/displacement");
  header.reference = hdf5::GetText(displacement.get(), "reference");
  header.reference_id = hdf5::GetText(displacement.get(), "reference_id");
  if (!header.contents.strain) return header;
  const Id strain = hdf5::OpenGroup(file, "/strain");
  header.strain_measure = hdf5::GetText(strain.get(), "measure");
  header.vsg_px = Whole(strain.get(), "vsg_px", 0, 1'000'000);
  header.window_points = Whole(strain.get(), "window", 0, 1'000'000);
  return header;
}

}  // namespace plumbline::internal
