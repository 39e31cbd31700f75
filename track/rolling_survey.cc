#include "track/rolling_survey.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <list>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/mode_triangulation.h"
#include "track/internal/axis_along_modes.h"
#include "track/internal/frame_rig.h"
#include "track/internal/surface_memory.h"
#include "track/internal/survey_grid.h"
#include "track/internal/survey_rows.h"
#include "track/internal/survey_tags.h"
#include "track/internal/view_material.h"
#include "track/right_drift.h"
#include "track/right_flow.h"
#include "track/rolling_starts.h"
#include "track/surface_motion.h"
#include "track/surface_state.h"

namespace plumbline {
namespace {

using internal::TimeOf;

constexpr double kTurn_rad = 2 * std::numbers::pi;

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
    StereoField pair;  // of the view's images, as if exposed together
    int stride = 1;    // of the points that may be kept; the next two are theirs
    StereoField kept;  // of the pair, as it was exposed
    std::optional<RightFlow> flow;
    internal::ViewMaterial material;   // NaN where the view has no point
    Eigen::MatrixXf material_along;    // (points of the grid, K): of their MaterialAngle()
    std::optional<RelativePose> pose;  // of the cameras, where frames are held against it
    double alike_points = 1;           // of the points that may be kept, that share one noise
  };

  Prepared& Prepare(std::size_t view);
  void Find(const GrayImage& left, const GrayImage& right, RollingFrame& frame);
  void FindAnew(const GrayImage& left, const GrayImage& right, RollingFrame& frame);
  bool Follow(double angle_rad, const GrayImage& left, const GrayImage& right, RollingFrame& frame);
  void Search(double rough_rad, const GrayImage& left, const GrayImage& right, RollingFrame& frame);
  StereoField Expect(const internal::SurfaceMemory& supposed, const Prepared& prepared,
                     double angle_rad) const;
  void Place(const Prepared& prepared, StereoField matches, double rough_rad, RollingFrame& frame);
  void Forget(RollingFrame& frame);
  void Keep(const Prepared& prepared, RollingFrame& frame);
  void AddRow(const RollingFrame& frame, const Prepared& prepared, double rough_rad);

  const WheelReference& wheel;
  RollingSurveyOptions options;
  Image<std::uint8_t> mask;
  std::optional<WheelLibrary> library;  // where there are images
  ModeTriangulation modes;
  std::vector<WheelAxis> axes_along;  // one a mode
  std::list<Prepared> prepared;       // the last used first
  std::vector<RollingFrame> frames;
  internal::SurveyRows rows;
  internal::SurfaceMemory memory;
  double found_share = 0;  // of the points that the last frame was expected to show
  ImageSize grid;          // of the points that are kept
  Eigen::Vector2i first_px{0, 0};
  int spacing_px = 0;
};

RollingSurvey::Impl::Impl(const WheelReference& w, const RollingSurveyOptions& o,
                          const Image<std::uint8_t>& m)
    : wheel(w),
      options(internal::Coarser(o, w.rig.left.size())),
      mask(m),
      modes(w.rig),
      axes_along(internal::AxesAlongModes(w)),
      memory(w) {
  if (o.images) library.emplace(w, o.library);
}

RollingSurvey::Impl::Prepared& RollingSurvey::Impl::Prepare(std::size_t view) {
  const auto found = std::find_if(prepared.begin(), prepared.end(),
                                  [&](const Prepared& p) { return p.view == view; });
  if (found != prepared.end()) {
    prepared.splice(prepared.begin(), prepared, found);
    return prepared.front();
  }
  const WheelReferenceView& v = wheel.views[view];
  Prepared anew;
  anew.view = view;
  anew.sequence = std::make_unique<StereoSequence>(wheel.rig, v.left, v.right, options.matching,
                                                   mask, RightPlaceOf(wheel, v));
  anew.pair = anew.sequence->reference();
  anew.stride = internal::StrideFor(static_cast<int>(anew.pair.left.status.pixel_count()),
                                    options.most_points);
  anew.kept = internal::EveryMatch(anew.pair, anew.stride);
  const RightFlow flow(wheel, anew.pair);
  anew.flow = flow.Every(anew.stride);
  MoveAlong(flow.Of(anew.pair.right), -wheel.LateTurnOf(v), &anew.pair.right);
  anew.material = internal::MaterialOf(wheel, v, anew.pair);
  anew.material_along =
      internal::MaterialAlongModes(wheel, v, anew.material.point_mm, modes, axes_along);
  if (options.refinement != PoseRefinement::kOff) {
    anew.alike_points = internal::AlikePoints(anew.kept.left, options.matching.field.correlator);
    anew.pose = internal::PoseOfView(wheel.rig, internal::EveryMatch(anew.pair, anew.stride),
                                     anew.alike_points);
  }
  while (prepared.size() >= static_cast<std::size_t>(options.views_held)) prepared.pop_back();
  prepared.push_front(std::move(anew));
  return prepared.front();
}

// The points that both cameras see, of known material.
void RollingSurvey::Impl::Keep(const Prepared& by, RollingFrame& frame) {
  const StereoField& field = frame.matches;
  const Image<Eigen::Vector3d>& material = by.material.point_mm;
  const Image<Eigen::Vector3f> unit = UnitCovariance(by.kept, field);
  const Image<Eigen::Vector2d> flow_px = by.flow->Of(field.right);
  internal::SurveyRows::PoseMatches& pose = rows.poses.back();
  if (by.pose) {
    pose = internal::SurveyRows::PoseMatches::Of(*by.pose, field, unit, flow_px, by.alike_points);
  }
  const StereoRig rig = internal::RigOfFrame(wheel.rig, pose.view, pose.observations, {},
                                             pose.alike_points, options.refinement, &frame);
  const StereoSurface surface = TriangulateField(rig, field, unit);
  const auto cov = CovarianceOf(surface.instant, unit);
  grid = field.left.size();
  first_px = field.left.first_px;
  spacing_px = field.left.step_px;
  for (int r = 0; r < grid.height; ++r) {
    for (int c = 0; c < grid.width; ++c) {
      const int row = r * by.stride, column = c * by.stride;
      const Eigen::Vector3d& undeformed = material(row, column);
      if (surface.status(r, c) != Status::kOk || !undeformed.allFinite()) continue;
      const Eigen::Vector2d pixel = field.left.PixelOf(r, c);
      const Eigen::Vector2d left = pixel + field.left.displacement_px(r, c);
      frame.points.push_back({left,
                              pixel + field.right.displacement_px(r, c),
                              surface.instant.point_mm(r, c),
                              cov(r, c),
                              undeformed,
                              {c, r},
                              row * material.width() + column,
                              flow_px(r, c),
                              internal::RightPixelAt(by.pair.right, left),
                              by.material.cov_random_mm2(row, column)});
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
  std::vector<RollingObservation>& out = rows.observations.back();
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
  Eigen::MatrixXf& along = rows.psi_along.back();
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

// Where the points of a view should be seen, well inside of both images.
StereoField RollingSurvey::Impl::Expect(const internal::SurfaceMemory& supposed, const Prepared& by,
                                        double angle_rad) const {
  constexpr double kRoom = 1.5;  // of a subset's half
  return supposed.Expect(angle_rad, by.sequence->reference().left, by.material.point_mm,
                         kRoom * options.matching.field.correlator.radius_px());
}

// From where the frames before let expect the surface, the wheel at this angle; and from what the
// frame itself then shows of it. False, and nothing changed, where that leads to fewer of the
// points than it did in the last frame.
bool RollingSurvey::Impl::Follow(double angle_rad, const GrayImage& left, const GrayImage& right,
                                 RollingFrame& frame) {
  constexpr int kRounds = 3;
  constexpr double kAsMany = 0.95, kNoMore = 0.005;
  frame.view = internal::NearestView(wheel, angle_rad);
  Prepared& by = Prepare(frame.view);
  internal::SurfaceMemory supposed = memory;
  double before = 0;
  for (int round = 0; round < kRounds; ++round) {
    by.sequence->Restart();
    const StereoField expected = Expect(supposed, by, angle_rad);
    const StereoField field = by.sequence->AddFrom(expected, left, right, frame.index);
    Place(by, internal::EveryMatch(field, by.stride), angle_rad, frame);
    const double share = internal::ShareFound(expected, field);
    if (frame.status == RollingFrameStatus::kPlaced && share >= kAsMany * found_share) {
      found_share = std::max(found_share, share);
      return true;
    }
    if (frame.status != RollingFrameStatus::kPlaced || share < before + kNoMore) break;
    before = share;
    supposed = memory;
    supposed.Take(frame, TimeOf(frame));
    angle_rad = supposed.angle_rad();
    Forget(frame);
  }
  Forget(frame);
  frame.problem.clear();
  return false;
}

// Anywhere in the images of the view at this angle.
void RollingSurvey::Impl::Search(double rough_rad, const GrayImage& left, const GrayImage& right,
                                 RollingFrame& frame) {
  frame.view = internal::NearestView(wheel, rough_rad);
  Prepared& by = Prepare(frame.view);
  by.sequence->Restart();
  const StereoField field = by.sequence->Add(left, right, frame.index);
  Place(by, internal::EveryMatch(field, by.stride), rough_rad, frame);
  if (frame.status == RollingFrameStatus::kPlaced) {
    internal::SurfaceMemory supposed = memory;
    supposed.Take(frame, TimeOf(frame));
    found_share = internal::ShareFound(Expect(supposed, by, supposed.angle_rad()), field);
  }
}

void RollingSurvey::Impl::Find(const GrayImage& left, const GrayImage& right, RollingFrame& frame) {
  if (!internal::LookForTags(wheel, left, right, frame)) return;
  const std::optional<double> foreseen_rad = memory.AngleAt(TimeOf(frame));
  if (foreseen_rad && Follow(*foreseen_rad, left, right, frame)) {
    frame.placed_by = PlacedBy::kFollowed;
  } else {
    FindAnew(left, right, frame);
  }
  if (frame.status == RollingFrameStatus::kPlaced &&
      !frame.tag_place.Allows(frame.measured_angle_rad)) {
    frame.problem = frame.tag_place.why = frame.tag_place.Contradiction(frame.measured_angle_rad);
    Forget(frame);
  }
}

// By its tags, where it shows any of the wheel's; else by its features.
void RollingSurvey::Impl::FindAnew(const GrayImage& left, const GrayImage& right,
                                   RollingFrame& frame) {
  double rough_rad = frame.tag_place.angle_rad;
  const bool by_tags = frame.tag_place.found;
  if (!by_tags) {
    const WheelPlace place = library.value().Find(left);
    if (!place.found) {
      frame.problem = place.why;
      return;
    }
    rough_rad = place.candidates.front().angle_rad;
  }
  if (memory.empty() || !Follow(rough_rad, left, right, frame)) {
    Search(rough_rad, left, right, frame);
  }
  if (frame.status == RollingFrameStatus::kPlaced) {
    frame.placed_by = by_tags ? PlacedBy::kTags : PlacedBy::kFeatures;
  } else if (by_tags) {
    frame.problem = "where its tags say that the wheel stands, " + frame.problem;
  }
}

// What the matches say of where the wheel stands, if they agree.
void RollingSurvey::Impl::Place(const Prepared& by, StereoField matches, double rough_rad,
                                RollingFrame& frame) {
  frame.matches = std::move(matches);
  frame.near_rad = rough_rad;
  Keep(by, frame);
  if (frame.points.size() < static_cast<std::size_t>(options.least_points)) {
    frame.problem = fmt::format(
        "only {} points of the wheel's reference image are found in both images, and {} must be: "
        "too little of the surface is seen, or it is blurred",
        frame.points.size(), options.least_points);
    Forget(frame);
    return;
  }
  AddRow(frame, by, rough_rad);
  std::vector<double> psi;
  for (const RollingObservation& o : rows.observations.back()) psi.push_back(o.psi_rad);
  frame.measured_angle_rad = Median(psi);
  for (double& value : psi) value = std::abs(value - frame.measured_angle_rad);
  const double scatter = Median(std::move(psi));
  if (!(scatter <= options.most_scatter_rad)) {
    frame.problem = fmt::format(
        "its points do not agree on an angle of the wheel (they scatter by {:.2g} degrees): the "
        "cameras have moved since the wheel's reference was made, or it is of another wheel",
        scatter * 360 / kTurn_rad);
    Forget(frame);
    return;
  }
  frame.status = RollingFrameStatus::kPlaced;
}

// What a frame's points said of it.
void RollingSurvey::Impl::Forget(RollingFrame& frame) {
  frame.status = RollingFrameStatus::kNotFound;
  frame.placed_by = PlacedBy::kNothing;
  frame.measured_angle_rad = RollingFrame::kNone;
  frame.points.clear();
  frame.matches = {};
  frame.near_rad = RollingFrame::kNone;
  frame.right_from_left.reset();
  frame.right_from_left_moved.clear();
  rows.ClearLast();
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
  impl_->rows.Push(static_cast<Eigen::Index>(impl_->axes_along.size()));
}

const RollingFrame& RollingSurvey::Add(std::int64_t index, double time_s, const GrayImage& left,
                                       const GrayImage& right) {
  Impl& impl = *impl_;
  internal::CheckSize(impl.wheel, left, right);
  RollingFrame frame;
  frame.index = index;
  frame.time_s = time_s;
  impl.rows.Push(static_cast<Eigen::Index>(impl.axes_along.size()));
  try {
    impl.Find(left, right, frame);
  } catch (const InputError& error) {
    frame.problem = error.what();
  }
  if (frame.status == RollingFrameStatus::kPlaced) impl.memory.Take(frame, TimeOf(frame));
  impl.frames.push_back(std::move(frame));
  return impl.frames.back();
}

const RollingFrame& RollingSurvey::AddMatched(RollingFrame told) {
  Impl& impl = *impl_;
  impl.rows.Push(static_cast<Eigen::Index>(impl.axes_along.size()));
  if (!impl.wheel.tags.family.empty()) told.tag_place = PlaceByTags(impl.wheel, told.tags);
  if (told.status == RollingFrameStatus::kPlaced) {
    const bool known = told.view < impl.wheel.views.size();
    const Impl::Prepared* const by = known ? &impl.Prepare(told.view) : nullptr;
    if (!known || told.matches.left.size() != by->kept.left.size() ||
        told.matches.left.first_px != by->kept.left.first_px ||
        told.matches.left.step_px != by->kept.left.step_px) {
      throw InputError("the matches are not those of this wheel and these options");
    }
    impl.Place(*by, std::move(told.matches), told.near_rad, told);
  }
  impl.frames.push_back(std::move(told));
  return impl.frames.back();
}

RollingWheel RollingSurvey::Finish() {
  Impl& impl = *impl_;
  impl.prepared.clear();
  impl.rows.Unwrap(&impl.frames);
  const bool moved = std::any_of(impl.frames.begin(), impl.frames.end(), [](const auto& frame) {
    return frame.right_from_left.has_value();
  });
  if (moved && impl.options.refinement == PoseRefinement::kWhenSignificant) {
    impl.options.refinement = PoseRefinement::kAlways;
    impl.rows.RefineAll(impl.wheel, &impl.frames);
  }
  RollingWheel out;
  out.refinement = impl.options.refinement;
  out.frames = std::move(impl.frames);
  out.grid = impl.grid;
  out.first_px = impl.first_px;
  out.spacing_px = impl.spacing_px;
  impl.frames.clear();
  impl.rows.FindAngles(impl.wheel, impl.options.angles, impl.options.smoother, &out);
  return out;
}

void RollingSurvey::MoveBack(const RightDelay& delay, RollingWheel* rolling) {
  delay.Check();
  if (!delay.any()) return;
  Impl& impl = *impl_;
  impl.rows.MoveBack(impl.wheel, delay, impl.options.refinement, rolling);
  impl.rows.FindAngles(impl.wheel, impl.options.angles, impl.options.smoother, rolling);
}

void RollingSurvey::HoldToGround(std::vector<GroundPitch> pitch, RollingWheel* rolling) {
  Impl& impl = *impl_;
  if (pitch.size() != rolling->frames.size()) {
    throw std::invalid_argument("RollingSurvey: a pitch of the ground is needed for each frame");
  }
  impl.rows.pitch = std::move(pitch);
  impl.rows.FindAngles(impl.wheel, impl.options.angles, impl.options.smoother, rolling);
  if (rolling->right_delay.any()) FindRightDrift(impl.wheel, rolling);  // beside the new speeds
}

}  // namespace plumbline
