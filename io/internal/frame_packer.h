#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "io/internal/hdf5.h"
#include "io/internal/point_layout.h"

namespace plumbline::internal {

// Turns the records of a journal into the groups of a series. Each kind of series has one.
class FramePacker {
 public:
  virtual ~FramePacker() = default;

  // The next frame. Throws hdf5::Error, std::runtime_error on what is no record of a frame.
  virtual void Add(std::span<const std::uint8_t> payload) = 0;

  // Once all frames are there: what has one row a frame, and the axes. Throws hdf5::Error.
  virtual void Finish() = 0;
};

// Of the kind that the file, which holds the header, is of.
std::unique_ptr<FramePacker> MakeFramePacker(hid_t file, const SeriesShape& shape);

}  // namespace plumbline::internal
