#include "io/internal/series_layout.h"

#include <oneapi/tbb/parallel_for.h>
#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>
#include <stdexcept>

#include "io/internal/series_records.h"

namespace plumbline::internal {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr std::size_t kLargestChunk = std::size_t{1} << 20;

using F = PointField;
using Part = PointPart;

constexpr std::string_view kCommonSigma =
    "standard deviation from the calibration, common to all points";

constexpr ContentFlag kAlways = nullptr, kMoved = &SeriesContents::displacement,
                      kStrained = &SeriesContents::strain, kSlipped = &SeriesContents::slip;

constexpr std::array kPointFields = {
    F{kSurface, Part::kValue, "position", &kXyz, "mm", "position of the surface point", kAlways},
    F{kSurface, Part::kRandom, "position_errors_random", &kXyz, "mm", kRandomSigma, kAlways},
    F{kSurface, Part::kCalibration, "position_errors_calibration", &kXyz, "mm", kCommonSigma,
      kAlways},
    F{kSurface, Part::kCombined, "position_errors", &kXyz, "mm", kCombinedSigma, kAlways},
    F{kSurface, Part::kCorrelation, "correlation", &kOneNumber, "1", "score of the match", kAlways},
    F{kSurface, Part::kEpipolar, "epipolar_px", &kOneNumber, "pixel",
      "signed distance of the match from the epipolar line", kAlways},
    F{kSurface, Part::kStatus, "status", &kOneNumber, "1", "why there is no value here, or ok",
      kAlways},
    F{kSurface, Part::kCovariance, "covariance", &kSpaceTensor, "mm2",
      "random covariance of the position: xx, xy, xz, yy, yz, zz", &SeriesContents::covariance},
    F{kDisplacement, Part::kValue, "value", &kXyz, "mm",
      "displacement of the surface point from the reference", kMoved},
    F{kDisplacement, Part::kRandom, "value_errors_random", &kXyz, "mm", kRandomSigma, kMoved},
    F{kDisplacement, Part::kCalibration, "value_errors_calibration", &kXyz, "mm", kCommonSigma,
      kMoved},
    F{kDisplacement, Part::kCombined, "value_errors", &kXyz, "mm", kCombinedSigma, kMoved},
    F{kStrain, Part::kValue, "green_lagrange", &kPlaneTensor, "1",
      "Green-Lagrange strain in the local axes of the surface: xx, yy, xy (tensor shear)",
      kStrained},
    F{kStrain, Part::kRandom, "green_lagrange_errors_random", &kPlaneTensor, "1", kRandomSigma,
      kStrained},
    F{kStrain, Part::kCalibration, "green_lagrange_errors_calibration", &kPlaneTensor, "1",
      kCommonSigma, kStrained},
    F{kStrain, Part::kCombined, "green_lagrange_errors", &kPlaneTensor, "1", kCombinedSigma,
      kStrained},
    F{kStrain, Part::kPrincipal, "principal", &kPrincipals, "1",
      "principal strains, the larger one first", kStrained},
    F{kStrain, Part::kPrincipalAngle, "angle", &kOneNumber, "rad",
      "angle of the first principal direction from the local x axis towards y", kStrained},
    F{kSlip, Part::kValue, "velocity", &kXyz, "mm/s",
      "velocity of the surface point over the ground", kSlipped},
    F{kSlip, Part::kRandom, "velocity_errors_random", &kXyz, "mm/s", kRandomSigma, kSlipped},
    F{kSlip, Part::kCalibration, "velocity_errors_calibration", &kXyz, "mm/s", kCommonSigma,
      kSlipped},
    F{kSlip, Part::kCombined, "velocity_errors", &kXyz, "mm/s", kCombinedSigma, kSlipped},
};

// The size of the image that the field's values come from.
ImageSize SizeIn(const SeriesFrame& frame, const PointField& field) {
  const auto [value, random, calibration] = VectorImages(frame, field.group);
  switch (field.part) {
    case Part::kRandom:
      return random->size();
    case Part::kCalibration:
      return calibration->size();
    case Part::kCovariance:
      return frame.surface.cov_random_mm2.size();
    case Part::kCorrelation:
      return frame.surface.correlation.size();
    case Part::kEpipolar:
      return frame.surface.epipolar_px.size();
    case Part::kStatus:
      return frame.surface.status.size();
    default:
      return value->size();
  }
}

// Places in PointFields() of what a frame with a surface holds. Throws std::invalid_argument where
// that is not of the grid's size.
std::vector<std::size_t> FieldsOf(const SeriesFrame& frame, const SeriesShape& shape) {
  const SeriesContents contents = shape.contents();
  std::vector<std::size_t> fields;
  for (std::size_t i = 0; i < kPointFields.size(); ++i) {
    const PointField& field = kPointFields[i];
    if (!Holds(contents, field.needs) || VectorImages(frame, field.group)[0]->empty()) continue;
    if (SizeIn(frame, field) != ImageSize{shape.columns, shape.rows}) {
      throw std::invalid_argument("SeriesWriter: what " + field.Path() +
                                  " is to hold is not of the size of the grid");
    }
    fields.push_back(i);
  }
  return fields;
}

Status StatusOf(const Surface& surface, std::size_t i) {
  const Status status = surface.status.data()[i];
  const bool finite = surface.position_mm.data()[i].allFinite();
  return status == Status::kOk && !finite ? Status::kFailedVerification : status;
}

// The values of one field at point i.
void Gather(const SeriesFrame& frame, const PointField& field, std::size_t i, float* to) {
  const auto images = VectorImages(frame, field.group);
  const Eigen::Vector3f& value = images[0]->data()[i];
  const bool there = StatusOf(frame.surface, i) == Status::kOk && value.allFinite();
  const auto copy = [&](const auto& vector) {
    for (int k = 0; k < static_cast<int>(vector.size()); ++k) {
      to[k] = there && std::isfinite(vector[k]) ? vector[k] : kNaN;
    }
  };
  switch (field.part) {
    case Part::kValue:
      return copy(value);
    case Part::kRandom:
      return copy(images[1]->data()[i]);
    case Part::kCalibration:
      return copy(images[2]->data()[i]);
    case Part::kCombined: {
      const Eigen::Vector3f& a = images[1]->data()[i];
      const Eigen::Vector3f& b = images[2]->data()[i];
      return copy(Eigen::Vector3f((a.cwiseAbs2() + b.cwiseAbs2()).cwiseSqrt()));
    }
    case Part::kPrincipal:
      return copy(PrincipalOf(value).strain);
    case Part::kPrincipalAngle:
      return copy(Eigen::Matrix<float, 1, 1>(PrincipalOf(value).angle_rad));
    case Part::kCovariance:
      return copy(frame.surface.cov_random_mm2.data()[i]);
    default: {  // of the match, which may tell something where it failed
      const bool is_correlation = field.part == Part::kCorrelation;
      const Image<float>& image =
          is_correlation ? frame.surface.correlation : frame.surface.epipolar_px;
      *to = std::isfinite(image.data()[i]) ? image.data()[i] : kNaN;
    }
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
std::vector<std::uint8_t> EncodeChunk(const SeriesFrame& frame, const SeriesShape& shape,
                                      const PointField& field, int band) {
  const auto columns = static_cast<std::size_t>(shape.columns);
  const auto first = static_cast<std::size_t>(band * shape.band_rows) * columns;
  const auto last = std::min(static_cast<std::size_t>(shape.rows) * columns,
                             first + static_cast<std::size_t>(shape.band_rows) * columns);
  if (field.is_status()) {
    std::vector<std::uint8_t> values(shape.ChunkBytes(field),
                                     static_cast<std::uint8_t>(Status::kMasked));
    for (std::size_t i = first; i < last; ++i) {
      values[i - first] = static_cast<std::uint8_t>(StatusOf(frame.surface, i));
    }
    return Deflated(values);
  }
  const auto components = static_cast<std::size_t>(field.axis->count);
  std::vector<float> values(shape.ChunkBytes(field) / sizeof(float), kNaN);
  for (std::size_t i = first; i < last; ++i) {
    Gather(frame, field, i, values.data() + (i - first) * components);
  }
  return Deflated(Shuffled(values));
}

void PutRecord(ByteWriter& out, const RecordGroup& group, const SeriesFrame& frame) {
  out.Put(static_cast<std::uint8_t>(group.found(frame)));
  out.Put(group.problem(frame));
  for (const RecordField& field : group.fields) {
    if (!field.set) continue;
    const Eigen::MatrixXd value = field.get(frame);
    for (Eigen::Index i = 0; i < value.size(); ++i) out.Put(value.data()[i]);
  }
}

void GetRecord(ByteReader& in, const RecordGroup& group, SeriesFrame* frame) {
  const bool found = in.Get<std::uint8_t>() != 0;
  group.set_found(found, in.GetText(), frame);
  for (const RecordField& field : group.fields) {
    if (!field.set) continue;
    Eigen::MatrixXd value(field.rows(), field.columns());
    for (Eigen::Index i = 0; i < value.size(); ++i) value.data()[i] = in.Get<double>();
    field.set(value, frame);
  }
}

void PutContour(ByteWriter& out, const std::vector<Eigen::Vector2d>& contour_mm) {
  out.Put(static_cast<std::uint64_t>(contour_mm.size()));
  for (const Eigen::Vector2d& point : contour_mm) {
    out.Put(point.x());
    out.Put(point.y());
  }
}

std::vector<Eigen::Vector2d> GetContour(ByteReader& in) {
  std::vector<Eigen::Vector2d> contour_mm;
  for (auto count = in.Get<std::uint64_t>(); count > 0; --count) {
    const auto x = in.Get<double>();
    contour_mm.emplace_back(x, in.Get<double>());
  }
  return contour_mm;
}

}  // namespace

std::string PointField::Path() const {
  return std::string(kPointGroups[group].path) + "/" + std::string(name);
}

std::span<const PointField> PointFields() { return kPointFields; }

const PointField& FieldOf(PointGroup group, PointPart part) {
  const auto found = std::find_if(kPointFields.begin(), kPointFields.end(), [&](const auto& field) {
    return field.group == group && field.part == part;
  });
  if (found == kPointFields.end()) throw std::logic_error("there is no such point field");
  return *found;
}

SeriesContents SeriesShape::contents() const {
  SeriesContents contents;
  for (std::size_t bit = 0; bit < kOptionalContents.size(); ++bit) {
    contents.*kOptionalContents[bit].flag = (content_bits >> bit & 1u) != 0;
  }
  return contents;
}

std::size_t SeriesShape::ChunkBytes(const PointField& field) const {
  return static_cast<std::size_t>(band_rows) * static_cast<std::size_t>(columns) *
         static_cast<std::size_t>(field.axis->count) * (field.is_status() ? 1 : sizeof(float));
}

SeriesShape SeriesShape::For(ImageSize grid, const SeriesContents& contents) {
  if (grid.width <= 0 || grid.height <= 0) {
    throw std::invalid_argument("SeriesWriter: the grid is empty");
  }
  SeriesShape shape{grid.height, grid.width, 1, 0};
  for (std::size_t bit = 0; bit < kOptionalContents.size(); ++bit) {
    if (contents.*kOptionalContents[bit].flag) shape.content_bits |= 1u << bit;
  }
  const std::size_t row_bytes = shape.ChunkBytes(FieldOf(kSurface, Part::kValue));
  shape.band_rows = static_cast<std::int32_t>(
      std::clamp<std::size_t>(kLargestChunk / row_bytes, 1, static_cast<std::size_t>(grid.height)));
  return shape;
}

std::vector<std::uint8_t> EncodeFrame(const SeriesFrame& frame, const SeriesShape& shape) {
  const bool has_surface = frame.problem.empty() && !frame.surface.position_mm.empty();
  const auto fields = has_surface ? FieldsOf(frame, shape) : std::vector<std::size_t>{};
  const SeriesContents contents = shape.contents();
  ByteWriter out;
  out.Put(frame.index);
  out.Put(frame.time_s);
  out.Put(frame.left_id);
  out.Put(frame.right_id);
  out.Put(frame.problem);
  out.Put(static_cast<std::int32_t>(frame.dropped_before));
  out.Put(frame.surface.frame);
  for (const RecordGroup& group : RecordGroups()) {
    if (Holds(contents, group.needs)) PutRecord(out, group, frame);
  }
  if (contents.patch) PutContour(out, frame.patch.contour_mm);
  out.Put(static_cast<std::uint8_t>(has_surface));

  const auto bands = static_cast<std::size_t>(shape.bands());
  std::vector<std::vector<std::uint8_t>> chunks(bands * fields.size());
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
    chunks[i] =
        EncodeChunk(frame, shape, kPointFields[fields[i / bands]], static_cast<int>(i % bands));
  });
  out.Put(static_cast<std::uint64_t>(chunks.size()));
  for (std::size_t i = 0; i < chunks.size(); ++i) {
    out.Put(static_cast<std::uint32_t>(fields[i / bands]));
    out.Put(static_cast<std::int32_t>(i % bands));
    out.Put(static_cast<std::uint64_t>(chunks[i].size()));
    out.PutBytes(chunks[i]);
  }
  return std::move(out.bytes());
}

FrameRecord DecodeFrame(std::span<const std::uint8_t> bytes, const SeriesShape& shape) {
  ByteReader in(bytes);
  const SeriesContents contents = shape.contents();
  FrameRecord record;
  SeriesFrame& frame = record.frame;
  frame.index = in.Get<std::int64_t>();
  frame.time_s = in.Get<double>();
  frame.left_id = in.GetText();
  frame.right_id = in.GetText();
  frame.problem = in.GetText();
  frame.dropped_before = in.Get<std::int32_t>();
  frame.surface.frame = in.Get<SurfaceFrame>();
  for (const RecordGroup& group : RecordGroups()) {
    if (Holds(contents, group.needs)) GetRecord(in, group, &frame);
  }
  if (contents.patch) frame.patch.contour_mm = GetContour(in);
  record.has_surface = in.Get<std::uint8_t>() != 0;
  for (auto count = in.Get<std::uint64_t>(); count > 0; --count) {
    FrameRecord::Chunk chunk;
    chunk.field = in.Get<std::uint32_t>();
    chunk.band = in.Get<std::int32_t>();
    chunk.bytes = in.GetBytes(in.Get<std::uint64_t>());
    if (chunk.field >= kPointFields.size() || !Holds(contents, kPointFields[chunk.field].needs) ||
        chunk.band < 0 || chunk.band >= shape.bands()) {
      throw std::runtime_error("a record holds points of another series");
    }
    record.chunks.push_back(chunk);
  }
  return record;
}

}  // namespace plumbline::internal
