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

// What both sides of a vertex have in common of 16 rays each: where these begin, and how they are spread.
typedef struct {
  Vertex hit;  // of the surface there, seen from no side as yet
  vu ray, key;
} RayOrigins;

FN RayOrigins ray_origins(const Scene* scene, const Mesh* mesh, global const LinksParameters* parameters, uint element,
                          vu ray, vi active) {
  RayOrigins from;
  from.ray = ray;
  from.key = element_key(parameters, mesh, element, 0x47u);
  RingPoint at = random_ring_point(mesh, element, LINK_REACH, from.key, ray);
  from.hit = element_hit(scene, &at, active);
  return from;
}

// Rays of one side, which sends `sent` in all, into a block.
FN void send_rays(const Scene* scene, global const LinksParameters* parameters, const RayOrigins* from, uint element,
                  uint sent, vi active, global float* rays, uint block) {
  Vertex v = from->hit;
  prepare_scattering(scene, &v, against_normal(&v.hit, element));
  v3 above = grid_direction(from->ray, side_of(sent), from->key);
  vf share = (vf)((float)parameters->directions / (float)sent);
  send_ray(&v, above, share * layer_weight(scene, &v, above), active, rays, block);
}

#ifdef LINKS_LOBES
FN void send_lobe_rays(const Scene* scene, const Mesh* mesh, global const LinksParameters* parameters, uint element,
                       uint owner, uint sent, vu ray, vi active, global float* rays, uint block) {
  uint bin = bin_of(mesh, element);
  vu key = element_key(parameters, mesh, owner, 0x47u + 0x100u * bin);
  RingPoint at = random_ring_point(mesh, owner, LINK_REACH, key, ray);
  vf u0, u1, x, y;
  sample_pair(key, ray, LINKS_MOST_DIRECTIONS, 6u, &u0, &u1);
  grid_point(ray, side_of(sent), key, &x, &y);
  Vertex metal = lobe_surface(scene, &at, owner, bin, u0, u1, active);
  LobeSample s = sample_lobe(scene, &metal, x, y);
  vf share = (vf)((float)parameters->directions / (float)sent);
  send_ray(&metal, s.above, share * lobe_luminance(s.weight), active & metal.active, rays, block);
}
#endif

// Ray r of element first + e is number e * directions + r of `count`, whole elements. Elements that send fewer leave
// the last ones out, and the others weigh more. `counters`: the first counts rays. Where both sides of a vertex are
// among the elements, the front's work-items send the rays of both: all but the side is the same.
kernel WIDE void links_rays(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                            global const uint* restrict mesh, global const uint* restrict lobes,
                            global const uint* restrict sides, uint first, uint count, global float* restrict rays,
                            global uint* restrict counters) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint directions = parameters->directions, within = first_lane % directions;
  uint element = first + first_lane / directions, end = first + count / directions;
  Mesh m = load_mesh(mesh);
  int alone = is_lobe(&m, element) || (element & 1u ? element == first : element + 1u == end);
  if (!alone && (element & 1u)) return;
  uint owner = owner_of(&m, lobes, element), sent[2];
  sent[0] = rays_of(parameters, &m, sides, owner);
  sent[1] = alone ? 0u : rays_of(parameters, &m, sides, element + 1u);
  if (within == 0u) atomic_add(counters, sent[0] + sent[1]);
  vi active = (vi)(element < parameters->elements ? all_lanes() : no_lanes());
  vu ray = (vu)within + lane_index();
#ifdef LINKS_LOBES
  if (is_lobe(&m, element) && within < sent[0]) {
    send_lobe_rays(scene, &m, parameters, element, owner, sent[0], ray, active, rays, block);
    return;
  }
#endif
  RayOrigins from;
  if (within < max(sent[0], sent[1])) from = ray_origins(scene, &m, parameters, owner, ray, active);
  for (uint s = 0; s < (alone ? 1u : 2u); ++s, block += directions / LANES)
    if (within < sent[s])
      send_rays(scene, parameters, &from, element + s, sent[s], active, rays, block);
    else
      send_no_ray(rays, block);
}

#endif
