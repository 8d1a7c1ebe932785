// Reading an illumination cut (kernels/photon_records.h; Wang et al. 2009, section 3.3): the irradiance of the cut's
// nodes near a place, weighed by eq. 4 and 5.
#ifndef GLEANER_KERNELS_PHOTON_CUT_H
#define GLEANER_KERNELS_PHOTON_CUT_H

#include "kernels/photon/map.h"

FN vf cut_word(const PhotonMap* cut, uint block, uint part, uint word) {
  return row_f(cut->photons, CUT_WORDS, block * MAP_PARTS + part, word);
}

// W/m^2, RGB, in `to`; the sum of the weights: 0 where no node is near. As in a map, what is off the surface's plane is
// farther away.
FN float cut_irradiance(global const float* rows, uint nodes, const MapPlace* p, float* to) {
  PhotonMap cut = photon_map(rows, nodes);
  vf weights = zero_f(), r = zero_f(), g = zero_f(), b = zero_f();
  uint at = 0u;
  for (;;) {
    // Boxes hold all that their nodes reach: the place lies in them, or it is not reached.
    uint block = next_leaf(&cut, p, FLT_MIN, &at);
    if (block == GLEANER_NONE) break;
    for (uint part = 0; part < MAP_PARTS; ++part) {
      vf x = cut_word(&cut, block, part, CUT_PLACE) - p->x;
      vf y = cut_word(&cut, block, part, CUT_PLACE + 1u) - p->y;
      vf z = cut_word(&cut, block, part, CUT_PLACE + 2u) - p->z;
      vf nearness = cut_word(&cut, block, part, CUT_NEARNESS);
      vf height = x * p->nx + y * p->ny + z * p->nz;
      vf distance2 = x * x + y * y + z * z + MAP_FLATNESS * height * height;
      vf falloff = 1.0f - distance2 * nearness;
      vf cosine = cut_word(&cut, block, part, CUT_NORMAL) * p->nx +
                  cut_word(&cut, block, part, CUT_NORMAL + 1u) * p->ny +
                  cut_word(&cut, block, part, CUT_NORMAL + 2u) * p->nz;
      // Over r_p^2: nodes have nearly equal power, so that dark ones are wide, and would darken what is bright beside
      // them.
      vi near = (falloff > zero_f()) & (cosine > (vf)MAP_LEAST_COSINE);
      vi below = near & far_below(height, distance2);
      if (any_lane(below))
        near = near & none(below & covered(p, as_vu(cut_word(&cut, block, part, CUT_ARRIVAL)), height, distance2));
      vf weight = pick(zero_f(), falloff * cosine * nearness, near);
      weights += weight;
      r += weight * cut_word(&cut, block, part, CUT_IRRADIANCE);
      g += weight * cut_word(&cut, block, part, CUT_IRRADIANCE + 1u);
      b += weight * cut_word(&cut, block, part, CUT_IRRADIANCE + 2u);
    }
  }
  float sum = sum_lanes(weights);
  if (sum > 0.0f) {
    to[0] = sum_lanes(r) / sum;
    to[1] = sum_lanes(g) / sum;
    to[2] = sum_lanes(b) / sum;
  }
  return sum;
}

#endif
