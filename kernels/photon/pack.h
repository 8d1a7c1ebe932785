// Unit vectors in few bits: octahedral coordinates (Cigolle et al. 2014, "A Survey of Efficient Representations for
// Independent Unit Vectors"). 16 + 16 bits are off by 4e-5 rad at most, 12 + 12 bits by 7e-4.
#ifndef GLEANER_KERNELS_PHOTON_PACK_H
#define GLEANER_KERNELS_PHOTON_PACK_H

#include "kernels/vec3.h"

FN vf sign_of(vf x) { return pick((vf)-1.0f, one_f(), x >= zero_f()); }

// x and y of the octahedron's folded-out square, `bits` each, x in the low ones. No bits above them are set.
FN vu pack_unit(v3 d, uint bits) {
  vf scale = one_f() / (fabs(d.x) + fabs(d.y) + fabs(d.z));
  vf x = d.x * scale, y = d.y * scale;
  vf folded_x = (one_f() - fabs(y)) * sign_of(x), folded_y = (one_f() - fabs(x)) * sign_of(y);
  x = pick(x, folded_x, d.z < zero_f());
  y = pick(y, folded_y, d.z < zero_f());
  vf most = (vf)(float)((1u << bits) - 1u);
  vu low = to_u(clamp_f(fma(x, 0.5f * most, 0.5f * most + 0.5f), zero_f(), most));
  vu high = to_u(clamp_f(fma(y, 0.5f * most, 0.5f * most + 0.5f), zero_f(), most));
  return low | (high << bits);
}

FN v3 unpack_unit(vu packed, uint bits) {
  uint mask = (1u << bits) - 1u;
  vf scale = (vf)(2.0f / (float)mask);
  vf x = fma(to_f(packed & mask), scale, (vf)-1.0f), y = fma(to_f((packed >> bits) & mask), scale, (vf)-1.0f);
  vf z = one_f() - fabs(x) - fabs(y);
  vf fold = max_f(-z, zero_f());
  x = x - fold * sign_of(x);
  y = y - fold * sign_of(y);
  return normalize3(make3(x, y, z));
}

// Lengths of 2^-16 to 2^16 m in 8 bits, off by 6 % at most: a float's exponent and the first 3 bits of its mantissa.
#define LENGTH_FIRST ((127u - 16u) << 3)

FN vu pack_length(vf length) {
  vu code = as_vu(max_f(length, zero_f())) >> 20;
  return min(max(code, (vu)LENGTH_FIRST) - LENGTH_FIRST, (vu)255u);
}

FN vf unpack_length(vu code) { return as_vf(((code + LENGTH_FIRST) << 20) | (1u << 19)); }

#endif
