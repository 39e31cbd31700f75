#include <fmt/format.h>
#include <png.h>

#include <csetjmp>
#include <string>
#include <vector>

#include "io/internal/image_decode.h"

namespace plumbline::internal {
namespace {

struct PngFault {
  char text[160] = "";
};

void OnError(png_structp png, png_const_charp message) {
  auto* fault = static_cast<PngFault*>(png_get_error_ptr(png));
  std::snprintf(fault->text, sizeof fault->text, "%s", message);
  png_longjmp(png, 1);
}

// Colour-profile complaints and the like. Damage is an error, made so by png_set_crc_action.
void OnWarning(png_structp, png_const_charp) {}

struct PngReader {
  png_structp png = nullptr;
  png_infop info = nullptr;
  PngFault fault;

  PngReader() {
    png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &fault, OnError, OnWarning);
    if (png != nullptr) info = png_create_info_struct(png);
    if (info == nullptr) throw std::bad_alloc();
  }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;
  ~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }

  // Runs libpng calls; false when libpng gave up. `calls` must not own anything, since libpng
  // leaves it by longjmp.
  template <typename Calls>
  bool Try(const Calls& calls) {
    if (setjmp(png_jmpbuf(png)) != 0) return false;
    calls();
    return true;
  }
};

struct PngFacts {
  png_uint_32 width = 0, height = 0;
  int stored_bits = 0, colour_type = 0, stated_bits = 0, passes = 1;
  std::size_t row_bytes = 0;
  int channels = 0;
};

void ReadHeader(PngReader& reader, std::FILE* f) {
  png_set_user_limits(reader.png, 0x7fffffff, 0x7fffffff);
  png_set_crc_action(reader.png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
  png_init_io(reader.png, f);
  png_read_info(reader.png, reader.info);
}

void ChooseOutput(PngReader& reader, PngFacts& facts) {
  png_structp png = reader.png;
  facts.colour_type = png_get_color_type(png, reader.info);
  facts.stored_bits = png_get_bit_depth(png, reader.info);
  png_color_8p stated = nullptr;
  if (png_get_sBIT(png, reader.info, &stated) != 0) {
    facts.stated_bits =
        (facts.colour_type & PNG_COLOR_MASK_COLOR) != 0 ? stated->green : stated->gray;
  }
  if (facts.colour_type == PNG_COLOR_TYPE_PALETTE) png_set_palette_to_rgb(png);
  if (facts.colour_type == PNG_COLOR_TYPE_GRAY && facts.stored_bits < 8) {
    png_set_expand_gray_1_2_4_to_8(png);
  }
  png_set_strip_alpha(png);
  if (facts.stored_bits == 16) png_set_swap(png);
  facts.passes = png_set_interlace_handling(png);
  png_read_update_info(png, reader.info);
  facts.row_bytes = png_get_rowbytes(png, reader.info);
  facts.channels = png_get_channels(png, reader.info);
}

void StoreRow(const PngFacts& facts, const unsigned char* row, std::uint16_t* grey) {
  const auto sample = [&](std::size_t i) -> unsigned {
    if (facts.stored_bits < 16) return row[i];
    std::uint16_t v;
    std::memcpy(&v, row + 2 * i, 2);
    return v;
  };
  const auto n = static_cast<std::size_t>(facts.width);
  for (std::size_t c = 0; c < n; ++c) {
    grey[c] = facts.channels == 1
                  ? static_cast<std::uint16_t>(sample(c))
                  : GreyFromRgb(sample(3 * c), sample(3 * c + 1), sample(3 * c + 2));
  }
}

}  // namespace

DecodedImage DecodePng(const std::filesystem::path& file, std::int64_t max_pixels) {
  const FilePointer f = OpenForReading(file);
  PngReader reader;
  const auto refuse = [&]() {
    const bool ended = std::feof(f.get()) != 0;
    RefuseImage(file, ended ? std::string("the PNG file is truncated")
                            : fmt::format("the PNG file is damaged ({})", reader.fault.text));
  };
  if (!reader.Try([&] { ReadHeader(reader, f.get()); })) refuse();
  PngFacts facts;
  facts.width = png_get_image_width(reader.png, reader.info);
  facts.height = png_get_image_height(reader.png, reader.info);
  DecodedImage out;
  const ImageSize size = CheckedSize(file, facts.width, facts.height, max_pixels);
  if (!reader.Try([&] { ChooseOutput(reader, facts); })) refuse();

  out.image.grey = Image<std::uint16_t>(size);
  const bool interlaced = facts.passes > 1;
  std::vector<unsigned char> rows(facts.row_bytes * (interlaced ? facts.height : 1u));
  const auto read_rows = [&] {
    for (int pass = 0; pass < facts.passes; ++pass) {
      for (int r = 0; r < size.height; ++r) {
        unsigned char* row =
            rows.data() + (interlaced ? static_cast<std::size_t>(r) * facts.row_bytes : 0);
        png_read_row(reader.png, row, nullptr);
        if (pass + 1 == facts.passes) StoreRow(facts, row, out.image.grey.row(r));
      }
    }
    png_read_end(reader.png, nullptr);
  };
  if (!reader.Try(read_rows)) refuse();
  out.was_colour = facts.channels == 3;
  out.image.bits = SignificantBits(out.image.grey, facts.stored_bits, facts.stated_bits);
  return out;
}

}  // namespace plumbline::internal
