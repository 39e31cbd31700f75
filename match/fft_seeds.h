#pragma once

#include <cstdint>
#include <vector>

#include "calib/image.h"
#include "match/correlation_seed.h"

namespace plumbline {

struct FftSeedOptions {
  int subset_px = 41;   // odd side of the square template at full resolution
  int spacing_px = 50;  // of the lattice on which seeds are looked for
  int search_px = 0;    // largest displacement along x or y that is looked for; 0: the whole image
  double min_zncc = 0.6;
  // Largest share of the best match's ZNCC that any other place of the search window may reach. A
  // pattern that repeats itself within the window has no seeds.
  double max_second_share = 0.85;
  // Smallest standard deviation of a template, in grey levels of 8 bits.
  double min_contrast_grey = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Looks for templates of the reference, on a lattice, in the deformed image by zero-normalised
// cross-correlation, with the displacement of each place unknown but its subset little turned and
// strained: up to about 10 degrees or 0.2.
//
// Coarse to fine: both images are halved until the longer side is about 300 px, where each template
// is searched in the whole of the deformed image by FFT (Lewis, "Fast normalized
// cross-correlation", Vision Interface 1995), and kept if no second place is nearly as good. What
// its neighbours bear out starts the search in the next finer image, in a window of a few pixels
// and with the motion's gradient as the neighbours show it; what is still unexplained is searched
// as a whole again, as far as time allows. Parts that move differently keep their own motion.
//
// mask: 0 where a pixel of the reference is not to be used; may be null. Templates cut by it use
// what is left, half of their pixels at least.
// Returns: seeds at the full resolution, sorted by place. Sub-pixel by a parabola: about 0.1 px.
//          The gradient is from the neighbours and 0 where there are too few. score is the ZNCC.
//          Nothing, where there is no texture in two directions.
// Throws:  UsageError from options.Check(); InputError when the images or the mask differ in size
//          or the subset does not fit into them.
// The result does not depend on the number of threads.
[[nodiscard]] std::vector<CorrelationSeed> FindFftSeeds(const GrayImage& reference,
                                                        const GrayImage& deformed,
                                                        const Image<std::uint8_t>* mask = nullptr,
                                                        const FftSeedOptions& options = {});

}  // namespace plumbline
