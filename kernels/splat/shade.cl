// Splatting: what records bring to the points of tiles (Gautron et al. 2005, algorithm 1). Stage kind "splat_shade".
//
//   for each point, for each record whose sphere meets the box about its tile's points
//     w <- eq. 2; where w >= 1 / a: sum of (w - 1 / a) E' and of the weights, E' by eq. 8
//
// A point owns its sums, and takes records in their order: no two work-items add to one number. The paper's weight
// jumps from 1 / a to nothing where a record ends, which shows as an edge; what exceeds 1 / a does not.
//
// The gradient between a record and the point is not the record's (eq. 8) but the mean of that and of the one at the
// point, which is the weighted mean of all records'. So light that changes quadratically is met: where it is concave,
// each record's own gradient alone leads too high, and no mean of such values is right.
#include "kernels/sampling.h"
#include "kernels/splat/level.h"
#include "kernels/splat/read.h"

// Weighted sums of where a point lies to its records, and of their gradients, a colour after the other.
typedef struct {
  v3 away, turn;
  v3 rotation[3], translation[3];
} GradientSums;

FN GradientSums no_gradients(void) {
  GradientSums sums;
  sums.away = sums.turn = splat3(zero_f());
  for (uint c = 0; c < 3u; ++c) sums.rotation[c] = sums.translation[c] = splat3(zero_f());
  return sums;
}

// A record's light, changed by half of what its own gradient says.
FN vf color_at(global const float* record, uint color, v3 turn, v3 away) {
  vf change = dot3(turn, vector_at(record, CACHE_ROTATION + 3u * color)) +
              dot3(away, vector_at(record, CACHE_TRANSLATION + 3u * color));
  return (vf)record[CACHE_IRRADIANCE + color] + 0.5f * change;
}

FN void add_gradients(GradientSums* sums, global const float* record, v3 turn, v3 away, vf weight) {
  sums->away = mad3(away, weight, sums->away);
  sums->turn = mad3(turn, weight, sums->turn);
  for (uint c = 0; c < 3u; ++c) {
    sums->rotation[c] = mad3(vector_at(record, CACHE_ROTATION + 3u * c), weight, sums->rotation[c]);
    sums->translation[c] = mad3(vector_at(record, CACHE_TRANSLATION + 3u * c), weight, sums->translation[c]);
  }
}

// What the gradient at the point adds to the weighted sum of a colour.
FN vf mean_gradient(const GradientSums* sums, uint color, vf weights) {
  return 0.5f * (dot3(sums->turn, sums->rotation[color]) + dot3(sums->away, sums->translation[color])) /
         max_f(weights, (vf)1e-30f);
}

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
  GradientSums gradients = no_gradients();
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
      v3 value = make3(color_at(record, 0u, turn, d), color_at(record, 1u, turn, d), color_at(record, 2u, turn, d));
      sum = mad3(value, read.weight, sum);
      add_gradients(&gradients, record, turn, d, read.weight);
      weights += read.weight;
    }
  }
  sum = make3(max_f(sum.x + mean_gradient(&gradients, 0u, weights), zero_f()),
              max_f(sum.y + mean_gradient(&gradients, 1u, weights), zero_f()),
              max_f(sum.z + mean_gradient(&gradients, 2u, weights), zero_f()));
  write_shown(radiance, sum, weights, words3(point, SPLAT_FACTOR), there, lane, count);
}
