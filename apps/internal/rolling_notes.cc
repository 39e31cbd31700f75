#include "apps/internal/rolling_notes.h"

#include <fmt/format.h>

#include <cmath>

namespace plumbline::internal {

std::string DelayNote(const RightDelayEstimate& estimate, const RightDelay& used) {
  constexpr double kBeyond = 4, kMs = 1e3;
  std::string note = fmt::format(
      "By the images the right camera exposes {:.4f} ms later than the left one, sigma {:.2g}",
      kMs * estimate.value_s, kMs * estimate.sigma_s);
  if (std::abs(estimate.value_s - used.value_s) >
      kBeyond * std::hypot(estimate.sigma_s, used.sigma_s)) {
    note += fmt::format(
        ", but {:g} ms are taken out: heights and deflection are off by the rest (see "
        "--right-delay)",
        kMs * used.value_s);
  }
  return note + ".";
}

std::vector<std::string> CarcassNotes(const RollingContact& contact, double middle_y_mm) {
  std::vector<std::string> notes;
  const CarcassThickness& carcass = contact.carcass;
  const CarcassCheck& check = contact.carcass_check;
  const auto place = [&](double y_mm) {
    return fmt::format("{:.0f} mm from the middle of the tread", y_mm - middle_y_mm);
  };
  if (check.contradicts) {
    notes.push_back(fmt::format(
        "What touches the ground contradicts the thickness of the carcass: {} it is {:.2f} mm {} "
        "than --carcass says, but for what tilts the ground, and the contact patch is wrong: {}.",
        place(check.at_y_mm), std::abs(check.most_mm), check.most_mm > 0 ? "thicker" : "thinner",
        carcass.y_mm.empty()
            ? "give the thickness by place across the tread, with its --carcass-sigma"
        : carcass.sigma_mm > 0 ? "give a larger --carcass-sigma"
                               : "give --carcass-sigma, with which the contact corrects it"));
  }
  if (carcass.modes_mm.size() == 0) return notes;
  std::size_t most = 0;
  const auto corrected = [&](std::size_t k) {
    return carcass.thickness_mm[k] - carcass.said_mm[k];
  };
  for (std::size_t k = 0; k < carcass.y_mm.size(); ++k) {
    if (std::abs(corrected(k)) > std::abs(corrected(most))) most = k;
  }
  notes.push_back(fmt::format(
      "What touches the ground corrects the thickness of the carcass by up to {:.3f} mm ({}).",
      corrected(most), place(carcass.y_mm[most])));
  return notes;
}

}  // namespace plumbline::internal
