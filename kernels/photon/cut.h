// Reading an illumination cut (kernels/photon_records.h; Wang et al. 2009, section 3.3): the irradiance of the cut's
// nodes near a place, weighed by eq. 4 and 5.
#ifndef GLEANER_KERNELS_PHOTON_CUT_H
#define GLEANER_KERNELS_PHOTON_CUT_H

#include "kernels/photon/map.h"

// W/m^2, RGB, in `to`; the sum of the weights: 0 where no node is near. As in a map, what is off the surface's plane is
// farther away.
FN float cut_irradiance(global const float* cut, uint nodes, const MapPlace* p, float* to) {
  float weights = 0.0f, r = 0.0f, g = 0.0f, b = 0.0f;
  uint at = 0u;
  while (at < nodes) {
    global const float* n = cut + CUT_WORDS * at;
    if (p->x < n[NODE_LOWER] || p->y < n[NODE_LOWER + 1u] || p->z < n[NODE_LOWER + 2u] || p->x > n[NODE_UPPER] ||
        p->y > n[NODE_UPPER + 1u] || p->z > n[NODE_UPPER + 2u]) {
      at = ((global const uint*)n)[NODE_SKIP];
      continue;
    }
    ++at;
    float nearness = n[CUT_NEARNESS];
    if (nearness <= 0.0f) continue;
    // A node of the cut is in the middle of the box that it reaches.
    float x = p->x - 0.5f * (n[NODE_LOWER] + n[NODE_UPPER]),
          y = p->y - 0.5f * (n[NODE_LOWER + 1u] + n[NODE_UPPER + 1u]),
          z = p->z - 0.5f * (n[NODE_LOWER + 2u] + n[NODE_UPPER + 2u]);
    float height = x * p->nx + y * p->ny + z * p->nz;
    float falloff = 1.0f - (x * x + y * y + z * z + MAP_FLATNESS * height * height) * nearness;
    if (falloff <= 0.0f) continue;
    float cosine = n[CUT_NORMAL] * p->nx + n[CUT_NORMAL + 1u] * p->ny + n[CUT_NORMAL + 2u] * p->nz;
    if (cosine <= MAP_LEAST_COSINE) continue;
    // Over r_p^2: nodes have nearly equal power, so that dark ones are wide, and would darken what is bright beside
    // them.
    float weight = falloff * cosine * nearness;
    weights += weight;
    r += weight * n[CUT_IRRADIANCE];
    g += weight * n[CUT_IRRADIANCE + 1u];
    b += weight * n[CUT_IRRADIANCE + 2u];
  }
  if (weights > 0.0f) {
    to[0] = r / weights;
    to[1] = g / weights;
    to[2] = b / weights;
  }
  return weights;
}

#endif
