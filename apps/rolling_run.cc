#include "apps/rolling_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <list>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "apps/internal/rolling_notes.h"
#include "apps/internal/rolling_records.h"
#include "apps/internal/surface_records.h"
#include "apps/internal/survey_records.h"
#include "apps/internal/tag_records.h"
#include "apps/internal/wheel_lean.h"
#include "apps/internal/wheel_motion.h"
#include "calib/error.h"
#include "track/right_drift.h"
#include "track/right_flow.h"
#include "track/rolling_starts.h"
#include "track/stored_matches.h"

namespace plumbline {
namespace {

double SecondsSince(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

}  // namespace

void RollingRunOptions::Check() const {
  survey.Check();
  sequence.Check();
  evaluation.Check();
  if (right_delay) right_delay->Check();
  if (sequence.strategy == StereoStrategy::kIncremental) {
    throw UsageError(
        "A rolling tyre is measured against the wheel's reference images: the strategy is "
        "reference or fresh-stereo, not incremental.");
  }
  if (views_held < 1) throw UsageError("At least one reference image is prepared at a time.");
  if (survey.matching.field.step_px % sequence.field.step_px != 0) {
    throw UsageError(fmt::format(
        "The points of the survey are some of those that are measured: its step of {} px has to be "
        "a multiple of {} px.",
        survey.matching.field.step_px, sequence.field.step_px));
  }
}

struct RollingRun::Impl {
  Impl(WheelReference w, const RollingRunOptions& o)
      : delay(o.right_delay            ? *o.right_delay
              : o.estimate_right_delay ? RightDelay{}
                                       : w.right_delay.value_or(RightDelay{})),
        reference(std::move(w)),
        options(o),
        wanted(Wanted()),
        survey(Surveyor()) {}

  // A view that frames are measured against.
  struct Prepared {
    std::size_t view = 0;
    std::unique_ptr<StereoSequence> sequence;
    std::optional<RightFlow> flow;
    std::unique_ptr<SurfaceEvaluation> evaluation;
  };

  Image<std::uint8_t> Wanted() {
    FieldOptions& field = options.sequence.field;
    if (options.roi) {
      PlaceGrid(*options.roi, reference.rig.left.size(), field);
      PlaceGrid(*options.roi, reference.rig.left.size(), options.survey.matching.field);
    }
    return WantedPixels(reference.rig.left.size(), options.roi, options.mask);
  }
  std::unique_ptr<RollingSurvey> Surveyor() {
    options.Check();
    if (delay.sigma_s > 0 && reference.delay_mode < 0) {
      throw std::invalid_argument("RollingRun: a delay with a sigma, a wheel without its mode");
    }
    if (options.evaluation.strain_axes == "material") {
      // Material under the axis goes towards x, as the wheel rolls.
      options.evaluation.strain_options.x_around = {reference.axis.origin_in_rig_mm(),
                                                    -reference.axis.direction_in_rig()};
    }
    options.evaluation.known_frame = internal::FrameOfWheel(reference);
    return std::make_unique<RollingSurvey>(reference, options.survey, wanted);
  }
  Prepared& Prepare(std::size_t view);
  void PrepareGrid(const SurveyRecord& survey);
  void EndSurvey(const std::string& first_problem);
  bool IsPlaced(std::size_t at) const {
    return rolling.frames.at(at).status == RollingFrameStatus::kPlaced;
  }
  StereoField Match(const StereoFrame& pair, std::size_t at);
  void EvaluatePlaced(const StereoField& field, double time_s, std::size_t at, StereoRunFrame& out);
  void Complete(std::size_t at, SeriesFrame* frame) const;
  std::optional<UncertainFrame> GroundAt(std::size_t at) const;
  void AddContact(std::size_t at, SeriesFrame* frame) const;
  void AddLean(std::size_t at, SeriesFrame* frame) const;
  std::vector<RigRotationFrame> Rotation(bool over_ground) const;  // empty: against the rig

  // late: by so much turn of the flow, or time of a velocity.
  std::optional<MatchMode> ModeOf(const Image<Eigen::Vector2d>& flow_px, double late) const;
  Image<Eigen::Vector2d> VelocityOf(const RightFlow& flow, const StereoField& field,
                                    std::size_t at) const;

  RightDelay delay;
  WheelReference reference;
  RollingRunOptions options;
  Image<std::uint8_t> wanted;
  std::unique_ptr<RollingSurvey> survey;  // until all is known of it
  RollingWheel rolling;
  std::optional<RollingContact> contact;
  std::optional<ChannelLean> lean;  // where there was a channel of the wheel's speed
  RightDelayEstimate estimate;
  double threshold_mm = 0;
  std::string convention;        // of slip
  std::list<Prepared> prepared;  // the last used first
  PlanarField grid;              // of the points that are measured, without its values
};

RollingRun::Impl::Prepared& RollingRun::Impl::Prepare(std::size_t view) {
  const auto found = std::find_if(prepared.begin(), prepared.end(),
                                  [&](const Prepared& p) { return p.view == view; });
  if (found != prepared.end()) {
    prepared.splice(prepared.begin(), prepared, found);
    return prepared.front();
  }
  while (prepared.size() >= static_cast<std::size_t>(options.views_held)) prepared.pop_back();
  const WheelReferenceView& v = reference.views[view];
  Prepared anew{view, nullptr, {}, nullptr};
  anew.sequence = std::make_unique<StereoSequence>(reference.rig, v.left, v.right, options.sequence,
                                                   wanted, RightPlaceOf(reference, v));
  StereoField pair = anew.sequence->reference();
  anew.flow.emplace(reference, pair);
  grid = internal::GridOf(pair.left);
  const Image<Eigen::Vector2d> flow_px = anew.flow->Of(pair.right);
  MoveAlong(flow_px, -reference.LateTurnOf(v), &pair.right);
  anew.evaluation = std::make_unique<SurfaceEvaluation>(
      reference.rig, std::move(pair), anew.sequence->correlator().neighbours(), options.evaluation,
      ModeOf(flow_px, reference.SigmaLateTurnOf(v)));
  prepared.push_front(std::move(anew));
  return prepared.front();
}

// What a delay of the right exposure that is one sigma longer does: the matches go back by more.
std::optional<MatchMode> RollingRun::Impl::ModeOf(const Image<Eigen::Vector2d>& flow_px,
                                                  double late) const {
  if (reference.delay_mode < 0) return std::nullopt;
  MatchMode mode{static_cast<std::size_t>(reference.delay_mode), flow_px};
  for (Eigen::Vector2d& px : mode.right_px.values()) px *= -late;
  return mode;
}

// How the right pixels of a frame's matches go with the material.
Image<Eigen::Vector2d> RollingRun::Impl::VelocityOf(const RightFlow& flow, const StereoField& field,
                                                    std::size_t at) const {
  return RightVelocity(rolling, at, flow.Of(field.right), field.right);
}

RollingRun::RollingRun(WheelReference wheel, const RollingRunOptions& options)
    : impl_(std::make_unique<Impl>(std::move(wheel), options)) {}

RollingRun::~RollingRun() = default;

const RollingWheel& RollingRun::wheel() const { return impl_->rolling; }
const WheelReference& RollingRun::reference() const { return impl_->reference; }

const RightDelayEstimate& RollingRun::right_delay() const { return impl_->estimate; }
const RightDelay& RollingRun::right_delay_used() const { return impl_->delay; }

// Throws where there is nothing to go on with.
void RollingRun::Impl::EndSurvey(const std::string& first_problem) {
  rolling = survey->Finish();
  if (rolling.placed() > 0) survey->MoveBack(delay, &rolling);
  if (rolling.refinement != options.survey.refinement) {
    options.evaluation.refinement = rolling.refinement;
    prepared.clear();
  }
  if (rolling.frames.empty()) throw InputError("There are no frames to measure.");
  if (rolling.placed() == 0) {
    throw InputError(fmt::format("None of the {} frames is found on the wheel; the first one: {}.",
                                 rolling.frames.size(), first_problem));
  }
}

bool RollingRun::Survey(ImageSource& source, const RollingProgress& progress) {
  Impl& impl = *impl_;
  const std::int64_t total = source.DeclaredCount();
  std::string first_problem;
  for (std::int64_t done = 0;; ++done) {
    if (!progress(done, total)) return false;
    const std::optional<StereoFrame> pair = source.Next();
    if (!pair) break;
    std::string problem = pair->problem;
    if (problem.empty()) {
      problem = impl.survey->Add(pair->index, pair->time_s, pair->left, pair->right).problem;
    } else {
      impl.survey->AddUnreadable(pair->index, pair->time_s, problem);
    }
    if (first_problem.empty()) first_problem = problem;
  }
  impl.EndSurvey(first_problem);
  return true;
}

void RollingRun::Impl::PrepareGrid(const SurveyRecord& survey) {
  if (!(survey.view >= 0 && survey.view < static_cast<double>(reference.views.size()))) {
    throw InputError("the survey's matches are not with views of this wheel");
  }
  Prepare(static_cast<std::size_t>(survey.view));
}

bool RollingRun::SurveyAgain(std::int64_t count, const MeasuredFrames& frames,
                             const RollingProgress& progress) {
  Impl& impl = *impl_;
  std::string first_problem;
  for (std::int64_t i = 0; i < count; ++i) {
    if (!progress(i, count)) return false;
    const SeriesFrame stored = frames(i);
    if (stored.survey.found && impl.grid.size() == ImageSize{}) impl.PrepareGrid(stored.survey);
    const RollingFrame& frame =
        impl.survey->AddMatched(internal::RollingFrameOf(stored, impl.grid));
    if (first_problem.empty()) first_problem = frame.problem;
  }
  impl.EndSurvey(first_problem);
  return true;
}

std::vector<std::string> RollingRun::Notes() const {
  const RollingWheel& rolling = impl_->rolling;
  std::vector<std::string> notes;
  const auto frames = static_cast<int>(rolling.frames.size());
  if (rolling.placed() < frames) {
    notes.push_back(fmt::format("{} of {} frames are not found on the wheel and are marked.",
                                frames - rolling.placed(), frames));
  }
  const auto outliers = std::count_if(rolling.frames.begin(), rolling.frames.end(),
                                      [](const RollingFrame& f) { return f.outlier; });
  if (outliers > 0) {
    notes.push_back(fmt::format(
        "The wheel angles of {} frames contradict those of the others; there the angle is that of "
        "the others alone.",
        outliers));
  }
  for (std::string& note : internal::TagNotes(impl_->reference, rolling)) {
    notes.push_back(std::move(note));
  }
  constexpr double kDegree = std::numbers::pi / 180;
  notes.push_back(fmt::format(
      "All wheel angles together may be off by {:.2g} degrees, and displacements around the wheel "
      "with them{}.",
      rolling.sigma_common_rad / kDegree,
      rolling.twist.known ? ""
                          : ": what shears the tyre all over the view cannot be told from a turn"));
  if (impl_->lean) notes.push_back(internal::TextOf(*impl_->lean));
  if (impl_->contact && !impl_->contact->found) {
    notes.push_back("The ground is in no frame: " + impl_->contact->problem);
  }
  if (impl_->contact) {
    const auto& found = impl_->contact->frames;
    const auto obstacles = std::count_if(found.begin(), found.end(), [](const auto& f) {
      return f.rotation.found && f.patch.by == FramePatch::By::kThreshold;
    });
    if (obstacles > 0) {
      notes.push_back(fmt::format(
          "In {} frames the law of lift-off does not hold, as over an obstacle or with a carcass "
          "of another thickness than was said. {}",
          obstacles,
          impl_->lean && impl_->lean->used
              ? "The wheel's turn there is that of the channel."
              : "The wheel's turn is told there by what of the surface stands still before and "
                "behind the contact; what draws all of it along cannot be told from a turn."));
    }
  }
  if (impl_->contact) {
    for (std::string& note :
         internal::CarcassNotes(*impl_->contact, impl_->reference.profile.crown_y_mm)) {
      notes.push_back(std::move(note));
    }
  }
  if (impl_->estimate.found) notes.push_back(internal::DelayNote(impl_->estimate, impl_->delay));
  if (!impl_->reference.closed) {
    notes.push_back(
        "The wheel's reference is not of a full turn: frames beyond its arc are not found on it.");
  }
  return notes;
}

SeriesHeader RollingRun::Header() {
  Impl& impl = *impl_;
  const auto& frames = impl.rolling.frames;
  const auto placed = std::find_if(frames.begin(), frames.end(), [](const RollingFrame& f) {
    return f.status == RollingFrameStatus::kPlaced;
  });
  SeriesHeader header = impl.Prepare(placed->view).evaluation->Header();
  header.contents.velocity = header.contents.rigid_motion = false;
  header.contents.wheel = header.contents.material = header.contents.placement = true;
  header.contents.survey = header.contents.matches;
  header.surveyed_frames = static_cast<std::int64_t>(frames.size());
  if (impl.contact) {
    header.contents.patch = header.contents.slip = true;
    header.contents.rig_rotation = header.contents.deformation = true;
    header.slip_convention = impl.convention;
    header.contents.wheel_channel = impl.lean.has_value();
    if (impl.estimate.found) {
      header.estimated_right_delay = RightDelay{impl.estimate.value_s, impl.estimate.sigma_s};
    }
  }
  header.displacement_reference = "wheel";
  header.right_delay = impl.delay;
  header.reference.reset();  // each view has its own
  return header;
}

// As if both cameras had exposed together.
StereoField RollingRun::Impl::Match(const StereoFrame& pair, std::size_t at) {
  Prepared& by = Prepare(rolling.frames[at].view);
  by.sequence->Restart();
  const StereoField starts = StartsOf(rolling, at, by.sequence->reference().left);
  StereoField field = by.sequence->AddFrom(starts, pair.left, pair.right, pair.index);
  if (delay.value_s != 0) {
    MoveAlong(VelocityOf(*by.flow, field, at), -delay.value_s, &field.right);
  }
  RoundAsStored(&field);
  return field;
}

void RollingRun::Impl::EvaluatePlaced(const StereoField& field, double time_s, std::size_t at,
                                      StereoRunFrame& out) {
  Prepared& by = Prepare(rolling.frames[at].view);
  BodyMotion body = internal::TurnSinceView(reference, rolling, at);
  if (delay.any() || reference.delay_mode >= 0) {
    body.match_mode = delay.sigma_s > 0 ? ModeOf(VelocityOf(*by.flow, field, at), delay.sigma_s)
                                        : ModeOf(by.flow->Of(field.right), 0);
  }
  if (delay.value_s != 0) body.right_common_px = RightDriftLeftOut(rolling, at, field.right);
  const std::optional<UncertainFrame> ground = GroundAt(at);
  if (ground) {
    body = internal::InGround(std::move(body), contact->frames[at].rotation.ground,
                              *options.evaluation.known_frame);
  }
  SeriesFrame& frame = out.frame = by.evaluation->Evaluate(field, time_s, &body);
  frame.ground.problem = "the ground under the tyre was not looked for";
  frame.wheel = internal::WheelRecordOf(reference, rolling, at, ground ? &*ground : nullptr);
  Rigid3 here_from_wheel = reference.axis.RigFromWheel(rolling.frames[at].angle_rad);
  if (ground) here_from_wheel = ground->frame_from_rig * here_from_wheel;
  frame.material = internal::MaterialOf(here_from_wheel, frame);
  if (ground && frame.problem.empty()) {
    frame.surface.frame = SurfaceFrame::kGround;
    internal::AddGroundErrors(*ground, &frame.surface);
  }
  out.summary = by.evaluation->Summarise(frame);
}

std::optional<UncertainFrame> RollingRun::Impl::GroundAt(std::size_t at) const {
  if (!contact || !contact->frames[at].rotation.found) return std::nullopt;
  return GroundFrameOf(contact->frames[at].rotation, reference.axis);
}

// What the survey's points say of the frame.
void RollingRun::Impl::AddContact(std::size_t at, SeriesFrame* frame) const {
  if (!contact) return;
  const RollingContactFrame& found = contact->frames[at];
  frame->ground = internal::GroundRecordOf(found.rotation);
  frame->rig_rotation = internal::RigRotationRecordOf(found.rotation);
  frame->patch = internal::PatchRecordOf(found, threshold_mm);
  frame->deformation = internal::DeformationRecordOf(found.deformation);
  frame->slip = internal::SlipRecordOf(found, frame->surface.status.size(),
                                       rolling.spacing_px / options.sequence.field.step_px);
}

void RollingRun::Impl::AddLean(std::size_t at, SeriesFrame* frame) const {
  if (!lean) return;
  WheelChannelRecord& record = frame->wheel_channel;
  record.found = lean->used && frame->wheel.found;
  record.lean = rolling.frames[at].channel_lean;
  if (!record.found) record.problem = lean->used ? frame->wheel.problem : lean->problem;
}

std::vector<RigRotationFrame> RollingRun::Impl::Rotation(bool over_ground) const {
  std::vector<RigRotationFrame> rotation;
  if (!over_ground) return rotation;
  for (const RollingContactFrame& frame : contact.value().frames) {
    rotation.push_back(frame.rotation);
  }
  return rotation;
}

SampledSignal RollingRun::WheelSpeeds(bool over_ground) const {
  return WheelSpeedsOf(impl_->rolling, impl_->Rotation(over_ground));
}

void RollingRun::LeanOn(const std::optional<WheelSpeedChannel>& channel, bool over_ground,
                        const std::string& problem) {
  Impl& impl = *impl_;
  impl.lean.emplace();
  impl.lean->problem = problem;
  if (!channel) return;
  impl.lean = LeanOnChannel(*channel, impl.Rotation(over_ground), impl.options.survey.smoother,
                            &impl.rolling);
}

void RollingRun::FindContact(RollingContactOptions contact) {
  Impl& impl = *impl_;
  const CorrelatorOptions& correlator = impl.options.survey.matching.field.correlator;
  contact.subset_px = correlator.subset_px;
  contact.order = correlator.order;
  contact.circular = correlator.shape == SubsetShape::kCircle;
  impl.threshold_mm = contact.patch.threshold.threshold_mm;
  impl.convention = kSlipConventionNames[static_cast<std::size_t>(contact.slip.convention)];
  impl.contact = FindRollingContact(impl.reference, impl.rolling, contact);
  if (!impl.survey) return;  // found with it before
  if (const std::vector<GroundPitch> pitch = GroundPitchesOf(*impl.contact); !pitch.empty()) {
    impl.survey->HoldToGround(pitch, &impl.rolling);
    impl.contact = FindRollingContact(impl.reference, impl.rolling, contact);
  }
  std::vector<std::uint8_t> steady;
  for (const RollingContactFrame& frame : impl.contact->frames) {
    steady.push_back(frame.patch.by == FramePatch::By::kLiftOff ? 1 : 0);
  }
  impl.estimate = EstimateRightDelay(impl.reference, impl.rolling, steady, contact.subset_px);
  if (impl.options.estimate_right_delay) {
    if (!impl.estimate.found) {
      throw InputError("The right camera's delay cannot be estimated: " + impl.estimate.problem +
                       ".");
    }
    impl.delay = {impl.estimate.value_s, impl.estimate.sigma_s};
    impl.survey->MoveBack(impl.delay, &impl.rolling);
    impl.contact = FindRollingContact(impl.reference, impl.rolling, contact);
  }
  impl.survey.reset();
}

// What is known of a frame beside its points.
void RollingRun::Impl::Complete(std::size_t at, SeriesFrame* frame) const {
  if (!frame->wheel.found) frame->wheel.problem = frame->problem;
  AddLean(at, frame);
  frame->placement = internal::PlacementRecordOf(rolling, at);
  if (!frame->placement.found) frame->placement.problem = frame->problem;
  AddContact(at, frame);
  if (options.evaluation.matches) frame->survey = internal::SurveyRecordOf(rolling, at, grid);
}

StereoRunFrame RollingRun::Measure(const StereoFrame& pair, std::int64_t position) {
  StereoRunFrame out;
  const auto at = static_cast<std::size_t>(position);
  const auto begin = std::chrono::steady_clock::now();
  if (!pair.problem.empty()) {
    out.frame.problem = pair.problem;
  } else if (!impl_->IsPlaced(at)) {
    out.frame.problem = "not found on the wheel: " + impl_->rolling.frames[at].problem;
  } else {
    const StereoField field = impl_->Match(pair, at);
    out.match_s = SecondsSince(begin);
    out.left_counts = field.left_counts;
    out.right_counts = field.right_counts;
    impl_->EvaluatePlaced(field, pair.time_s, at, out);
    out.evaluate_s = SecondsSince(begin) - out.match_s;
  }
  impl_->Complete(at, &out.frame);
  out.frame.index = pair.index;
  out.frame.time_s = pair.time_s;
  out.frame.left_id = pair.left_id;
  out.frame.right_id = pair.right_id;
  return out;
}

StereoRunFrame RollingRun::MeasureAgain(const SeriesFrame& before, std::int64_t position) {
  StereoRunFrame out;
  Impl& impl = *impl_;
  const auto at = static_cast<std::size_t>(position);
  const auto begin = std::chrono::steady_clock::now();
  if (!impl.IsPlaced(at) && before.problem.empty()) {
    out.frame.problem = "not found on the wheel: " + impl.rolling.frames[at].problem;
  } else if (impl.IsPlaced(at) && before.wheel.found) {
    // Also where none of its points was found, as then.
    const StereoField field =
        before.problem.empty() ? internal::FieldOf(before.match, before.surface.status, impl.grid)
                               : internal::NoneOf(impl.grid);
    impl.EvaluatePlaced(field, before.time_s, at, out);
    // Scores are not worked out again.
    if (out.frame.problem.empty()) out.frame.surface.correlation = before.surface.correlation;
    out.evaluate_s = SecondsSince(begin);
  } else {
    out.frame.problem = before.problem;
  }
  impl.Complete(at, &out.frame);
  internal::NameAs(before, &out.frame);
  return out;
}

}  // namespace plumbline
