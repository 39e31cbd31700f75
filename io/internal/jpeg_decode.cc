#include <fmt/format.h>

#include <csetjmp>
#include <cstdio>
#include <string>
#include <vector>
// jpeglib.h needs <cstdio> before it.
#include <jpeglib.h>

#include "io/internal/image_decode.h"

namespace plumbline::internal {
namespace {

struct JpegFault {
  jpeg_error_mgr manager;  // first: libjpeg hands this struct back through a pointer to it
  std::jmp_buf jump;
  char text[JMSG_LENGTH_MAX] = "";
};

[[noreturn]] void OnError(j_common_ptr info) {
  auto* fault = reinterpret_cast<JpegFault*>(info->err);
  info->err->format_message(info, fault->text);
  std::longjmp(fault->jump, 1);
}

// libjpeg fills what is missing with grey and only warns; a measurement must not use such pixels.
void OnMessage(j_common_ptr info, int level) {
  if (level < 0) OnError(info);
}

struct JpegReader {
  jpeg_decompress_struct info{};
  JpegFault fault;

  JpegReader() {
    info.err = jpeg_std_error(&fault.manager);
    fault.manager.error_exit = OnError;
    fault.manager.emit_message = OnMessage;
  }
  JpegReader(const JpegReader&) = delete;
  JpegReader& operator=(const JpegReader&) = delete;
  ~JpegReader() { jpeg_destroy_decompress(&info); }

  // As PngReader::Try.
  template <typename Calls>
  bool Try(const Calls& calls) {
    if (setjmp(fault.jump) != 0) return false;
    calls();
    return true;
  }
};

}  // namespace

DecodedImage DecodeJpeg(const std::filesystem::path& file, std::int64_t max_pixels) {
  const FilePointer f = OpenForReading(file);
  JpegReader reader;
  jpeg_decompress_struct& info = reader.info;
  const auto refuse = [&]() {
    const bool ended = std::feof(f.get()) != 0;
    RefuseImage(file, fmt::format("the JPEG file is {} ({})", ended ? "truncated" : "damaged",
                                  reader.fault.text));
  };
  const auto read_header = [&] {
    jpeg_create_decompress(&info);
    jpeg_stdio_src(&info, f.get());
    jpeg_read_header(&info, TRUE);
  };
  if (!reader.Try(read_header)) refuse();
  DecodedImage out;
  const ImageSize size = CheckedSize(file, info.image_width, info.image_height, max_pixels);
  if (info.num_components != 1 && info.num_components != 3) {
    RefuseImage(file, fmt::format("it has {} colour components; save it as grey or RGB",
                                  info.num_components));
  }
  out.was_colour = info.num_components == 3;
  out.image.grey = Image<std::uint16_t>(size);
  std::vector<JSAMPLE> row(static_cast<std::size_t>(size.width));
  const auto read_rows = [&] {
    info.out_color_space = JCS_GRAYSCALE;  // of YCbCr this is Y itself, the Rec. 601 luma
    jpeg_start_decompress(&info);
    for (int r = 0; r < size.height; ++r) {
      JSAMPROW to = row.data();
      jpeg_read_scanlines(&info, &to, 1);
      std::uint16_t* grey = out.image.grey.row(r);
      for (int c = 0; c < size.width; ++c) grey[c] = to[c];
    }
    jpeg_finish_decompress(&info);
  };
  if (!reader.Try(read_rows)) refuse();
  return out;
}

}  // namespace plumbline::internal
