#include "track/stored_matches.h"

#include <Eigen/Core>
#include <cstddef>

#include "calib/image.h"

namespace plumbline {
namespace {

// By way of an image of floats: g++ 12 -O2 leaves out a rounding that goes there and back at once.
void Round(Image<Eigen::Vector2d>* pixels) {
  Image<Eigen::Vector2f> stored(pixels->size(), Eigen::Vector2f::Zero());
  for (std::size_t i = 0; i < stored.pixel_count(); ++i) {
    stored.data()[i] = pixels->data()[i].cast<float>();
  }
  for (std::size_t i = 0; i < stored.pixel_count(); ++i) {
    pixels->data()[i] = stored.data()[i].cast<double>();
  }
}

}  // namespace

void RoundAsStored(StereoField* field) {
  Round(&field->left.displacement_px);
  Round(&field->right.displacement_px);
}

}  // namespace plumbline
