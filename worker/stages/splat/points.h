#pragma once
// Rows of kernels/splat_records.h on the host.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>

#include "kernels/splat_records.h"

namespace gleaner::worker {

struct SplatPoint {
  std::array<float, 3> position, normal, geometric;
  std::array<float, 3> factor;  // of a place: its radius, accuracy and spacing
  float footprint;              // 0: no point
  std::uint32_t table;
  float row;
  std::uint32_t key;
  bool exists() const { return footprint > 0; }
  // `table` holds both (kernels/splat/level.h).
  std::uint32_t albedo_table() const {
    return (table & SPLAT_TABLE_BITS) == SPLAT_TABLE_BITS ? GLEANER_NONE : table & SPLAT_TABLE_BITS;
  }
  std::uint32_t level() const { return (table ^ albedo_table()) >> SPLAT_LEVEL_SHIFT; }
};
static_assert(sizeof(SplatPoint) == SPLAT_POINT_WORDS * 4);

// CACHE_CLEARANCE.
using Clearance = std::array<float, SPLAT_DIRECTIONS>;
// CACHE_LEAST_CLEAR.
inline float least_clear(const Clearance& clearance) { return std::ranges::max(clearance); }

// A row of "splat_select". Of its point, `factor` has the radius, the accuracy and the mean distance.
struct SplatPlace {
  SplatPoint point;
  std::array<float, 2> narrow;
  std::uint32_t shaped, reserved;
  Clearance clearance;
};
static_assert(sizeof(SplatPlace) == SPLAT_PLACE_WORDS * 4);

struct CacheRecord {
  std::array<float, 3> position, normal;
  float radius;
  std::array<float, 3> irradiance;
  std::array<float, 9> rotation, translation;  // a colour after the other
  float accuracy;
  std::uint32_t level;
  std::array<float, 2> spare;
  std::array<float, 3> hessian;  // CACHE_HESSIAN, or CACHE_NARROW and nothing
  float least_clear;             // CACHE_LEAST_CLEAR
  Clearance clearance;
  float noise() const { return spare[0]; }                                  // CACHE_NOISE
  std::array<float, 2> narrow() const { return {hessian[0], hessian[1]}; }  // of a merged record
};
static_assert(sizeof(CacheRecord) == CACHE_WORDS * 4);

inline std::uint32_t splat_tiles(std::uint32_t pixels) { return (pixels + SPLAT_TILE - 1) / SPLAT_TILE; }

inline float distance(const std::array<float, 3>& a, const std::array<float, 3>& b) {
  float squared = 0;
  for (std::size_t k = 0; k < 3; ++k) squared += (a[k] - b[k]) * (a[k] - b[k]);
  return std::sqrt(squared);
}

// The box about points; empty as long as none was added.
struct PointBox {
  std::array<float, 3> lower = filled(std::numeric_limits<float>::infinity()), upper = filled(-lower[0]);

  void add(const std::array<float, 3>& p) {
    for (std::size_t k = 0; k < 3; ++k) {
      lower[k] = p[k] < lower[k] ? p[k] : lower[k];
      upper[k] = p[k] > upper[k] ? p[k] : upper[k];
    }
  }
  void add(const PointBox& other) {
    if (!other.empty()) add(other.lower), add(other.upper);
  }
  bool empty() const { return lower[0] > upper[0]; }
  // Whether a sphere reaches it; a little more than that, for rounding.
  bool meets(const std::array<float, 3>& center, float radius) const {
    return squared_distance(center) <= radius * radius * 1.01f;
  }
  float distance(const std::array<float, 3>& p) const { return std::sqrt(squared_distance(p)); }

 private:
  float squared_distance(const std::array<float, 3>& p) const {
    float squared = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      const float below = lower[k] - p[k], above = p[k] - upper[k];
      const float off = below > 0 ? below : above > 0 ? above : 0;
      squared += off * off;
    }
    return squared;
  }
  static std::array<float, 3> filled(float value) { return {value, value, value}; }
};

}  // namespace gleaner::worker
