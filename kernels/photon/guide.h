// Emission that goes where photons are of use (kernels/photon_records.h: GUIDE_...; worker/stages/photon/guide.h).
#ifndef GLEANER_KERNELS_PHOTON_GUIDE_H
#define GLEANER_KERNELS_PHOTON_GUIDE_H

#include "kernels/photon_records.h"
#include "kernels/transport/light_paths.h"

#ifdef NEED_LIGHTS

FN vf below_one(vf u) { return min_f(u, (vf)0x1.fffffep-1f); }

// Moves a path's numbers to where the guide wants them: each half of the tree gets its share of a number's range, so
// that numbers that are stratified stay so (hierarchical warping: Clarberg, Jarosz, Akenine-Moller & Jensen 2005).
// Returns the density of the numbers there: 1 where they are as even as without a guide.
FN vf guide_emission(global const float* guide, EmissionNumbers* n) {
  vf u[GUIDE_NUMBERS] = {n->light, n->u0, n->u1, n->d0, n->d1};
  vu row = (vu)0u;
  for (;;) {
    vu axis = gather_u((global const uint*)guide + GUIDE_AXIS, row * GUIDE_WORDS);
    vi inner = axis != (vu)GLEANER_NONE;
    if (!any_lane(inner)) break;
    vu child = gather_u((global const uint*)guide + GUIDE_CHILD, row * GUIDE_WORDS);
    vf share = gather_f(guide + GUIDE_SHARE, row * GUIDE_WORDS);
    vi upper = no_lanes();
    for (uint k = 0; k < GUIDE_NUMBERS; ++k) {
      vi here = inner & (axis == k);
      vi above = here & (u[k] >= share);
      vf moved = below_one(pick(u[k] / share, (u[k] - share) / (one_f() - share), above));
      u[k] = pick(u[k], moved, here);
      upper = upper | above;
    }
    row = pick_u(row, child + pick_u((vu)0u, (vu)1u, upper), inner);
  }
  vf w[16];
  load_words(guide, row * GUIDE_WORDS, w);
  n->light = below_one(fma(u[0], w[GUIDE_EXTENT], w[GUIDE_LOWER]));
  n->u0 = below_one(fma(u[1], w[GUIDE_EXTENT + 1], w[GUIDE_LOWER + 1]));
  n->u1 = below_one(fma(u[2], w[GUIDE_EXTENT + 2], w[GUIDE_LOWER + 2]));
  n->d0 = below_one(fma(u[3], w[GUIDE_EXTENT + 3], w[GUIDE_LOWER + 3]));
  n->d1 = below_one(fma(u[4], w[GUIDE_EXTENT + 4], w[GUIDE_LOWER + 4]));
  return w[GUIDE_DENSITY];
}

#endif

#endif
