// Rays lie in blocks of 16, row after row: the layout of Embree's RTCRay16 and RTCRayHit16, so that on CPU devices it
// traces the very buffers that kernels write and nothing is copied. Compiled by OpenCL C and by C++.
#ifndef GLEANER_KERNELS_RAYS_H
#define GLEANER_KERNELS_RAYS_H

#define RAY_BLOCK 16u
#define ROW_ORIGIN 0u
#define ROW_NEAR 3u
#define ROW_DIRECTION 4u
#define ROW_TIME 7u
#define ROW_FAR 8u
#define ROW_MASK 9u
#define ROW_SOURCE 10u  // RTCRay16::id: the triangle the ray leaves from, or 0xffffffff
#define ROW_FLAGS 11u   // the instance the ray leaves from, in scenes with instances; else 0
#define RAY_ROWS 12u
#define ROW_NORMAL 12u
#define ROW_U 15u
#define ROW_V 16u
#define ROW_PRIMITIVE 17u
#define ROW_GEOMETRY 18u  // 0xffffffff: nothing was hit
#define ROW_INSTANCE 19u  // in scenes with instances: the one that was hit, 0xffffffff where the triangle is of none
#define RAY_HIT_ROWS 20u

#ifdef __OPENCL_VERSION__
#include "kernels/vec3.h"

// Fields of the work-item's own rays. `block` counts work-items.
#if LANES == 16
FN uint row_index(uint block, uint rows, uint row) { return block * rows + row; }
FN vf row_f(global const float* rays, uint rows, uint block, uint row) { return load_f(rays, block * rows + row); }
FN vu row_u(global const float* rays, uint rows, uint block, uint row) {
  return load_u((global const uint*)rays, block * rows + row);
}
FN void set_row_f(global float* rays, uint rows, uint block, uint row, vf v) { store_f(rays, block * rows + row, v); }
FN void set_row_u(global float* rays, uint rows, uint block, uint row, vu v) {
  store_u((global uint*)rays, block * rows + row, v);
}
#else
FN uint row_index(uint i, uint rows, uint row) { return (i >> 4) * rows * 16u + row * 16u + (i & 15u); }
FN vf row_f(global const float* rays, uint rows, uint i, uint row) { return rays[row_index(i, rows, row)]; }
FN vu row_u(global const float* rays, uint rows, uint i, uint row) {
  return ((global const uint*)rays)[row_index(i, rows, row)];
}
FN void set_row_f(global float* rays, uint rows, uint i, uint row, vf v) { rays[row_index(i, rows, row)] = v; }
FN void set_row_u(global float* rays, uint rows, uint i, uint row, vu v) {
  ((global uint*)rays)[row_index(i, rows, row)] = v;
}
#endif
FN v3 row_3(global const float* rays, uint rows, uint block, uint row) {
  return make3(row_f(rays, rows, block, row), row_f(rays, rows, block, row + 1u), row_f(rays, rows, block, row + 2u));
}
FN void set_row_3(global float* rays, uint rows, uint block, uint row, v3 v) {
  set_row_f(rays, rows, block, row, v.x);
  set_row_f(rays, rows, block, row + 1u, v.y);
  set_row_f(rays, rows, block, row + 2u, v.z);
}
// Those rows that a query reads; a ray whose `far` is not positive asks nothing. `source`: the triangle that the ray
// leaves, GLEANER_NONE where it leaves none, and the `instance` that this is of (0 in scenes without instances).
FN void set_ray(global float* rays, uint rows, uint block, v3 origin, v3 direction, vf far, vu source, vu instance) {
  set_row_3(rays, rows, block, ROW_ORIGIN, origin);
  set_row_f(rays, rows, block, ROW_NEAR, zero_f());
  set_row_3(rays, rows, block, ROW_DIRECTION, direction);
  set_row_f(rays, rows, block, ROW_TIME, zero_f());
  set_row_f(rays, rows, block, ROW_FAR, far);
  set_row_u(rays, rows, block, ROW_MASK, (vu)0xffffffffu);
  set_row_u(rays, rows, block, ROW_SOURCE, source);
  set_row_u(rays, rows, block, ROW_FLAGS, instance);
}
// The same rows in private memory.
FN void put_ray(vf* rows, v3 origin, v3 direction, vf far, vu source, vu instance) {
  put_words3(rows, ROW_ORIGIN, origin);
  rows[ROW_NEAR] = zero_f();
  put_words3(rows, ROW_DIRECTION, direction);
  rows[ROW_TIME] = zero_f();
  rows[ROW_FAR] = far;
  rows[ROW_MASK] = as_vf((vu)0xffffffffu);
  rows[ROW_SOURCE] = as_vf(source);
  rows[ROW_FLAGS] = as_vf(instance);
}
// Where row 0 of ray `i` lies; add 16 for each row.
FN vu ray_address(vu i, uint rows) { return (i >> 4) * (rows * 16u) + (i & 15u); }

// One step of the float's last place away from zero or towards it, so that x moves the way of `sign`.
FN vf next_toward(vf x, vf sign) {
  vu bits = as_vu(x);
  vi up = (x >= zero_f()) == (sign > zero_f());
  vu moved = pick_u(bits - 1u, bits + 1u, as_vi(pick_u((vu)0u, (vu)0xffffffffu, up)));
  return pick(as_vf(moved), x, x == zero_f());
}

// A point of a triangle by the weights of its second and third corner, and by how much each component may be off the
// triangle's plane. Computed along the edges from the first corner, so that only the last sum is rounded to the
// coordinates' size; the edges' part of the bound has room for the roundings of a ray query that begins there, which
// are relative to the same edges. (Corners weighted by themselves are off by units of the coordinates: 0.25 m at 10^5
// m.)
FN v3 surface_point(v3 p0, v3 e1, v3 e2, vf b1, vf b2, v3* error) {
  const vf unit = (vf)5.9604645e-8f;  // 2^-24
  v3 p = add3(p0, mad3(e1, b1, scale3(e2, b2)));
  *error = make3(unit * fma(fabs(e1.x) + fabs(e2.x), (vf)16.0f, fabs(p.x)),
                 unit * fma(fabs(e1.y) + fabs(e2.y), (vf)16.0f, fabs(p.y)),
                 unit * fma(fabs(e1.z) + fabs(e2.z), (vf)16.0f, fabs(p.z)));
  return p;
}

// The origin of a ray that leaves `p` on the side of `direction`: moved along the triangle's normal by the bound of p's
// rounding error, component by component (pbrt-v4, 6.8.6), then by one unit in the last place. No scene-sized epsilon.
// A share of the largest component's error comes on top: in a plane through 0, across an axis, the bound itself is 0
// and an any-hit query would find the plane at distance 0 (it made the floors at y = 0 black).
FN v3 offset_ray_origin(v3 p, v3 error, v3 n, v3 direction) {
  vf d = fabs(n.x) * error.x + fabs(n.y) * error.y + fabs(n.z) * error.z + 0.03125f * max_component(error);
  d = pick(-d, d, dot3(n, direction) > zero_f());
  v3 o = mad3(n, d, p);
  return make3(next_toward(o.x, d * n.x), next_toward(o.y, d * n.y), next_toward(o.z, d * n.z));
}
#endif

#endif
