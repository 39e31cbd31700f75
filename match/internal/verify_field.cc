#include "match/internal/verify_field.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "calib/median.h"
#include "match/internal/field_parts.h"

namespace plumbline::internal {
namespace {

// The reference's own place of a point that another match should lead to.
constexpr double kSigmas = 5;
// Of the correlation that the match had: what an independent look has to see of it.
constexpr double kSeenAgain = 0.5;
// Lack of correlation (1 - ZNCC), in medians of the field's, above which a subset is odd: its inner
// half is asked, and its sigma, which counts the misfit as noise, not believed.
constexpr double kOdd = 3;
// That above which the inner half has to fit well for the subset to be believed, and how well.
constexpr double kFarOff = 30;
constexpr double kFitsWell = 10;
constexpr double kLeastLack = 0.002;  // that the median is taken to be: no image is better for good
constexpr int kSmallestInner = 9;     // px

double Bilinear(const GrayImage& image, const Eigen::Vector2d& at) {
  const int x = std::clamp(static_cast<int>(std::floor(at.x())), 0, image.width() - 2);
  const int y = std::clamp(static_cast<int>(std::floor(at.y())), 0, image.height() - 2);
  const double s = at.x() - x;
  const double t = at.y() - y;
  const std::uint16_t* row = image.grey.row(y) + x;
  const std::uint16_t* next = image.grey.row(y + 1) + x;
  return (1 - t) * ((1 - s) * row[0] + s * row[1]) + t * ((1 - s) * next[0] + s * next[1]);
}

// Zero-normalised cross-correlation of the inner half of a subset, by plain bilinear interpolation
// of the raw images: shares nothing with the correlator but the place it found.
double LookAgain(const GrayImage& reference, const GrayImage& deformed,
                 const Image<std::uint8_t>* mask, const Eigen::Vector2i& pixel,
                 const SubsetWarp& warp, int radius) {
  double n = 0;
  double f = 0;
  double g = 0;
  double ff = 0;
  double gg = 0;
  double fg = 0;
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      const Eigen::Vector2i at = pixel + Eigen::Vector2i(x, y);
      if (at.minCoeff() < 0 || at.x() >= reference.width() || at.y() >= reference.height()) {
        continue;
      }
      if (mask != nullptr && (*mask)(at.y(), at.x()) == 0) continue;
      const double a = reference.grey(at.y(), at.x());
      const double b = Bilinear(deformed, pixel.cast<double>() + warp.Apply(Eigen::Vector2d(x, y)));
      n += 1;
      f += a;
      g += b;
      ff += a * a;
      gg += b * b;
      fg += a * b;
    }
  }
  const double norm = (ff - f * f / n) * (gg - g * g / n);
  return norm > 0 ? (fg - f * g / n) / std::sqrt(norm) : 0;
}

// The warp that undoes a match: from the pixel of the deformed image nearest to where it led.
struct WayBack {
  Eigen::Vector2d there;
  Eigen::Vector2i from;
  SubsetWarp warp;

  WayBack(const Eigen::Vector2i& pixel, const SubsetWarp& match)
      : there(pixel.cast<double>() + match.displacement_px()),
        from(there.array().round().cast<int>()) {
    // Inverted about the point itself: the second order holds nowhere else.
    SubsetWarp about = match;
    about.c.col(0).setZero();
    warp = Inverse(about);
    warp.c.col(0) -= match.displacement_px();
    warp = warp.MovedTo(from.cast<double>() - there);
  }
};

double Sigma(const Eigen::Vector3f& cov) {
  return std::sqrt(static_cast<double>(cov[0]) + static_cast<double>(cov[2]));
}

class Verifier {
 public:
  Verifier(const MatchedImages& images, const FieldOptions& options, const Propagation& propagation,
           const PlanarField& field)
      : images_(images),
        options_(options),
        propagation_(propagation),
        field_(field),
        usual_lack_(MedianLack()) {}

  // 1 for the points that are kOk and should not be.
  std::vector<std::uint8_t> Rejected() const;

 private:
  SubsetWarp FoundWarp(std::size_t point) const;
  Image<std::uint8_t> MaskThere() const;
  double Lack(std::size_t point) const {
    return 1 - static_cast<double>(field_.zncc.data()[point]);
  }
  double MedianLack() const;
  // What of a sigma is believed of a subset that lacks this much of the correlation.
  double Believed(double lack) const { return std::sqrt(std::min(1.0, kOdd * usual_lack_ / lack)); }
  bool InnerHalfAgrees(const SubsetCorrelator& inner, std::size_t point) const;
  bool ComesHome(const SubsetCorrelator& backward, std::size_t point) const;

  const MatchedImages& images_;
  const FieldOptions& options_;
  const Propagation& propagation_;
  const PlanarField& field_;
  double usual_lack_;
};

SubsetWarp Verifier::FoundWarp(std::size_t point) const {
  SubsetWarp warp;
  warp.c = propagation_.WarpOf(static_cast<std::int64_t>(point)).cast<double>();
  warp.c.col(0) = field_.displacement_px.data()[point];
  return warp;
}

// The mask as it lies in the deformed image, around the points that matched: a subset at its edge
// would not find the way back with the background in it.
Image<std::uint8_t> Verifier::MaskThere() const {
  const ImageSize size = images_.reference.size();
  Image<std::uint8_t> there(size, 0);
  const int reach = std::min(options_.step_px, options_.correlator.radius_px()) * 3 / 2 + 1;
  for (std::size_t i = 0; i < field_.status.pixel_count(); ++i) {
    if (field_.status.data()[i] != Status::kOk) continue;
    const WayBack back(propagation_.PixelOf(static_cast<std::int64_t>(i)), FoundWarp(i));
    for (int y = std::max(0, back.from.y() - reach);
         y <= std::min(size.height - 1, back.from.y() + reach); ++y) {
      for (int x = std::max(0, back.from.x() - reach);
           x <= std::min(size.width - 1, back.from.x() + reach); ++x) {
        if (there(y, x) != 0) continue;
        const Eigen::Vector2d by = (Eigen::Vector2i(x, y) - back.from).cast<double>();
        const Eigen::Vector2i here =
            (back.from.cast<double>() + back.warp.Apply(by)).array().round().cast<int>();
        if (here.minCoeff() >= 0 && here.x() < size.width && here.y() < size.height &&
            (*images_.mask)(here.y(), here.x()) != 0) {
          there(y, x) = 1;
        }
      }
    }
  }
  return there;
}

double Verifier::MedianLack() const {
  std::vector<double> lacks;
  for (std::size_t i = 0; i < field_.status.pixel_count(); ++i) {
    if (field_.status.data()[i] == Status::kOk) lacks.push_back(Lack(i));
  }
  return lacks.empty() ? kLeastLack : std::max(kLeastLack, Median(std::move(lacks)));
}

// A subset part of which lies on something else that moves otherwise settles somewhere between. Its
// inner half settles elsewhere, or fits no better.
bool Verifier::InnerHalfAgrees(const SubsetCorrelator& inner, std::size_t point) const {
  const SubsetMatch match = inner.Match(
      images_.deformed, propagation_.PixelOf(static_cast<std::int64_t>(point)), FoundWarp(point));
  const bool far_off = Lack(point) > kFarOff * usual_lack_;
  if (match.status != Status::kOk) {
    return !far_off && match.status != Status::kNotConverged &&
           match.status != Status::kLowCorrelation;
  }
  const double lack = 1 - match.zncc;
  if (far_off && lack > kFitsWell * usual_lack_) return false;
  const double off = (match.warp.displacement_px() - field_.displacement_px.data()[point]).norm();
  const double sigma = std::sqrt(match.cov_displacement_px2.trace());
  return off <= options_.verify_tolerance_px + kSigmas * sigma * Believed(lack);
}

bool Verifier::ComesHome(const SubsetCorrelator& backward, std::size_t point) const {
  const Eigen::Vector2i pixel = propagation_.PixelOf(static_cast<std::int64_t>(point));
  const WayBack way(pixel, FoundWarp(point));
  const SubsetMatch back = backward.Match(images_.reference, way.from, way.warp);
  // At the border of the image there may not be enough of the subset to come back with.
  if (back.status == Status::kOutsideImage) return true;
  if (back.status != Status::kOk) return false;
  const Eigen::Vector2d home =
      way.from.cast<double>() + back.warp.Apply(way.there - way.from.cast<double>());
  return (home - pixel.cast<double>()).norm() <=
         options_.verify_tolerance_px +
             kSigmas * Sigma(field_.cov_displacement_px2.data()[point]) * Believed(Lack(point));
}

std::vector<std::uint8_t> Verifier::Rejected() const {
  CorrelatorOptions backward_options = options_.correlator;
  backward_options.max_sigma_px = 1;  // the forward match has been judged already
  backward_options.min_pixel_share /= 2;
  CorrelatorOptions inner_options = backward_options;
  inner_options.subset_px = std::max(options_.correlator.radius_px() / 2 * 2 + 1,
                                     std::min(kSmallestInner, options_.correlator.subset_px));
  inner_options.order = std::min(options_.correlator.order, 1);
  const Image<std::uint8_t> mask_there =
      images_.mask != nullptr ? MaskThere() : Image<std::uint8_t>();
  const SubsetCorrelator backward(images_.deformed, backward_options,
                                  images_.mask != nullptr ? &mask_there : nullptr);
  const SubsetCorrelator inner(images_.reference, inner_options, images_.mask);
  std::vector<std::uint8_t> rejected(field_.status.pixel_count(), 0);
  tbb::parallel_for(std::size_t{0}, rejected.size(), [&](std::size_t i) {
    if (field_.status.data()[i] != Status::kOk) return;
    const double seen = LookAgain(images_.raw_reference, images_.raw_deformed, images_.mask,
                                  propagation_.PixelOf(static_cast<std::int64_t>(i)), FoundWarp(i),
                                  options_.correlator.radius_px() / 2);
    const bool odd = Lack(i) > kOdd * usual_lack_;
    const bool holds = seen >= kSeenAgain * (1 - Lack(i)) && (!odd || InnerHalfAgrees(inner, i)) &&
                       ComesHome(backward, i);
    rejected[i] = holds ? 0 : 1;
  });
  return rejected;
}

}  // namespace

void TakeBack(std::int64_t point, Status why, PlanarField& field) {
  const auto i = static_cast<std::size_t>(point);
  const PlanarField none({1, 1}, {0, 0}, 1);
  field.status.data()[i] = why;
  field.displacement_px.data()[i] = none.displacement_px(0, 0);
  field.gradient.data()[i] = none.gradient(0, 0);
  field.cov_displacement_px2.data()[i] = none.cov_displacement_px2(0, 0);
  field.cov_gradient.data()[i] = none.cov_gradient(0, 0);
  field.reference_share.data()[i] = none.reference_share(0, 0);
}

void RejectNotFoundBack(const MatchedImages& images, const FieldOptions& options,
                        const Propagation& propagation, PlanarField& field, FieldCounts& counts) {
  const std::vector<std::uint8_t> rejected =
      Verifier(images, options, propagation, field).Rejected();
  for (std::size_t i = 0; i < rejected.size(); ++i) {
    if (rejected[i] == 0) continue;
    TakeBack(static_cast<std::int64_t>(i), Status::kFailedVerification, field);
    ++counts.not_found_back;
  }
}

void RejectParts(bool keep_still_parts, PlanarField& field, FieldCounts& counts) {
  const std::vector<FieldPart> parts = PartsOf(field);
  const std::vector<std::size_t> isolated = IsolatedParts(parts, field);
  const auto reject = [&](const std::vector<std::size_t>& which, std::int64_t& count) {
    for (const std::size_t part : which) {
      for (const std::int64_t point : parts[part].points) {
        if (field.status.data()[point] != Status::kOk) continue;
        TakeBack(point, Status::kFailedVerification, field);
        ++count;
      }
    }
  };
  reject(isolated, counts.isolated);
  if (!keep_still_parts) reject(StillBackground(parts), counts.still);
}

void CountStatuses(const PlanarField& field, FieldCounts& counts) {
  counts.points = counts.attempted = counts.ok = 0;
  counts.by_status.fill(0);
  for (const Status status : field.status.values()) {
    ++counts.points;
    ++counts.by_status[static_cast<std::size_t>(status)];
    counts.attempted += status != Status::kMasked ? 1 : 0;
    counts.ok += status == Status::kOk ? 1 : 0;
  }
}

}  // namespace plumbline::internal
