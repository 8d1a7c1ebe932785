#pragma once
// What single records of a cache say of a place, on the host (Gautron et al. 2005, eq. 2 and 8). They count as in
// kernels/splat/shade.cl, which changes their light by the mean of all their gradients.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "worker/stages/splat/points.h"
#include "worker/stages/splat/scalar.h"
#include "worker/stages/splat/tangent_frame.h"

namespace gleaner::worker::splat {

using Color = std::array<double, 3>;

// CACHE_NARROW in the world.
inline TangentFrame::Vec narrow_of(const std::array<float, 3>& normal, const std::array<float, 2>& narrow) {
  return TangentFrame(normal).world(double{narrow[0]}, double{narrow[1]});
}

// Of a place by `d` from a record: `across` of splat_error().
inline float across_of(const std::array<float, 3>& normal, const std::array<float, 2>& narrow,
                       const std::array<float, 3>& d) {
  if (narrow[0] == 0 && narrow[1] == 0) return 0;
  const TangentFrame::Vec axis = narrow_of(normal, narrow);
  return static_cast<float>(d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2]);
}

// Whether a place by `d` from a record, in its frame, lies behind something that stands on its surface.
inline bool behind_something(const Clearance& clearance, const TangentFrame& frame, const std::array<float, 3>& d,
                             float slack) {
  const auto along = [&](const TangentFrame::Vec& axis) {
    return static_cast<float>(d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2]);
  };
  float away = 0;
  const float direction = splat_direction(along(frame.s), along(frame.t), &away);
  const auto before = std::min(static_cast<std::uint32_t>(direction), SPLAT_DIRECTIONS - 1);
  const float part = direction - static_cast<float>(before);
  const float one_over = clearance[before] * (1 - part) + clearance[(before + 1) & (SPLAT_DIRECTIONS - 1)] * part;
  return away * one_over > 1 + slack;
}

// w - 1 / a at a place of normal n; 0: the record does not reach there. `stretch`: how many times as far as a picture
// lets it; `past_walls`: also behind what stands on its surface.
inline double record_weight(const CacheRecord& record, const std::array<float, 3>& p, const std::array<float, 3>& n,
                            float stretch = 1, bool past_walls = false) {
  const float x = p[0] - record.position[0], y = p[1] - record.position[1], z = p[2] - record.position[2];
  const float accuracy = stretch * record.accuracy, most = accuracy * (1 + SPLAT_SLACK), reach = most * record.radius;
  if (!(x * x + y * y + z * z <= reach * reach)) return 0;
  const std::array<float, 3>& m = record.normal;
  const float error =
      splat_error(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], record.radius, across_of(m, record.narrow(), {x, y, z}));
  if (error > most || splat_is_hidden(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], SPLAT_MOST_DEPTH)) return 0;
  if (!past_walls && splat_stands_near(record.least_clear, reach) &&
      behind_something(record.clearance, TangentFrame(m), {x, y, z}, SPLAT_SLACK))
    return 0;
  const float least = 1 / accuracy;
  return std::max(1 / error - least, SPLAT_SLACK * least);
}

// E' by the record's gradients, W/m^2; below 0 where they carry it too far.
inline Color record_light(const CacheRecord& record, const std::array<float, 3>& p, const std::array<float, 3>& n) {
  const std::array<float, 3>& m = record.normal;
  Color light{};
  for (std::size_t c = 0; c < 3; ++c) {
    light[c] = record.irradiance[c];
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t i = (k + 1) % 3, j = (k + 2) % 3;
      light[c] += (double{m[i]} * n[j] - double{m[j]} * n[i]) * record.rotation[3 * c + k] +
                  (double{p[k]} - record.position[k]) * record.translation[3 * c + k];
    }
  }
  return light;
}

// Of what it says, as large as its noise, and of a sign of its own.
inline Color record_noise(const CacheRecord& record) {
  Color noise{};
  for (std::size_t c = 0; c < 3; ++c) noise[c] = double{record.noise()} * record.irradiance[c];
  return noise;
}

}  // namespace gleaner::worker::splat
