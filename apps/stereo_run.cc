#include "apps/stereo_run.h"

#include <fmt/format.h>

#include <chrono>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

void CheckSize(const GrayImage& image, const Camera& camera, const std::string& id,
               const char* side) {
  if (image.size() == camera.size()) return;
  throw InputError(
      fmt::format("{} is {}x{} px, but the {} camera of the rig was calibrated with {}x{} px.", id,
                  image.width(), image.height(), side, camera.size().width, camera.size().height));
}

void CheckPair(const StereoFrame& pair, const StereoRig& rig) {
  CheckSize(pair.left, rig.left, pair.left_id, "left");
  CheckSize(pair.right, rig.right, pair.right_id, "right");
}

double SecondsSince(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

// The rig against the seeds of the reference pair, which were found without it.
void CheckRig(const StereoSeeds& seeds, double max_epipolar_px) {
  if (!seeds.ContradictRig()) return;
  if (seeds.behind_camera > seeds.off_epipolar) {
    throw InputError(fmt::format(
        "Of {} places found in both images of the reference pair, {} would lie behind the cameras: "
        "left and right are swapped, or the rig file is that of other cameras.",
        seeds.found, seeds.behind_camera));
  }
  throw InputError(fmt::format(
      "Of {} places found in both images of the reference pair, {} lie more than {:g} px from "
      "their epipolar lines: the rig file is that of other cameras, the cameras have moved since "
      "it was made (calibrate again), or left and right are swapped.",
      seeds.found, seeds.off_epipolar, max_epipolar_px));
}

}  // namespace

void StereoRunOptions::Check() const {
  sequence.Check();
  evaluation.Check();
  if (block_frames < 1) throw UsageError("A block holds at least one frame.");
}

struct StereoRun::Impl {
  Impl(const StereoRig& r, const StereoRunOptions& o) : rig(r), options(o) {}

  StereoRig rig;
  StereoRunOptions options;
  std::string reference_id;
  std::int64_t reference_index = 0;
  std::unique_ptr<StereoSequence> sequence;
  std::unique_ptr<SurfaceEvaluation> evaluation;
  std::int64_t block = 0;

  // Whether the pair was matched; false where it is the reference itself, or bad.
  bool Begin(const StereoFrame& pair, std::int64_t position);
};

StereoRun::StereoRun(const StereoRig& rig, const StereoFrame& reference,
                     const StereoRunOptions& options)
    : impl_(std::make_unique<Impl>(rig, options)) {
  options.Check();
  CheckPair(reference, rig);
  impl_->reference_id = reference.left_id;
  impl_->reference_index = reference.index;
  FieldOptions& field = impl_->options.sequence.field;
  if (options.roi) PlaceGrid(*options.roi, reference.left.size(), field);
  impl_->sequence = std::make_unique<StereoSequence>(
      rig, reference.left, reference.right, impl_->options.sequence,
      WantedPixels(reference.left.size(), options.roi, options.mask));
  CheckRig(impl_->sequence->reference_seeds(), options.sequence.seeds.max_epipolar_px);
  impl_->evaluation = std::make_unique<SurfaceEvaluation>(
      rig, impl_->sequence->reference(), impl_->sequence->correlator().neighbours(),
      options.evaluation);
}

StereoRun::~StereoRun() = default;

SeriesHeader StereoRun::Header() const {
  SeriesHeader header = impl_->evaluation->Header();
  header.displacement_reference = fmt::format("frame {}", impl_->reference_index);
  if (header.reference) header.reference->left_id = impl_->reference_id;
  return header;
}

std::vector<std::string> StereoRun::Notes() const {
  std::vector<std::string> notes;
  if (impl_->sequence->follows_curvature()) {
    notes.push_back(
        "The two views differ by more curvature than shape functions of order 1 can follow: it is "
        "taken from the reference pair and given to them.");
  }
  if (impl_->sequence->reference_seeds().from_disparity) {
    notes.push_back(
        "Much of the reference pair had no seed from features; the rectified pair was matched "
        "(SGBM) to find where to start.");
  }
  return notes;
}

double StereoRun::correlation_area_points() const {
  return impl_->evaluation->correlation_area_points();
}

bool StereoRun::Impl::Begin(const StereoFrame& pair, std::int64_t position) {
  if (options.sequence.strategy != StereoStrategy::kIncremental &&
      position / options.block_frames != block) {
    block = position / options.block_frames;
    sequence->Restart();
  }
  if (!pair.problem.empty()) return false;
  CheckPair(pair, rig);
  return pair.index != reference_index;
}

StereoRunFrame StereoRun::Measure(const StereoFrame& pair, std::int64_t position) {
  StereoRunFrame out;
  Impl& impl = *impl_;
  const auto begin = std::chrono::steady_clock::now();
  if (impl.Begin(pair, position)) {
    const StereoField field = impl.sequence->Add(pair.left, pair.right, pair.index);
    out.match_s = SecondsSince(begin);
    out.left_counts = field.left_counts;
    out.right_counts = field.right_counts;
    out.frame = impl.evaluation->Evaluate(field, pair.time_s);
  } else if (pair.problem.empty()) {
    out.frame = impl.evaluation->EvaluateReference(pair.time_s);
  } else {
    out.frame.problem = pair.problem;
  }
  out.frame.index = pair.index;
  out.frame.time_s = pair.time_s;
  out.frame.left_id = pair.left_id;
  out.frame.right_id = pair.right_id;
  out.summary = impl.evaluation->Summarise(out.frame);
  out.evaluate_s = SecondsSince(begin) - out.match_s;
  return out;
}

std::int64_t StereoRun::FirstToMeasure(std::int64_t first_wanted) const {
  if (impl_->options.sequence.strategy == StereoStrategy::kIncremental || first_wanted < 1)
    return 0;
  return (first_wanted - 1) / impl_->options.block_frames * impl_->options.block_frames;
}

}  // namespace plumbline
