#include "io/internal/planar_layout.h"

#include <cmath>

#include "io/internal/point_values.h"
#include "io/series_frame.h"

namespace plumbline::internal {
namespace {

using F = PointField;
using Part = PointPart;

constexpr std::uint32_t kAlways = 0, kFullGradient = BitOf(&PlanarContents::gradient_covariance),
                        kStrained = BitOf(&PlanarContents::strain);

constexpr std::array<PointGroupFacts, kPlanarGroupCount> kGroups = {{
    {"/displacement", "value", "displacement", kAlways, false, true},
    {"/strain", "value", "strain", kStrained, false, true},
}};

constexpr std::array<std::string_view, 2> kUvNames = {"u", "v"};
constexpr std::array<std::string_view, 10> kGradientTensorNames = {
    "du/dx du/dx", "du/dx du/dy", "du/dx dv/dx", "du/dx dv/dy", "du/dy du/dy",
    "du/dy dv/dx", "du/dy dv/dy", "dv/dx dv/dx", "dv/dx dv/dy", "dv/dy dv/dy"};
constexpr ComponentAxis kUv{"component", kUvNames};
constexpr ComponentAxis kGradientTensor{"gradient_covariance_component", kGradientTensorNames};

constexpr std::array kFields = {
    F{kPlanarDisplacement, Part::kValue, "/displacement/value", &kUv, "pixel",
      "displacement of the material point along x and y of the image", kAlways, PointType::kDouble},
    F{kPlanarDisplacement, Part::kRandom, "/displacement/value_errors_random", &kUv, "pixel",
      kRandomSigma, kAlways, PointType::kFloat, "/displacement/value_errors"},
    F{kPlanarDisplacement, Part::kCovariance, "/displacement/covariance", &kUvTensor, "pixel2",
      "random covariance of the displacement: uu, uv, vv"},
    F{kPlanarDisplacement, Part::kGradient, "/displacement/gradient", &kGradient, "1",
      "gradient of the displacement, of the subset's shape function"},
    F{kPlanarDisplacement, Part::kGradientRandom, "/displacement/gradient_errors_random",
      &kGradient, "1", kRandomSigma, kAlways, PointType::kFloat, "/displacement/gradient_errors"},
    F{kPlanarDisplacement, Part::kGradientCovariance, "/displacement/gradient_covariance",
      &kGradientTensor, "1", "random covariance of the gradient, upper triangle row by row",
      kFullGradient},
    F{kPlanarDisplacement, Part::kCorrelation, "/displacement/correlation", &kOneNumber, "1",
      "zero-normalised cross-correlation of the subsets"},
    F{kPlanarDisplacement, Part::kIterations, "/displacement/iterations", &kOneNumber, "1",
      "iterations that the correlation took", kAlways, PointType::kByte},
    F{kPlanarDisplacement, Part::kStatus, "/displacement/status", &kOneNumber, "1", kStatusLongName,
      kAlways, PointType::kStatus},
    F{kPlanarStrain, Part::kValue, "/strain/value", &kPlaneTensor, "1",
      "strain along the image's axes, of the group's measure: xx, yy, xy (tensor shear)",
      kStrained},
    F{kPlanarStrain, Part::kRandom, "/strain/value_errors_random", &kPlaneTensor, "1", kRandomSigma,
      kStrained, PointType::kFloat, "/strain/value_errors"},
    F{kPlanarStrain, Part::kCovariance, "/strain/covariance", &kStrainTensor, "1",
      "random covariance of the strain, upper triangle row by row", kStrained},
    F{kPlanarStrain, Part::kPrincipal, "/strain/principal", &kPrincipals, "1", kPrincipalLongName,
      kStrained},
    F{kPlanarStrain, Part::kPrincipalRandom, "/strain/principal_errors_random", &kPrincipals, "1",
      kRandomSigma, kStrained, PointType::kFloat, "/strain/principal_errors"},
    F{kPlanarStrain, Part::kPrincipalAngle, "/strain/angle", &kOneNumber, "rad",
      "angle of the first principal direction from the image's x axis towards y", kStrained},
    F{kPlanarStrain, Part::kPrincipalAngleRandom, "/strain/angle_errors_random", &kOneNumber, "rad",
      kRandomSigma, kStrained, PointType::kFloat, "/strain/angle_errors"},
    F{kPlanarStrain, Part::kStatus, "/strain/status", &kOneNumber, "1", kStatusLongName, kStrained,
      PointType::kStatus},
};

// Sigmas from a covariance's upper triangle, stored row by row, of n rows.
template <int n, typename Triangle>
Eigen::Matrix<float, n, 1> SigmasOf(const Triangle& covariance) {
  Eigen::Matrix<float, n, 1> sigmas;
  for (int row = 0, at = 0; row < n; at += n - row, ++row) sigmas[row] = std::sqrt(covariance[at]);
  return sigmas;
}

class PlanarSource : public PointSource {
 public:
  explicit PlanarSource(const PlanarSeriesFrame& frame) : frame_(frame) {}

  ImageSize SizeOf(const PointField& field) const override {
    return field.group == kPlanarStrain ? SizeInStrain(field.part) : SizeInField(field.part);
  }

  void Gather(const PointField& field, std::size_t first, std::size_t last,
              std::uint8_t* to) const override {
    for (std::size_t i = first; i < last; ++i) {
      std::uint8_t* place = to + (i - first) * field.axis->count() * BytesOf(field.type);
      if (field.group == kPlanarStrain) {
        GatherStrain(field.part, i, place);
      } else {
        GatherField(field.part, i, place);
      }
    }
  }

 private:
  ImageSize SizeInField(Part part) const {
    const PlanarField& f = frame_.field;
    switch (part) {
      case Part::kRandom:
      case Part::kCovariance:
        return f.cov_displacement_px2.size();
      case Part::kGradient:
        return f.gradient.size();
      case Part::kGradientRandom:
      case Part::kGradientCovariance:
        return f.cov_gradient.size();
      case Part::kCorrelation:
        return f.zncc.size();
      case Part::kIterations:
        return f.iterations.size();
      case Part::kStatus:
        return f.status.size();
      default:
        return f.displacement_px.size();
    }
  }

  ImageSize SizeInStrain(Part part) const {
    const PlanarStrainRecord& e = frame_.strain;
    switch (part) {
      case Part::kRandom:
      case Part::kCovariance:
      case Part::kPrincipalRandom:
      case Part::kPrincipalAngleRandom:
        return e.covariance.size();
      case Part::kStatus:
        return e.status.size();
      default:
        return e.strain.size();
    }
  }

  void GatherField(Part part, std::size_t i, std::uint8_t* to) const {
    const PlanarField& f = frame_.field;
    const Eigen::Vector2d& value = f.displacement_px.data()[i];
    const Status status = StatusOf(f.status.data()[i], value);
    const bool there = status == Status::kOk;
    switch (part) {
      case Part::kValue:
        return PutValues(value, there, to);
      case Part::kRandom:
        return PutValues(SigmasOf<2>(f.cov_displacement_px2.data()[i]), there, to);
      case Part::kCovariance:
        return PutValues(f.cov_displacement_px2.data()[i], there, to);
      case Part::kGradient: {
        const Eigen::Matrix2f& G = f.gradient.data()[i];
        return PutValues(Eigen::Vector4f(G(0, 0), G(0, 1), G(1, 0), G(1, 1)), there, to);
      }
      case Part::kGradientRandom:
        return PutValues(SigmasOf<4>(f.cov_gradient.data()[i]), there, to);
      case Part::kGradientCovariance:
        return PutValues(f.cov_gradient.data()[i], there, to);
      case Part::kStatus:
        *to = static_cast<std::uint8_t>(status);
        return;
      case Part::kIterations:
        *to = f.iterations.data()[i];
        return;
      default:  // of the match, which may tell something where it failed
        return PutValue(f.zncc.data()[i], true, to);
    }
  }

  void GatherStrain(Part part, std::size_t i, std::uint8_t* to) const {
    const PlanarStrainRecord& e = frame_.strain;
    const Eigen::Vector3f& value = e.strain.data()[i];
    const Status status = StatusOf(e.status.data()[i], value);
    const bool there = status == Status::kOk;
    switch (part) {
      case Part::kValue:
        return PutValues(value, there, to);
      case Part::kRandom:
        return PutValues(SigmasOf<3>(e.covariance.data()[i]), there, to);
      case Part::kCovariance:
        return PutValues(e.covariance.data()[i], there, to);
      case Part::kPrincipal:
        return PutValues(PrincipalOf(value).strain, there, to);
      case Part::kPrincipalRandom:
        return PutValues(SigmaOfPrincipal(value, e.covariance.data()[i]).strain, there, to);
      case Part::kPrincipalAngle:
        return PutValue(PrincipalOf(value).angle_rad, there, to);
      case Part::kPrincipalAngleRandom:
        return PutValue(SigmaOfPrincipal(value, e.covariance.data()[i]).angle_rad, there, to);
      default:
        *to = static_cast<std::uint8_t>(status);
    }
  }

  const PlanarSeriesFrame& frame_;
};

}  // namespace

const PointLayout& PlanarPoints() {
  static constexpr PointLayout layout = {"displacement field", kGroups, kFields};
  return layout;
}

SeriesShape PlanarShape(ImageSize grid, const PlanarContents& contents) {
  const std::uint32_t bits = BitsOf(contents);
  const PointField* widest = &kFields[0];
  const auto width = [](const PointField& f) { return f.axis->count() * BytesOf(f.type); };
  for (const PointField& field : kFields) {
    if (Holds(bits, field.needs) && width(field) > width(*widest)) widest = &field;
  }
  return SeriesShape::For(grid, bits, *widest);
}

std::vector<std::uint8_t> EncodePlanarFrame(const PlanarSeriesFrame& frame,
                                            const SeriesShape& shape) {
  const bool has_field = frame.problem.empty() && !frame.field.displacement_px.empty();
  const PlanarSource source(frame);
  const auto fields =
      has_field ? FieldsOf(PlanarPoints(), shape, source) : std::vector<std::size_t>{};
  ByteWriter out;
  out.Put(frame.index);
  out.Put(frame.time_s);
  out.Put(frame.id);
  out.Put(frame.problem);
  out.Put(static_cast<std::int32_t>(frame.dropped_before));
  out.Put(frame.reference_index);
  out.Put(static_cast<std::uint8_t>(has_field));
  PutChunks(out, PlanarPoints(), shape, fields, source);
  return std::move(out.bytes());
}

FrameRecord<PlanarSeriesFrame> DecodePlanarFrame(std::span<const std::uint8_t> bytes,
                                                 const SeriesShape& shape) {
  ByteReader in(bytes);
  FrameRecord<PlanarSeriesFrame> record;
  PlanarSeriesFrame& frame = record.frame;
  frame.index = in.Get<std::int64_t>();
  frame.time_s = in.Get<double>();
  frame.id = in.GetText();
  frame.problem = in.GetText();
  frame.dropped_before = in.Get<std::int32_t>();
  frame.reference_index = in.Get<std::int64_t>();
  record.has_points = in.Get<std::uint8_t>() != 0;
  record.chunks = GetChunks(in, PlanarPoints(), shape);
  return record;
}

}  // namespace plumbline::internal
