#include "io/internal/frame_packer.h"

#include "io/internal/planar_tables.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_tables.h"

namespace plumbline::internal {

std::unique_ptr<FramePacker> MakeFramePacker(hid_t file, const SeriesShape& shape) {
  return IsPlanar(file) ? MakePlanarPacker(file, shape) : MakeStereoPacker(file, shape);
}

}  // namespace plumbline::internal
