#pragma once
// Photons on the host: what they pack into a word, as kernels/photon/pack.h reads it.

#include <array>
#include <cstdint>

namespace gleaner::worker {

inline constexpr float kFarthestPhoton = 1e18f;  // m: what lies farther away is no photon (kernels/photon_records.h)

// A unit vector, of octahedral coordinates of `width` bits each, x in the low ones.
std::array<float, 3> unpack_unit(std::uint32_t packed, unsigned width);
// m.
float unpack_length(std::uint32_t code);

}  // namespace gleaner::worker
