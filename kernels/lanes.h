// One source for two kinds of machine: a work-item handles LANES rays at once. On CPU devices LANES is 16 and a varying
// value is an OpenCL vector (measured on PoCL: the loop vectoriser gives up on such code, explicit vectors ran 14 times
// faster); on GPUs it is 1 and a varying value is a scalar. Masks are what comparisons give: all bits set (vector) or 1
// (scalar).
#ifndef GLEANER_KERNELS_LANES_H
#define GLEANER_KERNELS_LANES_H

#include "scene/model/device_types.h"

#define FN static inline __attribute__((always_inline))

// Large functions, some of which are called from several places. LLVM takes twice as long for kernels that hold a copy
// of each at every call, which run no faster on CPUs; kernels of scenes without textures, lobes and environments are
// small.
#if LANES == 16 &&                                                                                         \
    (defined(NEED_TEXTURES) || defined(NEED_SPECULAR) || defined(NEED_GLOSSY) || defined(NEED_METALLIC) || \
     defined(NEED_CLEARCOAT) || defined(NEED_SHEEN) || defined(NEED_ENVIRONMENT))
#define OUTLINED static __attribute__((noinline))
#else
#define OUTLINED FN
#endif

#if LANES == 16

typedef float16 vf;
typedef int16 vi;
typedef uint16 vu;

#define EACH_LANE(X) X(0) X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(a) X(b) X(c) X(d) X(e) X(f)

FN vu lane_index(void) { return (vu)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15); }
FN int any_lane(vi m) {
  int8 a = m.lo | m.hi;
  int4 b = a.lo | a.hi;
  int2 c = b.lo | b.hi;
  return (c.lo | c.hi) != 0;
}
// All bits that any lane has set.
FN uint any_bits(vu x) {
  uint8 a = x.lo | x.hi;
  uint4 b = a.lo | a.hi;
  uint2 c = b.lo | b.hi;
  return c.lo | c.hi;
}
FN vf gather_f(global const float* p, vu i) {
  return (vf)(p[i.s0], p[i.s1], p[i.s2], p[i.s3], p[i.s4], p[i.s5], p[i.s6], p[i.s7], p[i.s8], p[i.s9], p[i.sa],
              p[i.sb], p[i.sc], p[i.sd], p[i.se], p[i.sf]);
}
FN vu gather_u(global const uint* p, vu i) {
  return (vu)(p[i.s0], p[i.s1], p[i.s2], p[i.s3], p[i.s4], p[i.s5], p[i.s6], p[i.s7], p[i.s8], p[i.s9], p[i.sa],
              p[i.sb], p[i.sc], p[i.sd], p[i.se], p[i.sf]);
}
FN vf gather_c(constant float* p, vu i) {
  return (vf)(p[i.s0], p[i.s1], p[i.s2], p[i.s3], p[i.s4], p[i.s5], p[i.s6], p[i.s7], p[i.s8], p[i.s9], p[i.sa],
              p[i.sb], p[i.sc], p[i.sd], p[i.se], p[i.sf]);
}
FN void scatter_f(global float* p, vu i, vf v) {
#define ONE(k) p[i.s##k] = v.s##k;
  EACH_LANE(ONE)
#undef ONE
}
FN void scatter_u(global uint* p, vu i, vu v) {
#define ONE(k) p[i.s##k] = v.s##k;
  EACH_LANE(ONE)
#undef ONE
}
// Sixteen words a lane, from `table + word`: whole cache lines are read and turned in registers. A gather of each
// column would read sixteen lines a column (measured on Zen 5: gathers were most of the shading's time).
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#define SHUFFLE_PAIR(x, i, j, low, high) \
  {                                      \
    float16 p_ = x[i], q_ = x[j];        \
    x[i] = SHUFFLE(p_, q_, low);         \
    x[j] = SHUFFLE(p_, q_, high);        \
  }
#define LOW_1 0, 16, 2, 18, 4, 20, 6, 22, 8, 24, 10, 26, 12, 28, 14, 30
#define HIGH_1 1, 17, 3, 19, 5, 21, 7, 23, 9, 25, 11, 27, 13, 29, 15, 31
#define LOW_2 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29
#define HIGH_2 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31
#define LOW_4 0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27
#define HIGH_4 4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28, 29, 30, 31
#define LOW_8 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23
#define HIGH_8 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31
FN void transpose16(float16* x) {
  // clang-format off
#define STEP(i, j) SHUFFLE_PAIR(x, i, j, LOW_1, HIGH_1)
  STEP(0, 1) STEP(2, 3) STEP(4, 5) STEP(6, 7) STEP(8, 9) STEP(10, 11) STEP(12, 13) STEP(14, 15)
#undef STEP
#define STEP(i, j) SHUFFLE_PAIR(x, i, j, LOW_2, HIGH_2)
  STEP(0, 2) STEP(1, 3) STEP(4, 6) STEP(5, 7) STEP(8, 10) STEP(9, 11) STEP(12, 14) STEP(13, 15)
#undef STEP
#define STEP(i, j) SHUFFLE_PAIR(x, i, j, LOW_4, HIGH_4)
  STEP(0, 4) STEP(1, 5) STEP(2, 6) STEP(3, 7) STEP(8, 12) STEP(9, 13) STEP(10, 14) STEP(11, 15)
#undef STEP
#define STEP(i, j) SHUFFLE_PAIR(x, i, j, LOW_8, HIGH_8)
  STEP(0, 8) STEP(1, 9) STEP(2, 10) STEP(3, 11) STEP(4, 12) STEP(5, 13) STEP(6, 14) STEP(7, 15)
#undef STEP
  // clang-format on
}
// One whole vector at any float's address. PoCL's vload16 and vstore16 are written in pairs of floats, which its
// compiler puts together again: that was half of all it had to do.
#ifdef __clang__
typedef float unaligned16 __attribute__((ext_vector_type(16), aligned(4)));
FN vf load_vector(global const float* p) { return *(global const unaligned16*)p; }
FN void store_vector(global float* p, vf v) { *(global unaligned16*)p = v; }
#else
FN vf load_vector(global const float* p) { return vload16(0, p); }
FN void store_vector(global float* p, vf v) { vstore16(v, 0, p); }
#endif
FN void load_words(global const float* table, vu word, vf* out) {
  out[0] = load_vector(table + word.s0);
  out[1] = load_vector(table + word.s1);
  out[2] = load_vector(table + word.s2);
  out[3] = load_vector(table + word.s3);
  out[4] = load_vector(table + word.s4);
  out[5] = load_vector(table + word.s5);
  out[6] = load_vector(table + word.s6);
  out[7] = load_vector(table + word.s7);
  out[8] = load_vector(table + word.s8);
  out[9] = load_vector(table + word.s9);
  out[10] = load_vector(table + word.sa);
  out[11] = load_vector(table + word.sb);
  out[12] = load_vector(table + word.sc);
  out[13] = load_vector(table + word.sd);
  out[14] = load_vector(table + word.se);
  out[15] = load_vector(table + word.sf);
  transpose16(out);
}
// The inverse, in the lanes' order. `in` is lost.
FN void store_words(global float* table, vu word, vf* in) {
  transpose16(in);
  store_vector(table + word.s0, in[0]);
  store_vector(table + word.s1, in[1]);
  store_vector(table + word.s2, in[2]);
  store_vector(table + word.s3, in[3]);
  store_vector(table + word.s4, in[4]);
  store_vector(table + word.s5, in[5]);
  store_vector(table + word.s6, in[6]);
  store_vector(table + word.s7, in[7]);
  store_vector(table + word.s8, in[8]);
  store_vector(table + word.s9, in[9]);
  store_vector(table + word.sa, in[10]);
  store_vector(table + word.sb, in[11]);
  store_vector(table + word.sc, in[12]);
  store_vector(table + word.sd, in[13]);
  store_vector(table + word.se, in[14]);
  store_vector(table + word.sf, in[15]);
}
// Exclusive prefix sum of the mask's lanes; *total gets their number.
FN vu rank_lanes(vi m, uint* total) {
  vu x = select((vu)0, (vu)1, m);
  x += (vu)(0, x.s0, x.s1, x.s2, x.s3, x.s4, x.s5, x.s6, x.s7, x.s8, x.s9, x.sa, x.sb, x.sc, x.sd, x.se);
  x += (vu)(0, 0, x.s0, x.s1, x.s2, x.s3, x.s4, x.s5, x.s6, x.s7, x.s8, x.s9, x.sa, x.sb, x.sc, x.sd);
  x += (vu)(0, 0, 0, 0, x.s0, x.s1, x.s2, x.s3, x.s4, x.s5, x.s6, x.s7, x.s8, x.s9, x.sa, x.sb);
  x += (vu)(0, 0, 0, 0, 0, 0, 0, 0, x.s0, x.s1, x.s2, x.s3, x.s4, x.s5, x.s6, x.s7);
  *total = x.sf;
  return (vu)(0, x.s0, x.s1, x.s2, x.s3, x.s4, x.s5, x.s6, x.s7, x.s8, x.s9, x.sa, x.sb, x.sc, x.sd, x.se);
}
FN vf load_f(global const float* p, uint block) { return *(global const float16*)(p + 16u * block); }
FN vu load_u(global const uint* p, uint block) { return *(global const uint16*)(p + 16u * block); }
FN void store_f(global float* p, uint block, vf v) { *(global float16*)(p + 16u * block) = v; }
FN void store_u(global uint* p, uint block, vu v) { *(global uint16*)(p + 16u * block) = v; }
FN vf as_vf(vu x) { return as_float16(x); }
FN vu as_vu(vf x) { return as_uint16(x); }
FN vi as_vi(vu x) { return as_int16(x); }
FN vu as_unsigned(vi x) { return as_uint16(x); }
FN vf to_f(vu x) { return convert_float16(x); }
FN vf to_f_signed(vi x) { return convert_float16(x); }
FN vu to_u(vf x) { return convert_uint16(x); }
FN vi to_i(vf x) { return convert_int16(x); }

#elif LANES == 1

typedef float vf;
typedef int vi;
typedef uint vu;

FN vu lane_index(void) { return 0u; }
FN int any_lane(vi m) { return m != 0; }
FN uint any_bits(vu x) { return x; }
FN vf gather_f(global const float* p, vu i) { return p[i]; }
FN vu gather_u(global const uint* p, vu i) { return p[i]; }
FN vf gather_c(constant float* p, vu i) { return p[i]; }
FN void scatter_f(global float* p, vu i, vf v) { p[i] = v; }
FN void scatter_u(global uint* p, vu i, vu v) { p[i] = v; }
FN void load_words(global const float* table, vu word, vf* out) {
  for (uint k = 0; k < 16; ++k) out[k] = table[word + k];
}
FN void store_words(global float* table, vu word, vf* in) {
  for (uint k = 0; k < 16; ++k) table[word + k] = in[k];
}
FN vu rank_lanes(vi m, uint* total) {
  *total = m ? 1u : 0u;
  return 0u;
}
FN vf load_f(global const float* p, uint block) { return p[block]; }
FN vu load_u(global const uint* p, uint block) { return p[block]; }
FN void store_f(global float* p, uint block, vf v) { p[block] = v; }
FN void store_u(global uint* p, uint block, vu v) { p[block] = v; }
FN vf as_vf(vu x) { return as_float(x); }
FN vu as_vu(vf x) { return as_uint(x); }
FN vi as_vi(vu x) { return (int)x; }
FN vu as_unsigned(vi x) { return (uint)x; }
FN vf to_f(vu x) { return (float)x; }
FN vf to_f_signed(vi x) { return (float)x; }
FN vu to_u(vf x) { return (uint)x; }
FN vi to_i(vf x) { return (int)x; }

#else
#error "LANES must be 1 or 16"
#endif

// Values k to p + stride * k, for each lane at its own place. A loop: written out, the stores of a row's words were a
// quarter of a kernel's compile time (LLVM compares each store with each).
FN void scatter_words(global float* p, uint stride, vu at, const vf* values, uint count) {
  __attribute__((opencl_unroll_hint(1))) for (uint k = 0; k < count; ++k) scatter_f(p + stride * k, at, values[k]);
}

// select() by mask with the chosen value last, as in OpenCL: pick(otherwise, where, mask).
FN vf pick(vf otherwise, vf where, vi m) { return select(otherwise, where, m); }
FN vu pick_u(vu otherwise, vu where, vi m) { return select(otherwise, where, m); }
FN vi none(vi m) { return m == 0; }
// min and max that give the second argument where the first is NaN.
FN vf min_f(vf a, vf b) { return select(b, a, a < b); }
FN vf max_f(vf a, vf b) { return select(b, a, a > b); }
FN vf clamp_f(vf x, vf lower, vf upper) { return min_f(max_f(x, lower), upper); }
FN vf zero_f(void) { return (vf)0.0f; }
FN vf one_f(void) { return (vf)1.0f; }
FN vi all_lanes(void) { return zero_f() == zero_f(); }
FN vi no_lanes(void) { return zero_f() != zero_f(); }
FN vf safe_sqrt(vf x) { return sqrt(max_f(x, zero_f())); }
FN vi finite_f(vf x) { return fabs(x) <= (vf)3.402823466e38f; }

#endif
