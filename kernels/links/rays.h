// Rays of elements: cosine-weighted, from points of their one-rings. Programs that include this file have the kernel
// links_rays.
#ifndef GLEANER_KERNELS_LINKS_RAYS_H
#define GLEANER_KERNELS_LINKS_RAYS_H

#include "kernels/links/ray.h"

// Rays begin within this part of the one-ring: what a vertex gets is interpolated, so that a mean over all of the ring
// would blur it, and be off at the ring's open side; from the vertex itself, in the corner of a room, rays would begin
// on the other wall.
#define LINK_REACH 0.25f

// Ray r of element first + e is number e * directions + r of `count`.
kernel WIDE void links_rays(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                            global const uint* restrict mesh, global const uint* restrict lobes, uint first, uint count,
                            uint side, global float* restrict rays) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint directions = parameters->directions;
  uint element = first + first_lane / directions;
  Mesh m = load_mesh(mesh);
  vi active = (vi)(element < parameters->elements ? all_lanes() : no_lanes());
  vu ray = (vu)(first_lane % directions) + lane_index();
  uint owner = owner_of(&m, lobes, element);
  vu key = element_key(parameters, &m, owner, 0x47u + 0x100u * bin_of(&m, element));
  RingPoint at = random_ring_point(&m, owner, LINK_REACH, key, ray);
#ifdef LINKS_LOBES
  if (is_lobe(&m, element)) {
    vf u0, u1, x, y;
    sample_pair(key, ray, LINKS_MOST_DIRECTIONS, 6u, &u0, &u1);
    grid_point(ray, side, key, &x, &y);
    Vertex metal = lobe_surface(scene, &at, owner, bin_of(&m, element), u0, u1, active);
    LobeSample s = sample_lobe(scene, &metal, x, y);
    send_ray(&metal, s.above, lobe_luminance(s.weight), active & metal.active, rays, block);
    return;
  }
#endif
  Vertex from = element_surface(scene, &at, element, active);
  v3 above = grid_direction(ray, side, key);
  send_ray(&from, above, layer_weight(scene, &from, above), active, rays, block);
}

#endif
