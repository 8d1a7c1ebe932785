// Reading a photon map, or the cut of it, where gather paths say (path_shade's `reads`).
#ifndef GLEANER_KERNELS_PHOTON_READ_H
#define GLEANER_KERNELS_PHOTON_READ_H

#include "kernels/photon/area.h"
#include "kernels/photon/cut.h"
#include "kernels/photon/layer.h"

typedef struct {
  v3 light;  // irradiance that the diffuse layer takes, without what is no surface
  PhotonSpread spread;
} MapSum;

FN MapSum sum_photons(const Scene* scene, const PhotonMap* map, const MapPlace* place, global const float* read,
                      float radius2, bool own) {
  MapSum sum;
  sum.light = splat3(zero_f());
  sum.spread = photon_spread(place);
  uint at = first_node(map, place);
  float reach2;
  for (;;) {
    uint block = next_leaf(map, place, radius2, own, &at, &reach2);
    if (block == GLEANER_NONE) break;
    for (uint part = 0; part < MAP_PARTS; ++part) {
      vf distance2;
      vi near = photons_near(map, block, part, place, reach2, &distance2);
      if (!any_lane(near)) continue;
      sum.light = mad3(layer_takes(scene, map, block, part, read, near), (vf)(INV_PI / reach2), sum.light);
      spread_add(&sum.spread, map, block, part, place, reach2, near & (distance2 > zero_f()));
    }
  }
  return sum;
}

kernel void photon_read(global const float* restrict reads, uint count, SCENE_PARAMETERS,
                        global const float* restrict map, uint map_nodes, global const float* restrict cut,
                        uint cut_blocks, uint cut_depth, uint neighbours, float most_radius,
                        global float* restrict slots, uint slot_count) {
  uint i = (uint)get_global_id(0);
  if (i >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  global const float* read = reads + READ_WORDS * i;
  uint slot = ((global const uint*)read)[READ_SLOT];
  if (slot >= slot_count) return;
  MapPlace place = map_place(read);
  if (cut_blocks && !place.caustics && place.most_depth >= cut_depth) {
    float e[3];
    if (cut_irradiance(cut, cut_blocks, &place, e)) {
      global float* to = slots + SLOT_WORDS * slot + SLOT_INDIRECT;
      float share = mean_layer_share(&scene_value, read);
      for (uint k = 0; k < 3u; ++k) to[k] += read[READ_FACTOR + k] * e[k] * share;
      return;
    }
  }
  PhotonMap photons = photon_map(map, map_nodes);
  // Photons shine as far as the map says, or as a radius that was asked for.
  bool own = neighbours != 0u;
  float radius2 = own ? INFINITY : most_radius * most_radius;
  MapSum sum = sum_photons(&scene_value, &photons, &place, read, radius2, own);
  float scale = disc_over_surface(&sum.spread);
  global float* to = slots + SLOT_WORDS * slot + SLOT_INDIRECT;
  to[0] += read[READ_FACTOR] * scale * sum_lanes(sum.light.x);
  to[1] += read[READ_FACTOR + 1u] * scale * sum_lanes(sum.light.y);
  to[2] += read[READ_FACTOR + 2u] * scale * sum_lanes(sum.light.z);
}

#endif
