#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "calib/image.h"
#include "match/correlate_field.h"

namespace plumbline {

// A rectangle of an image (the left one, of two), in whole pixels.
struct PixelRegion {
  int x = 0, y = 0, width = 0, height = 0;

  // Reads "x,y,w,h". Throws UsageError saying what is wrong.
  static PixelRegion Parse(const std::string& text);

  // Throws InputError when no pixel of it lies in an image of this size.
  void CheckInside(ImageSize size) const;
};

// A mask from a file: 0 is left out, every other level (1 or 255, say) is kept as 1. Throws
// InputError when it cannot be read or keeps nothing.
Image<std::uint8_t> ReadMask(const std::filesystem::path& file);

// The pixels of an image of this size that region and mask (empty: all) let through, as 1; an empty
// image where both let all of it through. Throws InputError when the mask has another size, the
// region lies outside, or the two leave nothing.
Image<std::uint8_t> WantedPixels(ImageSize size, const std::optional<PixelRegion>& region,
                                 const Image<std::uint8_t>& mask);

// Sets the grid to the points whose subset fits into the region. Throws InputError as
// CheckInside(), and where it holds not even one subset.
void PlaceGrid(const PixelRegion& region, ImageSize image, FieldOptions& field);

}  // namespace plumbline
