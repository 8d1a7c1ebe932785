// Reading a photon map, or the cut of it, where gather paths say (path_shade's `reads`).
#ifndef GLEANER_KERNELS_PHOTON_READ_H
#define GLEANER_KERNELS_PHOTON_READ_H

#include "kernels/photon/area.h"
#include "kernels/photon/cut.h"
#include "kernels/photon/layer.h"

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
  // A search for what is nowhere goes through all photons within `most_radius`.
  if (place.caustics && ((global const uint*)map)[MAP_CAUSTICS] == 0u) return;
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
  float radius2 = estimate_radius2(&photons, &place, neighbours, most_radius);
  v3 sum = splat3(zero_f());
  PhotonSpread spread = photon_spread(&place);
  uint at = 0u;
  for (;;) {
    uint block = next_leaf(&photons, &place, radius2, &at);
    if (block == GLEANER_NONE) break;
    for (uint part = 0; part < MAP_PARTS; ++part) {
      vf distance2;
      vi near = photons_near(&photons, block, part, &place, radius2, &distance2);
      if (!any_lane(near)) continue;
      sum = add3(sum, layer_takes(&scene_value, &photons, block, part, read, near));
      spread_add(&spread, &photons, block, part, &place, near & (distance2 > zero_f()));
    }
  }
  float scale = 1.0f / spread_area(&spread, radius2);
  global float* to = slots + SLOT_WORDS * slot + SLOT_INDIRECT;
  to[0] += read[READ_FACTOR] * scale * sum_lanes(sum.x);
  to[1] += read[READ_FACTOR + 1u] * scale * sum_lanes(sum.y);
  to[2] += read[READ_FACTOR + 2u] * scale * sum_lanes(sum.z);
}

#endif
