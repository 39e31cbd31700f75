#include "io/internal/series_layout.h"

#include <cmath>
#include <optional>
#include <type_traits>

#include "io/internal/point_values.h"
#include "io/internal/series_images.h"
#include "io/internal/series_records.h"
#include "track/strain_measure.h"

namespace plumbline::internal {
namespace {

using F = PointField;
using Part = PointPart;

constexpr std::string_view kCommonSigma =
    "standard deviation from the calibration, common to all points";

constexpr std::uint32_t kAlways = 0, kWithCovariance = BitOf(&SeriesContents::covariance),
                        kMoved = BitOf(&SeriesContents::displacement),
                        kStrained = BitOf(&SeriesContents::strain),
                        kSlipped = BitOf(&SeriesContents::slip),
                        kMoving = BitOf(&SeriesContents::velocity),
                        kMatched = BitOf(&SeriesContents::matches),
                        kOfMaterial = BitOf(&SeriesContents::material),
                        kOfWindows = BitOf(&SeriesContents::strain_windows),
                        kSurveyed = BitOf(&SeriesContents::survey);

constexpr std::array<PointGroupFacts, kPointGroupCount> kGroups = {{
    {"/surface", "position", "position", kAlways, true, true},
    {"/displacement", "value", "displacement", kMoved, true, false},
    {"/slip", "velocity", "velocity", kSlipped, true, false},
    {"/velocity", "value", "velocity", kMoving, true, false},
    {"/match", "left_displacement", "match", kMatched, false, false, true},
    {"/material", "position", "place on the undeformed wheel", kOfMaterial, false, false},
    {"/survey", "left_displacement", "match of the survey", kSurveyed, false, false, true, true},
    {"/strain", "value", "strain", kStrained, false, true},
}};

constexpr std::array<std::string_view, 2> kXyNames = {"x", "y"};
constexpr ComponentAxis kXy{"component", kXyNames};
constexpr std::array<std::string_view, 3> kXyzNames = {"x", "y", "z"};
constexpr std::array<std::string_view, 6> kSpaceTensorNames = {"xx", "xy", "xz", "yy", "yz", "zz"};
constexpr ComponentAxis kXyz{"component", kXyzNames};
constexpr ComponentAxis kSpaceTensor{"covariance_component", kSpaceTensorNames};

// A field that the first version of the format has not.
constexpr F New(F field) {
  field.since = 2;
  return field;
}
constexpr F NewOptional(F field) {
  field.optional = true;
  return New(field);
}
constexpr F Renamed(F field, std::string_view before) {
  field.before = before;
  return field;
}

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
    F{kSlip, Part::kValue, "/slip/velocity", &kXyz, "mm/s",
      "velocity of the surface point over the ground", kSlipped},
    F{kSlip, Part::kRandom, "/slip/velocity_errors_random", &kXyz, "mm/s", kRandomSigma, kSlipped},
    F{kSlip, Part::kCalibration, "/slip/velocity_errors_calibration", &kXyz, "mm/s", kCommonSigma,
      kSlipped},
    F{kSlip, Part::kCombined, "/slip/velocity_errors", &kXyz, "mm/s", kCombinedSigma, kSlipped},
    F{kVelocity, Part::kValue, "/velocity/value", &kXyz, "mm/s", "velocity of the surface point",
      kMoving},
    F{kVelocity, Part::kRandom, "/velocity/value_errors_random", &kXyz, "mm/s", kRandomSigma,
      kMoving},
    F{kVelocity, Part::kCalibration, "/velocity/value_errors_calibration", &kXyz, "mm/s",
      kCommonSigma, kMoving},
    F{kVelocity, Part::kCombined, "/velocity/value_errors", &kXyz, "mm/s", kCombinedSigma, kMoving},
    F{kMatch, Part::kValue, "/match/left_displacement", &kXy, "pixel",
      "pixel in the left image now, less that of the grid", kMatched},
    F{kMatch, Part::kRightValue, "/match/right_displacement", &kXy, "pixel",
      "pixel in the right image now, less that of the grid", kMatched},
    F{kMatch, Part::kGradient, "/match/left_gradient", &kGradient, "1",
      "gradient of left_displacement along x and y of the reference image", kMatched},
    F{kMatch, Part::kRightGradient, "/match/right_gradient", &kGradient, "1",
      "gradient of right_displacement along x and y of the reference image", kMatched},
    F{kMatch, Part::kCovariance, "/match/left_covariance", &kUvTensor, "pixel2",
      "random covariance of left_displacement: uu, uv, vv", kMatched},
    F{kMatch, Part::kRightCovariance, "/match/right_covariance", &kUvTensor, "pixel2",
      "random covariance of right_displacement: uu, uv, vv", kMatched},
    F{kMatch, Part::kShare, "/match/left_share", &kOneNumber, "1",
      "share of left_covariance that comes from the noise of the reference image", kMatched},
    F{kMatch, Part::kRightShare, "/match/right_share", &kOneNumber, "1",
      "share of right_covariance that comes from the noise of the reference image", kMatched},
    F{kMaterial, Part::kValue, "/material/position", &kXyz, "mm",
      "place of the point on the undeformed wheel, in the wheel frame", kOfMaterial},
    F{kSurvey, Part::kValue, "/survey/left_displacement", &kXy, "pixel",
      "pixel in the left image, less that of the grid, as the survey matched it", kSurveyed},
    F{kSurvey, Part::kRightValue, "/survey/right_displacement", &kXy, "pixel",
      "pixel in the right image, less that of the grid, before its delay is taken out", kSurveyed},
    F{kSurvey, Part::kGradient, "/survey/left_gradient", &kGradient, "1",
      "gradient of left_displacement along x and y of the reference image", kSurveyed},
    F{kSurvey, Part::kRightGradient, "/survey/right_gradient", &kGradient, "1",
      "gradient of right_displacement along x and y of the reference image", kSurveyed},
    F{kSurvey, Part::kCovariance, "/survey/left_covariance", &kUvTensor, "pixel2",
      "random covariance of left_displacement: uu, uv, vv", kSurveyed},
    F{kSurvey, Part::kRightCovariance, "/survey/right_covariance", &kUvTensor, "pixel2",
      "random covariance of right_displacement: uu, uv, vv", kSurveyed},
    F{kSurvey, Part::kShare, "/survey/left_share", &kOneNumber, "1",
      "share of left_covariance that comes from the noise of the reference image", kSurveyed},
    F{kSurvey, Part::kRightShare, "/survey/right_share", &kOneNumber, "1",
      "share of right_covariance that comes from the noise of the reference image", kSurveyed},
    Renamed({kStrain, Part::kValue, "/strain/value", &kPlaneTensor, "1",
             "strain in the local axes of the surface, of the group's measure: xx, yy, xy (tensor "
             "shear)",
             kStrained},
            "/strain/green_lagrange"),
    Renamed({kStrain, Part::kRandom, "/strain/value_errors_random", &kPlaneTensor, "1",
             kRandomSigma, kStrained},
            "/strain/green_lagrange_errors_random"),
    Renamed({kStrain, Part::kCalibration, "/strain/value_errors_calibration", &kPlaneTensor, "1",
             kCommonSigma, kStrained},
            "/strain/green_lagrange_errors_calibration"),
    Renamed({kStrain, Part::kCombined, "/strain/value_errors", &kPlaneTensor, "1", kCombinedSigma,
             kStrained},
            "/strain/green_lagrange_errors"),
    New({kStrain, Part::kModel, "/strain/value_errors_model", &kPlaneTensor, "1",
         "standard deviation of what the polynomial over the gauge leaves out",
         kStrained | kOfWindows}),
    New({kStrain, Part::kWindow, "/strain/window_points", &kOneNumber, "1",
         "side of the point's strain gauge, in points of the grid", kStrained | kOfWindows}),
    New({kStrain, Part::kCovariance, "/strain/covariance", &kStrainTensor, "1",
         "random covariance of the strain, upper triangle row by row",
         kStrained | kWithCovariance}),
    F{kStrain, Part::kPrincipal, "/strain/principal", &kPrincipals, "1", kPrincipalLongName,
      kStrained},
    NewOptional({kStrain, Part::kPrincipalRandom, "/strain/principal_errors_random", &kPrincipals,
                 "1", kRandomSigma, kStrained}),
    NewOptional({kStrain, Part::kPrincipalCalibration, "/strain/principal_errors_calibration",
                 &kPrincipals, "1", kCommonSigma, kStrained}),
    NewOptional({kStrain, Part::kPrincipalCombined, "/strain/principal_errors", &kPrincipals, "1",
                 kCombinedSigma, kStrained}),
    F{kStrain, Part::kPrincipalAngle, "/strain/angle", &kOneNumber, "rad",
      "angle of the first principal direction from the local x axis towards y", kStrained},
    NewOptional({kStrain, Part::kPrincipalAngleRandom, "/strain/angle_errors_random", &kOneNumber,
                 "rad", kRandomSigma, kStrained}),
    NewOptional({kStrain, Part::kPrincipalAngleCalibration, "/strain/angle_errors_calibration",
                 &kOneNumber, "rad", kCommonSigma, kStrained}),
    NewOptional({kStrain, Part::kPrincipalAngleCombined, "/strain/angle_errors", &kOneNumber, "rad",
                 kCombinedSigma, kStrained}),
    New({kStrain, Part::kMaxShear, "/strain/max_shear", &kOneNumber, "1",
         "largest shear in the surface (of the tensor): half the difference of the principal "
         "strains",
         kStrained}),
    NewOptional({kStrain, Part::kMaxShearRandom, "/strain/max_shear_errors_random", &kOneNumber,
                 "1", kRandomSigma, kStrained}),
    NewOptional({kStrain, Part::kMaxShearCalibration, "/strain/max_shear_errors_calibration",
                 &kOneNumber, "1", kCommonSigma, kStrained}),
    NewOptional({kStrain, Part::kMaxShearCombined, "/strain/max_shear_errors", &kOneNumber, "1",
                 kCombinedSigma, kStrained}),
    New({kStrain, Part::kVonMises, "/strain/von_mises", &kOneNumber, "1",
         "von Mises equivalent strain, of a material that keeps its volume", kStrained}),
    NewOptional({kStrain, Part::kVonMisesRandom, "/strain/von_mises_errors_random", &kOneNumber,
                 "1", kRandomSigma, kStrained}),
    NewOptional({kStrain, Part::kVonMisesCalibration, "/strain/von_mises_errors_calibration",
                 &kOneNumber, "1", kCommonSigma, kStrained}),
    NewOptional({kStrain, Part::kVonMisesCombined, "/strain/von_mises_errors", &kOneNumber, "1",
                 kCombinedSigma, kStrained}),
    New({kStrain, Part::kStatus, "/strain/status", &kOneNumber, "1", kStatusLongName, kStrained,
         PointType::kStatus}),
};

// The random and the calibration sigma that a combined one is made of; nothing: it is none.
std::optional<std::array<Part, 2>> SigmasOf(Part combined) {
  switch (combined) {
    case Part::kCombined:
      return {{Part::kRandom, Part::kCalibration}};
    case Part::kPrincipalCombined:
      return {{Part::kPrincipalRandom, Part::kPrincipalCalibration}};
    case Part::kPrincipalAngleCombined:
      return {{Part::kPrincipalAngleRandom, Part::kPrincipalAngleCalibration}};
    case Part::kMaxShearCombined:
      return {{Part::kMaxShearRandom, Part::kMaxShearCalibration}};
    case Part::kVonMisesCombined:
      return {{Part::kVonMisesRandom, Part::kVonMisesCalibration}};
    default:
      return std::nullopt;
  }
}

// A point's value as the numbers of its dataset, matrices row by row.
Eigen::Matrix<float, 1, 1> Numbers(float value) { return Eigen::Matrix<float, 1, 1>(value); }
Eigen::Matrix<float, 1, 1> Numbers(Status code) { return Numbers(static_cast<float>(code)); }
template <int N>
const Eigen::Matrix<float, N, 1>& Numbers(const Eigen::Matrix<float, N, 1>& value) {
  return value;
}
Eigen::Vector4f Numbers(const Eigen::Matrix2f& value) {
  return {value(0, 0), value(0, 1), value(1, 0), value(1, 1)};
}

class StereoSource : public PointSource {
 public:
  explicit StereoSource(const SeriesFrame& frame) : frame_(frame) {}

  ImageSize SizeOf(const PointField& field) const override {
    if (const auto sigmas = SigmasOf(field.part)) {
      const ImageSize random = SizeOf(FieldOf(field.group, (*sigmas)[0]));
      return random == SizeOf(FieldOf(field.group, (*sigmas)[1])) ? random : ImageSize{};
    }
    std::optional<ImageSize> own;
    VisitImage(frame_, field, [&](const auto& image) { own = image.size(); });
    return own ? *own : SizeOf(FieldOf(field.group, Part::kValue));
  }

  void Gather(const PointField& field, std::size_t first, std::size_t last,
              std::uint8_t* to) const override {
    const std::size_t bytes = field.axis->count() * BytesOf(field.type);
    const auto put = [&](const auto& number_of) {
      const std::vector<bool> there = Where(field, first, last);
      for (std::size_t i = first; i < last; ++i) {
        PutValues(number_of(i), there[i - first], to + (i - first) * bytes);
      }
    };
    if (const auto sigmas = SigmasOf(field.part)) {
      VisitImage(frame_, FieldOf(field.group, (*sigmas)[0]), [&](const auto& a) {
        VisitImage(frame_, FieldOf(field.group, (*sigmas)[1]), [&](const auto& b) {
          if constexpr (std::is_same_v<decltype(a), decltype(b)>) {
            put([&](std::size_t i) { return Combined(field, a, b, i); });
          }
        });
      });
      return;
    }
    switch (field.part) {
      case Part::kStatus:
        for (std::size_t i = first; i < last; ++i) {
          to[i - first] = static_cast<std::uint8_t>(StatusAt(field.group, i));
        }
        return;
      case Part::kPrincipal:
        return put([&](std::size_t i) { return PrincipalOf(Strain(i)).strain; });
      case Part::kPrincipalAngle:
        return put([&](std::size_t i) { return Numbers(PrincipalOf(Strain(i)).angle_rad); });
      case Part::kMaxShear:
        return put([&](std::size_t i) {
          return Numbers(static_cast<float>(InvariantsOf(Strain(i).cast<double>()).max_shear));
        });
      case Part::kVonMises:
        return put([&](std::size_t i) {
          return Numbers(static_cast<float>(InvariantsOf(Strain(i).cast<double>()).von_mises));
        });
      default:
        VisitImage(frame_, field, [&](const auto& image) {
          put([&](std::size_t i) { return Numbers(image.data()[i]); });
        });
    }
  }

 private:
  template <typename Element>
  auto Combined(const PointField& field, const Image<Element>& a, const Image<Element>& b,
                std::size_t i) const {
    const auto random = Numbers(a.data()[i]), calibration = Numbers(b.data()[i]);
    auto variance = (random.cwiseAbs2() + calibration.cwiseAbs2()).eval();
    if constexpr (std::is_same_v<Element, Eigen::Vector3f>) {
      const Image<Eigen::Vector3f>& model = frame_.strain.sigma_model;
      if (field.group == kStrain && !model.empty()) variance += model.data()[i].cwiseAbs2();
    }
    return variance.cwiseSqrt().eval();
  }

  const Eigen::Vector3f& Strain(std::size_t i) const { return frame_.strain.value.data()[i]; }

  Status StatusAt(std::uint8_t group, std::size_t i) const {
    return group == kStrain
               ? StatusOf(frame_.strain.status.data()[i], Strain(i))
               : StatusOf(frame_.surface.status.data()[i], frame_.surface.position_mm.data()[i]);
  }

  // Which points have a number in the field, as far as their status and their vector say.
  std::vector<bool> Where(const PointField& field, std::size_t first, std::size_t last) const {
    std::vector<bool> there(last - first, true);
    // Of the match, which may tell something where it failed.
    if (field.part == Part::kCorrelation || field.part == Part::kEpipolar) return there;
    VisitImage(frame_, FieldOf(field.group, Part::kValue), [&](const auto& vectors) {
      for (std::size_t i = first; i < last; ++i) {
        there[i - first] = (kGroups[field.group].free || StatusAt(field.group, i) == Status::kOk) &&
                           Numbers(vectors.data()[i]).allFinite();
      }
    });
    return there;
  }

  static const PointField& FieldOf(std::uint8_t group, Part part) {
    return StereoPoints().FieldOf(group, part);
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
  const std::vector<std::size_t> fields = FieldsOf(StereoPoints(), shape, source, has_surface);
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
  if (contents.survey) out.Put(frame.survey.tags);
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
  if (contents.survey) frame.survey.tags = in.GetText();
  record.has_points = in.Get<std::uint8_t>() != 0;
  record.chunks = GetChunks(in, StereoPoints(), shape);
  return record;
}

}  // namespace plumbline::internal
