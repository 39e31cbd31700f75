#include "match/planar_sequence.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>

#include "calib/error.h"
#include "calib/median.h"
#include "match/internal/motion_memory.h"
#include "match/internal/updated_reference.h"

namespace plumbline {
namespace {

using internal::ComposedField;
using internal::UpdatedReference;

double MedianZncc(const PlanarField& field) {
  std::vector<double> zncc;
  for (std::size_t i = 0; i < field.status.pixel_count(); ++i) {
    if (field.status.data()[i] == Status::kOk) zncc.push_back(field.zncc.data()[i]);
  }
  return zncc.empty() ? 0 : Median(std::move(zncc));
}

// The best that was reached with one reference.
struct Reached {
  std::int64_t ok = 0;
  double zncc = 0;
};

}  // namespace

void SequenceOptions::Check() const {
  field.Check();
  if (update_every < 1) {
    throw UsageError(
        fmt::format("The reference is updated every 1 frame or more; {} is not.", update_every));
  }
  for (const double share : {least_ok_share, least_zncc_share}) {
    if (!(share > 0 && share < 1)) {
      throw UsageError(fmt::format(
          "The share below which the reference is updated lies between 0 and 1; {} does not.",
          share));
    }
  }
}

struct PlanarSequence::Impl {
  Impl(const GrayImage& reference, const SequenceOptions& o, const Image<std::uint8_t>& m)
      : options(o), mask(m), size(reference.size()), first(reference, o.field, m) {}

  // The last frame: what the next one starts from, and may be correlated with.
  struct Last {
    GrayImage image;  // empty with a fixed reference
    std::int64_t number = 0;
    ComposedField fields;
  };

  ComposedField Match(const GrayImage& image, const SeedFinder& seeds,
                      const PlanarField* starts) const;
  bool Worse(const CorrelatedField& now) const;
  std::unique_ptr<const UpdatedReference> ReferenceOf(const Last& frame) const;
  void Take(std::unique_ptr<const UpdatedReference> reference, std::int64_t number);
  std::optional<ComposedField> AfterUpdate(const GrayImage& image, const CorrelatedField& now);
  PlanarField Increment(const PlanarField& total) const;

  SequenceOptions options;
  Image<std::uint8_t> mask;
  ImageSize size;
  FieldCorrelator first;
  Image<SubsetCurvature> curvature;
  std::unique_ptr<const UpdatedReference> updated;
  std::int64_t reference_number = -1;
  std::int64_t with_reference = 0;  // frames
  Reached reached;
  internal::MotionMemory memory;  // in terms of the reference in force
  std::optional<Last> last;
};

PlanarSequence::PlanarSequence(const GrayImage& reference, const SequenceOptions& options,
                               const Image<std::uint8_t>& mask) {
  options.Check();
  impl_ = std::make_unique<Impl>(reference, options, mask);
}

PlanarSequence::~PlanarSequence() = default;

const FieldCorrelator& PlanarSequence::correlator() const { return impl_->first; }

ComposedField PlanarSequence::Impl::Match(const GrayImage& image, const SeedFinder& seeds,
                                          const PlanarField* starts) const {
  FieldStart begin;
  begin.prior = starts != nullptr ? starts : memory.Expected();
  begin.search = starts == nullptr;
  begin.verify_back = options.verify_all || starts != nullptr;
  if (updated) return updated->Correlate(image, begin);
  begin.seeds = seeds;
  begin.curvature = curvature.empty() ? nullptr : &curvature;
  ComposedField result{first.Correlate(image, begin), {}, {}};
  result.leg = result.total.field;
  return result;
}

bool PlanarSequence::Impl::Worse(const CorrelatedField& now) const {
  return static_cast<double>(now.counts.ok) <
             options.least_ok_share * static_cast<double>(reached.ok) ||
         MedianZncc(now.field) < options.least_zncc_share * reached.zncc;
}

std::unique_ptr<const UpdatedReference> PlanarSequence::Impl::ReferenceOf(const Last& frame) const {
  return std::make_unique<const UpdatedReference>(frame.image, frame.fields, mask, first.options());
}

// The motion of the last frame, for the one that comes: from here on.
PlanarField PlanarSequence::Impl::Increment(const PlanarField& total) const {
  PlanarField increment = total;
  for (std::size_t i = 0; i < total.status.pixel_count(); ++i) {
    increment.displacement_px.data()[i].setZero();
    increment.gradient.data()[i].setZero();
    if (!last || last->fields.total.field.status.data()[i] != Status::kOk) continue;
    increment.displacement_px.data()[i] =
        total.displacement_px.data()[i] - last->fields.total.field.displacement_px.data()[i];
  }
  return increment;
}

void PlanarSequence::Impl::Take(std::unique_ptr<const UpdatedReference> reference,
                                std::int64_t number) {
  updated = std::move(reference);
  reference_number = number;
  with_reference = 0;
  reached = {};
}

// The frame once more, with the one before it as its reference, where that is better; else nothing
// and nothing changed.
std::optional<ComposedField> PlanarSequence::Impl::AfterUpdate(const GrayImage& image,
                                                               const CorrelatedField& now) {
  auto anew = ReferenceOf(*last);
  ComposedField again = anew->Correlate(image, {});
  const bool better = again.total.counts.ok > now.counts.ok ||
                      (static_cast<double>(again.total.counts.ok) >=
                           options.least_ok_share * static_cast<double>(now.counts.ok) &&
                       MedianZncc(again.total.field) > MedianZncc(now.field));
  if (!better) return std::nullopt;
  Take(std::move(anew), last->number);
  memory.Forget();
  return again;
}

void PlanarSequence::SetCurvature(Image<SubsetCurvature> curvature) {
  impl_->curvature = std::move(curvature);
}

void PlanarSequence::Restart() {
  Impl& impl = *impl_;
  impl.Take(nullptr, -1);
  impl.memory.Forget();
  impl.last.reset();
}

SequenceFrame PlanarSequence::Add(const GrayImage& deformed, std::int64_t number,
                                  const SeedFinder& seeds, const PlanarField* starts) {
  Impl& impl = *impl_;
  if (deformed.size() != impl.size) impl.first.Correlate(deformed);  // throws
  const SequenceOptions& options = impl.options;
  ComposedField fields = impl.Match(deformed, seeds, starts);
  if (options.reference == ReferenceMode::kAuto && impl.last &&
      impl.last->number != impl.reference_number && impl.Worse(fields.total)) {
    if (auto again = impl.AfterUpdate(deformed, fields.total)) fields = std::move(*again);
  }
  ++impl.with_reference;
  impl.reached.ok = std::max(impl.reached.ok, fields.total.counts.ok);
  impl.reached.zncc = std::max(impl.reached.zncc, MedianZncc(fields.total.field));
  impl.memory.Take(fields.leg);

  SequenceFrame frame{fields.total.field, fields.total.counts, impl.reference_number,
                      impl.updated ? impl.updated->lost() : 0};
  if (options.reference == ReferenceMode::kFixed || fields.total.counts.ok == 0) return frame;
  Impl::Last next{deformed, number, std::move(fields)};
  // Not to a frame that would lose most of the points for good.
  if (options.reference == ReferenceMode::kEvery && impl.with_reference >= options.update_every &&
      2 * next.fields.total.counts.ok >= impl.reached.ok) {
    impl.memory.Replace(impl.Increment(next.fields.total.field));
    impl.Take(impl.ReferenceOf(next), number);
  }
  impl.last = std::move(next);
  return frame;
}

}  // namespace plumbline
