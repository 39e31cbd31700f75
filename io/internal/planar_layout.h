#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "io/internal/point_layout.h"
#include "io/internal/series_contents.h"
#include "io/planar_series.h"

// What a series of one camera holds, and how its frames lie in the journal.
namespace plumbline::internal {

template <>
struct OptionalContents<PlanarContents> {
  static constexpr std::array<OptionalContent<PlanarContents>, 2> list = {{
      {"gradient_covariance", "/displacement/gradient_covariance",
       &PlanarContents::gradient_covariance},
      {"strain", "/strain", &PlanarContents::strain},
  }};
};

// Places of the groups in PlanarPoints().groups.
enum PlanarGroup : std::uint8_t { kPlanarDisplacement, kPlanarStrain, kPlanarGroupCount };

// Of points: /displacement, /strain.
const PointLayout& PlanarPoints();

SeriesShape PlanarShape(ImageSize grid, const PlanarContents& contents);

// Compresses with all threads; the bytes do not depend on their number. Throws
// std::invalid_argument when an image does not fit the shape.
std::vector<std::uint8_t> EncodePlanarFrame(const PlanarSeriesFrame& frame,
                                            const SeriesShape& shape);

// `chunks` point into `bytes`. Throws std::runtime_error on what EncodePlanarFrame() did not write.
FrameRecord<PlanarSeriesFrame> DecodePlanarFrame(std::span<const std::uint8_t> bytes,
                                                 const SeriesShape& shape);

}  // namespace plumbline::internal
