#include "io/internal/series_layout.h"

#include <cmath>
#include <limits>
#include <stdexcept>

#include "io/internal/point_values.h"
#include "io/internal/series_records.h"

namespace plumbline::internal {
namespace {

using F = PointField;
using Part = PointPart;

constexpr std::string_view kCommonSigma =
    "standard deviation from the calibration, common to all points";

constexpr std::uint32_t kAlways = 0, kWithCovariance = BitOf(&SeriesContents::covariance),
                        kMoved = BitOf(&SeriesContents::displacement),
                        kStrained = BitOf(&SeriesContents::strain),
                        kSlipped = BitOf(&SeriesContents::slip);

constexpr std::array<PointGroupFacts, kPointGroupCount> kGroups = {{
    {"/surface", "position", "position", kAlways, true, true},
    {"/displacement", "value", "displacement", kMoved, true, false},
    {"/strain", "green_lagrange", "strain", kStrained, false, false},
    {"/slip", "velocity", "velocity", kSlipped, true, false},
}};

constexpr std::array<std::string_view, 3> kXyzNames = {"x", "y", "z"};
constexpr std::array<std::string_view, 6> kSpaceTensorNames = {"xx", "xy", "xz", "yy", "yz", "zz"};
constexpr ComponentAxis kXyz{"component", kXyzNames};
constexpr ComponentAxis kSpaceTensor{"covariance_component", kSpaceTensorNames};

constexpr std::array kFields = {
    F{kSurface, Part::kValue, "/surface/position", &kXyz, "mm", "position of the surface point"},
    F{kSurface, Part::kRandom, "/surface/position_errors_random", &kXyz, "mm", kRandomSigma},
    F{kSurface, Part::kCalibration, "/surface/position_errors_calibration", &kXyz, "mm",
      kCommonSigma},
    F{kSurface, Part::kCombined, "/surface/position_errors", &kXyz, "mm", kCombinedSigma},
    F{kSurface, Part::kCorrelation, "/surface/correlation", &kOneNumber, "1", "score of the match"},
    F{kSurface, Part::kEpipolar, "/surface/epipolar_px", &kOneNumber, "pixel",
      "signed distance of the match from the epipolar line"},
    F{kSurface, Part::kStatus, "/surface/status", &kOneNumber, "1", kStatusLongName, kAlways,
      PointType::kStatus},
    F{kSurface, Part::kCovariance, "/surface/covariance", &kSpaceTensor, "mm2",
      "random covariance of the position: xx, xy, xz, yy, yz, zz", kWithCovariance},
    F{kDisplacement, Part::kValue, "/displacement/value", &kXyz, "mm",
      "displacement of the surface point from the reference", kMoved},
    F{kDisplacement, Part::kRandom, "/displacement/value_errors_random", &kXyz, "mm", kRandomSigma,
      kMoved},
    F{kDisplacement, Part::kCalibration, "/displacement/value_errors_calibration", &kXyz, "mm",
      kCommonSigma, kMoved},
    F{kDisplacement, Part::kCombined, "/displacement/value_errors", &kXyz, "mm", kCombinedSigma,
      kMoved},
    F{kStrain, Part::kValue, "/strain/green_lagrange", &kPlaneTensor, "1",
      "Green-Lagrange strain in the local axes of the surface: xx, yy, xy (tensor shear)",
      kStrained},
    F{kStrain, Part::kRandom, "/strain/green_lagrange_errors_random", &kPlaneTensor, "1",
      kRandomSigma, kStrained},
    F{kStrain, Part::kCalibration, "/strain/green_lagrange_errors_calibration", &kPlaneTensor, "1",
      kCommonSigma, kStrained},
    F{kStrain, Part::kCombined, "/strain/green_lagrange_errors", &kPlaneTensor, "1", kCombinedSigma,
      kStrained},
    F{kStrain, Part::kPrincipal, "/strain/principal", &kPrincipals, "1", kPrincipalLongName,
      kStrained},
    F{kStrain, Part::kPrincipalAngle, "/strain/angle", &kOneNumber, "rad",
      "angle of the first principal direction from the local x axis towards y", kStrained},
    F{kSlip, Part::kValue, "/slip/velocity", &kXyz, "mm/s",
      "velocity of the surface point over the ground", kSlipped},
    F{kSlip, Part::kRandom, "/slip/velocity_errors_random", &kXyz, "mm/s", kRandomSigma, kSlipped},
    F{kSlip, Part::kCalibration, "/slip/velocity_errors_calibration", &kXyz, "mm/s", kCommonSigma,
      kSlipped},
    F{kSlip, Part::kCombined, "/slip/velocity_errors", &kXyz, "mm/s", kCombinedSigma, kSlipped},
};

Status StatusAt(const Surface& surface, std::size_t i) {
  return StatusOf(surface.status.data()[i], surface.position_mm.data()[i]);
}

class StereoSource : public PointSource {
 public:
  explicit StereoSource(const SeriesFrame& frame) : frame_(frame) {}

  ImageSize SizeOf(const PointField& field) const override {
    const auto images = VectorImages(frame_, static_cast<PointGroup>(field.group));
    const Surface& s = frame_.surface;
    switch (field.part) {
      case Part::kRandom:
        return images[1]->size();
      case Part::kCalibration:
        return images[2]->size();
      case Part::kCovariance:
        return s.cov_random_mm2.size();
      case Part::kCorrelation:
        return s.correlation.size();
      case Part::kEpipolar:
        return s.epipolar_px.size();
      case Part::kStatus:
        return s.status.size();
      default:
        return images[0]->size();
    }
  }

  void Gather(const PointField& field, std::size_t first, std::size_t last,
              std::uint8_t* to) const override {
    for (std::size_t i = first; i < last; ++i) {
      GatherPoint(field, i, to + (i - first) * field.axis->count() * BytesOf(field.type));
    }
  }

 private:
  void GatherPoint(const PointField& field, std::size_t i, std::uint8_t* to) const {
    const Surface& s = frame_.surface;
    const auto images = VectorImages(frame_, static_cast<PointGroup>(field.group));
    const Eigen::Vector3f& value = images[0]->data()[i];
    const bool there = StatusAt(s, i) == Status::kOk && value.allFinite();
    switch (field.part) {
      case Part::kValue:
        return PutValues(value, there, to);
      case Part::kRandom:
        return PutValues(images[1]->data()[i], there, to);
      case Part::kCalibration:
        return PutValues(images[2]->data()[i], there, to);
      case Part::kCombined: {
        const Eigen::Vector3f& a = images[1]->data()[i];
        const Eigen::Vector3f& b = images[2]->data()[i];
        return PutValues(Eigen::Vector3f((a.cwiseAbs2() + b.cwiseAbs2()).cwiseSqrt()), there, to);
      }
      case Part::kPrincipal:
        return PutValues(PrincipalOf(value).strain, there, to);
      case Part::kPrincipalAngle:
        return PutValue(PrincipalOf(value).angle_rad, there, to);
      case Part::kCovariance:
        return PutValues(s.cov_random_mm2.data()[i], there, to);
      case Part::kStatus:
        *to = static_cast<std::uint8_t>(StatusAt(s, i));
        return;
      // Of the match, which may tell something where it failed.
      case Part::kCorrelation:
        return PutValue(s.correlation.data()[i], true, to);
      default:
        return PutValue(s.epipolar_px.data()[i], true, to);
    }
  }

  const SeriesFrame& frame_;
};

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

const PointLayout& StereoPoints() {
  static constexpr PointLayout layout = {"surface", kGroups, kFields};
  return layout;
}

SeriesShape StereoShape(ImageSize grid, const SeriesContents& contents) {
  return SeriesShape::For(grid, BitsOf(contents), StereoPoints().FieldOf(kSurface, Part::kValue));
}

std::vector<std::uint8_t> EncodeFrame(const SeriesFrame& frame, const SeriesShape& shape) {
  const bool has_surface = frame.problem.empty() && !frame.surface.position_mm.empty();
  const StereoSource source(frame);
  const auto fields =
      has_surface ? FieldsOf(StereoPoints(), shape, source) : std::vector<std::size_t>{};
  const auto contents = FromBits<SeriesContents>(shape.content_bits);
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
  PutChunks(out, StereoPoints(), shape, fields, source);
  return std::move(out.bytes());
}

FrameRecord<SeriesFrame> DecodeFrame(std::span<const std::uint8_t> bytes,
                                     const SeriesShape& shape) {
  ByteReader in(bytes);
  const auto contents = FromBits<SeriesContents>(shape.content_bits);
  FrameRecord<SeriesFrame> record;
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
  record.has_points = in.Get<std::uint8_t>() != 0;
  record.chunks = GetChunks(in, StereoPoints(), shape);
  return record;
}

}  // namespace plumbline::internal
