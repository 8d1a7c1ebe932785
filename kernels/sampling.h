// Random numbers and what is made of them. A number depends on (key, sample, dimension) alone, where the key is a hash
// of (seed, pixel, sequence): Owen-scrambled Sobol points, two dimensions at a time, padded by shuffling the order of
// the samples anew for each pair (Burley 2020, "Practical Hash-based Owen Scrambling").
#ifndef GLEANER_KERNELS_SAMPLING_H
#define GLEANER_KERNELS_SAMPLING_H

#include "kernels/vec3.h"

// Finalizer of good avalanche (Wellons, "lowbias32").
FN vu hash_u(vu x) {
  x ^= x >> 16;
  x *= 0x7feb352du;
  x ^= x >> 15;
  x *= 0x846ca68bu;
  x ^= x >> 16;
  return x;
}
FN vu hash_combine(vu a, vu b) { return hash_u(a ^ (b * 0x9e3779b9u + 0x7f4a7c15u)); }

FN vu reverse_bits(vu x) {
  x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
  x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
  x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
  x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);
  return (x >> 16) | (x << 16);
}

// A permutation in which each bit depends on the lower ones alone (Laine & Karras 2011, constants by Vegdahl): Owen
// scrambling of bit-reversed numbers.
FN vu permute_upward(vu x, vu seed) {
  x ^= x * 0x3d20adeau;
  x += seed;
  x *= (seed >> 16) | 1u;
  x ^= x * 0x05526c56u;
  x ^= x * 0x53a22864u;
  return x;
}

// The second Sobol dimension, bit-reversed, of indices below 65536: its matrix is Pascal's triangle mod 2, whose rows
// are the subsets of each other's bits (Lucas), so that the product is a sum over supersets, four steps for sixteen
// bits.
FN vu sobol1_reversed(vu i) {
  i ^= (i >> 1) & 0x5555u;
  i ^= (i >> 2) & 0x3333u;
  i ^= (i >> 4) & 0x0f0fu;
  return i ^ ((i >> 8) & 0x00ffu);
}

// In [0, 1): 24 bits, so that 1 is never reached by rounding.
FN vf unit_float(vu x) { return to_f(x >> 8) * (vf)5.9604644775390625e-8f; }

// Two dimensions, stratified together over any aligned run of 2^k samples. `sample` < `samples`, a power of two, at
// most 65536.
FN void sample_pair(vu key, vu sample, uint samples, uint dimension, vf* u0, vf* u1) {
  vu h = hash_u(key ^ (vu)(dimension * 0x9e3779b9u));
  vu shuffled = reverse_bits(permute_upward(reverse_bits(sample), h)) & (vu)(samples - 1u);
  // A coordinate's leading bits come from its seed's low ones: what these are made of must differ, or u0 tells of u1.
  vu h0 = h * 0x2c1b3c6du;
  vu h1 = rotate(h, (vu)16u) * 0x6c50b47du;
  h0 ^= h0 >> 16;
  h1 ^= h1 >> 16;
  *u0 = unit_float(reverse_bits(permute_upward(shuffled, h0)));
  *u1 = unit_float(reverse_bits(permute_upward(sobol1_reversed(shuffled), h1)));
}

// sin and cos of 2 pi u for u in [0, 1]: exact reduction to an eighth, then minimax polynomials (error below 2e-7).
FN void sincos_2pi(vf u, vf* s, vf* c) {
  vf q = floor(u * 4.0f + 0.5f);
  vf x = (u - q * 0.25f) * 6.28318530717958648f;  // [-pi/4, pi/4]
  vf x2 = x * x;
  vf sx = x * fma(x2, fma(x2, fma(x2, (vf)-1.9515295891e-4f, (vf)8.3321608736e-3f), (vf)-1.6666654611e-1f), one_f());
  vf cx =
      fma(x2 * x2, fma(x2, fma(x2, (vf)2.443315711809948e-5f, (vf)-1.388731625493765e-3f), (vf)4.166664568298827e-2f),
          fma(x2, (vf)-0.5f, one_f()));
  vu k = to_u(q) & 3u;
  vi odd = (k & 1u) != 0u;
  vf a = pick(sx, cx, odd);
  vf b = pick(cx, sx, odd);
  *s = pick(a, -a, k >= 2u);
  *c = pick(b, -b, (k == 1u) | (k == 2u));
}

// Cosine-weighted direction about +z; pdf = z / pi.
FN v3 sample_cosine(vf u0, vf u1) {
  vf s, c;
  sincos_2pi(u0, &s, &c);
  vf r = sqrt(u1);
  return make3(r * c, r * s, safe_sqrt(one_f() - u1));
}

// The power heuristic with exponent 2 (Veach 1997, 9.2.3): the weight of a sample drawn with density `taken`, where the
// other way would have had density `other`. By their ratio: densities of far lights and of near-mirrors have squares
// that no float holds.
FN vf power_heuristic(vf taken, vf other) {
  vf ratio = other / taken;
  return one_f() / fma(ratio, ratio, one_f());
}

// Barycentric coordinates, uniform over a triangle (weights of the second and third corner).
FN void sample_triangle(vf u0, vf u1, vf* b1, vf* b2) {
  vf s = sqrt(u0);
  *b1 = s * (one_f() - u1);
  *b2 = s * u1;
}

#endif
