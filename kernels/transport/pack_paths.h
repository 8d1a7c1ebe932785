// Kernel pack_paths: paths that are left, without those that have ended. For programs whose paths are moved in place,
// step after step.
#ifndef GLEANER_KERNELS_TRANSPORT_PACK_PATHS_H
#define GLEANER_KERNELS_TRANSPORT_PACK_PATHS_H

#include "kernels/transport/scattering.h"
#include "kernels/wide.h"

// The rest of a block's lanes write behind `capacity` paths. The second of `counters` gets the paths' number.
kernel WIDE void pack_paths(uint count, uint capacity, global const float* restrict paths,
                            global float* restrict packed, global uint* restrict counters) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  vi alive = path_lanes(block, count, row_u(paths, PATH_ROWS, block, ROW_META));
  uint kept;
  vu rank = rank_lanes(alive, &kept);
  if (kept == 0u) return;
  uint place = atomic_add(counters + 1, kept);
  vu to = ray_address(pick_u((vu)capacity, (vu)place + rank, alive), PATH_ROWS);
  __attribute__((opencl_unroll_hint(1))) for (uint row = 0; row < PATH_ROWS; ++row) {
    if (row == ROW_NORMAL) row = ROW_GEOMETRY;  // nobody reads the last hit any more
    scatter_f(packed + RAY_BLOCK * row, to, row_f(paths, PATH_ROWS, block, row));
  }
}

#endif
