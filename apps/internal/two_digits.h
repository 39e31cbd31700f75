#pragma once

#include <string>

namespace plumbline::internal {

// The size of an error as people write it: two significant digits, without an exponent where that
// can be read ("0.000031", "0.10", "85", "920").
[[nodiscard]] std::string TwoDigits(double size);

// A value with what it may be off by, of noise and of the calibration: "18.003 +- 0.016 +- 0.036";
// an error that is not finite is left out. The value has the decimals of the first error that is
// there (GUM, JCGM 100:2008, 7.2.6), `fewest` where none is.
[[nodiscard]] std::string WithErrors(double value, double random, double calibration,
                                     int fewest = 0);

}  // namespace plumbline::internal
