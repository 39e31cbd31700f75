#pragma once

#include <cstddef>
#include <functional>

namespace plumbline {

// Calls body(begin, end) over pieces of [0, count), on all of TBB's threads. What it does to one
// index must not depend on another. What it throws is thrown here.
void ForEachRange(std::size_t count, const std::function<void(std::size_t, std::size_t)>& body);

// Calls body(i) for each i below count, likewise.
template <typename Body>
void ForEachIndex(std::size_t count, const Body& body) {
  ForEachRange(count, [&body](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i != end; ++i) body(i);
  });
}

}  // namespace plumbline
