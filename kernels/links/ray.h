// One ray of an element, or of a point between its vertices: where it goes, what it weighs, and to which elements its
// hit links it.
#ifndef GLEANER_KERNELS_LINKS_RAY_H
#define GLEANER_KERNELS_LINKS_RAY_H

#include "kernels/links/lobes.h"
#include "kernels/links/mesh.h"
#include "kernels/wide.h"

// Rows of a block of 16 rays: the ray and its hit, then what the element's side of the link weighs.
#define ROW_WEIGHT RAY_HIT_ROWS
#define LINK_ROWS (RAY_HIT_ROWS + 1u)
// Point `ray` of side x side in a square. Blocks of 4 x 4 neighbours, turned for each vertex: its own place on a torus.
FN void grid_point(vu ray, uint side, vu key, vf* x_out, vf* y_out) {
  vu tile = ray >> 4, within = ray & 15u;
  uint tiles = side / 4u;
  // Small numbers' quotient, without the division of integers that CPUs have for no vector.
  vu row = to_u((to_f(tile) + (vf)0.5f) * (vf)(1.0f / (float)tiles)), column = tile - row * tiles;
  vu x = column * 4u + (within & 3u), y = row * 4u + (within >> 2);
  vf u = (to_f(x) + unit_float(hash_combine(key, (vu)1u)) * (float)side) / (float)side;
  vf v = (to_f(y) + unit_float(hash_combine(key, (vu)2u)) * (float)side) / (float)side;
  *x_out = u - floor(u);
  *y_out = v - floor(v);
}
// The same as a direction above the surface.
FN v3 grid_direction(vu ray, uint side, vu key) {
  vf u, v;
  grid_point(ray, side, key, &u, &v);
  return concentric_direction(u, v);
}

// What the lobe above the layer leaves of a ray, which goes `above` the surface.
FN vf layer_weight(const Scene* scene, const Vertex* from, v3 above) {
  return left_above(scene, &from->surface, clamp_f(above.z, (vf)1e-6f, one_f()));
}

// `weight`: what the light that it finds counts.
FN void send_ray(const Vertex* from, v3 above, vf weight, vi active, global float* rays, uint block) {
  v3 direction = from_frame(&from->frame, above);
#ifdef NEED_BENT_NORMALS
  weight *= geometric_share(&from->frame, direction, above.z);
#endif
  v3 origin = offset_ray_origin(from->hit.p, from->hit.error, from->hit.geometric, direction);
  active = active & (weight > zero_f()) & (above.z > (vf)1e-6f) & finite3(origin) & finite3(direction);
  set_ray(rays, LINK_ROWS, block, origin, direction, pick((vf)-1.0f, (vf)INFINITY, active), from->primitive,
          hit_instance(&from->hit));
  set_row_u(rays, LINK_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_f(rays, LINK_ROWS, block, ROW_WEIGHT, pick(zero_f(), weight, active));
}

// What a hit sees: the vertices about it, on the side that the ray met, with what each of them weighs.
typedef struct {
  vu element[3];
  vf weight[3];  // 0: nothing is seen
#ifdef LINKS_LOBES
  vu lobe[3];
  vf lobe_weight[3];
#endif
  Vertex hit;  // as scattering has it
} SeenElements;

// Of lanes whose ray met something. `sides`: as of SIDE_BITS.
FN SeenElements seen_elements(const Scene* scene, const Mesh* mesh, global const uint* lobes, global const uint* sides,
                              global const float* rays, uint block, vi hit) {
  vf weight = row_f(rays, LINK_ROWS, block, ROW_WEIGHT);
  v3 direction = row_3(rays, LINK_ROWS, block, ROW_DIRECTION);
  Vertex v = meet_surface(scene, rays, LINK_ROWS, block, hit);
#ifdef NEED_MEDIA
  v.media = media_of(0u, 0u);
#endif
  prepare_scattering(scene, &v, direction);
#ifdef NEED_ALPHA
  weight *= v.surface.opacity;
#endif
  weight = pick(zero_f(), weight, v.active);
#ifdef LINKS_LOBES
  vf lobe_weight = pick(zero_f(), weight, is_rough_metal(&v.surface));
  vu bin = seen_bin(&v, direction);
#endif
  weight *= left_above(scene, &v.surface, max_f(v.frame.view.z, (vf)1e-6f));
  Corners c = corners_at(mesh, v.primitive, v.hit.b1, v.hit.b2);
  vu side = pick_u((vu)0u, (vu)1u, v.frame.from_back);
  vf outside[3];
  for (uint k = 0; k < 3u; ++k) {
    vu element = c.vertex[k] * 2u + side;
    vu bits = gather_u(sides, element / SIDES_OF_WORD) >> (element % SIDES_OF_WORD * SIDE_BITS);
    outside[k] = pick(one_f(), zero_f(), (bits & SIDE_INSIDE) != 0u);
  }
  weigh_outside(&c, outside);
  SeenElements seen;
  seen.hit = v;
  for (uint k = 0; k < 3u; ++k) {
    seen.element[k] = c.vertex[k] * 2u + side;
    seen.weight[k] = weight * c.weight[k];
#ifdef LINKS_LOBES
    vu number = gather_u(lobes, seen.element[k]);
    vi has = number != GLEANER_NONE;
    seen.lobe[k] = pick_u((vu)0u, mesh->elements + number * LOBE_BINS + bin, has);
    seen.lobe_weight[k] = pick(zero_f(), lobe_weight * c.weight[k], has);
#endif
  }
  return seen;
}

#endif
