#include "match/stereo_sequence.h"

#include <fmt/format.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_invoke.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "match/internal/updated_reference.h"
#include "match/internal/worst_sigma.h"
#include "match/planar_sequence.h"

namespace plumbline {
namespace {

using internal::ComposedField;
using internal::UpdatedReference;

const Eigen::Matrix2d kOne = Eigen::Matrix2d::Identity();

// The points at rest in the reference image itself; those that are not to be used as `right` says.
PlanarField AtRest(const PlanarField& right) {
  PlanarField left(right.size(), right.first_px, right.step_px);
  left.subset_px = right.subset_px;
  left.order = right.order;
  for (std::size_t i = 0; i < right.status.pixel_count(); ++i) {
    if (right.status.data()[i] == Status::kMasked) {
      left.status.data()[i] = Status::kMasked;
      continue;
    }
    left.status.data()[i] = Status::kOk;
    left.displacement_px.data()[i].setZero();
    left.gradient.data()[i].setZero();
    left.cov_displacement_px2.data()[i].setZero();
    left.cov_gradient.data()[i].setZero();
    left.reference_share.data()[i] = 1;
    left.zncc.data()[i] = 1;
  }
  return left;
}

// From the left image to the right one of a pair, out of where that shows each point.
PlanarField StartsAt(const SubsetGrid& grid, const RightPlace& place) {
  PlanarField starts(grid.grid, grid.first_px, grid.step_px);
  const double reach = grid.subset_px / 2.0;
  for (int r = 0; r < grid.grid.height; ++r) {
    for (int c = 0; c < grid.grid.width; ++c) {
      const Eigen::Vector2d x = starts.PixelOf(r, c);
      const auto along = [&](const Eigen::Vector2d& by) {
        return ((place(x + by) - place(x - by)) / (2 * reach)).eval();
      };
      Eigen::Matrix2d F;
      F << along({reach, 0}), along({0, reach});
      const Eigen::Vector2d displacement = place(x) - x;
      if (!F.allFinite() || !displacement.allFinite()) continue;
      starts.status(r, c) = Status::kOk;
      starts.displacement_px(r, c) = displacement;
      starts.gradient(r, c) = (F - kOne).cast<float>();
    }
  }
  return starts;
}

// Half the second derivatives of the motion at a point, out of its neighbours' gradients; NaN where
// one is missing.
SubsetCurvature CurvatureAt(const PlanarField& field, int r, int c) {
  SubsetCurvature half = SubsetCurvature::Constant(std::numeric_limits<float>::quiet_NaN());
  if (r < 1 || c < 1 || r + 1 >= field.size().height || c + 1 >= field.size().width) return half;
  const std::array<Eigen::Vector2i, 5> places = {
      Eigen::Vector2i(c, r), {c - 1, r}, {c + 1, r}, {c, r - 1}, {c, r + 1}};
  if (!std::all_of(places.begin(), places.end(), [&](const Eigen::Vector2i& at) {
        return field.status(at.y(), at.x()) == Status::kOk;
      })) {
    return half;
  }
  const auto per_px = static_cast<float>(1.0 / (2.0 * field.step_px));
  const Eigen::Matrix2f along_x = per_px * (field.gradient(r, c + 1) - field.gradient(r, c - 1));
  const Eigen::Matrix2f along_y = per_px * (field.gradient(r + 1, c) - field.gradient(r - 1, c));
  half.col(0) = along_x.col(0) / 2;
  half.col(1) = (along_x.col(1) + along_y.col(0)) / 2;
  half.col(2) = along_y.col(1) / 2;
  return half;
}

// Means over windows of five subsets: the gradients' own noise would pass for curvature. Zero where
// there is none to tell.
Image<SubsetCurvature> SmoothCurvature(const PlanarField& field) {
  const ImageSize size = field.size();
  Image<SubsetCurvature> raw(size, SubsetCurvature::Zero());
  Image<SubsetCurvature> smooth = raw;
  for (int r = 0; r < size.height; ++r) {
    for (int c = 0; c < size.width; ++c) raw(r, c) = CurvatureAt(field, r, c);
  }
  const int reach = std::max(2, 5 * field.subset_px / (2 * field.step_px));
  tbb::parallel_for(0, size.height, [&](int row) {
    for (int column = 0; column < size.width; ++column) {
      SubsetCurvature sum = SubsetCurvature::Zero();
      int count = 0;
      for (int r = std::max(0, row - reach); r <= std::min(size.height - 1, row + reach); ++r) {
        for (int c = std::max(0, column - reach); c <= std::min(size.width - 1, column + reach);
             ++c) {
          if (!raw(r, c).allFinite()) continue;
          sum += raw(r, c);
          ++count;
        }
      }
      if (count >= 4) smooth(row, column) = sum / static_cast<float>(count);
    }
  });
  return smooth;
}

// How far shape functions of order 1 put a point off, over its sigma: the median over the field. An
// affine subset of side s that is fitted to a motion with second derivatives w is off by its mean,
// s^2 / 24 (w_xx + w_yy).
double BiasInSigmas(const PlanarField& field, const Image<SubsetCurvature>& curvature) {
  const double side = field.subset_px;
  std::vector<double> ratios;
  for (std::size_t i = 0; i < field.status.pixel_count(); ++i) {
    if (field.status.data()[i] != Status::kOk) continue;
    const SubsetCurvature& half = curvature.data()[i];
    const double second = 2 * static_cast<double>((half.col(0) + half.col(2)).norm());
    const double sigma = internal::WorstSigma(CovarianceOf(field.cov_displacement_px2.data()[i]));
    ratios.push_back(side * side / 24 * second / sigma);
  }
  return ratios.empty() ? 0 : Median(std::move(ratios));
}

// The start of a leg from one image to another, out of where both show the points.
PlanarField LegBetween(const PlanarField& from, const PlanarField& to) {
  PlanarField leg = to;
  for (std::size_t i = 0; i < to.status.pixel_count(); ++i) {
    if (from.status.data()[i] != Status::kOk || to.status.data()[i] != Status::kOk) {
      leg.status.data()[i] = Status::kNotConverged;
      continue;
    }
    leg.displacement_px.data()[i] = to.displacement_px.data()[i] - from.displacement_px.data()[i];
    const Eigen::Matrix2d F_from = kOne + from.gradient.data()[i].cast<double>();
    const Eigen::Matrix2d F_to = kOne + to.gradient.data()[i].cast<double>();
    leg.gradient.data()[i] = (F_to * F_from.inverse() - kOne).cast<float>();
  }
  return leg;
}

}  // namespace

void StereoSequenceOptions::Check() const {
  field.Check();
  seeds.Check();
  if (update_every < 1) {
    throw UsageError(
        fmt::format("The reference is updated every 1 frame or more; {} is not.", update_every));
  }
}

struct StereoSequence::Impl {
  Impl(const StereoRig& rig, const GrayImage& left, const GrayImage& right,
       const StereoSequenceOptions& o, const Image<std::uint8_t>& m, const RightPlace& place);
  SequenceOptions Sequence() const;
  void MatchReference(const StereoRig& rig, const GrayImage& left, const RightPlace& place);
  std::optional<SequenceFrame> MatchReferenceFrom(const RightPlace& place);
  std::vector<CorrelationSeed> RightSeeds(const GrayImage& right) const;
  ComposedField FreshStereo(const GrayImage& left, const GrayImage& right,
                            const SequenceFrame& tracked, const StereoField* starts);
  StereoField Add(const GrayImage& left_image, const GrayImage& right_image, std::int64_t number,
                  const StereoField* starts);

  StereoSequenceOptions options;
  Image<std::uint8_t> mask;
  GrayImage right_reference;
  StereoSeeds seeds;
  StereoField reference;
  std::unique_ptr<PlanarSequence> left, right;
  Image<SubsetCurvature> curvature;  // of the right matches; empty: not worth it
  std::optional<StereoField> last;   // of kFreshStereo
};

SequenceOptions StereoSequence::Impl::Sequence() const {
  SequenceOptions sequence;
  sequence.field = options.field;
  sequence.verify_all = options.verify_all;
  if (options.strategy == StereoStrategy::kIncremental) {
    sequence.reference = ReferenceMode::kEvery;
    sequence.update_every = options.update_every;
  }
  return sequence;
}

StereoSequence::Impl::Impl(const StereoRig& rig, const GrayImage& l, const GrayImage& r,
                           const StereoSequenceOptions& o, const Image<std::uint8_t>& m,
                           const RightPlace& place)
    : options(o), mask(m), right_reference(r) {
  if (l.size() != r.size()) {
    throw InputError(fmt::format(
        "the left image has {} x {} px and the right one {} x {}: correlation across the cameras "
        "needs images of one size; crop both alike and calibrate with the cropped ones",
        l.width(), l.height(), r.width(), r.height()));
  }
  MatchReference(rig, l, place);
  if (options.follow_curvature && options.field.correlator.order == 1) {
    curvature = SmoothCurvature(reference.right);
    constexpr double kWorthIt = 0.1;
    if (BiasInSigmas(reference.right, curvature) < kWorthIt) {
      curvature = {};
    } else {
      MatchReference(rig, l, place);
    }
  }
  seeds.seeds.clear();
}

// A sequence of each camera, both from the left reference image. That of the right camera has seen
// the right reference image, so that it goes on from there.
void StereoSequence::Impl::MatchReference(const StereoRig& rig, const GrayImage& l,
                                          const RightPlace& place) {
  left = std::make_unique<PlanarSequence>(l, Sequence(), mask);
  SequenceOptions across = Sequence();
  across.field.correlator.deformed_noise = options.right_noise;
  right = std::make_unique<PlanarSequence>(l, across, mask);
  right->SetCurvature(curvature);
  std::optional<SequenceFrame> found;
  if (place) found = MatchReferenceFrom(place);
  if (!found) {
    if (seeds.seeds.empty()) {
      const Image<std::uint8_t>* const wanted = mask.empty() ? nullptr : &mask;
      seeds = FindStereoSeeds(rig, l, right_reference, wanted, options.seeds);
    }
    found = right->Add(right_reference, -1, [this](const GrayImage&) { return seeds.seeds; });
  }
  reference.right = std::move(found->field);
  reference.right_counts = found->counts;
  reference.left = AtRest(reference.right);
}

// Nothing where the places lead to too little, and nothing changed.
std::optional<SequenceFrame> StereoSequence::Impl::MatchReferenceFrom(const RightPlace& place) {
  constexpr double kLeastFound = 0.9;  // of what was known
  const PlanarField starts = StartsAt(right->correlator().grid(), place);
  const auto known =
      std::count(starts.status.values().begin(), starts.status.values().end(), Status::kOk);
  if (known == 0) return std::nullopt;
  SequenceFrame found = right->Add(right_reference, -1, nullptr, &starts);
  if (static_cast<double>(found.counts.ok) >= kLeastFound * static_cast<double>(known)) {
    return found;
  }
  right->Restart();
  return std::nullopt;
}

// Seeds for a right image that nothing is known of: from the right reference image, taken on from
// where that shows the points of the grid.
std::vector<CorrelationSeed> StereoSequence::Impl::RightSeeds(const GrayImage& image) const {
  const PlanarField& base = reference.right;
  const double reach = std::max(base.step_px, base.subset_px);
  std::vector<CorrelationSeed> composed;
  for (const CorrelationSeed& seed :
       FindSeeds(right_reference, image, nullptr, options.field.seeds)) {
    double nearest = reach * reach;
    std::optional<std::size_t> point;
    for (std::size_t i = 0; i < base.status.pixel_count(); ++i) {
      if (base.status.data()[i] != Status::kOk) continue;
      const auto columns = static_cast<std::size_t>(base.size().width);
      const Eigen::Vector2d there =
          base.PixelOf(static_cast<int>(i / columns), static_cast<int>(i % columns)) +
          base.displacement_px.data()[i];
      const double distance = (there - seed.reference_px).squaredNorm();
      if (distance >= nearest) continue;
      nearest = distance;
      point = i;
    }
    if (!point) continue;
    const auto columns = static_cast<std::size_t>(base.size().width);
    const Eigen::Vector2d x =
        base.PixelOf(static_cast<int>(*point / columns), static_cast<int>(*point % columns));
    const Eigen::Vector2d there = x + base.displacement_px.data()[*point];
    const Eigen::Vector2d moved =
        there + seed.displacement_px + seed.gradient * (there - seed.reference_px);
    const Eigen::Matrix2d F =
        (kOne + seed.gradient) * (kOne + base.gradient.data()[*point].cast<double>());
    composed.push_back({x, moved - x, F - kOne, seed.score});
  }
  return composed;
}

ComposedField StereoSequence::Impl::FreshStereo(const GrayImage& l, const GrayImage& r,
                                                const SequenceFrame& tracked,
                                                const StereoField* starts) {
  ComposedField base;
  base.total = {tracked.field, tracked.counts};
  base.leg = tracked.field;
  const UpdatedReference across(l, base, mask, right->correlator().options());
  const StereoField& before = starts != nullptr ? *starts : last ? *last : reference;
  const PlanarField leg = LegBetween(before.left, before.right);
  FieldStart start;
  start.prior = &leg;
  start.verify_back = options.verify_all || starts != nullptr || !last;
  start.curvature = curvature.empty() ? nullptr : &curvature;
  start.search = starts == nullptr;
  return across.Correlate(r, start);
}

StereoField StereoSequence::Impl::Add(const GrayImage& left_image, const GrayImage& right_image,
                                      std::int64_t number, const StereoField* starts) {
  for (const GrayImage* image : {&left_image, &right_image}) {
    if (image->size() != right_reference.size()) {
      throw InputError(fmt::format("the images have {} x {} px and those of the reference {} x {}",
                                   image->width(), image->height(), right_reference.width(),
                                   right_reference.height()));
    }
  }
  const PlanarField* const left_starts = starts == nullptr ? nullptr : &starts->left;
  SequenceFrame tracked, seen;
  if (options.strategy == StereoStrategy::kFreshStereo) {
    tracked = left->Add(left_image, number, nullptr, left_starts);
    if (tracked.counts.ok > 0) {
      ComposedField across = FreshStereo(left_image, right_image, tracked, starts);
      seen.field = std::move(across.total.field);
      seen.counts = across.total.counts;
    } else {
      seen.field = tracked.field;
      seen.counts = tracked.counts;
    }
  } else {
    const PlanarField* const right_starts = starts == nullptr ? nullptr : &starts->right;
    tbb::parallel_invoke([&] { tracked = left->Add(left_image, number, nullptr, left_starts); },
                         [&] {
                           seen = right->Add(
                               right_image, number,
                               [&](const GrayImage& image) { return RightSeeds(image); },
                               right_starts);
                         });
  }
  StereoField field;
  field.left = std::move(tracked.field);
  field.left_counts = tracked.counts;
  field.right = std::move(seen.field);
  field.right_counts = seen.counts;
  field.reference_frame = tracked.reference_frame;
  if (options.strategy == StereoStrategy::kFreshStereo && field.right_counts.ok > 0) last = field;
  return field;
}

StereoSequence::StereoSequence(const StereoRig& rig, const GrayImage& left, const GrayImage& right,
                               const StereoSequenceOptions& options,
                               const Image<std::uint8_t>& mask, const RightPlace& right_place) {
  options.Check();
  impl_ = std::make_unique<Impl>(rig, left, right, options, mask, right_place);
}

StereoSequence::~StereoSequence() = default;

const StereoField& StereoSequence::reference() const { return impl_->reference; }
const StereoSeeds& StereoSequence::reference_seeds() const { return impl_->seeds; }
const FieldCorrelator& StereoSequence::correlator() const { return impl_->left->correlator(); }
bool StereoSequence::follows_curvature() const { return !impl_->curvature.empty(); }

StereoField StereoSequence::Add(const GrayImage& left, const GrayImage& right,
                                std::int64_t number) {
  return impl_->Add(left, right, number, nullptr);
}

StereoField StereoSequence::AddFrom(const StereoField& starts, const GrayImage& left,
                                    const GrayImage& right, std::int64_t number) {
  if (impl_->options.strategy == StereoStrategy::kIncremental) {
    throw std::logic_error("the points of an incremental sequence are known from the last frame");
  }
  return impl_->Add(left, right, number, &starts);
}

void StereoSequence::Restart() {
  if (impl_->options.strategy == StereoStrategy::kIncremental) {
    throw std::logic_error("an incremental sequence cannot start in its middle");
  }
  impl_->left->Restart();
  impl_->right->Restart();
  impl_->last.reset();
}

}  // namespace plumbline
