#include "apps/internal/survey_records.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "apps/internal/surface_records.h"
#include "calib/error.h"

namespace plumbline::internal {
namespace {

using Corners = std::array<Eigen::Vector2d, 4>;

nlohmann::json JsonOf(const Corners& corners) {
  nlohmann::json json = nlohmann::json::array();
  for (const Eigen::Vector2d& px : corners) json.push_back({px.x(), px.y()});
  return json;
}

Corners CornersOf(const nlohmann::json& json) {
  Corners corners;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    corners[i] = {json.at(i).at(0).get<double>(), json.at(i).at(1).get<double>()};
  }
  return corners;
}

// Numbers with as many digits as they need to be read back as they were.
std::string TextOf(const StereoTags& tags) {
  if (tags.tags.empty() && tags.twice.empty()) return "";
  nlohmann::json json = {{"tags", nlohmann::json::array()}, {"twice", tags.twice}};
  for (const StereoTag& tag : tags.tags) {
    json["tags"].push_back(
        {{"id", tag.id}, {"left_px", JsonOf(tag.left_px)}, {"right_px", JsonOf(tag.right_px)}});
  }
  return json.dump();
}

StereoTags TagsOf(const std::string& text) {
  StereoTags tags;
  if (text.empty()) return tags;
  try {
    const auto json = nlohmann::json::parse(text);
    tags.twice = json.at("twice").get<std::vector<int>>();
    for (const auto& tag : json.at("tags")) {
      tags.tags.push_back(
          {tag.at("id").get<int>(), CornersOf(tag.at("left_px")), CornersOf(tag.at("right_px"))});
    }
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("its tags cannot be read: {}", error.what()));
  }
  return tags;
}

// Each value of `image` at its place on a grid of which it has every `stride`-th point.
template <typename T>
Image<T> Spread(const Image<T>& image, ImageSize grid, int stride, const T& none) {
  Image<T> out(grid, none);
  for (int r = 0; r < image.height(); ++r) {
    for (int c = 0; c < image.width(); ++c) out(r * stride, c * stride) = image(r, c);
  }
  return out;
}

template <typename T>
Image<T> Gathered(const Image<T>& image, ImageSize size, int stride, const T& none) {
  Image<T> out(size, none);
  for (int r = 0; r < size.height; ++r) {
    for (int c = 0; c < size.width; ++c) out(r, c) = image(r * stride, c * stride);
  }
  return out;
}

// `move`: Spread or Gathered, of all that a match holds.
template <typename Move>
MatchField Moved(const MatchField& match, const Move& move) {
  constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
  const Eigen::Vector2f no_pixel = Eigen::Vector2f::Constant(kNone);
  const Eigen::Vector3f no_cov = Eigen::Vector3f::Constant(kNone);
  const Eigen::Matrix2f no_gradient = Eigen::Matrix2f::Constant(kNone);
  return {move(match.left_displacement_px, no_pixel), move(match.right_displacement_px, no_pixel),
          move(match.left_gradient, no_gradient),     move(match.right_gradient, no_gradient),
          move(match.left_cov_px2, no_cov),           move(match.right_cov_px2, no_cov),
          move(match.left_reference_share, kNone),    move(match.right_reference_share, kNone)};
}

bool IsWhole(double value, double least, double most) {
  return value >= least && value <= most && value == std::floor(value);
}

}  // namespace

PlanarField GridOf(const PlanarField& field) {
  PlanarField grid;
  grid.first_px = field.first_px;
  grid.step_px = field.step_px;
  grid.subset_px = field.subset_px;
  grid.order = field.order;
  grid.status = Image<Status>(field.size(), Status::kMasked);
  return grid;
}

StereoField NoneOf(const PlanarField& grid) {
  StereoField none;
  none.left = PlanarField(grid.size(), grid.first_px, grid.step_px);
  none.left.subset_px = grid.subset_px;
  none.left.order = grid.order;
  none.right = none.left;
  return none;
}

SurveyRecord SurveyRecordOf(const RollingWheel& rolling, std::size_t frame,
                            const PlanarField& grid) {
  const RollingFrame& from = rolling.frames[frame];
  SurveyRecord record;
  record.found = from.status == RollingFrameStatus::kPlaced;
  record.problem = from.problem;
  record.tags = TextOf(from.tags);
  if (!record.found) return record;
  const PlanarField& kept = from.matches.left;
  const int stride = kept.step_px / grid.step_px;
  if (kept.first_px != grid.first_px || stride * grid.step_px != kept.step_px ||
      (kept.size().width - 1) * stride >= grid.size().width ||
      (kept.size().height - 1) * stride >= grid.size().height) {
    throw std::logic_error("the points of the survey are not among those that are measured");
  }
  record.view = static_cast<double>(from.view);
  record.near_rad = from.near_rad;
  record.spacing_px = kept.step_px;
  record.match = Moved(MatchRecordOf(from.matches), [&](const auto& image, const auto& none) {
    return Spread(image, grid.size(), stride, none);
  });
  return record;
}

RollingFrame RollingFrameOf(const SeriesFrame& stored, const PlanarField& like) {
  const SurveyRecord& survey = stored.survey;
  RollingFrame frame;
  frame.index = stored.index;
  frame.time_s = stored.time_s;
  frame.problem = survey.problem;
  frame.tags = TagsOf(survey.tags);
  if (!survey.found) {
    frame.status = stored.problem == survey.problem ? RollingFrameStatus::kUnreadable
                                                    : RollingFrameStatus::kNotFound;
    return frame;
  }
  constexpr double kMostViews = 1e9;
  const double stride = survey.spacing_px / like.step_px;
  const double by = stored.placement.placed_by;
  if (!IsWhole(survey.view, 0, kMostViews) || !IsWhole(stride, 1, kMostViews) ||
      !IsWhole(by, 0, static_cast<double>(kPlacedByNames.size() - 1))) {
    throw InputError(fmt::format("frame {}: its survey makes no sense", stored.index));
  }
  frame.status = RollingFrameStatus::kPlaced;
  frame.placed_by = static_cast<PlacedBy>(static_cast<int>(by));
  frame.view = static_cast<std::size_t>(survey.view);
  frame.near_rad = survey.near_rad;
  PlanarField kept = like;
  kept.step_px = static_cast<int>(survey.spacing_px);
  const int every = static_cast<int>(stride);
  const ImageSize grid = like.size();
  const ImageSize size{(grid.width - 1) / every + 1, (grid.height - 1) / every + 1};
  const MatchField match = Moved(survey.match, [&](const auto& image, const auto& none) {
    return Gathered(image, size, every, none);
  });
  frame.matches = FieldOf(match, Image<Status>(size, Status::kMasked), kept);
  return frame;
}

}  // namespace plumbline::internal
