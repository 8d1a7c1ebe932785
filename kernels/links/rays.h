// Rays of elements: cosine-weighted, from points of their one-rings. Programs that include this file have the kernel
// links_rays.
#ifndef GLEANER_KERNELS_LINKS_RAYS_H
#define GLEANER_KERNELS_LINKS_RAYS_H

#include "kernels/links/ray.h"

// Rays begin within this part of the one-ring: what a vertex gets is interpolated, so that a mean over all of the ring
// would blur it, and be off at the ring's open side; from the vertex itself, in the corner of a room, rays would begin
// on the other wall.
#define LINK_REACH 0.25f

// How many rays an element sends. `sides`: as of SIDE_BITS, read where hidden elements send fewer.
FN uint rays_of(global const LinksParameters* parameters, const Mesh* mesh, global const uint* sides, uint element) {
  if (parameters->divided && !is_of_divided(mesh, element >> 1)) return 0u;
  if (parameters->hidden_directions == 0u) return parameters->directions;
  uint side = sides[element / SIDES_OF_WORD] >> (element % SIDES_OF_WORD * SIDE_BITS);
  return side & SIDE_HIDDEN ? parameters->hidden_directions : parameters->directions;
}
FN uint side_of(uint rays) {
  uint side = 4u;
  while (side * side < rays) side += 4u;
  return side;
}

FN void send_no_ray(global float* rays, uint block) {
  set_ray(rays, LINK_ROWS, block, splat3(zero_f()), uniform3(0.0f, 0.0f, 1.0f), (vf)-1.0f, (vu)GLEANER_NONE, (vu)0u);
  set_row_u(rays, LINK_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_f(rays, LINK_ROWS, block, ROW_WEIGHT, zero_f());
}

// Ray r of element first + e is number e * directions + r of `count`. Elements that send fewer leave the last ones out,
// and the others weigh more. `counters`: the first counts rays.
kernel WIDE void links_rays(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                            global const uint* restrict mesh, global const uint* restrict lobes,
                            global const uint* restrict sides, uint first, uint count, global float* restrict rays,
                            global uint* restrict counters) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint directions = parameters->directions;
  uint element = first + first_lane / directions;
  Mesh m = load_mesh(mesh);
  vi active = (vi)(element < parameters->elements ? all_lanes() : no_lanes());
  uint owner = owner_of(&m, lobes, element), sent = rays_of(parameters, &m, sides, owner);
  if (first_lane % directions == 0u) atomic_add(counters, sent);
  if (first_lane % directions >= sent) {
    send_no_ray(rays, block);
    return;
  }
  uint side = side_of(sent);
  vf share = (vf)((float)directions / (float)sent);
  vu ray = (vu)(first_lane % directions) + lane_index();
  vu key = element_key(parameters, &m, owner, 0x47u + 0x100u * bin_of(&m, element));
  RingPoint at = random_ring_point(&m, owner, LINK_REACH, key, ray);
#ifdef LINKS_LOBES
  if (is_lobe(&m, element)) {
    vf u0, u1, x, y;
    sample_pair(key, ray, LINKS_MOST_DIRECTIONS, 6u, &u0, &u1);
    grid_point(ray, side, key, &x, &y);
    Vertex metal = lobe_surface(scene, &at, owner, bin_of(&m, element), u0, u1, active);
    LobeSample s = sample_lobe(scene, &metal, x, y);
    send_ray(&metal, s.above, share * lobe_luminance(s.weight), active & metal.active, rays, block);
    return;
  }
#endif
  Vertex from = element_surface(scene, &at, element, active);
  v3 above = grid_direction(ray, side, key);
  send_ray(&from, above, share * layer_weight(scene, &from, above), active, rays, block);
}

#endif
