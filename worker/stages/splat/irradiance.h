#pragma once
// A record's irradiance and its gradients, from light over strata of its hemisphere.

#include <array>
#include <cstdint>
#include <span>

#include "worker/stages/splat/points.h"

namespace gleaner::worker {

// Strata of equal cosine-weighted solid angle: `polar` rings from the normal on, of `azimuthal` strata each.
struct HemisphereGrid {
  std::uint32_t polar = 1, azimuthal = 16;
  std::uint32_t strata() const { return polar * azimuthal; }
};

// A ray through a stratum.
struct HemisphereSample {
  std::array<float, 3> radiance;  // W/(sr m^2), RGB
  float nearness;                 // 1/m: one over the distance to what it met; 0: nothing
  float x, y;                     // of its unit direction in the frame of the normal (basis3() of kernels/vec3.h)
};

// `place`: position, normal, radius and accuracy are taken from it. `samples`: one a stratum, ring by ring.
CacheRecord cache_record(const SplatPoint& place, const HemisphereGrid& grid,
                         std::span<const HemisphereSample> samples);

}  // namespace gleaner::worker
