// A regular grid over clusters' centres, and the nearest of the 27 cells about a point (algorithms 1 and 2 of the
// Colom et al. 2022). FUZZINESS, a macro, says how many are wanted; with WITH_NORMALS they are nearest by
// position and normal.
#ifndef GLEANER_KERNELS_CLUSTER_GRID_H
#define GLEANER_KERNELS_CLUSTER_GRID_H

// The grid: its corner, 1 / edge, cells a side; cells in rows of x; `cells` holds each one's first seed and, last, the
// number of seeds.
#define GRID_ORIGIN 0u
#define GRID_INVERSE 3u
#define GRID_SIZE 4u  // uint, three
#define GRID_HEADER 8u
// A seed, in the cells' order: a cluster's position and normal, and its row.
#define SEED_WORDS 8u
#define SEED_POSITION 0u
#define SEED_NORMAL 3u
#define SEED_ROW 6u  // uint

#ifdef __OPENCL_VERSION__
#include "kernels/vec3.h"
#include "scene/model/records.h"

// Squared distances (ascending; infinity: no more) and rows (GLEANER_NONE) of the nearest seeds whose normals are
// within the threshold of n (eq. 7).
FN void nearest_seeds(v3 p, v3 n, vi active, global const float* grid, global const uint* cells,
                      global const float* seeds, float least_cosine, vf* best, vu* who) {
  global const uint* header = (global const uint*)grid;
  uint nx = header[GRID_SIZE], ny = header[GRID_SIZE + 1], nz = header[GRID_SIZE + 2];
  p = pick3(splat3(zero_f()), p, active);
  vf limit = (vf)4194304.0f;
  vi cx = to_i(clamp_f(floor((p.x - grid[GRID_ORIGIN]) * grid[GRID_INVERSE]), -limit, limit));
  vi cy = to_i(clamp_f(floor((p.y - grid[GRID_ORIGIN + 1]) * grid[GRID_INVERSE]), -limit, limit));
  vi cz = to_i(clamp_f(floor((p.z - grid[GRID_ORIGIN + 2]) * grid[GRID_INVERSE]), -limit, limit));
  vi x0 = max(cx - 1, (vi)0), x1 = min(cx + 1, (vi)((int)nx - 1));
  for (uint f = 0; f < FUZZINESS; ++f) {
    best[f] = (vf)INFINITY;
    who[f] = (vu)GLEANER_NONE;
  }
  for (int dz = -1; dz <= 1; ++dz)
    for (int dy = -1; dy <= 1; ++dy) {
      vi y = cy + dy, z = cz + dz;
      vi there = active & (y >= 0) & (y < (int)ny) & (z >= 0) & (z < (int)nz) & (x0 <= x1);
      if (!any_lane(there)) continue;
      vi base = (z * (int)ny + y) * (int)nx;
      vu k = gather_u(cells, pick_u((vu)0u, as_unsigned(base + x0), there));
      vu end = gather_u(cells, pick_u((vu)0u, as_unsigned(base + x1 + 1), there));
      end = pick_u(k, end, there);
      while (any_lane(k < end)) {
        vi here = k < end;
        vf s[16];
        load_words(seeds, pick_u((vu)0u, k, here) * SEED_WORDS, s);
        v3 d = sub3(words3(s, SEED_POSITION), p);
        vf r = dot3(d, d);
#ifdef WITH_NORMALS
        // Eq. 2 of Wang et al. 2009, squared; positions come multiplied by its alpha.
        v3 turn = sub3(words3(s, SEED_NORMAL), n);
        r = sqrt(r) + sqrt(dot3(turn, turn));
        r *= r;
#endif
        here = here & (dot3(words3(s, SEED_NORMAL), n) > (vf)least_cosine) & (r < best[FUZZINESS - 1]);
#ifdef SAME_SURFACE
        // A ledge above a wall is no part of it, however near: what lies between them blocks other light.
        vf above = dot3(d, n);
        here = here & (above * above <= (vf)(SAME_SURFACE * SAME_SURFACE) * r);
#endif
        if (any_lane(here)) {
          vu id = as_vu(s[SEED_ROW]);
          r = pick((vf)INFINITY, r, here);
          for (uint f = 0; f < FUZZINESS; ++f) {
            vi nearer = r < best[f];
            vf farther = pick(r, best[f], nearer);
            vu farther_id = pick_u(id, who[f], nearer);
            best[f] = pick(best[f], r, nearer);
            who[f] = pick_u(who[f], id, nearer);
            r = farther;
            id = farther_id;
          }
        }
        k = pick_u(k, k + 1u, k < end);
      }
    }
}
#endif

#endif
