// Final gather: the path tracer, which reads a photon map where its paths have left their first surface. Stage kind
// "photon_gather".
//
//   repeat
//     camera_generate, trace, path_shade, trace, shadow_connect    as kernels/path.cl
//     photon_read    where a path meets a diffuse layer behind its first surface: what the map's density says of the
//                    irradiance there is added to its slot
//   until no path is left
//
// The first surface is scattered from by its BSDF, so that over a diffuse layer gather rays are distributed by the
// cosine. kernels/path_filter.h tells which light is read and which the path finds. The estimate divides the power of
// the k - 1 nearest photons by the disc that the k-th is on: of photons strewn evenly its mean is their density.
#include "kernels/photon/layer.h"

#define PHOTON_GATHER
#ifndef PATH_FILTER
#define PATH_FILTER 7  // of both maps
#endif
#include "kernels/path.cl"

kernel void photon_read(global const float* restrict reads, uint count, SCENE_PARAMETERS,
                        global const float* restrict map, uint map_nodes, uint neighbours, float most_radius,
                        global float* restrict slots, uint slot_count) {
  uint i = (uint)get_global_id(0);
  if (i >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  global const float* read = reads + READ_WORDS * i;
  uint slot = ((global const uint*)read)[READ_SLOT];
  if (slot >= slot_count) return;
  PhotonMap photons = photon_map(map, map_nodes);
  MapPlace place = map_place(read);
  float radius2 = estimate_radius2(&photons, &place, neighbours, most_radius);
  v3 sum = splat3(zero_f());
  uint at = 0u;
  for (;;) {
    uint block = next_leaf(&photons, &place, radius2, &at);
    if (block == GLEANER_NONE) break;
    for (uint part = 0; part < MAP_PARTS; ++part) {
      vf distance2;
      vi near = photons_near(&photons, block, part, &place, radius2, &distance2);
      if (any_lane(near)) sum = add3(sum, layer_takes(&scene_value, &photons, block, part, read, near));
    }
  }
  float scale = INV_PI / radius2;
  global float* to = slots + SLOT_WORDS * slot + SLOT_INDIRECT;
  to[0] += read[READ_FACTOR] * scale * sum_lanes(sum.x);
  to[1] += read[READ_FACTOR + 1u] * scale * sum_lanes(sum.y);
  to[2] += read[READ_FACTOR + 2u] * scale * sum_lanes(sum.z);
}
