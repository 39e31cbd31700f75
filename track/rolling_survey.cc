#include "track/rolling_survey.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <list>
#include <numbers>
#include <optional>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/mode_triangulation.h"
#include "track/internal/axis_along_modes.h"
#include "track/surface_motion.h"
#include "track/surface_state.h"

namespace plumbline {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;

void CheckSize(const WheelReference& wheel, const GrayImage& left, const GrayImage& right) {
  for (const auto& [image, camera] :
       {std::pair(&left, &wheel.rig.left), std::pair(&right, &wheel.rig.right)}) {
    if (image->size() == camera->size()) continue;
    throw InputError(fmt::format(
        "the image has {} x {} px and the wheel's reference images {} x {}: it is of another rig",
        image->width(), image->height(), camera->size().width, camera->size().height));
  }
}

// The view of which most of what the frame shows is in the picture.
std::size_t NearestView(const WheelReference& wheel, double angle_rad) {
  std::size_t nearest = 0;
  double least = kTurn_rad;
  for (std::size_t v = 0; v < wheel.views.size(); ++v) {
    const double off = std::abs(std::remainder(angle_rad - wheel.views[v].angle_rad, kTurn_rad));
    if (off < least) {
      least = off;
      nearest = v;
    }
  }
  return nearest;
}

// So many of them that at most `most` are left.
int StrideFor(int points, int most) {
  int stride = 1;
  while (points > most * stride * stride) ++stride;
  return stride;
}

// By how much the speed of a frame may be off because places disagree on the turns beside it.
double SpeedSpread(const RollingAngles& angles, const std::vector<double>& times, std::size_t f) {
  const auto beside = [&](std::size_t later) {
    return later == 0 || later >= times.size()
               ? 0
               : angles.frames[later].turn_spread_rad / (times[later] - times[later - 1]);
  };
  return std::max(beside(f), beside(f + 1));
}

}  // namespace

double MaterialAngle(const Eigen::Vector3d& in_wheel_mm) {
  return std::atan2(in_wheel_mm.x(), -in_wheel_mm.z());
}

void RollingSurveyOptions::Check() const {
  library.Check();
  matching.Check();
  angles.Check();
  smoother.Check();
  if (least_points < 6 || most_points < least_points) {
    throw UsageError("A frame is placed by 6 points or more, and as many are kept.");
  }
  if (!(most_scatter_rad > 0)) {
    throw UsageError("What points say of the wheel's angle may scatter by more than 0.");
  }
  if (views_held < 1) throw UsageError("At least one reference image is prepared at a time.");
}

int RollingWheel::placed() const {
  return static_cast<int>(std::count_if(frames.begin(), frames.end(), [](const RollingFrame& f) {
    return f.status == RollingFrameStatus::kPlaced;
  }));
}

struct RollingSurvey::Impl {
  Impl(const WheelReference& w, const RollingSurveyOptions& o, const Image<std::uint8_t>& m);

  // A view that frames can be matched with.
  struct Prepared {
    std::size_t view = 0;
    std::unique_ptr<StereoSequence> sequence;
    Image<Eigen::Vector3d> material_mm;  // wheel frame; NaN where the view has no point
    Eigen::MatrixXf material_along;      // (points of the grid, K): of their MaterialAngle()
    std::optional<RelativePose> pose;    // of the cameras, where frames are held against it
  };

  Prepared& Prepare(std::size_t view);
  Image<Eigen::Vector3d> MaterialOf(const WheelReferenceView& view, const StereoField& field) const;
  Eigen::MatrixXf MaterialAlong(const WheelReferenceView& view,
                                const Image<Eigen::Vector3d>& material_mm) const;
  void Match(const GrayImage& left, const GrayImage& right, double rough_rad, RollingFrame& frame);
  StereoRig RigOf(const Prepared& prepared, const std::vector<StereoObservation>& observations,
                  RollingFrame& frame) const;
  int watch_stride() const {  // points so far apart share no noise
    const FieldOptions& field = options.matching.field;
    return std::max(1, (field.correlator.subset_px + field.step_px - 1) / field.step_px);
  }
  void Keep(const Prepared& prepared, const StereoField& field, RollingFrame& frame);
  void AddRow(const RollingFrame& frame, const Prepared& prepared, double rough_rad);
  void Unwrap();

  const WheelReference& wheel;
  RollingSurveyOptions options;
  Image<std::uint8_t> mask;
  WheelLibrary library;
  ModeTriangulation modes;
  std::vector<WheelAxis> axes_along;  // one a mode
  std::list<Prepared> prepared;       // the last used first
  std::vector<RollingFrame> frames;
  std::vector<std::vector<RollingObservation>> observations;  // one a frame
  std::vector<Eigen::MatrixXf> psi_along;
  ImageSize grid;  // of the points that are kept
  int spacing_px = 0;
};

RollingSurvey::Impl::Impl(const WheelReference& w, const RollingSurveyOptions& o,
                          const Image<std::uint8_t>& m)
    : wheel(w),
      options(o),
      mask(m),
      library(w, o.library),
      modes(w.rig),
      axes_along(internal::AxesAlongModes(w)) {}

// Where the points of a view's pair lie on the undeformed wheel.
Image<Eigen::Vector3d> RollingSurvey::Impl::MaterialOf(const WheelReferenceView& view,
                                                       const StereoField& field) const {
  StereoSurface surface = TriangulateField(wheel.rig, field, UnitCovariance(field, field));
  const Rigid3 wheel_from_rig = wheel.axis.RigFromWheel(view.angle_rad).Inverse();
  Image<Eigen::Vector3d> material_mm = std::move(surface.instant.point_mm);
  for (std::size_t i = 0; i < material_mm.pixel_count(); ++i) {
    Eigen::Vector3d& p = material_mm.data()[i];
    if (surface.status.data()[i] == Status::kOk) {
      p = wheel_from_rig * p;
    } else {
      p.setConstant(RollingFrame::kNone);
    }
  }
  return material_mm;
}

// What each mode does to the material angles of a view's points: they are seen where they are, at
// another place of another wheel.
Eigen::MatrixXf RollingSurvey::Impl::MaterialAlong(
    const WheelReferenceView& view, const Image<Eigen::Vector3d>& material_mm) const {
  const std::size_t count = material_mm.pixel_count(), K = axes_along.size();
  Eigen::MatrixXf along =
      Eigen::MatrixXf::Zero(static_cast<Eigen::Index>(count), static_cast<Eigen::Index>(K));
  if (K == 0) return along;
  const Rigid3 rig_from_wheel = wheel.axis.RigFromWheel(view.angle_rad);
  std::vector<std::size_t> places;
  std::vector<Eigen::Vector2d> left, right;
  std::vector<Eigen::Vector3d> in_rig;
  for (std::size_t i = 0; i < count; ++i) {
    if (!material_mm.data()[i].allFinite()) continue;
    places.push_back(i);
    in_rig.push_back(rig_from_wheel * material_mm.data()[i]);
    left.push_back(wheel.rig.left.Project(in_rig.back()));
    right.push_back(wheel.rig.right.Project(wheel.rig.right_from_left * in_rig.back()));
  }
  std::vector<Eigen::Vector3f> moved(places.size() * K);
  modes.Differences(left, right, moved);
  for (std::size_t k = 0; k < K; ++k) {
    const double angle =
        view.angle_rad + wheel.angles_along_modes_rad(static_cast<Eigen::Index>(k), view.frame);
    const Rigid3 wheel_from_rig = axes_along[k].RigFromWheel(angle).Inverse();
    for (std::size_t n = 0; n < places.size(); ++n) {
      const Eigen::Vector3d there = wheel_from_rig * (in_rig[n] + moved[n * K + k].cast<double>());
      along(static_cast<Eigen::Index>(places[n]), static_cast<Eigen::Index>(k)) =
          static_cast<float>(std::remainder(
              MaterialAngle(there) - MaterialAngle(material_mm.data()[places[n]]), kTurn_rad));
    }
  }
  return along;
}

RollingSurvey::Impl::Prepared& RollingSurvey::Impl::Prepare(std::size_t view) {
  const auto found = std::find_if(prepared.begin(), prepared.end(),
                                  [&](const Prepared& p) { return p.view == view; });
  if (found != prepared.end()) {
    prepared.splice(prepared.begin(), prepared, found);
    return prepared.front();
  }
  const WheelReferenceView& v = wheel.views[view];
  Prepared anew{
      view,
      std::make_unique<StereoSequence>(wheel.rig, v.left, v.right, options.matching, mask),
      {},
      {},
      {}};
  anew.material_mm = MaterialOf(v, anew.sequence->reference());
  if (options.refinement != PoseRefinement::kOff) {
    const StereoField& field = anew.sequence->reference();
    try {
      anew.pose = PoseOfPair(wheel.rig,
                             ObservationsOf(field, UnitCovariance(field, field), watch_stride()));
    } catch (const InputError&) {
      // Its matches do not tell a pose: frames keep that of the calibration.
    }
  }
  anew.material_along = MaterialAlong(v, anew.material_mm);
  while (prepared.size() >= static_cast<std::size_t>(options.views_held)) prepared.pop_back();
  prepared.push_front(std::move(anew));
  return prepared.front();
}

// The rig as it was in a frame: refined where the right camera has moved since the view was taken.
StereoRig RollingSurvey::Impl::RigOf(const Prepared& by,
                                     const std::vector<StereoObservation>& observations,
                                     RollingFrame& frame) const {
  StereoRig rig = wheel.rig;
  frame.right_from_left.reset();
  frame.right_from_left_moved.clear();
  if (!by.pose) return rig;
  try {
    const CameraMotion motion = MotionSince(wheel.rig, *by.pose, observations);
    if (!motion.moved && options.refinement != PoseRefinement::kAlways) return rig;
    rig.right_from_left = WithBaselineOf(rig, PoseAfter(motion.since.change, rig.right_from_left));
    frame.right_from_left = rig.right_from_left;
    for (const auto& error : ErrorsOfMotion(motion.since.cov_random, rig.baseline_mm())) {
      frame.right_from_left_moved.push_back(PoseAfter(error, rig.right_from_left));
    }
  } catch (const InputError&) {
    // Its matches do not tell a pose: that of the calibration stays.
  }
  return rig;
}

// The points that both cameras see, of known material.
void RollingSurvey::Impl::Keep(const Prepared& by, const StereoField& field, RollingFrame& frame) {
  const StereoSequence& sequence = *by.sequence;
  const Image<Eigen::Vector3d>& material = by.material_mm;
  const Image<Eigen::Vector3f> unit = UnitCovariance(sequence.reference(), field);
  const StereoRig rig = RigOf(by, ObservationsOf(field, unit, watch_stride()), frame);
  const StereoSurface surface = TriangulateField(rig, field, unit);
  const auto cov = CovarianceOf(surface.instant, unit);
  const auto usable = [&](int r, int c) {
    return surface.status(r, c) == Status::kOk && material(r, c).allFinite();
  };
  const int stride = StrideFor(static_cast<int>(material.pixel_count()), options.most_points);
  grid = {(material.width() - 1) / stride + 1, (material.height() - 1) / stride + 1};
  spacing_px = stride * field.left.step_px;
  for (int r = 0; r < material.height(); r += stride) {
    for (int c = 0; c < material.width(); c += stride) {
      if (!usable(r, c)) continue;
      const Eigen::Vector2d pixel = field.left.PixelOf(r, c);
      frame.points.push_back({pixel + field.left.displacement_px(r, c),
                              pixel + field.right.displacement_px(r, c),
                              surface.instant.point_mm(r, c),
                              cov(r, c),
                              material(r, c),
                              {c / stride, r / stride},
                              r * material.width() + c});
    }
  }
}

// What the frame's points say of the wheel's angle, near the rough one; and along the modes.
void RollingSurvey::Impl::AddRow(const RollingFrame& frame, const Prepared& by, double rough_rad) {
  constexpr int kBlockPx = 72;
  const int block = std::max(1, kBlockPx / spacing_px);  // points
  const Rigid3 wheel_from_rig = wheel.axis.RigFromWheel(0).Inverse();
  const Eigen::Index K = static_cast<Eigen::Index>(axes_along.size());
  const std::size_t count = frame.points.size();
  std::vector<RollingObservation>& out = observations.back();
  std::vector<Eigen::Vector2d> left, right;
  for (const RollingPoint& p : frame.points) {
    const Eigen::Vector3d here = wheel_from_rig * p.point_mm;
    RollingObservation o;
    o.place_rad = MaterialAngle(here);
    o.y_mm = here.y();
    o.radial_mm =
        std::hypot(here.x(), here.z()) - std::hypot(p.undeformed_mm.x(), p.undeformed_mm.z());
    const double psi = MaterialAngle(p.undeformed_mm) - o.place_rad;
    o.psi_rad = rough_rad + std::remainder(psi - rough_rad, kTurn_rad);
    const double radius = std::hypot(here.x(), here.z());
    const Eigen::Vector3d forwards =
        wheel.axis.rotation * Eigen::Vector3d(-here.z(), 0, here.x()) / radius;
    const Eigen::Matrix3d cov = CovarianceOf(p.cov_random_mm2);
    o.sigma_rad = std::sqrt(forwards.dot(cov * forwards)) / radius;
    o.block = p.at.y() / block * grid.width + p.at.x() / block;
    out.push_back(o);
    left.push_back(p.left_px);
    right.push_back(p.right_px);
  }
  Eigen::MatrixXf& along = psi_along.back();
  along.resize(static_cast<Eigen::Index>(count), K);
  if (K == 0) return;
  std::vector<Eigen::Vector3f> moved(count * axes_along.size());
  modes.Differences(left, right, moved);
  for (Eigen::Index k = 0; k < K; ++k) {
    const Rigid3 moved_from_rig = axes_along[static_cast<std::size_t>(k)].RigFromWheel(0).Inverse();
    for (std::size_t i = 0; i < count; ++i) {
      const RollingPoint& p = frame.points[i];
      const Eigen::Vector3d there =
          moved_from_rig *
          (p.point_mm + moved[i * axes_along.size() + static_cast<std::size_t>(k)].cast<double>());
      const double place = std::remainder(MaterialAngle(there) - out[i].place_rad, kTurn_rad);
      along(static_cast<Eigen::Index>(i), k) =
          by.material_along(p.place, k) - static_cast<float>(place);
    }
  }
}

void RollingSurvey::Impl::Match(const GrayImage& left, const GrayImage& right, double rough_rad,
                                RollingFrame& frame) {
  frame.view = NearestView(wheel, rough_rad);
  std::optional<StereoField> field;
  Prepared* by = nullptr;
  try {
    by = &Prepare(frame.view);
    by->sequence->Restart();
    field = by->sequence->Add(left, right, frame.index);
  } catch (const InputError& error) {
    frame.problem = error.what();
    return;
  }
  Keep(*by, *field, frame);
  if (frame.points.size() < static_cast<std::size_t>(options.least_points)) {
    frame.problem = fmt::format(
        "only {} points of the wheel's reference image are found in both images, and {} must be: "
        "too little of the surface is seen, or it is blurred",
        frame.points.size(), options.least_points);
    frame.points.clear();
    return;
  }
  AddRow(frame, *by, rough_rad);
  std::vector<double> psi;
  for (const RollingObservation& o : observations.back()) psi.push_back(o.psi_rad);
  frame.measured_angle_rad = Median(psi);
  for (double& value : psi) value = std::abs(value - frame.measured_angle_rad);
  const double scatter = Median(std::move(psi));
  if (!(scatter <= options.most_scatter_rad)) {
    frame.problem = fmt::format(
        "its points do not agree on an angle of the wheel (they scatter by {:.2g} degrees): the "
        "cameras have moved since the wheel's reference was made, or it is of another wheel",
        scatter * 360 / kTurn_rad);
    frame.measured_angle_rad = RollingFrame::kNone;
    frame.points.clear();
    observations.back().clear();
    psi_along.back().resize(0, static_cast<Eigen::Index>(axes_along.size()));
    return;
  }
  frame.status = RollingFrameStatus::kPlaced;
}

RollingSurvey::RollingSurvey(const WheelReference& wheel, const RollingSurveyOptions& options,
                             const Image<std::uint8_t>& mask) {
  options.Check();
  impl_ = std::make_unique<Impl>(wheel, options, mask);
}

RollingSurvey::~RollingSurvey() = default;

void RollingSurvey::AddUnreadable(std::int64_t index, double time_s, const std::string& problem) {
  RollingFrame frame;
  frame.index = index;
  frame.time_s = time_s;
  frame.status = RollingFrameStatus::kUnreadable;
  frame.problem = problem;
  impl_->frames.push_back(std::move(frame));
  impl_->observations.emplace_back();
  impl_->psi_along.emplace_back(0, static_cast<Eigen::Index>(impl_->axes_along.size()));
}

const RollingFrame& RollingSurvey::Add(std::int64_t index, double time_s, const GrayImage& left,
                                       const GrayImage& right) {
  Impl& impl = *impl_;
  CheckSize(impl.wheel, left, right);
  RollingFrame frame;
  frame.index = index;
  frame.time_s = time_s;
  impl.observations.emplace_back();
  impl.psi_along.emplace_back(0, static_cast<Eigen::Index>(impl.axes_along.size()));
  const WheelPlace place = impl.library.Find(left);
  if (place.found) {
    impl.Match(left, right, place.candidates.front().angle_rad, frame);
  } else {
    frame.problem = place.why;
  }
  impl.frames.push_back(std::move(frame));
  return impl.frames.back();
}

// Angles go on beyond a turn, at the speed that the wheel had.
void RollingSurvey::Impl::Unwrap() {
  double before_s = 0, now_s = 0, before = 0, now = 0;
  int placed = 0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    RollingFrame& frame = frames[f];
    if (frame.status != RollingFrameStatus::kPlaced) continue;
    const double t = std::isfinite(frame.time_s) ? frame.time_s : static_cast<double>(frame.index);
    double expected = now;
    if (placed > 1 && now_s > before_s) {
      expected += (now - before) / (now_s - before_s) * (t - now_s);
    }
    const double first = frame.measured_angle_rad;
    frame.measured_angle_rad = placed == 0 ? first - kTurn_rad * std::floor(first / kTurn_rad)
                                           : expected + std::remainder(first - expected, kTurn_rad);
    for (RollingObservation& o : observations[f]) o.psi_rad += frame.measured_angle_rad - first;
    before = now;
    before_s = now_s;
    now = frame.measured_angle_rad;
    now_s = t;
    ++placed;
  }
}

RollingWheel RollingSurvey::Finish() {
  Impl& impl = *impl_;
  impl.prepared.clear();
  impl.Unwrap();
  RollingWheel out;
  out.frames = std::move(impl.frames);
  out.grid = impl.grid;
  out.spacing_px = impl.spacing_px;
  impl.frames.clear();
  const std::size_t n = out.frames.size();
  bool clock = true;
  for (const RollingFrame& frame : out.frames) clock = clock && std::isfinite(frame.time_s);
  std::vector<double> times, angles, sigmas;
  for (const RollingFrame& frame : out.frames) {
    times.push_back(clock ? frame.time_s : static_cast<double>(frame.index));
  }
  out.deformation =
      FindRollingAngles(impl.observations, impl.psi_along, impl.options.angles, times);
  out.sigma_common_rad = out.deformation.sigma_common_rad;
  for (std::size_t f = 0; f < n; ++f) {
    RollingFrame& frame = out.frames[f];
    if (frame.status == RollingFrameStatus::kPlaced) {
      frame.measured_angle_rad = out.deformation.frames[f].angle_rad;
      frame.sigma_measured_rad = out.deformation.frames[f].sigma_rad;
    }
    angles.push_back(frame.measured_angle_rad);
    sigmas.push_back(frame.sigma_measured_rad);
  }
  const SmoothedAngles smooth =
      SmoothAngles(times, angles, sigmas, out.deformation.along_modes, impl.options.smoother);
  out.angle_along_modes_rad = smooth.angle_along_rad;
  out.speed_along_modes_rad_s = smooth.speed_along_rad_s;
  out.jerk_rad_s25 = smooth.jerk_rad_s25;
  out.scatter = smooth.scatter;
  const bool modes = out.angle_along_modes_rad.rows() > 0;
  for (std::size_t f = 0; f < n; ++f) {
    RollingFrame& frame = out.frames[f];
    const auto column = static_cast<Eigen::Index>(f);
    if (frame.status != RollingFrameStatus::kPlaced) {
      out.angle_along_modes_rad.col(column).setConstant(RollingFrame::kNone);
      out.speed_along_modes_rad_s.col(column).setConstant(RollingFrame::kNone);
      continue;
    }
    const SmoothedAngle& s = smooth.frames[f];
    frame.angle_rad = s.angle_rad;
    frame.sigma_random_rad = s.sigma_angle_rad;
    frame.lean = s.lean;
    frame.outlier = s.outlier;
    frame.sigma_measured_rad *= smooth.scatter;
    if (modes) frame.sigma_calibration_rad = out.angle_along_modes_rad.col(column).norm();
    if (!clock) continue;
    frame.speed_rad_s = s.speed_rad_s;
    frame.sigma_random_rad_s =
        std::hypot(s.sigma_speed_rad_s, SpeedSpread(out.deformation, times, f));
    if (modes) frame.sigma_calibration_rad_s = out.speed_along_modes_rad_s.col(column).norm();
  }
  return out;
}

}  // namespace plumbline
