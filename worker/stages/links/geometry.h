#pragma once
// Triangles of a scene, as those who divide them into vertices see them.

#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>

#include "kernels/scene_layout.h"
#include "worker/stages/vectors.h"

namespace gleaner::worker {

using Vec = std::array<double, 3>;

// Nodes at one place are one vertex where their normals agree to half a degree.
constexpr double kSameNormal = 0.99996;

inline Vec vec(const float* p) { return {p[0], p[1], p[2]}; }

struct Triangle {
  explicit Triangle(const float* row)
      : p{vec(row + TRIANGLE_P0), vec(row + TRIANGLE_P1), vec(row + TRIANGLE_P2)},
        n{vec(row + TRIANGLE_N0), vec(row + TRIANGLE_N1), vec(row + TRIANGLE_N2)} {
    std::memcpy(&material, row + TRIANGLE_MATERIAL, 4);
    const Vec normal = cross(p[1] - p[0], p[2] - p[0]);
    area = 0.5 * std::sqrt(dot(normal, normal));
    geometric = unit(normal);
  }
  Vec normal_at(double b1, double b2) const {
    const Vec normal = n[0] * (1 - b1 - b2) + n[1] * b1 + n[2] * b2;
    return dot(normal, normal) > 1e-12 ? unit(normal) : geometric;
  }

  std::array<Vec, 3> p, n;
  std::uint32_t material = 0;
  double area = 0;
  Vec geometric{};
};

// Words or floats as a key.
struct WordsHash {
  template <typename Word, std::size_t size>
  std::size_t operator()(const std::array<Word, size>& key) const {
    std::uint64_t h = 0x9e3779b97f4a7c15ull;
    for (const Word word : key) h = (h ^ std::bit_cast<std::uint32_t>(word)) * 0xff51afd7ed558ccdull, h ^= h >> 32;
    return h;
  }
};

// Place k of n between two corners: the same float for every triangle that has this edge.
inline std::array<float, 3> on_edge(Vec a, Vec b, std::uint32_t k, std::uint32_t n) {
  if (b < a) {
    std::swap(a, b);
    k = n - k;
  }
  const Vec p = k == n ? b : a + (b - a) * (static_cast<double>(k) / n);
  return {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
}

}  // namespace gleaner::worker
