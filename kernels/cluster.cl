// The assignment step of k-means (algorithm 1 of Colom et al. 2022). Stage kinds "vpl_cluster" and "point_cluster".
//
//   seeds, iterations and updates   on the host (worker/stages/cluster_stage.cpp)
//   cluster_assign                  each datum -> the nearest centroid whose normal is within the threshold (eq. 7),
//                                   among those in the 27 cells about it
//
// FUZZINESS is 1.
#include "kernels/cluster_grid.h"
#include "kernels/wide.h"

// The nearest centroid of each of `count` data points from `base` on, or GLEANER_NONE. A datum is a row of `stride`
// words that begins with a position and a normal.
kernel WIDE void cluster_assign(global const float* restrict data, uint stride, uint base, uint count,
                                global const float* restrict grid, global const uint* restrict cells,
                                global const float* restrict seeds, float least_cosine,
                                global uint* restrict assigned) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(data, (min(lane, (vu)(count - 1u)) + base) * stride, w);
  vf best[FUZZINESS];
  vu who[FUZZINESS];
  nearest_seeds(words3(w, 0u), words3(w, 3u), lane < count, grid, cells, seeds, least_cosine, best, who);
  store_u(assigned + base + first_lane, 0, who[0]);  // room for a whole block at the end is the caller's
}
