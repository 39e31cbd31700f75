#include "match/photon_transfer.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <optional>

#include "calib/error.h"
#include "match/internal/frame_difference.h"

namespace plumbline {
namespace {

constexpr std::int64_t kFewestPixels = 2000;  // that a curve can be made from
constexpr int kMostPoints = 48;
constexpr std::int64_t kFewestOfPoint = 200;
constexpr double kNearEnd = 4.5;  // sigmas from an end of the scale within which noise is clipped
constexpr double kNarrowShare = 0.05;  // of the scale: fewer grey levels tell no slope

// Residuals of one narrow range of grey levels.
struct Bin {
  std::int64_t n = 0;
  double sum_grey = 0;
  double sum_square = 0;
};

// The line through a curve, neither part negative.
struct Line {
  NoiseModel model;
  Eigen::Matrix2d cov = Eigen::Matrix2d::Zero();
  double chi2_per_dof = 0;
};

Line FitLine(const std::vector<PhotonTransferPoint>& curve, bool constant) {
  Line line;
  Eigen::Matrix2d H = Eigen::Matrix2d::Zero();
  Eigen::Vector2d g = Eigen::Vector2d::Zero();
  for (const PhotonTransferPoint& p : curve) {
    const Eigen::Vector2d row(1, p.grey);
    const double weight = 1 / (p.sigma_grey2 * p.sigma_grey2);
    H += weight * row * row.transpose();
    g += weight * p.variance_grey2 * row;
  }
  const double det = H.determinant();
  const bool degenerate = constant || !(det > 1e-12 * H(0, 0) * H(1, 1));
  Eigen::Vector2d solution(g[0] / H(0, 0), 0);
  line.cov(0, 0) = 1 / H(0, 0);
  if (!degenerate) {
    line.cov = H.inverse();
    solution = line.cov * g;
    if (solution[1] < 0) solution = {g[0] / H(0, 0), 0};
    if (solution[0] < 0) solution = {0, std::max(0.0, g[1] / H(1, 1))};
  }
  line.model = {std::max(0.0, solution[0]), std::max(0.0, solution[1])};
  for (const PhotonTransferPoint& p : curve) {
    const double misfit = p.variance_grey2 - line.model.Variance(p.grey);
    line.chi2_per_dof += misfit * misfit / (p.sigma_grey2 * p.sigma_grey2);
  }
  const auto n = static_cast<double>(curve.size());
  line.chi2_per_dof /= std::max(1.0, n - (constant ? 1 : 2));
  line.cov *= std::max(1.0, line.chi2_per_dof);
  return line;
}

// Sums neighbouring bins up to points of enough pixels, evenly over the grey levels in use.
std::vector<PhotonTransferPoint> MakeCurve(const std::vector<Bin>& bins, double low, double high) {
  std::vector<PhotonTransferPoint> curve;
  const auto mean = [](const Bin& bin) { return bin.sum_grey / static_cast<double>(bin.n); };
  double first = high, last = low;
  for (const Bin& bin : bins) {
    if (bin.n == 0 || mean(bin) <= low || mean(bin) >= high) continue;
    first = std::min(first, mean(bin));
    last = std::max(last, mean(bin));
  }
  const double width = (last - first) / kMostPoints;
  Bin group;
  double from = first;
  const auto close = [&] {
    const auto n = static_cast<double>(group.n);
    PhotonTransferPoint p;
    p.grey = group.sum_grey / n;
    p.variance_grey2 = 0.5 * group.sum_square / n - kRoundingVarianceGrey2;
    p.pixels = group.n;
    curve.push_back(p);
    group = {};
  };
  for (const Bin& bin : bins) {
    if (bin.n == 0 || mean(bin) <= low || mean(bin) >= high) continue;
    if (group.n >= kFewestOfPoint && mean(bin) > from + width) {
      close();
      from = mean(bin);
    }
    group.n += bin.n;
    group.sum_grey += bin.sum_grey;
    group.sum_square += bin.sum_square;
  }
  if (group.n >= kFewestOfPoint || (curve.empty() && group.n > 0)) close();
  return curve;
}

// sigma of a variance estimated from n differences of normal deviates; consecutive differences
// share a frame, so that their squares correlate by 1/4.
void SetSigmas(const NoiseModel& model, int pairs, std::vector<PhotonTransferPoint>& curve) {
  const double shared = 1 + 0.5 * (pairs - 1) / pairs;
  for (PhotonTransferPoint& p : curve) {
    const double variance = model.Variance(p.grey) + kRoundingVarianceGrey2;
    p.sigma_grey2 = variance * std::sqrt(2 * shared / static_cast<double>(p.pixels));
  }
}

}  // namespace

struct PhotonTransferFit::Impl {
  PhotonTransferOptions options;
  Image<std::uint8_t> mask;
  GrayImage previous;
  std::vector<Bin> bins;
  PhotonTransfer sums;  // what is counted as frames come in
  internal::GreyLimits limits{0, 65535};
  std::int64_t masked_pixels = 0, looked_at = 0, used = 0, black = 0, white = 0;
  std::int64_t counted = 0, identical = 0;
  std::int64_t tiles = 0, changed_tiles = 0;
  double smallest_motion_px = 0;  // of the pairs that moved
  double greatest_likeness = -1;  // of them
  double sum_right = 0, sum_below = 0, sum_squares = 0;

  void AddPair(const GrayImage& a, const GrayImage& b);
  void Collect(const GrayImage& a, const GrayImage& b, const Image<float>& residual);
  std::vector<PhotonTransferPoint> CurveWithin(const NoiseModel& model) const;
  void Refuse() const;
  void AddNotes(PhotonTransfer& out) const;
};

void PhotonTransferFit::Impl::AddPair(const GrayImage& a, const GrayImage& b) {
  const internal::FrameDifference difference =
      internal::DifferenceOfStillFrames(a, b, mask, options.tile_px);
  looked_at += masked_pixels;
  black += difference.black;
  white += difference.white;
  counted += difference.counted;
  identical += difference.identical;
  if (difference.motion_px > options.max_motion_px) {
    smallest_motion_px = sums.moved_pairs == 0 ? difference.motion_px
                                               : std::min(smallest_motion_px, difference.motion_px);
    greatest_likeness = std::max(greatest_likeness, difference.likeness);
    ++sums.moved_pairs;
    return;
  }
  const internal::GreyLimits here = internal::FindGreyLimits(a, b);
  limits.low = std::max(limits.low, here.low);
  limits.high = std::min(limits.high, here.high);
  tiles += difference.tiles;
  changed_tiles += difference.changed_tiles;
  ++sums.pairs;
  sums.motion_px = std::max(sums.motion_px, difference.motion_px);
  sums.flicker = std::max(sums.flicker, std::abs(difference.brightness_ratio - 1));
  Collect(a, b, difference.residual);
}

void PhotonTransferFit::Impl::Collect(const GrayImage& a, const GrayImage& b,
                                      const Image<float>& residual) {
  const ImageSize size = residual.size();
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      const double r = static_cast<double>(residual(y, x));
      if (std::isnan(r)) continue;
      const double grey = 0.5 * (a.grey(y, x) + b.grey(y, x));
      Bin& bin = bins[static_cast<std::size_t>(grey)];
      ++bin.n;
      bin.sum_grey += grey;
      bin.sum_square += r * r;
      ++used;
      const double right = x + 1 < size.width ? static_cast<double>(residual(y, x + 1)) : NAN;
      const double below = y + 1 < size.height ? static_cast<double>(residual(y + 1, x)) : NAN;
      if (std::isnan(right) || std::isnan(below)) continue;
      sum_right += r * right;
      sum_below += r * below;
      sum_squares += r * r;
    }
  }
}

// The curve of the pixels whose noise no end of the scale cuts.
std::vector<PhotonTransferPoint> PhotonTransferFit::Impl::CurveWithin(
    const NoiseModel& model) const {
  const auto reach = [&](double grey) {
    return kNearEnd * std::sqrt(model.Variance(grey) + kRoundingVarianceGrey2);
  };
  std::vector<PhotonTransferPoint> curve =
      MakeCurve(bins, limits.low + reach(limits.low), limits.high - reach(limits.high));
  SetSigmas(model, sums.pairs, curve);
  return curve;
}

void PhotonTransferFit::Impl::Refuse() const {
  if (sums.frames < 2) {
    throw InputError(
        fmt::format("Noise is found from how still frames differ, and there {}: take at least 2, "
                    "better 10, of a scene at rest.",
                    sums.frames == 0 ? "are none" : "is only 1"));
  }
  if (counted < kFewestPixels) {
    const char* why = white > black   ? "are saturated: expose shorter or close the aperture"
                      : black > white ? "are black: expose longer or use more light"
                                      : "are left to look at: use larger images or another mask";
    throw InputError(fmt::format("Too few of the pixels can be used ({} of {}); {} {}.", counted,
                                 looked_at, std::max(black, white), why));
  }
  if (identical == counted) {
    throw InputError(
        "The frames are the same, pixel by pixel: copies of one, or of a source without any noise; "
        "take each one anew, and store them uncompressed.");
  }
  if (sums.pairs == 0 && greatest_likeness < 0.5) {
    throw InputError(fmt::format(
        "Consecutive frames are unlike each other (correlation at most {:.2f}): give frames of one "
        "camera only, of a scene at rest.",
        greatest_likeness));
  }
  if (sums.pairs == 0) {
    throw InputError(fmt::format(
        "The picture moved by at least {:.2f} px between all of the frames, and {} px is the most "
        "that counts as still: fix camera and specimen, unload, and take the frames in quick "
        "succession.",
        smallest_motion_px, options.max_motion_px));
  }
  if (used < kFewestPixels || 2 * changed_tiles > tiles) {
    throw InputError(fmt::format(
        "The picture changed between the frames in {} of {} places (moving things, shadows, "
        "blinking light): take frames of a scene at rest, or mask what moves.",
        changed_tiles, tiles));
  }
}

void PhotonTransferFit::Impl::AddNotes(PhotonTransfer& out) const {
  const double levels = std::ldexp(1.0, out.bits);
  const double range = out.highest_grey - out.lowest_grey;
  if (out.constant) {
    out.notes.push_back(
        range < kNarrowShare * levels
            ? fmt::format(
                  "the grey levels reach from {:.0f} to {:.0f} only, too little to tell how "
                  "noise grows with them: it is taken as constant; a scene with dark and "
                  "bright parts tells more",
                  out.lowest_grey, out.highest_grey)
            : "the noise does not grow measurably with the grey level: it is taken as constant");
  }
  if (out.moved_pairs > 0) {
    out.notes.push_back(
        fmt::format("{} of {} pairs of frames are left out because the picture moved between them, "
                    "by {:.2f} px or more",
                    out.moved_pairs, out.moved_pairs + out.pairs, smallest_motion_px));
  }
  if (out.misfit > 0.1 && out.chi2_per_dof > 3) {
    out.notes.push_back(
        fmt::format("the variances depart from {} by {:.0f} % (rms): the camera changes its grey "
                    "levels (gamma, sharpening, compression) or the light flickered unevenly",
                    out.constant ? "one value" : "a line", 100 * out.misfit));
  }
  if (out.neighbour_correlation > 0.15) {
    out.notes.push_back(fmt::format(
        "the noise of neighbouring pixels is correlated ({:.2f}): the images are filtered or "
        "compressed, and sigmas that take pixels as independent come out too small",
        out.neighbour_correlation));
  }
  const double middle = out.model.Variance(0.5 * (out.lowest_grey + out.highest_grey));
  if (middle < kRoundingVarianceGrey2) {
    out.notes.push_back(
        "the noise is below that of rounding to whole grey levels; more bits would tell more");
  }
  if (changed_tiles > 0) {
    out.notes.push_back(
        fmt::format("{:.1f} % of the picture is left out because it changed between frames",
                    100.0 * static_cast<double>(changed_tiles) / static_cast<double>(tiles)));
  }
}

void PhotonTransferOptions::Check() const {
  if (tile_px < 16) throw UsageError("The tiles must be at least 16 px wide.");
  if (!(max_motion_px > 0 && max_motion_px <= 0.5)) {
    throw UsageError("The motion that counts as still must lie above 0 and up to 0.5 px.");
  }
}

double PhotonTransfer::sigma_offset_grey2() const { return std::sqrt(cov(0, 0)); }
double PhotonTransfer::sigma_slope_grey() const { return std::sqrt(cov(1, 1)); }

PhotonTransferFit::PhotonTransferFit(const PhotonTransferOptions& options, Image<std::uint8_t> mask)
    : impl_(std::make_unique<Impl>()) {
  options.Check();
  impl_->options = options;
  impl_->mask = std::move(mask);
  impl_->bins.resize(65536);
}

PhotonTransferFit::~PhotonTransferFit() = default;

void PhotonTransferFit::Add(const GrayImage& frame) {
  Impl& m = *impl_;
  const ImageSize size = m.sums.frames == 0 ? frame.size() : m.sums.size;
  if (!(frame.size() == size)) {
    throw InputError(fmt::format("Frame {} is {}x{} px and the first {}x{} px.", m.sums.frames + 1,
                                 frame.width(), frame.height(), size.width, size.height));
  }
  if (!m.mask.empty() && !(m.mask.size() == size)) {
    throw InputError(fmt::format("The mask is {}x{} px and the frames {}x{} px.", m.mask.width(),
                                 m.mask.height(), size.width, size.height));
  }
  m.sums.bits = std::max(m.sums.bits, frame.bits);
  if (m.sums.frames++ == 0) {
    m.sums.size = size;
    m.masked_pixels = m.mask.empty() ? static_cast<std::int64_t>(frame.grey.pixel_count())
                                     : static_cast<std::int64_t>(std::count_if(
                                           m.mask.values().begin(), m.mask.values().end(),
                                           [](std::uint8_t value) { return value != 0; }));
  } else {
    m.AddPair(m.previous, frame);
  }
  m.previous = frame;
}

PhotonTransfer PhotonTransferFit::Fit() const {
  const Impl& m = *impl_;
  m.Refuse();
  PhotonTransfer out = m.sums;
  const double looked_at = static_cast<double>(m.looked_at);
  out.used_share = static_cast<double>(m.used) / looked_at;
  out.black_share = static_cast<double>(m.black) / looked_at;
  out.white_share = static_cast<double>(m.white) / looked_at;
  if (m.sum_squares > 0) {
    out.neighbour_correlation = std::max(m.sum_right, m.sum_below) / m.sum_squares;
  }

  // The weights and the ends need the line: from none on.
  const auto refine = [&] {
    for (int round = 0; round < 6; ++round) {
      out.curve = m.CurveWithin(out.model);
      if (out.curve.empty()) {
        throw InputError(
            "What differs between the frames is as large as the grey scale itself, or all pixels "
            "are nearly black or white: take frames of a scene at rest, with grey levels between.");
      }
      const Line line = FitLine(out.curve, out.constant);
      out.model = line.model;
      out.cov = line.cov;
      out.chi2_per_dof = line.chi2_per_dof;
    }
  };
  refine();
  out.lowest_grey = out.curve.front().grey;
  out.highest_grey = out.curve.back().grey;
  const double range = out.highest_grey - out.lowest_grey;
  if (range < kNarrowShare * std::ldexp(1.0, out.bits) ||
      out.model.slope_grey < 3 * out.sigma_slope_grey()) {
    out.constant = true;
    refine();
  }
  double sum = 0, pixels = 0;
  for (const PhotonTransferPoint& p : out.curve) {
    const double expected = out.model.Variance(p.grey);
    const double relative = (p.variance_grey2 - expected) / (expected + kRoundingVarianceGrey2);
    sum += static_cast<double>(p.pixels) * relative * relative;
    pixels += static_cast<double>(p.pixels);
  }
  out.misfit = std::sqrt(sum / pixels);
  m.AddNotes(out);
  return out;
}

PhotonTransfer FitPhotonTransfer(const std::vector<GrayImage>& frames,
                                 const PhotonTransferOptions& options) {
  PhotonTransferFit fit(options);
  for (const GrayImage& frame : frames) fit.Add(frame);
  return fit.Fit();
}

}  // namespace plumbline
