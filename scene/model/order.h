#pragma once
// Orders and numbers that depend on their arguments alone.

#include <array>
#include <cstdint>

namespace gleaner::scene {

// The low ten bits of three numbers, interleaved: places near each other on a grid have codes near each other.
inline std::uint32_t morton(const std::array<std::uint32_t, 3>& cell) {
  std::uint32_t code = 0;
  for (unsigned k = 0; k < 3; ++k) {
    std::uint32_t x = cell[k] & 0x3ffu;
    x = (x | (x << 16)) & 0x030000ffu;
    x = (x | (x << 8)) & 0x0300f00fu;
    x = (x | (x << 4)) & 0x030c30c3u;
    x = (x | (x << 2)) & 0x09249249u;
    code |= x << k;
  }
  return code;
}

// A number in [0, 1) for each key (splitmix64's mixing function).
inline double unit_hash(std::uint64_t key) {
  key = (key ^ (key >> 30)) * 0xbf58476d1ce4e5b9ull;
  key = (key ^ (key >> 27)) * 0x94d049bb133111ebull;
  key ^= key >> 31;
  return static_cast<double>(key >> 11) * 0x1p-53;
}

}  // namespace gleaner::scene
