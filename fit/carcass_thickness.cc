#include "fit/carcass_thickness.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/error.h"

namespace plumbline {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Of a map at one of its entries.
double SlopeAt(const CarcassThickness& map, std::size_t k) {
  const std::vector<double>&y = map.y_mm, &t = map.thickness_mm;
  const auto secant = [&](std::size_t i) { return (t[i + 1] - t[i]) / (y[i + 1] - y[i]); };
  const std::size_t last = y.size() - 1;
  if (last == 1) return secant(0);
  if (k == 0 || k == last) {
    // Of the parabola through the three entries at this end, as far as it stays monotone.
    const std::size_t here = k == 0 ? 0 : last - 1, next = k == 0 ? 1 : last - 2;
    const double h = y[here + 1] - y[here], g = y[next + 1] - y[next];
    const double slope = ((2 * h + g) * secant(here) - h * secant(next)) / (h + g);
    if (slope * secant(here) <= 0) return 0;
    return std::copysign(std::min(std::abs(slope), 3 * std::abs(secant(here))), slope);
  }
  const double before = secant(k - 1), after = secant(k);
  if (before * after <= 0) return 0;
  const double h = y[k] - y[k - 1], g = y[k + 1] - y[k];
  return 3 * (h + g) / ((2 * g + h) / before + (g + 2 * h) / after);
}

// Of the entry at or above a place within the map, not the first one.
std::size_t EntryAbove(const CarcassThickness& map, double y) {
  const auto above = std::lower_bound(map.y_mm.begin() + 1, map.y_mm.end(), y);
  return static_cast<std::size_t>(above - map.y_mm.begin());
}

template <typename T, typename Function>
Image<T> Over(const Image<Eigen::Vector3d>& undeformed_in_rig_mm, const WheelAxis& axis,
              const T& nowhere, const Function& at) {
  Image<T> values(undeformed_in_rig_mm.size(), nowhere);
  for (std::size_t i = 0; i < values.pixel_count(); ++i) {
    const double y_mm = axis.direction_in_rig().dot(undeformed_in_rig_mm.data()[i]);
    if (std::isfinite(y_mm)) values.data()[i] = at(y_mm);
  }
  return values;
}

}  // namespace

double CarcassThickness::At(double y) const {
  if (y_mm.empty()) return thickness_mm.front();
  if (!(y >= y_mm.front() && y <= y_mm.back())) return kNaN;
  const std::size_t k = EntryAbove(*this, y);
  const double width = y_mm[k] - y_mm[k - 1];
  const double u = (y - y_mm[k - 1]) / width, v = 1 - u;
  return v * v * (1 + 2 * u) * thickness_mm[k - 1] + u * u * (1 + 2 * v) * thickness_mm[k] +
         u * v * width * (v * SlopeAt(*this, k - 1) - u * SlopeAt(*this, k));
}

CarcassThickness CarcassThickness::AlongMode(int mode) const {
  CarcassThickness along = *this;
  const Eigen::VectorXd change = OfMode(mode);
  for (std::size_t i = 0; i < thickness_mm.size(); ++i) {
    along.thickness_mm[i] += change[static_cast<Eigen::Index>(i)];
  }
  return along;
}

Eigen::VectorXd CarcassThickness::OfMode(int mode) const {
  if (modes_mm.size() > 0) return modes_mm.col(mode);
  return sigma_mm * Eigen::VectorXd::Unit(static_cast<Eigen::Index>(thickness_mm.size()), mode);
}

// By differences: the curve's slopes hang on the entries beside an interval, one more on each side
// of it.
ThicknessShares CarcassThickness::SharesAt(double y) const {
  ThicknessShares shares;
  if (y_mm.empty()) {
    shares.count = 1;
    shares.share[0] = 1;
    return shares;
  }
  if (!std::isfinite(At(y))) return shares;
  constexpr double kStep_mm = 1e-4;
  const std::size_t above = EntryAbove(*this, y);
  shares.first = above < 2 ? 0 : above - 2;
  shares.count = static_cast<int>(std::min(y_mm.size(), above + 2) - shares.first);
  CarcassThickness moved{y_mm, thickness_mm};
  for (int k = 0; k < shares.count; ++k) {
    const auto at = static_cast<std::size_t>(k);
    double& entry = moved.thickness_mm[shares.first + at];
    const double here = entry;
    entry = here + kStep_mm;
    const double more = moved.At(y);
    entry = here - kStep_mm;
    shares.share[at] = (more - moved.At(y)) / (2 * kStep_mm);
    entry = here;
  }
  return shares;
}

double CarcassThickness::LeftOutAt(double y) const {
  constexpr double kShare = 0.25;
  if (y_mm.empty()) return 0;
  const double here = At(y);
  if (std::isnan(here)) return here;
  const std::size_t k = EntryAbove(*this, y);
  const double share = (y - y_mm[k - 1]) / (y_mm[k] - y_mm[k - 1]);
  return kShare * (here - (1 - share) * thickness_mm[k - 1] - share * thickness_mm[k]);
}

void CarcassThickness::Check() const {
  const bool constant = y_mm.empty() && thickness_mm.size() == 1;
  if (!constant && (y_mm.size() < 2 || y_mm.size() != thickness_mm.size())) {
    throw UsageError(
        "The carcass's thickness is one value, or a map of two or more places with one each.");
  }
  if (!(sigma_mm >= 0 && std::isfinite(sigma_mm))) {
    throw UsageError("The sigma of the carcass's thickness has to be 0 mm or more.");
  }
  const auto entries = static_cast<Eigen::Index>(thickness_mm.size());
  if ((!said_mm.empty() && said_mm.size() != thickness_mm.size()) ||
      (modes_mm.size() > 0 && (modes_mm.rows() != entries || modes_mm.cols() != entries))) {
    throw UsageError("The carcass's thickness has as many modes and said values as entries.");
  }
  for (std::size_t k = 0; k < thickness_mm.size(); ++k) {
    if (!(thickness_mm[k] >= 0 && std::isfinite(thickness_mm[k]))) {
      throw UsageError("The carcass's thickness has to be 0 mm or more everywhere.");
    }
    if (!constant && (!std::isfinite(y_mm[k]) || (k > 0 && !(y_mm[k] > y_mm[k - 1])))) {
      throw UsageError("The places of the carcass's thickness have to ascend.");
    }
  }
}

Image<double> ThicknessOver(const CarcassThickness& carcass,
                            const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                            const WheelAxis& axis) {
  carcass.Check();
  return Over(undeformed_in_rig_mm, axis, kNaN, [&](double y_mm) { return carcass.At(y_mm); });
}

const Image<double>& ThicknessAlong(std::size_t mode, std::size_t modes,
                                    const Image<double>& thickness_mm,
                                    std::span<const Image<double>> along_carcass) {
  const std::size_t others = modes - along_carcass.size();
  return mode < others ? thickness_mm : along_carcass[mode - others];
}

Image<ThicknessShares> ThicknessSharesOver(const CarcassThickness& carcass,
                                           const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                                           const WheelAxis& axis) {
  carcass.Check();
  return Over(undeformed_in_rig_mm, axis, ThicknessShares{},
              [&](double y_mm) { return carcass.SharesAt(y_mm); });
}

Image<double> ThicknessLeftOutOver(const CarcassThickness& carcass,
                                   const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                                   const WheelAxis& axis) {
  carcass.Check();
  return Over(undeformed_in_rig_mm, axis, kNaN,
              [&](double y_mm) { return carcass.LeftOutAt(y_mm); });
}

}  // namespace plumbline
