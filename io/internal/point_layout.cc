#include "io/internal/point_layout.h"

#include <libdeflate.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <memory>
#include <new>
#include <stdexcept>

#include "calib/status.h"

namespace plumbline::internal {
namespace {

constexpr std::size_t kLargestChunk = std::size_t{1} << 20;

// HDF5's shuffle filter: all first bytes, then all second bytes...
std::vector<std::uint8_t> Shuffled(std::span<const std::uint8_t> bytes, std::size_t value_bytes) {
  std::vector<std::uint8_t> out(bytes.size());
  const std::size_t count = bytes.size() / value_bytes;
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t b = 0; b < value_bytes; ++b) out[b * count + i] = bytes[value_bytes * i + b];
  }
  return out;
}

struct FreeCompressor {
  void operator()(libdeflate_compressor* compressor) const {
    libdeflate_free_compressor(compressor);
  }
};

std::vector<std::uint8_t> Deflated(std::span<const std::uint8_t> bytes) {
  static thread_local const std::unique_ptr<libdeflate_compressor, FreeCompressor> compressor(
      libdeflate_alloc_compressor(1));
  if (!compressor) throw std::bad_alloc();
  std::vector<std::uint8_t> out(libdeflate_zlib_compress_bound(compressor.get(), bytes.size()));
  out.resize(libdeflate_zlib_compress(compressor.get(), bytes.data(), bytes.size(), out.data(),
                                      out.size()));
  return out;
}

template <typename T>
void FillWith(T value, std::uint8_t* to, std::size_t bytes) {
  for (std::size_t at = 0; at < bytes; at += sizeof value)
    std::memcpy(to + at, &value, sizeof value);
}

// What HDF5 is told to give where nothing is stored.
void FillUp(PointType type, std::uint8_t* to, std::size_t bytes) {
  switch (type) {
    case PointType::kFloat:
      return FillWith(std::numeric_limits<float>::quiet_NaN(), to, bytes);
    case PointType::kDouble:
      return FillWith(std::numeric_limits<double>::quiet_NaN(), to, bytes);
    case PointType::kByte:
      return FillWith(std::uint8_t{0}, to, bytes);
    case PointType::kStatus:
      return FillWith(Status::kMasked, to, bytes);
  }
}

// A band beyond the last row is filled up with fill values, as HDF5 stores edge chunks.
std::vector<std::uint8_t> EncodeChunk(const PointField& field, const SeriesShape& shape, int band,
                                      const PointSource& source) {
  const auto columns = static_cast<std::size_t>(shape.columns);
  const auto first = static_cast<std::size_t>(band * shape.band_rows) * columns;
  const auto last = std::min(static_cast<std::size_t>(shape.rows) * columns,
                             first + static_cast<std::size_t>(shape.band_rows) * columns);
  std::vector<std::uint8_t> values(shape.ChunkBytes(field));
  source.Gather(field, first, last, values.data());
  const std::size_t used = (last - first) * field.axis->count() * BytesOf(field.type);
  FillUp(field.type, values.data() + used, values.size() - used);
  return Deflated(Shuffled(values, BytesOf(field.type)));
}

}  // namespace

std::size_t BytesOf(PointType type) {
  switch (type) {
    case PointType::kFloat:
      return sizeof(float);
    case PointType::kDouble:
      return sizeof(double);
    default:
      return 1;
  }
}

const PointField& PointLayout::FieldOf(std::uint8_t group, PointPart part) const {
  const auto found = std::find_if(fields.begin(), fields.end(), [&](const PointField& field) {
    return field.group == group && field.part == part;
  });
  if (found == fields.end()) throw std::logic_error("there is no such point field");
  return *found;
}

std::size_t SeriesShape::ChunkBytes(const PointField& field) const {
  return static_cast<std::size_t>(band_rows) * static_cast<std::size_t>(columns) *
         field.axis->count() * BytesOf(field.type);
}

SeriesShape SeriesShape::For(ImageSize grid, std::uint32_t content_bits, const PointField& field) {
  if (grid.width <= 0 || grid.height <= 0) {
    throw std::invalid_argument("SeriesWriter: the grid is empty");
  }
  SeriesShape shape{grid.height, grid.width, 1, content_bits};
  const std::size_t row_bytes = shape.ChunkBytes(field);
  shape.band_rows = static_cast<std::int32_t>(
      std::clamp<std::size_t>(kLargestChunk / row_bytes, 1, static_cast<std::size_t>(grid.height)));
  return shape;
}

std::vector<std::size_t> FieldsOf(const PointLayout& layout, const SeriesShape& shape,
                                  const PointSource& source, bool has_surface) {
  std::vector<std::size_t> fields;
  for (std::size_t i = 0; i < layout.fields.size(); ++i) {
    const PointField& field = layout.fields[i];
    if (!has_surface && !layout.groups[field.group].in_any_frame) continue;
    if (!Holds(shape.content_bits, field.needs) ||
        source.SizeOf(layout.FieldOf(field.group, PointPart::kValue)) == ImageSize{}) {
      continue;
    }
    if (field.optional && source.SizeOf(field) == ImageSize{}) continue;
    if (source.SizeOf(field) != shape.grid()) {
      throw std::invalid_argument("SeriesWriter: what " + field.Path() +
                                  " is to hold is not of the size of the grid");
    }
    fields.push_back(i);
  }
  return fields;
}

void PutChunks(ByteWriter& out, const PointLayout& layout, const SeriesShape& shape,
               const std::vector<std::size_t>& fields, const PointSource& source) {
  const auto bands = static_cast<std::size_t>(shape.bands());
  std::vector<std::vector<std::uint8_t>> chunks(bands * fields.size());
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
    chunks[i] =
        EncodeChunk(layout.fields[fields[i / bands]], shape, static_cast<int>(i % bands), source);
  });
  out.Put(static_cast<std::uint64_t>(chunks.size()));
  for (std::size_t i = 0; i < chunks.size(); ++i) {
    out.Put(static_cast<std::uint32_t>(fields[i / bands]));
    out.Put(static_cast<std::int32_t>(i % bands));
    out.Put(static_cast<std::uint64_t>(chunks[i].size()));
    out.PutBytes(chunks[i]);
  }
}

std::vector<PointChunk> GetChunks(ByteReader& in, const PointLayout& layout,
                                  const SeriesShape& shape) {
  std::vector<PointChunk> chunks;
  for (auto count = in.Get<std::uint64_t>(); count > 0; --count) {
    PointChunk chunk;
    chunk.field = in.Get<std::uint32_t>();
    chunk.band = in.Get<std::int32_t>();
    chunk.bytes = in.GetBytes(in.Get<std::uint64_t>());
    if (chunk.field >= layout.fields.size() ||
        !Holds(shape.content_bits, layout.fields[chunk.field].needs) || chunk.band < 0 ||
        chunk.band >= shape.bands()) {
      throw std::runtime_error("a record holds points of another series");
    }
    chunks.push_back(chunk);
  }
  return chunks;
}

}  // namespace plumbline::internal
