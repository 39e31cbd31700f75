#include <fmt/format.h>
#include <tiffio.h>

#include <cstdarg>
#include <string>
#include <vector>

#include "io/internal/image_decode.h"

namespace plumbline::internal {
namespace {

struct TiffFault {
  char text[200] = "";
};

int OnError(TIFF*, void* user, const char*, const char* format, va_list arguments) {
  auto* fault = static_cast<TiffFault*>(user);
  if (fault->text[0] == '\0') {
    std::vsnprintf(fault->text, sizeof fault->text, format, arguments);
  }
  return 1;
}

// Unknown tags of camera makers: no damage.
int OnWarning(TIFF*, void*, const char*, const char*, va_list) { return 1; }

struct CloseTiff {
  void operator()(TIFF* t) const { TIFFClose(t); }
};
using TiffPointer = std::unique_ptr<TIFF, CloseTiff>;

TiffPointer OpenTiff(const std::filesystem::path& file, std::int64_t max_bytes, TiffFault* fault) {
  TIFFOpenOptions* options = TIFFOpenOptionsAlloc();
  TIFFOpenOptionsSetErrorHandlerExtR(options, OnError, fault);
  TIFFOpenOptionsSetWarningHandlerExtR(options, OnWarning, nullptr);
  TIFFOpenOptionsSetMaxSingleMemAlloc(options, max_bytes);
  TiffPointer tiff(TIFFOpenExt(file.c_str(), "rm", options));
  TIFFOpenOptionsFree(options);
  return tiff;
}

struct TiffFacts {
  std::uint16_t bits = 1, samples = 1, format = SAMPLEFORMAT_UINT, photometric = 0, planar = 1;
  std::uint16_t highest = 0;
  std::uint32_t width = 0, height = 0;
  bool palette() const { return photometric == PHOTOMETRIC_PALETTE; }
  bool colour() const { return palette() || photometric == PHOTOMETRIC_RGB; }
};

TiffFacts ReadFacts(const std::filesystem::path& file, TIFF* tiff) {
  TiffFacts facts;
  TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &facts.width);
  TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &facts.height);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &facts.bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &facts.samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &facts.format);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &facts.planar);
  facts.photometric = PHOTOMETRIC_MINISBLACK;
  TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &facts.photometric);
  TIFFGetField(tiff, TIFFTAG_MAXSAMPLEVALUE, &facts.highest);
  const bool grey =
      facts.photometric == PHOTOMETRIC_MINISBLACK || facts.photometric == PHOTOMETRIC_MINISWHITE;
  if (!grey && !facts.colour()) {
    RefuseImage(file, "this kind of colour TIFF is not read; save it as grey or RGB");
  }
  if (facts.format != SAMPLEFORMAT_UINT && facts.format != SAMPLEFORMAT_VOID) {
    RefuseImage(file, "its samples are not unsigned integers; save it with 8 or 16 bits a sample");
  }
  if (facts.bits < 8 || facts.bits > 16) {
    RefuseImage(file, fmt::format("it has {} bits a sample; save it with 8 to 16", facts.bits));
  }
  const int least = facts.photometric == PHOTOMETRIC_RGB ? 3 : 1;
  if (facts.samples < least || facts.samples > 5 ||
      (facts.samples > 1 && facts.planar != PLANARCONFIG_CONTIG)) {
    RefuseImage(file, "its colour planes lie apart; save it with interleaved colours or as grey");
  }
  if (facts.palette() && facts.bits != 8) RefuseImage(file, "its palette is not of 8 bits");
  return facts;
}

// Sample i of a row of packed samples; packed bits other than 8 and 16 run from the highest bit.
unsigned Sample(const TiffFacts& facts, const unsigned char* row, std::size_t i) {
  if (facts.bits == 8) return row[i];
  if (facts.bits == 16) {
    std::uint16_t v;
    std::memcpy(&v, row + 2 * i, 2);
    return v;
  }
  unsigned value = 0;
  for (std::size_t bit = i * facts.bits; bit < (i + 1) * facts.bits; ++bit) {
    value = 2 * value + ((row[bit / 8] >> (7 - bit % 8)) & 1u);
  }
  return value;
}

struct Palette {
  std::uint16_t *r = nullptr, *g = nullptr, *b = nullptr;
};

// Pixels [0, n) of a row from column `first` on.
void StorePixels(const TiffFacts& facts, const Palette& palette, const unsigned char* row,
                 std::size_t n, std::uint16_t* grey) {
  const unsigned top = (1u << facts.bits) - 1;
  for (std::size_t c = 0; c < n; ++c) {
    const unsigned v = Sample(facts, row, c * facts.samples);
    if (facts.palette()) {
      grey[c] = GreyFromRgb(palette.r[v] >> 8, palette.g[v] >> 8, palette.b[v] >> 8);
    } else if (facts.photometric == PHOTOMETRIC_RGB) {
      grey[c] = GreyFromRgb(v, Sample(facts, row, c * facts.samples + 1),
                            Sample(facts, row, c * facts.samples + 2));
    } else {
      grey[c] =
          static_cast<std::uint16_t>(facts.photometric == PHOTOMETRIC_MINISWHITE ? top - v : v);
    }
  }
}

bool ReadStrips(TIFF* tiff, const TiffFacts& facts, const Palette& palette,
                Image<std::uint16_t>& grey) {
  std::vector<unsigned char> row(static_cast<std::size_t>(TIFFScanlineSize64(tiff)));
  const std::size_t needed =
      (static_cast<std::size_t>(facts.width) * facts.samples * facts.bits + 7) / 8;
  if (row.size() < needed) return false;
  for (std::uint32_t r = 0; r < facts.height; ++r) {
    if (TIFFReadScanline(tiff, row.data(), r, 0) < 0) return false;
    StorePixels(facts, palette, row.data(), facts.width, grey.row(static_cast<int>(r)));
  }
  return true;
}

bool ReadTiles(const std::filesystem::path& file, TIFF* tiff, const TiffFacts& facts,
               const Palette& palette, std::int64_t max_pixels, Image<std::uint16_t>& grey) {
  std::uint32_t tile_width = 0, tile_height = 0;
  TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &tile_width);
  TIFFGetField(tiff, TIFFTAG_TILELENGTH, &tile_height);
  CheckedSize(file, tile_width, tile_height, max_pixels);
  std::vector<unsigned char> tile(static_cast<std::size_t>(TIFFTileSize64(tiff)));
  const auto row_bytes = static_cast<std::size_t>(TIFFTileRowSize64(tiff));
  if (row_bytes < (static_cast<std::size_t>(tile_width) * facts.samples * facts.bits + 7) / 8 ||
      tile.size() < row_bytes * tile_height) {
    return false;
  }
  for (std::uint32_t y = 0; y < facts.height; y += tile_height) {
    for (std::uint32_t x = 0; x < facts.width; x += tile_width) {
      if (TIFFReadTile(tiff, tile.data(), x, y, 0, 0) < 0) return false;
      const std::uint32_t n = std::min(tile_width, facts.width - x);
      for (std::uint32_t r = 0; r < tile_height && y + r < facts.height; ++r) {
        StorePixels(facts, palette, tile.data() + r * row_bytes, n,
                    grey.row(static_cast<int>(y + r)) + x);
      }
    }
  }
  return true;
}

}  // namespace

DecodedImage DecodeTiff(const std::filesystem::path& file, std::int64_t max_pixels) {
  OpenForReading(file);  // says why, where it cannot be
  TiffFault fault;
  const auto refuse = [&] {
    RefuseImage(file, fmt::format("the TIFF file is truncated or damaged ({})", fault.text));
  };
  const TiffPointer tiff = OpenTiff(file, 16 * max_pixels + (1 << 20), &fault);
  if (!tiff) refuse();
  const TiffFacts facts = ReadFacts(file, tiff.get());
  const ImageSize size = CheckedSize(file, facts.width, facts.height, max_pixels);
  Palette palette;
  if (facts.palette() &&
      TIFFGetField(tiff.get(), TIFFTAG_COLORMAP, &palette.r, &palette.g, &palette.b) != 1) {
    refuse();
  }
  DecodedImage out;
  out.was_colour = facts.colour();
  out.image.grey = Image<std::uint16_t>(size);
  const bool read = TIFFIsTiled(tiff.get()) != 0
                        ? ReadTiles(file, tiff.get(), facts, palette, max_pixels, out.image.grey)
                        : ReadStrips(tiff.get(), facts, palette, out.image.grey);
  if (!read || fault.text[0] != '\0') refuse();
  int stated = 0;
  if (facts.bits < 16) stated = facts.bits;
  for (int bits = 8; bits < 16 && stated == 0 && facts.highest > 0; ++bits) {
    if (facts.highest == (1 << bits) - 1) stated = bits;
  }
  out.image.bits = SignificantBits(out.image.grey, facts.bits, stated);
  if (TIFFReadDirectory(tiff.get()) == 1) out.note = "only the first of its pages is read";
  return out;
}

}  // namespace plumbline::internal
