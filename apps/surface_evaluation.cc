#include "apps/surface_evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "apps/internal/body_motion.h"
#include "apps/internal/finite_median.h"
#include "apps/internal/ground_record.h"
#include "apps/internal/parse_numbers.h"
#include "apps/internal/plane_points.h"
#include "apps/internal/rig_watch.h"
#include "apps/internal/surface_points.h"
#include "apps/internal/surface_records.h"
#include "calib/error.h"
#include "calib/mode_triangulation.h"
#include "calib/parallel.h"
#include "calib/triangulate.h"
#include "match/correlation_area.h"
#include "track/right_flow.h"
#include "track/subset_smoothing.h"
#include "track/surface_motion.h"
#include "track/surface_plane.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// "x,y,z".
Eigen::Vector3d ParseDirection(const std::string& text) {
  const auto numbers = internal::ParseNumbers(text, ',');
  if (!numbers || numbers->size() != 3) {
    throw UsageError(fmt::format(
        "The axes of strain are material, ground or a direction x,y,z in the frame of the "
        "positions, not '{}'.",
        text));
  }
  const Eigen::Vector3d direction = Eigen::Map<const Eigen::Vector3d>(numbers->data());
  if (!(direction.norm() > 1e-9)) {
    throw UsageError("The direction of the strain's x axis has no length.");
  }
  return direction.normalized();
}

}  // namespace

void SurfaceEvaluationOptions::Check() const {
  ground.Check();
  AdaptiveGaugesOptions{strain_options, smallest_strain_window}.Check();
  if (strain_axes != "material" && strain_axes != "ground") ParseDirection(strain_axes);
  if (!(epipolar.tolerance_px >= 0 && epipolar.sigmas > 0)) {
    throw UsageError("The tolerance of the epipolar distance must not be negative.");
  }
}

struct SurfaceEvaluation::Impl {
  Impl(const StereoRig& r, StereoField field, NeighbourCorrelation n,
       const SurfaceEvaluationOptions& o, const std::optional<MatchMode>& match_mode);

  struct Previous {
    SurfaceState instant;  // in the frame
    Image<Eigen::Vector3f> unit;
    double time_s;
  };

  void AddModes(const StereoField& field, const internal::RigWatch::Verdict& verdict,
                const std::optional<MatchMode>& match_mode, StereoSurface& surface) const;
  StereoSurface SurfaceOf(const internal::RigWatch::Verdict& verdict, const StereoField& field,
                          const Image<Eigen::Vector3f>& unit,
                          const std::optional<MatchMode>& match_mode) const;
  std::optional<GroundPlane> PlaneOf(const SurfaceState& in_rig, const Image<Eigen::Vector3f>& unit,
                                     GroundRecord& record,
                                     std::vector<GroundPlane>* along_modes) const;
  void ChooseFrame(const SurfaceState& in_rig);
  std::size_t PoseModes() const {
    return options.refinement == PoseRefinement::kOff ? 0 : internal::RigWatch::kPoseModes;
  }
  void KeepReferencePoints(StereoSurface& surface) const;
  Image<Eigen::Matrix<float, 6, 1>> PositionCovariance(const StereoSurface& surface,
                                                       const SurfaceState& instant,
                                                       const Image<Eigen::Vector3f>& unit,
                                                       const SurfaceMotion* motion) const;
  void AddMotion(const StereoSurface& surface, const SurfaceState& instant,
                 const SurfaceMotion& motion, const Image<Eigen::Vector3f>& of_match, double time_s,
                 SeriesFrame& out);
  SeriesFrame FrameOf(const StereoField& field, const StereoSurface& surface,
                      const SurfaceState& instant, const Image<Eigen::Vector3f>& unit,
                      const SurfaceMotion* motion) const;

  StereoRig rig;
  StereoField reference;
  NeighbourCorrelation neighbours;
  SubsetSmoothing smoothing;
  SurfaceEvaluationOptions options;
  ModeTriangulation modes;
  double correlation_area = 1;  // points that share one noise
  internal::RigWatch watch;
  int plane_stride = 1;

  Image<Eigen::Vector3f> unit;  // of the reference
  StereoSurface reference_surface;
  MeasurementFrame frame;
  std::optional<GroundPlane> plane;  // of the reference pair, where positions are told from it
  Image<Eigen::Vector3d> plane_along_points;  // PlaneAlongPoints()
  Image<float> height_variance_mm2;           // of the points of the reference pair alone
  GroundRecord ground;
  RigWatchRecord reference_watch;
  SurfaceState at_reference;  // in the frame
  std::optional<AdaptiveGauges> gauges;
  std::optional<Previous> previous;
};

SurfaceEvaluation::Impl::Impl(const StereoRig& r, StereoField field, NeighbourCorrelation n,
                              const SurfaceEvaluationOptions& o,
                              const std::optional<MatchMode>& match_mode)
    : rig(r),
      reference(std::move(field)),
      neighbours(std::move(n)),
      smoothing(reference.left),
      options(o),
      modes(r),
      correlation_area(CorrelationArea(neighbours, reference.left.size())),
      watch(r, {.refinement = o.refinement, .limits = {}, .alike_points = correlation_area}) {
  const ImageSize grid = reference.left.size();
  plane_stride = std::max(1, reference.left.subset_px / (2 * reference.left.step_px));
  options.ground.correlation_area_points = 1;
  unit = UnitCovariance(reference, reference);
  const internal::RigWatch::Verdict verdict = watch.Reference(ObservationsOf(reference, unit));
  reference_watch = verdict.record;
  reference_surface = SurfaceOf(verdict, reference, unit, match_mode);
  if (std::none_of(reference_surface.status.values().begin(),
                   reference_surface.status.values().end(),
                   [](Status status) { return status == Status::kOk; })) {
    throw InputError(
        "No point of the reference pair could be matched between left and right and triangulated: "
        "are the cameras swapped, or is the rig file that of other cameras?");
  }
  ChooseFrame(reference_surface.instant);
  at_reference = InFrame(reference_surface.instant, frame);
  height_variance_mm2 = Image<float>(grid, 0);
  const auto cov = CovarianceOf(at_reference, unit);
  for (std::size_t i = 0; i < cov.pixel_count(); ++i) {
    height_variance_mm2.data()[i] = cov.data()[i][5];
  }
  if (options.strain_axes == "ground") {
    options.strain_options.x_direction = Eigen::Vector3d::UnitX();
  } else if (options.strain_axes != "material") {
    options.strain_options.x_direction = ParseDirection(options.strain_axes);
  }
  if (options.strain) {
    gauges.emplace(at_reference, unit, neighbours, reference.left.step_px, reference.left.subset_px,
                   AdaptiveGaugesOptions{options.strain_options, options.smallest_strain_window});
  }
}

// What the calibration's modes do to the points, and what the directions do in which a refined pose
// may be wrong.
void SurfaceEvaluation::Impl::AddModes(const StereoField& field,
                                       const internal::RigWatch::Verdict& verdict,
                                       const std::optional<MatchMode>& match_mode,
                                       StereoSurface& surface) const {
  if (modes.count() == 0) return;
  const auto count = static_cast<std::size_t>(modes.count());
  const ImageSize size = surface.status.size();
  std::vector<std::size_t> places;
  std::vector<Eigen::Vector2d> left, right;
  const auto columns = static_cast<std::size_t>(size.width);
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    if (surface.status.data()[i] != Status::kOk) continue;
    const Eigen::Vector2d pixel =
        field.left.PixelOf(static_cast<int>(i / columns), static_cast<int>(i % columns));
    places.push_back(i);
    left.push_back(pixel + field.left.displacement_px.data()[i]);
    right.push_back(pixel + field.right.displacement_px.data()[i]);
  }
  std::vector<Eigen::Vector3f> along(places.size() * count);
  modes.Differences(left, right, along);
  if (match_mode) {
    std::vector<Eigen::Vector2d> right_px;
    for (const std::size_t i : places) right_px.push_back(match_mode->right_px.data()[i]);
    FillModeOfMatches(verdict.rig, left, right, right_px, match_mode->mode, along);
  }
  const Eigen::Vector3f none = Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN());
  std::vector<Image<Eigen::Vector3f>>& images = surface.instant.along_modes_mm;
  images.assign(count + PoseModes(), Image<Eigen::Vector3f>(size, none));
  for (std::size_t n = 0; n < places.size(); ++n) {
    for (std::size_t k = 0; k < count; ++k) images[k].data()[places[n]] = along[n * count + k];
    for (std::size_t k = count; k < images.size(); ++k) images[k].data()[places[n]].setZero();
  }
  for (std::size_t k = 0; k < verdict.right_from_left_moved.size(); ++k) {
    StereoRig moved = verdict.rig;
    moved.right_from_left = verdict.right_from_left_moved[k];
    const std::vector<Eigen::Vector3d> points = TriangulatePoints(moved, left, right);
    for (std::size_t n = 0; n < places.size(); ++n) {
      images[count + k].data()[places[n]] =
          (points[n] - surface.instant.point_mm.data()[places[n]]).cast<float>();
    }
  }
}

StereoSurface SurfaceEvaluation::Impl::SurfaceOf(const internal::RigWatch::Verdict& verdict,
                                                 const StereoField& field,
                                                 const Image<Eigen::Vector3f>& of_match,
                                                 const std::optional<MatchMode>& match_mode) const {
  StereoSurface surface = TriangulateField(verdict.rig, field, of_match, options.epipolar);
  if (options.count_left_out) {
    surface.instant.cov_left_out_mm2 =
        smoothing.LeftOut(reference, field, surface.instant, of_match);
  }
  AddModes(field, verdict, match_mode, surface);
  return surface;
}

// A point that the reference pair rejected is none that anything could be told of later.
void SurfaceEvaluation::Impl::KeepReferencePoints(StereoSurface& surface) const {
  for (std::size_t i = 0; i < surface.status.pixel_count(); ++i) {
    const Status before = reference_surface.status.data()[i];
    if (before == Status::kOk || surface.status.data()[i] != Status::kOk) continue;
    surface.status.data()[i] = before;
    surface.instant.point_mm.data()[i].setConstant(kNone);
  }
}

// The plane of the points, in the rig frame, and its record with both covariances.
std::optional<GroundPlane> SurfaceEvaluation::Impl::PlaneOf(
    const SurfaceState& in_rig, const Image<Eigen::Vector3f>& of_match, GroundRecord& record,
    std::vector<GroundPlane>* along_modes) const {
  const internal::PointsOfPlane points(in_rig, of_match, plane_stride);
  std::optional<GroundPlane> found;
  try {
    found = FitGroundPlane(points.point_mm, points.cov_mm2, options.ground);
  } catch (const InputError& error) {
    record.problem = error.what();
    return found;
  }
  found->cov = std::max(1.0, found->scatter_ratio * found->scatter_ratio) *
               PlaneCovariance(*found, points.All(), neighbours);
  record = internal::GroundRecordOf(
      *found, GroundFromRig(*found, Eigen::Vector3d::Zero(), found->centroid));
  if (in_rig.along_modes_mm.empty()) return found;
  const std::vector<Image<Eigen::Vector3f>>& modes_mm = in_rig.along_modes_mm;
  std::vector<GroundPlane> there(modes_mm.size());
  ForEachIndex(modes_mm.size(), [&](std::size_t k) {
    std::vector<Eigen::Vector3d> moved(points.places.size());
    for (std::size_t n = 0; n < moved.size(); ++n) {
      moved[n] = points.point_mm[n] + modes_mm[k].data()[points.places[n]].cast<double>();
    }
    there[k] = RefitPlane(moved, points.cov_mm2, found->inlier);
  });
  record.cov_calibration.setZero();
  for (const GroundPlane& along : there) {
    const Eigen::Vector3d difference = PlaneDifference(*found, along);
    record.cov_calibration += difference * difference.transpose();
  }
  if (along_modes != nullptr) *along_modes = std::move(there);
  return found;
}

// The frame of positions: what the reference pair shows, and where it goes along the modes. In the
// rig frame the rigid motion that a mode gives to all points at once is taken out, as it says
// nothing about the surface.
void SurfaceEvaluation::Impl::ChooseFrame(const SurfaceState& in_rig) {
  if (options.known_frame) {
    frame = *options.known_frame;
    frame.along_modes.resize(in_rig.along_modes_mm.size(), frame.frame_from_rig);
    return;
  }
  std::vector<GroundPlane> along_modes;
  plane = PlaneOf(in_rig, unit, ground, &along_modes);
  if (plane && options.turn_into_ground_frame) {
    frame.frame_from_rig = ground.ground_from_rig;
    plane_along_points = PlaneAlongPoints(
        *plane, internal::PointsOfPlane(in_rig, unit, plane_stride).All(), neighbours);
    for (const GroundPlane& there : along_modes) {
      frame.along_modes.push_back(GroundFromRig(there, Eigen::Vector3d::Zero(), there.centroid));
    }
    return;
  }
  plane.reset();
  std::vector<std::size_t> places;
  std::vector<Eigen::Vector3d> points;
  for (std::size_t i = 0; i < in_rig.point_mm.pixel_count(); ++i) {
    if (!in_rig.point_mm.data()[i].allFinite()) continue;
    places.push_back(i);
    points.push_back(in_rig.point_mm.data()[i]);
  }
  for (const Image<Eigen::Vector3f>& mode : in_rig.along_modes_mm) {
    std::vector<Eigen::Vector3d> moved(points);
    for (std::size_t n = 0; n < moved.size(); ++n) {
      moved[n] += mode.data()[places[n]].cast<double>();
    }
    frame.along_modes.push_back(internal::BestRigidMotion(moved, points));
  }
}

// The random covariance of positions. Heights have the error of the plane that they are told from,
// which was fitted to the points at the reference. motion: since then; nothing: these are they.
Image<Eigen::Matrix<float, 6, 1>> SurfaceEvaluation::Impl::PositionCovariance(
    const StereoSurface& surface, const SurfaceState& instant,
    const Image<Eigen::Vector3f>& of_match, const SurfaceMotion* motion) const {
  constexpr int kZz = 5;
  Image<Eigen::Matrix<float, 6, 1>> cov = CovarianceOf(instant, of_match);
  if (!plane) return cov;
  Image<float> shared_mm(cov.size(), 0);
  for (std::size_t i = 0; i < cov.pixel_count(); ++i) {
    const float now = cov.data()[i][kZz];
    const float before = motion == nullptr ? now : height_variance_mm2.data()[i];
    const float moved = motion == nullptr ? 0 : motion->cov_random_mm2.data()[i][kZz];
    shared_mm.data()[i] = 0.5F * (now + before - moved) / std::sqrt(before);
  }
  const Image<float> added =
      HeightVarianceOfPlane(*plane, surface.instant.point_mm, plane_along_points, shared_mm);
  for (std::size_t i = 0; i < cov.pixel_count(); ++i) {
    float& height = cov.data()[i][kZz];
    height = std::max(height + added.data()[i], 0.0F);  // NaN stays
  }
  return cov;
}

// Positions and matches.
SeriesFrame SurfaceEvaluation::Impl::FrameOf(const StereoField& field, const StereoSurface& surface,
                                             const SurfaceState& instant,
                                             const Image<Eigen::Vector3f>& of_match,
                                             const SurfaceMotion* motion) const {
  SeriesFrame out;
  out.surface = internal::SurfaceRecordOf(
      surface, instant, PositionCovariance(surface, instant, of_match, motion), field,
      plane ? SurfaceFrame::kGround : SurfaceFrame::kRig, options.point_covariance);
  if (options.matches) out.match = internal::MatchRecordOf(field);
  return out;
}

SurfaceEvaluation::SurfaceEvaluation(const StereoRig& rig, StereoField reference,
                                     NeighbourCorrelation neighbours,
                                     const SurfaceEvaluationOptions& options,
                                     const std::optional<MatchMode>& match_mode) {
  options.Check();
  impl_ =
      std::make_unique<Impl>(rig, std::move(reference), std::move(neighbours), options, match_mode);
}

SurfaceEvaluation::~SurfaceEvaluation() = default;

SeriesHeader SurfaceEvaluation::Header() const {
  const Impl& impl = *impl_;
  SeriesHeader header{
      .rig = impl.rig, .grid_px = {}, .recipe_toml = {}, .inputs = {}, .rig_extras = {}};
  header.step_px = impl.reference.left.step_px;
  header.subset_px = impl.reference.left.subset_px;
  header.grid_points = "material";
  header.contents.covariance = impl.options.point_covariance;
  header.contents.displacement = header.contents.velocity = header.contents.rigid_motion = true;
  header.contents.rig_watch = true;
  header.contents.matches = impl.options.matches;
  header.contents.strain = impl.options.strain;
  header.rigid_motion_removed = impl.options.remove_rigid_motion;
  const ImageSize size = impl.reference.left.size();
  header.grid_px = Image<Eigen::Vector2f>(size, Eigen::Vector2f::Zero());
  for (int r = 0; r < size.height; ++r) {
    for (int c = 0; c < size.width; ++c) {
      header.grid_px(r, c) = impl.reference.left.PixelOf(r, c).cast<float>();
    }
  }
  if (impl.options.matches) {
    header.reference = ReferenceMatches{"", internal::MatchRecordOf(impl.reference),
                                        impl.reference_surface.status};
  }
  if (!impl.gauges) return header;
  const SurfaceStrain at_rest =
      impl.gauges->Strain(impl.at_reference, impl.reference_surface.status).strain;
  header.contents.strain_windows = impl.options.smallest_strain_window > 0;
  header.strain_measure = Name(at_rest.measure);
  header.strain_axes = impl.options.strain_axes;
  header.vsg_px = at_rest.vsg_px;
  header.vsg_mm = at_rest.vsg_mm;
  return header;
}

SeriesFrame SurfaceEvaluation::EvaluateReference(double time_s) {
  Impl& impl = *impl_;
  SeriesFrame out =
      impl.FrameOf(impl.reference, impl.reference_surface, impl.at_reference, impl.unit, nullptr);
  out.ground = impl.ground;
  out.rig_watch = impl.reference_watch;
  out.displacement = internal::AtRest(impl.reference_surface.status);
  if (impl.gauges) {
    out.strain = internal::StrainRecordOf(
        impl.gauges->Strain(impl.at_reference, impl.reference_surface.status));
    internal::ForgetNoise(out.strain);
  }
  out.rigid_motion.found = true;
  for (Eigen::Vector3d* const zero :
       {&out.rigid_motion.rotation_rad, &out.rigid_motion.translation_mm,
        &out.rigid_motion.sigma_random_rotation_rad,
        &out.rigid_motion.sigma_calibration_rotation_rad,
        &out.rigid_motion.sigma_random_translation_mm,
        &out.rigid_motion.sigma_calibration_translation_mm}) {
    zero->setZero();
  }
  impl.previous = {impl.at_reference, impl.unit, time_s};
  return out;
}

// What has no body to count from: plane, rigid motion and velocity of the surface itself.
void SurfaceEvaluation::Impl::AddMotion(const StereoSurface& surface, const SurfaceState& instant,
                                        const SurfaceMotion& motion,
                                        const Image<Eigen::Vector3f>& of_match, double time_s,
                                        SeriesFrame& out) {
  PlaneOf(surface.instant, of_match, out.ground, nullptr);
  if (out.ground.found) out.ground.ground_from_rig = frame.frame_from_rig;
  const SurfaceRigidMotion rigid =
      RigidMotionBetween(at_reference, instant, motion, correlation_area);
  out.rigid_motion = internal::RigidRecordOf(rigid);
  if (options.remove_rigid_motion && rigid.found) {
    out.displacement =
        internal::DisplacementRecordOf(WithoutRigidMotion(at_reference, instant, motion, rigid));
  }
  if (previous && time_s > previous->time_s) {
    out.velocity = internal::VelocityRecordOf(
        MotionBetween(previous->instant, instant, previous->unit), time_s - previous->time_s);
  }
  previous = {instant, of_match, time_s};
}

SeriesFrame SurfaceEvaluation::Evaluate(const StereoField& field, double time_s,
                                        const BodyMotion* body) {
  Impl& impl = *impl_;
  const Image<Eigen::Vector3f> unit = UnitCovariance(impl.reference, field);
  const std::vector<std::size_t> places = ObservedPlaces(field, unit);
  std::vector<Eigen::Vector2d> common;
  if (body != nullptr && !body->right_common_px.empty()) {
    for (const std::size_t i : places) common.push_back(body->right_common_px.data()[i]);
  }
  const auto verdict = impl.watch.Later(ObservationsAt(places, field, unit), common);
  const std::optional<MatchMode> none;
  StereoSurface surface =
      impl.SurfaceOf(verdict, field, unit, body != nullptr ? body->match_mode : none);
  impl.KeepReferencePoints(surface);
  if (std::none_of(surface.status.values().begin(), surface.status.values().end(),
                   [](Status status) { return status == Status::kOk; })) {
    SeriesFrame out;
    out.problem = "no point of the reference was found again in both images";
    Restart();
    return out;
  }
  SurfaceState instant = InFrame(surface.instant, impl.frame);
  if (body != nullptr && body->told_in) {
    MeasurementFrame told = *body->told_in;
    // A refined pose, which the instant is known along too, does not move it.
    told.along_modes.resize(instant.along_modes_mm.size(), told.frame_from_rig);
    instant = InFrame(instant, told);
  }
  const SurfaceMotion motion =
      body == nullptr ? MotionBetween(impl.at_reference, instant, impl.unit)
                      : internal::MotionFromBody(impl.at_reference,
                                                 internal::UndeformedNow(impl.at_reference, *body),
                                                 instant, impl.unit, *body);
  SeriesFrame out = impl.FrameOf(field, surface, instant, unit, &motion);
  out.rig_watch = verdict.record;
  if (impl.gauges) {
    out.strain = internal::StrainRecordOf(impl.gauges->Strain(instant, surface.status));
  }
  out.displacement = internal::DisplacementRecordOf(motion);
  if (body == nullptr) impl.AddMotion(surface, instant, motion, unit, time_s, out);
  return out;
}

void SurfaceEvaluation::Restart() { impl_->previous.reset(); }

double SurfaceEvaluation::correlation_area_points() const { return impl_->correlation_area; }

SurfaceSummary SurfaceEvaluation::Summarise(const SeriesFrame& frame) const {
  SurfaceSummary summary;
  const auto count = [](const Image<Status>& statuses, auto&& wanted) {
    return static_cast<std::int64_t>(
        std::count_if(statuses.values().begin(), statuses.values().end(), wanted));
  };
  const auto is_ok = [](Status status) { return status == Status::kOk; };
  summary.grid_points = count(impl_->reference_surface.status,
                              [](Status status) { return status != Status::kMasked; });
  summary.valid_points = count(frame.surface.status, is_ok);
  summary.strain_points = count(frame.strain.status, is_ok);
  summary.plane_distance_mm = frame.ground.found ? frame.ground.centroid_in_rig_mm.z() : kNone;
  summary.displacement_mm = internal::Medians(frame.displacement.value_mm);
  summary.sigma_random_displacement_mm = internal::Medians(frame.displacement.sigma_random_mm);
  summary.sigma_calibration_displacement_mm =
      internal::Medians(frame.displacement.sigma_calibration_mm);
  summary.strain = internal::Medians(frame.strain.value);
  summary.sigma_random_strain = internal::Medians(frame.strain.sigma_random);
  summary.sigma_calibration_strain = internal::Medians(frame.strain.sigma_calibration);
  return summary;
}

}  // namespace plumbline
