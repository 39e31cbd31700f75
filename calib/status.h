#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace plumbline {

// Why a sample holds no value (then it is NaN), or kOk. Stored in files together with these names.
enum class Status : std::uint8_t {
  kOk = 0,
  kOutsideImage,
  kLowTexture,
  kNotConverged,
  kLowCorrelation,
  kEpipolarViolation,
  kBehindCamera,
  kOccluded,
  kMasked,
  kFailedVerification,
  kExtrapolated,
};

// Names in the order of the enumerators: kStatusNames[i] is that of static_cast<Status>(i).
inline constexpr std::array<std::string_view, 11> kStatusNames = {"ok",
                                                                  "outside_image",
                                                                  "low_texture",
                                                                  "not_converged",
                                                                  "low_correlation",
                                                                  "epipolar_violation",
                                                                  "behind_camera",
                                                                  "occluded",
                                                                  "masked",
                                                                  "failed_verification",
                                                                  "extrapolated"};

constexpr std::string_view Name(Status status) {
  return kStatusNames[static_cast<std::size_t>(status)];
}

}  // namespace plumbline
