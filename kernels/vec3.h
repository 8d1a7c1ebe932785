// Three varying components, kept apart so that each is a whole vector register.
#ifndef GLEANER_KERNELS_VEC3_H
#define GLEANER_KERNELS_VEC3_H

#include "kernels/lanes.h"

typedef struct {
  vf x, y, z;
} v3;

FN v3 make3(vf x, vf y, vf z) {
  v3 r;
  r.x = x;
  r.y = y;
  r.z = z;
  return r;
}
FN v3 splat3(vf x) { return make3(x, x, x); }
FN v3 uniform3(float x, float y, float z) { return make3((vf)x, (vf)y, (vf)z); }
FN v3 add3(v3 a, v3 b) { return make3(a.x + b.x, a.y + b.y, a.z + b.z); }
FN v3 sub3(v3 a, v3 b) { return make3(a.x - b.x, a.y - b.y, a.z - b.z); }
FN v3 mul3(v3 a, v3 b) { return make3(a.x * b.x, a.y * b.y, a.z * b.z); }
FN v3 scale3(v3 a, vf s) { return make3(a.x * s, a.y * s, a.z * s); }
FN v3 mad3(v3 a, vf s, v3 b) { return make3(fma(a.x, s, b.x), fma(a.y, s, b.y), fma(a.z, s, b.z)); }
FN vf dot3(v3 a, v3 b) { return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z)); }
FN v3 cross3(v3 a, v3 b) { return make3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
FN v3 negate3(v3 a) { return make3(-a.x, -a.y, -a.z); }
FN vf length3(v3 a) { return sqrt(dot3(a, a)); }
// The zero vector stays zero.
FN v3 normalize3(v3 a) {
  vf l2 = dot3(a, a);
  return scale3(a, pick(zero_f(), one_f() / sqrt(l2), l2 > zero_f()));
}
FN v3 pick3(v3 otherwise, v3 where, vi m) {
  return make3(pick(otherwise.x, where.x, m), pick(otherwise.y, where.y, m), pick(otherwise.z, where.z, m));
}
FN vf max_component(v3 a) { return max_f(a.x, max_f(a.y, a.z)); }
FN vi finite3(v3 a) { return finite_f(a.x) & finite_f(a.y) & finite_f(a.z); }
FN v3 gather3(global const float* p, vu i) { return make3(gather_f(p, i), gather_f(p, i + 1u), gather_f(p, i + 2u)); }

FN void scatter3(global float* p, vu i, v3 v) {
  scatter_f(p, i, v.x);
  scatter_f(p + 1, i, v.y);
  scatter_f(p + 2, i, v.z);
}

// Of linear Rec. 709 colours.
FN vf luminance(v3 c) { return c.x * 0.2126f + c.y * 0.7152f + c.z * 0.0722f; }
FN float luminance_of(float r, float g, float b) { return 0.2126f * r + 0.7152f * g + 0.0722f * b; }

// Three words in a row of what load_words() gave, or for store_words().
FN v3 words3(const vf* words, uint first) { return make3(words[first], words[first + 1u], words[first + 2u]); }
FN void put_words3(vf* words, uint first, v3 v) {
  words[first] = v.x;
  words[first + 1u] = v.y;
  words[first + 2u] = v.z;
}

// Two unit vectors perpendicular to unit n (Duff et al. 2017, "Building an Orthonormal Basis, Revisited").
FN void basis3(v3 n, v3* s, v3* t) {
  vf sign = pick((vf)-1.0f, one_f(), n.z >= zero_f());
  vf a = (vf)-1.0f / (sign + n.z);
  vf b = n.x * n.y * a;
  *s = make3(one_f() + sign * n.x * n.x * a, sign * b, -sign * n.x);
  *t = make3(b, sign + n.y * n.y * a, -n.y);
}

#endif
