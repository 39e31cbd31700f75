#include "fit/carcass_thickness.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/error.h"

namespace plumbline {

double CarcassThickness::At(double y) const {
  if (y_mm.empty()) return thickness_mm.front();
  if (!(y >= y_mm.front() && y <= y_mm.back())) return std::numeric_limits<double>::quiet_NaN();
  const auto above = std::lower_bound(y_mm.begin(), y_mm.end(), y);
  const auto k = static_cast<std::size_t>(above - y_mm.begin());
  if (k == 0) return thickness_mm.front();
  const double share = (y - y_mm[k - 1]) / (y_mm[k] - y_mm[k - 1]);
  return (1 - share) * thickness_mm[k - 1] + share * thickness_mm[k];
}

void CarcassThickness::Check() const {
  const bool constant = y_mm.empty() && thickness_mm.size() == 1;
  if (!constant && (y_mm.size() < 2 || y_mm.size() != thickness_mm.size())) {
    throw UsageError(
        "The carcass's thickness is one value, or a map of two or more places with one each.");
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
  Image<double> thickness(undeformed_in_rig_mm.size(), std::numeric_limits<double>::quiet_NaN());
  for (std::size_t i = 0; i < thickness.pixel_count(); ++i) {
    const double y_mm = axis.direction_in_rig().dot(undeformed_in_rig_mm.data()[i]);
    if (std::isfinite(y_mm)) thickness.data()[i] = carcass.At(y_mm);
  }
  return thickness;
}

}  // namespace plumbline
