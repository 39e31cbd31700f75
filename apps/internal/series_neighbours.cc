#include "apps/internal/series_neighbours.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <cmath>
#include <optional>
#include <utility>

#include "apps/internal/field_options.h"
#include "apps/internal/recorded_input.h"
#include "apps/region.h"
#include "calib/error.h"
#include "io/image_sequence.h"
#include "io/image_source.h"
#include "match/correlate_field.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

namespace {

// The grid that a run correlated, how, and in which pixels.
struct Recorded {
  FieldOptions field;
  std::string reference_id;
  std::string mask, roi;  // as the recipe has them
};

// The table of a command in a recipe; empty where it cannot be read.
toml::table TableOf(const std::string& recipe_toml, const char* command) {
  try {
    toml::table recipe = toml::parse(recipe_toml);
    if (toml::table* const table = recipe[command].as_table()) return std::move(*table);
  } catch (const toml::parse_error&) {
  }
  return {};
}

// An image file, or a frame of a video: "left.mkv#0".
struct ImageName {
  std::string file, frame;  // the latter empty: an image file

  explicit ImageName(const std::string& id) : file(id) {
    const std::size_t at = id.rfind('#');
    if (at == std::string::npos || at + 1 == id.size() ||
        id.find_first_not_of("0123456789", at + 1) != std::string::npos) {
      return;
    }
    file = id.substr(0, at);
    frame = id.substr(at + 1);
  }

  GrayImage Read(const fs::path& path) const {
    if (frame.empty()) return ReadImage(path);
    ImageSourceOptions options;
    options.frames = frame;
    std::optional<SequenceImage> image = OpenImageSequence(path.string(), options)->Next();
    if (!image) throw InputError(fmt::format("'{}' has no frame {}", path.string(), frame));
    if (!image->problem.empty()) throw InputError(image->problem);
    return std::move(image->image);
  }
};

SeriesNeighbours Find(const Recorded& run, const std::string& inputs_json) {
  std::string why;
  try {
    const ImageName name(run.reference_id);
    const auto image = UnchangedInput(inputs_json, name.file, &why);
    std::optional<fs::path> mask;
    if (image && !run.mask.empty()) mask = UnchangedInput(inputs_json, run.mask, &why);
    if (image && (mask || run.mask.empty())) {
      const GrayImage reference = name.Read(*image);
      std::optional<PixelRegion> roi;
      if (!run.roi.empty()) roi = PixelRegion::Parse(run.roi);
      const FieldCorrelator correlator(
          reference, run.field,
          WantedPixels(reference.size(), roi, mask ? ReadMask(*mask) : Image<std::uint8_t>()));
      SeriesNeighbours exact{correlator.neighbours(), "", {*image}};
      if (mask) exact.files.push_back(*mask);
      return exact;
    }
  } catch (const InputError& error) {
    why = error.what();
  } catch (const UsageError& error) {
    why = error.what();
  }
  const CorrelatorOptions& o = run.field.correlator;
  return {NeighbourCorrelation::OfOverlap(run.field.grid, run.field.step_px, o.subset_px, o.order,
                                          o.shape == SubsetShape::kCircle),
          fmt::format("How the errors of neighbouring points go together is taken from the overlap "
                      "of their subsets alone, since the reference image is not to be had ({}); "
                      "sigmas of strain may be off by some per cent.",
                      why),
          {}};
}

}  // namespace

SeriesNeighbours NeighboursOf(const PlanarSeriesHeader& header, const std::string& inputs_json) {
  const toml::table recipe = TableOf(header.recipe_toml, "correlate");
  Recorded run{{},
               header.reference_id,
               recipe["mask"].value_or(std::string()),
               recipe["roi"].value_or(std::string())};
  FieldOptions& field = run.field;
  field.correlator.subset_px = header.subset_px;
  field.correlator.order = header.order;
  field.correlator.shape =
      header.subset_shape == "circle" ? SubsetShape::kCircle : SubsetShape::kSquare;
  field.image.interpolation =
      header.interpolation == "cubic" ? Interpolation::kCubic : Interpolation::kQuintic;
  field.image.prefilter = header.prefilter == "low-pass"   ? Prefilter::kLowPass
                          : header.prefilter == "gaussian" ? Prefilter::kGaussian
                                                           : Prefilter::kNone;
  if (header.prefilter == "gaussian") field.image.gaussian_sigma_px = header.prefilter_sigma_px;
  field.step_px = header.step_px;
  field.first_px = header.first_px;
  field.grid = header.grid;
  return Find(run, inputs_json);
}

SeriesNeighbours NeighboursOf(const SeriesReader& series, const std::string& reference_id) {
  const toml::table recipe = TableOf(series.facts().recipe_toml, "measure");
  Recorded run{{},
               reference_id,
               recipe["mask"].value_or(std::string()),
               recipe["roi"].value_or(std::string())};
  FieldOptions& field = run.field;
  field.correlator.subset_px = series.subset_px();
  field.correlator.order = static_cast<int>(recipe["order"].value_or(std::int64_t{1}));
  if (recipe["shape"].value_or(std::string()) == "circle") {
    field.correlator.shape = SubsetShape::kCircle;
  }
  if (recipe["interpolation"].value_or(std::string()) == "cubic") {
    field.image.interpolation = Interpolation::kCubic;
  }
  SetPrefilter(recipe["prefilter"].value_or(std::string("low-pass")), field.image);
  const Image<Eigen::Vector2f> grid = series.grid_px();
  field.step_px = series.step_px();
  field.grid = grid.size();
  field.first_px = grid(0, 0).array().round().cast<int>();
  return Find(run, series.facts().inputs_json);
}

}  // namespace plumbline::internal
