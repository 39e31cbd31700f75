#include "io/internal/wheel_tags_group.h"

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "io/internal/array_writer.h"
#include "io/internal/hdf5.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;
using hdf5::Shape;

constexpr const char* kGroup = "/wheel/tags";
constexpr const char* kIds = "/wheel/tags/id";
constexpr hsize_t kMaxTags = 100'000;
constexpr Eigen::Index kNumbers = 12;  // four corners, x y z each

}  // namespace

void WriteWheelTags(hid_t file, const WheelTags& tags, int modes) {
  if (tags.family.empty()) return;
  const Id group = hdf5::CreateGroup(file, kGroup);
  hdf5::SetText(group.get(), "NX_class", "NXcollection");
  hdf5::SetText(group.get(), "family", tags.family);
  hdf5::SetNumber(group.get(), "sigma_px", tags.sigma_px);
  std::vector<std::int32_t> ids, frames;
  std::vector<std::uint8_t> on_rim;
  std::vector<double> corners, covariance, along;
  for (const WheelTag& tag : tags.tags) {
    ids.push_back(tag.id);
    frames.push_back(tag.frames);
    on_rim.push_back(tag.on_rim ? 1 : 0);
    for (const Eigen::Vector3d& corner : tag.corner_mm) {
      corners.insert(corners.end(), corner.begin(), corner.end());
    }
    const double* cov = tag.cov_random_mm2.data();
    covariance.insert(covariance.end(), cov, cov + tag.cov_random_mm2.size());
    for (Eigen::Index k = 0; k < modes; ++k) {
      for (Eigen::Index i = 0; i < kNumbers; ++i) along.push_back(tag.along_modes_mm(k, i));
    }
  }
  const hsize_t n = ids.size(), K = static_cast<hsize_t>(modes);
  ArrayWriter out(file);
  out.Scale<std::int32_t>(kIds, "1", "id of the tag", ids);
  const std::string path = std::string(kGroup) + "/";
  out.Array<std::int32_t>(path + "frames", "1", "frames that the tag's place is from", {n}, frames,
                          {kIds});
  out.Array<std::uint8_t>(path + "on_rim", "1", "1: on the rim, rigid; 0: on the tyre", {n}, on_rim,
                          {kIds});
  out.Doubles(path + "corner", "mm",
              "corners of the tag's black border in the wheel frame: bottom left, bottom right, "
              "top right, top left",
              {n, 4, 3}, corners, {kIds});
  out.Doubles(path + "corner_covariance", "mm2",
              "random covariance of the four corners, x y z each", {n, 12, 12}, covariance, {kIds});
  out.Doubles(path + "corner_along_modes", "mm",
              "what one sigma of each calibration mode adds to the corners, x y z each", {n, K, 12},
              along, {kIds, "/rig/mode"});
}

WheelTags ReadWheelTags(hid_t file, int modes) {
  WheelTags tags;
  if (!hdf5::Exists(file, kGroup)) return tags;
  const Id group = hdf5::OpenGroup(file, kGroup);
  tags.family = hdf5::GetText(group.get(), "family");
  tags.sigma_px = hdf5::GetNumber(group.get(), "sigma_px", tags.sigma_px);
  Shape shape;
  const auto ids = hdf5::ReadArray<std::int32_t>(file, kIds, &shape, kMaxTags);
  if (tags.family.empty() || shape.size() != 1 ||
      std::adjacent_find(ids.begin(), ids.end(), std::greater_equal<>()) != ids.end()) {
    throw hdf5::Error("/wheel/tags has no family, or its ids do not ascend");
  }
  const hsize_t n = ids.size();
  const std::string path = std::string(kGroup) + "/";
  const auto frames = ReadDoubles(file, path + "frames", {n}),
             on_rim = ReadDoubles(file, path + "on_rim", {n});
  const auto corners = ReadDoubles(file, path + "corner", {n, 4, 3});
  const auto covariance = ReadDoubles(file, path + "corner_covariance", {n, 12, 12});
  const auto along =
      ReadDoubles(file, path + "corner_along_modes", {n, static_cast<hsize_t>(modes), 12});
  for (std::size_t t = 0; t < n; ++t) {
    WheelTag tag;
    tag.id = ids[t];
    tag.frames = static_cast<int>(frames[t]);
    tag.on_rim = on_rim[t] != 0;
    for (std::size_t k = 0; k < 4; ++k) {
      tag.corner_mm[k] = Eigen::Map<const Eigen::Vector3d>(corners.data() + 12 * t + 3 * k);
      if (!tag.corner_mm[k].allFinite()) throw hdf5::Error("/wheel/tags/corner holds no numbers");
    }
    tag.cov_random_mm2 = Eigen::Map<const WheelTag::Covariance>(covariance.data() + 144 * t);
    tag.along_modes_mm.resize(modes, kNumbers);
    for (Eigen::Index i = 0; i < tag.along_modes_mm.size(); ++i) {
      tag.along_modes_mm(i / kNumbers, i % kNumbers) =
          along[12 * static_cast<std::size_t>(modes) * t + static_cast<std::size_t>(i)];
    }
    tags.tags.push_back(std::move(tag));
  }
  return tags;
}

}  // namespace plumbline::internal
