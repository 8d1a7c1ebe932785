// How far the surfaces about a place are, and what stands near it. Stage kind "splat_select".
//
//   splat_probe_rays   cosine-weighted rays of places
//   trace              closest hits
//   splat_probe_sum    the harmonic mean of their lengths: R_k of eq. 2
//
//   splat_clear_rays   rays along their surfaces
//   trace              closest hits
//   splat_clearances   CACHE_CLEARANCE of kernels/splat_records.h
#include "kernels/rays.h"
#include "kernels/sampling.h"
#include "kernels/splat/weight.h"
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

// Ray i is that of place i / SPLAT_DIRECTIONS. A bent normal's tangents are taken along the surface.
kernel WIDE void splat_clear_rays(global const float* restrict places, uint count, global float* restrict hits) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vf place[16];
  load_words(places, (vu)(first_lane / SPLAT_DIRECTIONS * SPLAT_POINT_WORDS), place);
  vf turn = to_f((vu)(first_lane % SPLAT_DIRECTIONS) + lane_index()) * (4.0f / (float)SPLAT_DIRECTIONS);
  // The corners of the diamond are at turns 0 to 3.
  vf x = fabs(turn - (vf)2.0f) - one_f(), y = one_f() - fabs(turn - one_f());
  y = pick(y, turn - (vf)4.0f, turn > (vf)3.0f);
  v3 n = words3(place, SPLAT_NORMAL), geometric = words3(place, SPLAT_GEOMETRIC), s, t;
  basis3(n, &s, &t);
  v3 along = add3(scale3(s, x), scale3(t, y));
  along = normalize3(sub3(along, scale3(geometric, dot3(along, geometric))));
  v3 direction = normalize3(mad3(geometric, (vf)SPLAT_CLEAR_SLOPE, along));
  v3 origin = words3(place, SPLAT_POSITION);
  vi asks = ((vu)first_lane + lane_index() < count) & finite3(direction) & finite3(origin);
  set_ray(hits, RAY_HIT_ROWS, block, origin, direction, pick((vf)-1.0f, (vf)INFINITY, asks), (vu)GLEANER_NONE, (vu)0u);
  set_row_u(hits, RAY_HIT_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
}

// Of each of `count` rays.
kernel WIDE void splat_clearances(global const float* restrict places, global const float* restrict hits, uint count,
                                  global float* restrict clearances) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vf place[16];
  load_words(places, (vu)(first_lane / SPLAT_DIRECTIONS * SPLAT_POINT_WORDS), place);
  v3 s, t;
  basis3(words3(place, SPLAT_NORMAL), &s, &t);
  v3 to = scale3(row_3(hits, RAY_HIT_ROWS, block, ROW_DIRECTION), row_f(hits, RAY_HIT_ROWS, block, ROW_FAR));
  vf away = fabs(dot3(to, s)) + fabs(dot3(to, t));
  vi hit = ((vu)first_lane + lane_index() < count) & (row_u(hits, RAY_HIT_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE) &
           (away < (vf)1e30f);
  store_f(clearances, block, pick(zero_f(), one_f() / max_f(away, (vf)1e-20f), hit));
}
