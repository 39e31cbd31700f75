#include "track/carcass_modes.h"

#include "track/internal/still_modes.h"

namespace plumbline {

WheelReference WithCarcassModes(WheelReference wheel, const CarcassThickness& carcass) {
  carcass.Check();
  if (carcass.mode_count() > 0) {
    internal::AppendStillModes(carcass.mode_count(), "the carcass", &wheel);
  }
  return wheel;
}

}  // namespace plumbline
