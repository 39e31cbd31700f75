#include "match/internal/speckle_advice.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "calib/median.h"

namespace plumbline::internal {
namespace {

constexpr double kWeak = 2;             // times the median sigma
constexpr std::size_t kMost = 5;        // regions
constexpr double kFewestOfAll = 0.005;  // of the POIs, to be worth a word

std::string Where(double x, double y) {
  constexpr std::array<const char*, 3> kRows = {"upper", "middle", "lower"};
  constexpr std::array<const char*, 3> kColumns = {"left", "centre", "right"};
  const auto third = [](double share) {
    return static_cast<std::size_t>(std::clamp(static_cast<int>(3 * share), 0, 2));
  };
  const std::size_t row = third(y), column = third(x);
  if (row == 1 && column == 1) return "the middle";
  return fmt::format("the {} {}", kRows[row], kColumns[column]);
}

// A connected set of weak POIs, as their indices.
std::vector<std::size_t> Grow(std::size_t seed, const std::vector<SpecklePoi>& pois,
                              std::size_t columns, std::vector<std::uint8_t>& weak) {
  std::vector<std::size_t> members{seed};
  weak[seed] = 0;
  for (std::size_t next = 0; next < members.size(); ++next) {
    const std::size_t at = members[next], column = at % columns;
    const auto visit = [&](bool inside, std::size_t neighbour) {
      if (!inside || weak[neighbour] == 0) return;
      weak[neighbour] = 0;
      members.push_back(neighbour);
    };
    visit(column > 0, at - 1);
    visit(column + 1 < columns, at + 1);
    visit(at >= columns, at - columns);
    visit(at + columns < pois.size(), at + columns);
  }
  return members;
}

}  // namespace

void FindWeakRegions(const SpeckleCheckOptions& options, ImageSize size, int poi_columns,
                     SpeckleCheck& check) {
  const std::vector<SpecklePoi>& pois = check.pois;
  std::vector<std::uint8_t> weak(pois.size(), 0);
  for (std::size_t i = 0; i < pois.size(); ++i) {
    weak[i] = pois[i].status == Status::kLowTexture ||
              (pois[i].status == Status::kOk && pois[i].sigma_px > kWeak * check.median_sigma_px);
  }
  for (std::size_t i = 0; i < pois.size(); ++i) {
    if (weak[i] == 0) continue;
    const std::vector<std::size_t> members =
        Grow(i, pois, static_cast<std::size_t>(poi_columns), weak);
    WeakRegion region;
    int x0 = size.width, y0 = size.height, x1 = 0, y1 = 0;
    std::vector<double> sigmas;
    double sum_x = 0, sum_y = 0;
    for (const std::size_t k : members) {
      const Eigen::Vector2i c = pois[k].centre_px;
      const int half = options.subset_px / 2;
      x0 = std::min(x0, c.x() - half);
      y0 = std::min(y0, c.y() - half);
      x1 = std::max(x1, c.x() + half + 1);
      y1 = std::max(y1, c.y() + half + 1);
      sum_x += c.x();
      sum_y += c.y();
      sigmas.push_back(pois[k].status == Status::kOk ? pois[k].sigma_px : 1e300);
    }
    region.pois = static_cast<std::int64_t>(members.size());
    region.x = x0;
    region.y = y0;
    region.width = x1 - x0;
    region.height = y1 - y0;
    const double n = static_cast<double>(members.size());
    region.where = Where(sum_x / n / size.width, sum_y / n / size.height);
    region.sigma_px = Median(std::move(sigmas));
    if (region.sigma_px > 1e299) region.sigma_px = std::numeric_limits<double>::quiet_NaN();
    if (n >= kFewestOfAll * static_cast<double>(pois.size())) check.weak.push_back(region);
  }
  std::stable_sort(check.weak.begin(), check.weak.end(),
                   [](const WeakRegion& a, const WeakRegion& b) { return a.pois > b.pois; });
  if (check.weak.size() > kMost) check.weak.resize(kMost);
}

void AddSpeckleAdvice(const SpeckleCheckOptions& options, int bits, SpeckleCheck& check) {
  std::vector<std::string>& advice = check.advice;
  const auto percent = [](double share) { return fmt::format("{:.1f} %", 100 * share); };
  if (check.measurable_pois == 0) {
    advice.push_back(
        "there is no texture above the noise anywhere: the surface must be speckled, lit better or "
        "brought into focus");
    return;
  }
  if (check.feature_px < 3) {
    advice.push_back(fmt::format(
        "the features are small ({:.1f} px; 3 to 7 are good): interpolation between pixels has "
        "errors then; use coarser speckle, go nearer or use a longer lens",
        check.feature_px));
  } else if (check.feature_px > std::max(7.0, options.subset_px / 3.0)) {
    const int side = 2 * static_cast<int>(std::ceil(1.5 * check.feature_px)) + 1;
    advice.push_back(fmt::format(
        "the features are large ({:.1f} px; 3 to 7 are good), so that a subset of {} px holds few "
        "of them; use finer speckle, go further away, or subsets of at least {} px",
        check.feature_px, options.subset_px, side));
  }
  if (check.blur_px > 1.5) {
    advice.push_back(fmt::format(
        "the edges are as soft as a blur of {:.1f} px makes them (0.3 to 0.6 px is sharp): unless "
        "the pattern itself is soft, focus, close the aperture or expose shorter",
        check.blur_px));
  }
  if (check.white_share > 0.01) {
    advice.push_back(fmt::format("{} of the pixels are saturated and carry nothing: expose shorter",
                                 percent(check.white_share)));
  }
  if (check.black_share > 0.01) {
    advice.push_back(fmt::format(
        "{} of the pixels are clipped at black and carry nothing: expose longer or raise the black "
        "level",
        percent(check.black_share)));
  }
  if (check.contrast_grey < 0.05 * std::ldexp(1.0, bits)) {
    advice.push_back(
        fmt::format("the contrast is low (standard deviation {:.1f} of {:.0f} grey levels): more "
                    "light or paint "
                    "of more contrast lowers sigma in proportion",
                    check.contrast_grey, std::ldexp(1.0, bits)));
  }
  if (check.noise_estimated && check.noise.offset_grey2 < 0.05) {
    advice.push_back(
        "the image shows hardly any noise of its own (compressed, filtered or computed?), so that "
        "the predicted standard deviations are too small; give --noise");
  }
  const auto wanted = check.subset_for_wanted_px;
  if (wanted == 0) {
    advice.push_back(
        fmt::format("no subset up to {} px reaches {:.2g} px at 95 % of the points: improve the "
                    "image, or be content with less",
                    options.largest_subset_px, options.wanted_sigma_px));
  } else if (wanted > options.subset_px) {
    advice.push_back(fmt::format("for {:.2g} px at 95 % of the points take --subset {}",
                                 options.wanted_sigma_px, wanted));
  }
}

}  // namespace plumbline::internal
