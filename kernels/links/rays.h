// Rays of elements: cosine-weighted, from points of their one-rings. Programs that include this file have the kernel
// links_rays.
#ifndef GLEANER_KERNELS_LINKS_RAYS_H
#define GLEANER_KERNELS_LINKS_RAYS_H

#include "kernels/links/mesh.h"
#include "kernels/wide.h"

// Rows of a block of 16 rays: the ray and its hit, then what the element's side of the link weighs.
#define ROW_WEIGHT RAY_HIT_ROWS
#define LINK_ROWS (RAY_HIT_ROWS + 1u)
// Rays begin within this part of the one-ring: what a vertex gets is interpolated, so that a mean over all of the ring
// would blur it, and be off at the ring's open side; from the vertex itself, in the corner of a room, rays would begin
// on the other wall.
#define LINK_REACH 0.25f

// Square to disc (Shirley & Chiu 1997), then to the hemisphere above it: cosine-weighted, and neighbours stay so.
FN v3 concentric_direction(vf u, vf v) {
  vf a = fma(u, (vf)2.0f, (vf)-1.0f), b = fma(v, (vf)2.0f, (vf)-1.0f);
  vi wide = fabs(a) > fabs(b);
  vf r = pick(b, a, wide);
  vf ratio = pick(zero_f(), pick(a, b, wide) / r, r != zero_f());
  vf turn = pick((vf)0.25f - 0.125f * ratio, 0.125f * ratio, wide);  // in turns, from -1/8 to 3/8
  vf s, c;
  sincos_2pi(turn - floor(turn), &s, &c);
  return make3(r * c, r * s, safe_sqrt(one_f() - r * r));
}

// Ray r of element first + e is number e * directions + r of `count`.
kernel WIDE void links_rays(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                            global const uint* restrict mesh, uint first, uint count, uint side,
                            global float* restrict rays) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint directions = parameters->directions;
  uint element = first + first_lane / directions;
  Mesh m = load_mesh(mesh);
  vi active = (vi)(element < m.elements ? all_lanes() : no_lanes());
  vu ray = (vu)(first_lane % directions) + lane_index();
  // Blocks of 4 x 4 neighbours in a square of side x side, turned for each vertex: its own place on a torus.
  vu tile = ray >> 4, within = ray & 15u;
  uint tiles = side / 4u;
  vu x = (tile % tiles) * 4u + (within & 3u), y = (tile / tiles) * 4u + (within >> 2);
  vu key = element_key(parameters->seed_low, parameters->seed_high, element, 0x47u);
  vf u = (to_f(x) + unit_float(hash_combine(key, (vu)1u)) * (float)side) / (float)side;
  vf v = (to_f(y) + unit_float(hash_combine(key, (vu)2u)) * (float)side) / (float)side;
  v3 above = concentric_direction(u - floor(u), v - floor(v));
  RingPoint at = random_ring_point(&m, element, LINK_REACH, key, ray);
  Vertex from = element_surface(scene, &at, element, active);
  v3 direction = from_frame(&from.frame, above);
  vf weight = left_above(scene, &from.surface, clamp_f(above.z, (vf)1e-6f, one_f()));
#ifdef NEED_BENT_NORMALS
  weight *= geometric_share(&from.frame, direction, above.z);
#endif
  v3 origin = offset_ray_origin(from.hit.p, from.hit.error, from.hit.geometric, direction);
  active = active & (weight > zero_f()) & (above.z > (vf)1e-6f) & finite3(origin) & finite3(direction);
  set_ray(rays, LINK_ROWS, block, origin, direction, pick((vf)-1.0f, (vf)INFINITY, active), from.primitive,
          hit_instance(&from.hit));
  set_row_u(rays, LINK_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_f(rays, LINK_ROWS, block, ROW_WEIGHT, pick(zero_f(), weight, active));
}

#endif
