// Splatting: what records bring to the points of tiles (Gautron et al. 2005, algorithm 1). Stage kind "splat_shade".
//
//   for each point, for each record whose sphere meets the box about its tile's points
//     w <- eq. 2; where w >= 1 / a: sum of (w - 1 / a) E' and of the weights, E' by eq. 8
//
// A point owns its sums, and takes records in their order: no two work-items add to one number. The paper's weight
// jumps from 1 / a to nothing where a record ends, which shows as an edge; what exceeds 1 / a does not.
#include "kernels/sampling.h"
#include "kernels/splat/level.h"
#include "kernels/splat/read.h"

// `offsets`: where the list of each tile begins in `list`, and one more at the end. Radiance is RGB of each point and
// the sum of its weights.
kernel WIDE void splat_accumulate(global const float* restrict points, global const float* restrict cache,
                                  global const uint* restrict offsets, global const uint* restrict list,
                                  uint tile_points, uint count, global float* restrict radiance) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  uint tile = first_lane / tile_points;
  vu lane = (vu)first_lane + lane_index();
  vf point[16];
  load_words(points, min(lane, (vu)(count - 1u)) * SPLAT_POINT_WORDS, point);
  vi there = (point[SPLAT_FOOTPRINT] > zero_f()) & (lane < count);
  v3 sum = splat3(zero_f());
  vf weights = zero_f();
  if (any_lane(there)) {
    v3 p = words3(point, SPLAT_POSITION), n = words3(point, SPLAT_NORMAL);
    vu level = level_of_point(as_vu(point[SPLAT_TABLE]));
    uint end = offsets[tile + 1u];
    for (uint i = offsets[tile]; i < end; ++i) {
      global const float* record = cache + (ulong)CACHE_WORDS * list[i];
      RecordRead read = read_record(record, p, n, level, there);
      if (!any_lane(read.counts)) continue;
      v3 d = read.from, m = read.normal;
      v3 turn = cross3(m, n);
      v3 e = vector_at(record, CACHE_IRRADIANCE);
      vf r = e.x + dot3(turn, vector_at(record, CACHE_ROTATION)) + dot3(d, vector_at(record, CACHE_TRANSLATION));
      vf g =
          e.y + dot3(turn, vector_at(record, CACHE_ROTATION + 3u)) + dot3(d, vector_at(record, CACHE_TRANSLATION + 3u));
      vf b =
          e.z + dot3(turn, vector_at(record, CACHE_ROTATION + 6u)) + dot3(d, vector_at(record, CACHE_TRANSLATION + 6u));
      sum = mad3(make3(max_f(r, zero_f()), max_f(g, zero_f()), max_f(b, zero_f())), read.weight, sum);
      weights += read.weight;
    }
  }
  vi lit = there & (weights > zero_f());
  v3 shown = scale3(mul3(sum, words3(point, SPLAT_FACTOR)), one_f() / pick(one_f(), weights, lit));
  vf words[4];
  put_words3(words, 0u, pick3(splat3(zero_f()), shown, lit));
  words[3] = pick(zero_f(), weights, lit);
  scatter_words(radiance, 1u, pick_u((vu)count, lane, lane < count) * 4u, words, 4u);
}
