#include "apps/region.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>

#include "calib/error.h"
#include "io/image_source.h"

namespace plumbline {

PixelRegion PixelRegion::Parse(const std::string& text) {
  int value[4] = {};
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  bool good = true;
  for (int i = 0; i < 4 && good; ++i) {
    const auto [next, error] = std::from_chars(at, end, value[i]);
    good = error == std::errc() && (i == 3 ? next == end : next != end && *next == ',');
    at = next + 1;
  }
  if (!good || value[0] < 0 || value[1] < 0 || value[2] <= 0 || value[3] <= 0) {
    throw UsageError(fmt::format(
        "A region is x,y,w,h in px of the (left) image, for example 100,50,640,480, not '{}'.",
        text));
  }
  return {value[0], value[1], value[2], value[3]};
}

void PixelRegion::CheckInside(ImageSize size) const {
  if (x < size.width && y < size.height) return;
  throw InputError(fmt::format("The region {},{},{},{} lies outside the image of {}x{} px.", x, y,
                               width, height, size.width, size.height));
}

Image<std::uint8_t> ReadMask(const std::filesystem::path& file) {
  const GrayImage image = ReadImage(file);
  Image<std::uint8_t> mask(image.size());
  std::size_t kept = 0;
  for (std::size_t i = 0; i < mask.pixel_count(); ++i) {
    mask.values()[i] = image.grey.values()[i] != 0 ? 1 : 0;
    kept += mask.values()[i];
  }
  if (kept == 0) {
    throw InputError(fmt::format("The mask '{}' is 0 everywhere, which leaves nothing to measure.",
                                 file.string()));
  }
  return mask;
}

Image<std::uint8_t> WantedPixels(ImageSize size, const std::optional<PixelRegion>& region,
                                 const Image<std::uint8_t>& mask) {
  if (!mask.empty() && !(mask.size() == size)) {
    throw InputError(fmt::format("The mask is {}x{} px and the image {}x{} px.", mask.width(),
                                 mask.height(), size.width, size.height));
  }
  if (!region) return mask;
  region->CheckInside(size);
  const int right = region->x + std::min(region->width, size.width - region->x);
  const int bottom = region->y + std::min(region->height, size.height - region->y);
  Image<std::uint8_t> wanted(size, 0);
  std::size_t kept = 0;
  for (int y = region->y; y < bottom; ++y) {
    for (int x = region->x; x < right; ++x) {
      wanted(y, x) = mask.empty() || mask(y, x) != 0 ? 1 : 0;
      kept += wanted(y, x);
    }
  }
  if (kept == 0) throw InputError("The region and the mask leave no pixel of the image.");
  return wanted;
}

void PlaceGrid(const PixelRegion& region, ImageSize image, FieldOptions& field) {
  region.CheckInside(image);
  const int radius = field.correlator.radius_px();
  const int width = std::min(region.width, image.width - region.x);
  const int height = std::min(region.height, image.height - region.y);
  const int subset = field.correlator.subset_px;
  if (width < subset || height < subset) {
    throw InputError(fmt::format(
        "The region holds {}x{} px of the image, which is less than one subset of {} px; take a "
        "larger region or a smaller --subset.",
        width, height, subset));
  }
  field.first_px = {region.x + radius, region.y + radius};
  field.grid = {(width - subset) / field.step_px + 1, (height - subset) / field.step_px + 1};
}

}  // namespace plumbline
