// What the diffuse layer at a place takes of photons.
#ifndef GLEANER_KERNELS_PHOTON_LAYER_H
#define GLEANER_KERNELS_PHOTON_LAYER_H

#include "kernels/bsdf.h"
#include "kernels/photon/map.h"

// Of light that arrives evenly from all around, whose directions a cut does not know, what the lobe above the layer
// leaves to it: the mean over sixteen equal parts of that light.
FN float mean_layer_share(const Scene* scene, global const float* read) {
#ifdef NEED_LOBE
  uint table = ((global const uint*)read)[READ_TABLE];
  if (table == GLEANER_NONE) return 1.0f;
  Surface m;
  m.table = (vu)table;
  m.table_row = (vf)read[READ_ROW];
  float sum = 0.0f;
  for (uint part = 0; part < MAP_PARTS; ++part)
    sum += sum_lanes(left_to_layer(scene, &m, sqrt((to_f(lane_index() + part) + 0.5f) / 16.0f)));
  return sum / 16.0f;
#else
  return 1.0f;
#endif
}

// Power, W, of the photons in `near` lanes, weakened by the lobe above the layer.
FN v3 layer_takes(const Scene* scene, const PhotonMap* map, uint block, uint part, global const float* read, vi near) {
  v3 power = make3(photon_f(map, block, part, PHOTON_POWER), photon_f(map, block, part, PHOTON_POWER + 1u),
                   photon_f(map, block, part, PHOTON_POWER + 2u));
#ifdef NEED_LOBE
  uint table = ((global const uint*)read)[READ_TABLE];
  if (table != GLEANER_NONE) {
    v3 d = unpack_unit(photon_u(map, block, part, PHOTON_ARRIVAL), 12u);
    vf cosine = -(d.x * read[READ_NORMAL] + d.y * read[READ_NORMAL + 1u] + d.z * read[READ_NORMAL + 2u]);
    Surface m;
    m.table = (vu)table;
    m.table_row = (vf)read[READ_ROW];
    power = scale3(power, left_to_layer(scene, &m, clamp_f(cosine, (vf)1e-6f, one_f())));
  }
#endif
  return pick3(splat3(zero_f()), power, near);
}

#endif
