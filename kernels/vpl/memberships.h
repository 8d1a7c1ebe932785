// The point clusters of a block's points, and what these see: `rows` and `weights` as vpl_memberships writes them,
// `bits` as the stage "vpl_visibility" does. FUZZINESS, a macro, is the number of clusters a point belongs to.
#ifndef GLEANER_KERNELS_VPL_MEMBERSHIPS_H
#define GLEANER_KERNELS_VPL_MEMBERSHIPS_H

#include "kernels/lanes.h"

// Weights, and where each cluster's bits of a slice begin.
FN void load_memberships(global const uint* rows, global const float* weights, uint first_lane, uint row_words,
                         uint first_word, vu* row, vf* weight) {
  for (uint f = 0; f < FUZZINESS; ++f) {
    row[f] = load_u(rows + (ulong)FUZZINESS * first_lane + f * LANES, 0) * row_words + first_word;
    weight[f] = load_f(weights + (ulong)FUZZINESS * first_lane + f * LANES, 0);
  }
}

// Which of 32 lights a cluster sees; none where it counts for nothing.
FN vu visible_lights(global const uint* bits, vu word, vi member) {
  return pick_u((vu)0u, gather_u(bits, pick_u((vu)0u, word, member)), member);
}

#endif
