#include "io/internal/series_layout.h"

#include <oneapi/tbb/parallel_for.h>
#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>
#include <stdexcept>

namespace plumbline::internal {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr std::size_t kLargestChunk = std::size_t{1} << 20;

void CheckSize(ImageSize found, const SeriesShape& shape, const char* what) {
  if (found != ImageSize{shape.columns, shape.rows}) {
    throw std::invalid_argument(std::string("SeriesWriter: ") + what +
                                " is not of the size of the grid");
  }
}

void CheckSurface(const Surface& surface, const SeriesShape& shape) {
  CheckSize(surface.position_mm.size(), shape, "position_mm");
  CheckSize(surface.sigma_random_mm.size(), shape, "sigma_random_mm");
  CheckSize(surface.sigma_calibration_mm.size(), shape, "sigma_calibration_mm");
  CheckSize(surface.correlation.size(), shape, "correlation");
  CheckSize(surface.epipolar_px.size(), shape, "epipolar_px");
  CheckSize(surface.status.size(), shape, "status");
  if (shape.has_covariance != 0) CheckSize(surface.cov_random_mm2.size(), shape, "cov_random_mm2");
}

Status StatusOf(const Surface& surface, std::size_t i) {
  const Status status = surface.status.data()[i];
  const bool finite = surface.position_mm.data()[i].allFinite();
  return status == Status::kOk && !finite ? Status::kFailedVerification : status;
}

// The values of one field at point i.
void Gather(const Surface& surface, int field, std::size_t i, float* to) {
  const bool ok = StatusOf(surface, i) == Status::kOk;
  const auto copy = [&](const auto& vector) {
    for (int k = 0; k < static_cast<int>(vector.size()); ++k) to[k] = ok ? vector[k] : kNaN;
  };
  switch (field) {
    case kPosition:
      return copy(surface.position_mm.data()[i]);
    case kErrorsRandom:
      return copy(surface.sigma_random_mm.data()[i]);
    case kErrorsCalibration:
      return copy(surface.sigma_calibration_mm.data()[i]);
    case kErrors: {
      const Eigen::Vector3f& a = surface.sigma_random_mm.data()[i];
      const Eigen::Vector3f& b = surface.sigma_calibration_mm.data()[i];
      return copy(Eigen::Vector3f((a.cwiseAbs2() + b.cwiseAbs2()).cwiseSqrt()));
    }
    case kCovariance:
      return copy(surface.cov_random_mm2.data()[i]);
    case kCorrelation:
      *to = surface.correlation.data()[i];
      return;
    default:
      *to = surface.epipolar_px.data()[i];
  }
}

// HDF5's shuffle filter: all first bytes, then all second bytes...
std::vector<std::uint8_t> Shuffled(std::span<const float> values) {
  std::vector<std::uint8_t> out(values.size() * 4);
  const auto* from = reinterpret_cast<const std::uint8_t*>(values.data());
  for (std::size_t i = 0; i < values.size(); ++i) {
    for (std::size_t b = 0; b < 4; ++b) out[b * values.size() + i] = from[4 * i + b];
  }
  return out;
}

std::vector<std::uint8_t> Deflated(std::span<const std::uint8_t> bytes) {
  uLongf size = compressBound(static_cast<uLong>(bytes.size()));
  std::vector<std::uint8_t> out(size);
  if (compress2(out.data(), &size, bytes.data(), static_cast<uLong>(bytes.size()), 1) != Z_OK) {
    throw std::bad_alloc();
  }
  out.resize(size);
  return out;
}

// A band beyond the last row is filled up with fill values, as HDF5 stores edge chunks.
std::vector<std::uint8_t> EncodeChunk(const Surface& surface, const SeriesShape& shape, int field,
                                      int band) {
  const auto columns = static_cast<std::size_t>(shape.columns);
  const auto first = static_cast<std::size_t>(band * shape.band_rows) * columns;
  const auto last = std::min(static_cast<std::size_t>(shape.rows) * columns,
                             first + static_cast<std::size_t>(shape.band_rows) * columns);
  const PointField& facts = kPointFields[static_cast<std::size_t>(field)];
  if (facts.is_status) {
    std::vector<std::uint8_t> values(shape.ChunkBytes(field),
                                     static_cast<std::uint8_t>(Status::kMasked));
    for (std::size_t i = first; i < last; ++i) {
      values[i - first] = static_cast<std::uint8_t>(StatusOf(surface, i));
    }
    return Deflated(values);
  }
  const auto components = static_cast<std::size_t>(facts.components);
  std::vector<float> values(shape.ChunkBytes(field) / sizeof(float), kNaN);
  for (std::size_t i = first; i < last; ++i) {
    Gather(surface, field, i, values.data() + (i - first) * components);
  }
  return Deflated(Shuffled(values));
}

void PutGround(ByteWriter& out, const GroundRecord& g) {
  out.Put(static_cast<std::uint8_t>(g.found));
  out.Put(g.problem);
  const auto put = [&](const auto& matrix) {
    for (Eigen::Index i = 0; i < matrix.size(); ++i) out.Put(matrix.data()[i]);
  };
  put(g.normal_in_rig);
  out.Put(g.offset_mm);
  put(g.cov_random);
  put(g.cov_calibration);
  put(g.ground_from_rig.rotation);
  put(g.ground_from_rig.translation_mm);
  out.Put(g.rms_mm);
  out.Put(g.inlier_fraction);
  put(g.e1_in_rig);
  put(g.e2_in_rig);
  put(g.centroid_in_rig_mm);
}

GroundRecord GetGround(ByteReader& in) {
  GroundRecord g;
  g.found = in.Get<std::uint8_t>() != 0;
  g.problem = in.GetText();
  const auto get = [&](auto& matrix) {
    for (Eigen::Index i = 0; i < matrix.size(); ++i) matrix.data()[i] = in.Get<double>();
  };
  get(g.normal_in_rig);
  g.offset_mm = in.Get<double>();
  get(g.cov_random);
  get(g.cov_calibration);
  get(g.ground_from_rig.rotation);
  get(g.ground_from_rig.translation_mm);
  g.rms_mm = in.Get<double>();
  g.inlier_fraction = in.Get<double>();
  get(g.e1_in_rig);
  get(g.e2_in_rig);
  get(g.centroid_in_rig_mm);
  return g;
}

}  // namespace

std::size_t SeriesShape::ChunkBytes(int field) const {
  const PointField& facts = kPointFields[static_cast<std::size_t>(field)];
  return static_cast<std::size_t>(band_rows) * static_cast<std::size_t>(columns) *
         static_cast<std::size_t>(facts.components) * (facts.is_status ? 1 : sizeof(float));
}

SeriesShape SeriesShape::For(ImageSize grid, bool has_covariance) {
  if (grid.width <= 0 || grid.height <= 0) {
    throw std::invalid_argument("SeriesWriter: the grid is empty");
  }
  SeriesShape shape{grid.height, grid.width, 1, has_covariance ? 1 : 0};
  const std::size_t row_bytes = shape.ChunkBytes(kPosition);
  shape.band_rows = static_cast<std::int32_t>(
      std::clamp<std::size_t>(kLargestChunk / row_bytes, 1, static_cast<std::size_t>(grid.height)));
  return shape;
}

std::vector<std::uint8_t> EncodeFrame(const SeriesFrame& frame, const SeriesShape& shape) {
  const bool has_surface = frame.problem.empty() && !frame.surface.position_mm.empty();
  if (has_surface) CheckSurface(frame.surface, shape);
  ByteWriter out;
  out.Put(frame.index);
  out.Put(frame.time_s);
  out.Put(frame.left_id);
  out.Put(frame.right_id);
  out.Put(frame.problem);
  out.Put(static_cast<std::int32_t>(frame.dropped_before));
  out.Put(frame.surface.frame);
  PutGround(out, frame.ground);
  out.Put(static_cast<std::uint8_t>(has_surface));
  if (!has_surface) return std::move(out.bytes());

  const int bands = shape.bands();
  std::vector<std::vector<std::uint8_t>> chunks(static_cast<std::size_t>(bands * shape.fields()));
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
    chunks[i] =
        EncodeChunk(frame.surface, shape, static_cast<int>(i) / bands, static_cast<int>(i) % bands);
  });
  for (const std::vector<std::uint8_t>& chunk : chunks) {
    out.Put(static_cast<std::uint64_t>(chunk.size()));
    out.PutBytes(chunk);
  }
  return std::move(out.bytes());
}

FrameRecord DecodeFrame(std::span<const std::uint8_t> bytes, const SeriesShape& shape) {
  ByteReader in(bytes);
  FrameRecord record;
  SeriesFrame& frame = record.frame;
  frame.index = in.Get<std::int64_t>();
  frame.time_s = in.Get<double>();
  frame.left_id = in.GetText();
  frame.right_id = in.GetText();
  frame.problem = in.GetText();
  frame.dropped_before = in.Get<std::int32_t>();
  frame.surface.frame = in.Get<SurfaceFrame>();
  frame.ground = GetGround(in);
  record.has_surface = in.Get<std::uint8_t>() != 0;
  if (!record.has_surface) return record;
  const int bands = shape.bands();
  for (int i = 0; i < bands * shape.fields(); ++i) {
    record.chunks.push_back({i / bands, i % bands, in.GetBytes(in.Get<std::uint64_t>())});
  }
  return record;
}

}  // namespace plumbline::internal
