#pragma once
// Hemispherical harmonics (Gautron, Krivanek, Pattanaik & Bouatouch 2004, "A Novel Hemispherical Basis for Accurate and
// Efficient Rendering"): H_l^m(theta, phi) = K P_l^m(2 cos theta - 1) cos(m phi), and with sin(m phi) for negative m.
// Orthonormal over the hemisphere by solid angle.

#include <cstdint>
#include <span>

namespace gleaner::worker {

// Pairs (l, m) with l < order and 0 <= m <= l: pair l (l + 1) / 2 + m.
constexpr std::uint32_t harmonic_pairs(std::uint32_t order) { return order * (order + 1) / 2; }

// K P_l^m(2 z - 1) of all pairs at the cosine z, with the root of 2 where m > 0. `values`: harmonic_pairs(order).
void hemispherical_harmonics(std::uint32_t order, double z, std::span<double> values);

}  // namespace gleaner::worker
