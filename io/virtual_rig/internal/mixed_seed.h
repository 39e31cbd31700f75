#pragma once

#include <cstdint>
#include <initializer_list>

namespace plumbline::internal {

// One well-mixed seed from several numbers (the finaliser of SplitMix64: Steele, Lea and Flood,
// "Fast splittable pseudorandom number generators", OOPSLA 2014).
inline std::uint64_t MixedSeed(std::initializer_list<std::uint64_t> parts) {
  std::uint64_t z = 0;
  for (const std::uint64_t part : parts) {
    z += part + 0x9e3779b97f4a7c15ULL;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    z ^= z >> 31;
  }
  return z;
}

}  // namespace plumbline::internal
