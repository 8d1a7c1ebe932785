// How far the surfaces about a place are. Stage kind "splat_select".
//
//   splat_probe_rays   cosine-weighted rays of places
//   trace              closest hits
//   splat_probe_sum    the harmonic mean of their lengths: R_k of eq. 2
#include "kernels/rays.h"
#include "kernels/sampling.h"
#include "kernels/splat_records.h"
#include "kernels/wide.h"

// Ray i is that of place i / rays. `rays` is a multiple of 16.
kernel WIDE void splat_probe_rays(global const float* restrict places, uint rays, uint count,
                                  global float* restrict hits) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  uint at = first_lane / rays;
  vf place[16];
  load_words(places, (vu)(at * SPLAT_POINT_WORDS), place);
  vu ray = (vu)(first_lane - at * rays) + lane_index();
  vf u0, u1;
  sample_pair(hash_combine(as_vu(place[SPLAT_KEY]), (vu)0x50524f42u), ray, 65536u, 0u, &u0, &u1);
  v3 d = sample_cosine(u0, u1);
  v3 n = words3(place, SPLAT_NORMAL), s, t;
  basis3(n, &s, &t);
  v3 direction = normalize3(add3(add3(scale3(s, d.x), scale3(t, d.y)), scale3(n, d.z)));
  v3 origin = words3(place, SPLAT_POSITION);
  // A bent normal's hemisphere reaches below the surface.
  vi asks = ((vu)first_lane + lane_index() < count) & (dot3(direction, words3(place, SPLAT_GEOMETRIC)) > zero_f()) &
            finite3(direction) & finite3(origin);
  set_ray(hits, RAY_HIT_ROWS, block, origin, direction, pick((vf)-1.0f, (vf)INFINITY, asks), (vu)GLEANER_NONE, (vu)0u);
  set_row_u(hits, RAY_HIT_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
}

// 0: no surface is in sight. `count`: of places.
kernel void splat_probe_sum(global const float* restrict hits, uint rays, uint count, global float* restrict radii) {
  uint place = (uint)get_global_id(0);
  if (place >= count) return;
  float nearness = 0.0f, asked = 0.0f;
  for (uint r = 0; r < rays; ++r) {
    uint ray = place * rays + r;
    uint row = (ray >> 4) * RAY_HIT_ROWS * 16u + (ray & 15u);
    float length = hits[row + ROW_FAR * 16u];
    asked += length > 0.0f ? 1.0f : 0.0f;
    if (((global const uint*)hits)[row + ROW_GEOMETRY * 16u] != GLEANER_NONE) nearness += 1.0f / max(length, 1e-20f);
  }
  radii[place] = nearness > 0.0f ? asked / nearness : 0.0f;
}
