#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string_view>

#include "calib/status.h"
#include "io/internal/point_layout.h"

// What the tables of both kinds of series have in common.
namespace plumbline::internal {

// A point that claims to be there and has no finite value is not there.
template <typename Value>
Status StatusOf(Status status, const Value& value) {
  return status == Status::kOk && !value.allFinite() ? Status::kFailedVerification : status;
}

// One number of a point: NaN where the point has none or it is infinite.
template <typename Scalar>
void PutValue(Scalar value, bool there, std::uint8_t* to) {
  const Scalar stored =
      there && std::isfinite(value) ? value : std::numeric_limits<Scalar>::quiet_NaN();
  std::memcpy(to, &stored, sizeof stored);
}

template <typename Vector>
void PutValues(const Vector& vector, bool there, std::uint8_t* to) {
  for (Eigen::Index k = 0; k < vector.size(); ++k) {
    PutValue(vector[k], there, to + static_cast<std::size_t>(k) * sizeof(vector[k]));
  }
}

inline constexpr std::array<std::string_view, 3> kPlaneTensorNames = {"xx", "yy", "xy"};
inline constexpr std::array<std::string_view, 2> kPrincipalNames = {"first", "second"};
inline constexpr ComponentAxis kPlaneTensor{"component", kPlaneTensorNames};
inline constexpr std::array<std::string_view, 3> kUvTensorNames = {"uu", "uv", "vv"};
inline constexpr std::array<std::string_view, 4> kGradientNames = {"du/dx", "du/dy", "dv/dx",
                                                                   "dv/dy"};
inline constexpr std::array<std::string_view, 6> kStrainTensorNames = {"xx xx", "xx yy", "xx xy",
                                                                       "yy yy", "yy xy", "xy xy"};
inline constexpr ComponentAxis kUvTensor{"covariance_component", kUvTensorNames};
inline constexpr ComponentAxis kGradient{"gradient_component", kGradientNames};
inline constexpr ComponentAxis kStrainTensor{"covariance_component", kStrainTensorNames};
inline constexpr ComponentAxis kPrincipals{"principal_component", kPrincipalNames};

inline constexpr std::string_view kStatusLongName = "why there is no value here, or ok";
inline constexpr std::string_view kPrincipalLongName = "principal strains, the larger one first";

// long_name of uncertainties, of points and of records.
inline constexpr std::string_view kRandomSigma = "standard deviation from independent noise";
inline constexpr std::string_view kCalibrationSigma = "standard deviation from the calibration";
inline constexpr std::string_view kCombinedSigma =
    "standard deviation, random and calibration parts combined in quadrature";

}  // namespace plumbline::internal
