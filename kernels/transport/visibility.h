// Visibility: rays between points of surfaces, and their answers as bits.
//
//   connect_points        the segment between two points, moved off both surfaces
//   set_visibility_ray    its any-hit query, in a block of VISIBILITY_ROWS rows
//   trace                 any hit
//   visibility_pack       answers of 32 rays in a row -> a word; every program that includes this file has the kernel
//
// Include it where a method asks which points see each other. Light samples of paths have shadow rays of their own
// (kernels/path.cl), since they carry what they would add.
#ifndef GLEANER_KERNELS_TRANSPORT_VISIBILITY_H
#define GLEANER_KERNELS_TRANSPORT_VISIBILITY_H

#include "kernels/path_layout.h"

// From p to q, whose triangles have these rounding bounds and normals. The query's own rounding grows with the
// distance, as in sample_light().
FN void connect_points(v3 p, v3 p_error, v3 p_geometric, v3 q, v3 q_error, v3 q_geometric, v3* start, v3* direction) {
  v3 d = sub3(q, p);
  const vf unit = (vf)(16.0f * 5.9604645e-8f);
  q_error = add3(q_error, make3(unit * fabs(d.x), unit * fabs(d.y), unit * fabs(d.z)));
  *start = offset_ray_origin(p, p_error, p_geometric, d);
  *direction = sub3(offset_ray_origin(q, q_error, q_geometric, negate3(d)), *start);
}

// `source`, `instance`: what the rays leave (set_ray). Inactive lanes ask nothing.
FN void set_visibility_ray(global float* rays, uint block, v3 start, v3 direction, vi active, vu source, vu instance) {
  set_ray(rays, VISIBILITY_ROWS, block, start, direction, pick((vf)-1.0f, (vf)SHADOW_FAR, active), source, instance);
}

// Answers to bits: word first + k of `bits` gets those of rays 32 k to 32 k + 31 of this launch.
kernel void visibility_pack(global const float* restrict rays, uint words, uint first, global uint* restrict bits) {
  uint word = (uint)get_global_id(0);
  if (word >= words) return;
  uint value = 0u;
  for (uint part = 0; part < 2u; ++part) {
    global const float* far = rays + (ulong)16u * (VISIBILITY_ROWS * (2u * word + part) + ROW_FAR);
    for (uint k = 0; k < 16u; ++k) value |= far[k] > 0.0f ? 1u << (16u * part + k) : 0u;
  }
  bits[first + word] = value;
}

#endif
