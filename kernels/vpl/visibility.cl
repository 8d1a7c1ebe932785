// Which lights each point (or point cluster) sees, as bits. Stage kind "vpl_visibility"; "vpl_shade" for points that
// query every light.
//
//   for each point
//     vpl_visibility_cutoff   a share of the mean contribution of the lights, unshadowed
//     vpl_visibility_rays     a ray to each light, unless the two face away from each other or the light cannot
//     contribute
//                             as much as the cutoff
//     trace                   any hit
//     visibility_pack         answers -> bits
#include "kernels/instances.h"
#include "kernels/transport/visibility.h"
#include "kernels/vpl/geometry.h"
#include "kernels/wide.h"

// Of `count` points from point_base on; a multiple of 32 lights.
kernel WIDE void vpl_visibility_cutoff(global const float* restrict points, uint point_base, uint count,
                                       global const float* restrict lights, uint width, float clamp_to, float share,
                                       global float* restrict cutoff) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(points, ((vu)point_base + min(lane, (vu)(count - 1u))) * POINT_WORDS, w);
  v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL);
  vf sum = zero_f();
  for (uint k = 0; k < width; ++k) {
    global const float* light = lights + VPL_WORDS * k;
    vf at_point, side, inverse;
    vf g = geometry_of(light, p, n, (vf)clamp_to, &at_point, &side, &inverse);
    sum += g * light_luminance(light);
  }
  // A point on a light, without a bound, queries all.
  store_f(cutoff + first_lane, 0, pick(zero_f(), sum * (share / (float)width), sum < (vf)INFINITY));
}

// Rays from points to lights: `rows` points, each queries `width` lights (a multiple of 32) from its own first one
// on; ray r is point r / width, light r % width of it. Clusters of points and of lights are judged by the cones and
// spheres that hold their members. A triangle has triangle_words words, more in some scenes than in others: this
// program is one for all. So are `instances`, which are read where the scene is `instanced`. `left_out`: for each row,
// how many pairs face away, then how many contribute too little.
kernel WIDE void vpl_visibility_rays(global const float* restrict triangles, uint triangle_words,
                                     global const float* restrict instances, uint instanced,
                                     global const float* restrict points, global const uint* restrict chosen,
                                     uint listed, global const float* restrict lights, uint width, uint slices,
                                     uint point_base, uint ray_base, uint count, global float* restrict rays,
                                     global uint* counters, global uint* left_out, global const float* restrict cutoff,
                                     float clamp_to) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  uint ray = ray_base + first_lane;
  uint row = ray / width;  // of one point in all lanes: width is a multiple of 32
  uint point = listed ? chosen[row] : point_base + row;
  vi active = all_lanes();
  if (point == GLEANER_NONE) {
    active = no_lanes();
    point = 0u;
  }
  // A point's sample looks at a slice of its own (vpl_camera_rays).
  uint slice = slices > 1u ? (point >> 4) & (slices - 1u) : 0u;
  vu light = (vu)(slice * width + (ray - row * width)) + lane_index();
  global const float* p_words = points + POINT_WORDS * point;
  uint triangle = ((global const uint*)p_words)[POINT_TRIANGLE];
  active = active & ((vu)triangle != GLEANER_NONE);
  vf l[16];
  vu at = pick_u((vu)0u, light, active) * VPL_WORDS;
  load_words(lights, at, l);
  active = active & ((l[VPL_FLUX] > zero_f()) | (l[VPL_FLUX + 1u] > zero_f()) | (l[VPL_FLUX + 2u] > zero_f()));
  vf second[16];
  load_words(lights + 8u, at, second);  // words 8 to 23
  v3 p = uniform3(p_words[POINT_POSITION], p_words[POINT_POSITION + 1], p_words[POINT_POSITION + 2]);
  v3 n = uniform3(p_words[POINT_NORMAL], p_words[POINT_NORMAL + 1], p_words[POINT_NORMAL + 2]);
  v3 q = words3(l, VPL_POSITION);
  v3 d = sub3(q, p);
  vf d2 = dot3(d, d);
  vf inverse = one_f() / sqrt(d2);
  v3 w = scale3(d, inverse);
  // The cosine a member could have at best: the cone's sine more, and the members' sphere seen from the other end.
  vf cone_p = (vf)p_words[POINT_COS], cone_q = second[VPL_COS - 8u];
  vf reach = second[VPL_RADIUS - 8u] * inverse;
  vf at_point = dot3(n, w) + safe_sqrt(one_f() - cone_p * cone_p) + reach;
  vf at_light = -dot3(words3(l, VPL_NORMAL), w) + safe_sqrt(one_f() - cone_q * cone_q) + reach;
  vi facing = (at_point > zero_f()) & (at_light > zero_f()) & (d2 > zero_f());
  // Upper bound of a member's contribution: as near as the members' sphere comes.
  vf nearest = max_f(one_f() - reach, zero_f());
  vf most = min_f(min_f(at_point, one_f()) * min_f(at_light, one_f()) * inverse * inverse / (nearest * nearest),
                  (vf)clamp_to) *
            luminance(words3(l, VPL_FLUX));
  vi enough = most > (vf)cutoff[row];
  uint away, little, queried;
  rank_lanes(active & none(facing), &away);
  active = active & facing;
  rank_lanes(active & none(enough), &little);
  active = active & enough;
  rank_lanes(active, &queried);
  if (away) atomic_add(left_out + 2u * row, away);
  if (little) atomic_add(left_out + 2u * row + 1u, little);
  if (queried) atomic_add(counters, queried);
  uint t_row = triangle == GLEANER_NONE ? 0u : triangle;
  global const float* t = triangles + (ulong)triangle_words * t_row;
  v3 p0 = uniform3(t[TRIANGLE_P0], t[TRIANGLE_P0 + 1], t[TRIANGLE_P0 + 2]);
  v3 e1 = sub3(uniform3(t[TRIANGLE_P1], t[TRIANGLE_P1 + 1], t[TRIANGLE_P1 + 2]), p0);
  v3 e2 = sub3(uniform3(t[TRIANGLE_P2], t[TRIANGLE_P2 + 1], t[TRIANGLE_P2 + 2]), p0);
  v3 error;
  uint instance = 0u;
  if (instanced) {
    instance = triangle == GLEANER_NONE ? GLEANER_NONE : ((global const uint*)p_words)[POINT_INSTANCE];
    global const float* row = instances + (ulong)INSTANCE_WORDS * (instance + 1u);
    vf place[INSTANCE_SECOND];
    for (uint k = 0; k < INSTANCE_SECOND; ++k) place[k] = (vf)row[k];
    error = placed_error(place, e1, e2, p);
    e1 = place_vector(place, e1);
    e2 = place_vector(place, e2);
  } else {
    surface_point(p0, e1, e2, (vf)p_words[POINT_B1], (vf)p_words[POINT_B2], &error);
  }
  v3 start, direction;
  connect_points(p, error, normalize3(cross3(e1, e2)), q, words3(second, VPL_ERROR - 8u), words3(l, VPL_GEOMETRIC),
                 &start, &direction);
  active = active & finite3(direction) & finite3(start);
  set_visibility_ray(rays, block, start, direction, active, (vu)triangle, (vu)instance);
}
