#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>

#include "calib/image.h"
#include "match/internal/subset_search.h"

namespace plumbline::internal {

struct FftPeak {
  Eigen::Vector2d displacement_px{0, 0};
  double zncc = 0;
  double second_zncc = 0;  // of the best place that is not beside the first
};

// Searches templates of one size in the whole of an image: the numerator of the ZNCC is a
// cross-correlation by FFT, its denominator comes from running sums (Lewis, "Fast normalized
// cross-correlation", Vision Interface 1995); for a template cut by a mask from the correlation of
// its weights with the image and its square. In float, by FFTW. Find() may be called from many
// threads; the answers do not depend on it.
class FftCorrelator {
 public:
  FftCorrelator(const Image<float>& deformed, int radius_px);
  ~FftCorrelator();

  // search_px: largest displacement along x or y; 0: any. None where no
  // window has contrast or the maximum lies on the border.
  std::optional<FftPeak> Find(const SubsetTemplate& subset, int search_px) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace plumbline::internal
