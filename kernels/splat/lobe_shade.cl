// Splatting incoming radiance to points with rough lobes (Gautron et al. 2005, eq. 9). Stage kind "splat_shade" with an
// order above 0, which SPLAT_ORDER is: the largest one unless the program's options say another.
//
//   for each point, for each record whose sphere meets the box about its tile's points
//     w <- eq. 2; where w >= 1 / a: sum of (w - 1 / a) L' and of the weights; L' is the product of the lobe's
//     coefficients and of the record's, which gradients take to the point
//
// The paper turns a record's coefficients into the point's frame. Here the lobe is brought into the record's: it is the
// lobe of that view which the record's normal mirrors to where the point's normal mirrors the point's own. Where both
// normals are the same that is exact, and nothing is looked up twice.
#include "kernels/sampling.h"
#include "kernels/splat/level.h"
#include "kernels/splat/read.h"

#ifndef SPLAT_ORDER
#define SPLAT_ORDER SPLAT_MOST_ORDER
#endif
#define PAIRS HARMONIC_PAIRS(SPLAT_ORDER)

// A lobe's coefficients (worker/stages/splat/lobe_table.h).
typedef struct {
  vf a[PAIRS], b[PAIRS];
} LobeCoefficients;

FN void load_lobe(global const float* table, vf alpha, vf view, LobeCoefficients* lobe) {
  vf x = log(alpha * (1.0f / LOBE_TABLE_LEAST)) * (float)(LOBE_TABLE_ALPHAS - 1u) / log(1.0f / LOBE_TABLE_LEAST);
  vf y = acos(clamp_f(view, zero_f(), one_f())) * (0.63661977f * (float)(LOBE_TABLE_VIEWS - 1u));
  // Whatever the row holds, NaN too: the table's own places.
  x = pick(zero_f(), min_f(x, (vf)((float)LOBE_TABLE_ALPHAS - 1.001f)), x > zero_f());
  y = pick(zero_f(), min_f(y, (vf)((float)LOBE_TABLE_VIEWS - 1.001f)), y > zero_f());
  vu i = to_u(x), j = to_u(y);
  vf s = x - to_f(i), t = y - to_f(j);
  vu at = (i * LOBE_TABLE_VIEWS + j) * LOBE_TABLE_WORDS(SPLAT_ORDER);
  vf w00 = (one_f() - s) * (one_f() - t), w01 = (one_f() - s) * t, w10 = s * (one_f() - t), w11 = s * t;
  uint right = LOBE_TABLE_WORDS(SPLAT_ORDER), down = LOBE_TABLE_VIEWS * right;
  for (uint k = 0; k < 2u * PAIRS; ++k) {
    vf value = w00 * gather_f(table + k, at) + w01 * gather_f(table + k + right, at) +
               w10 * gather_f(table + k + down, at) + w11 * gather_f(table + k + down + right, at);
    if (k < PAIRS)
      lobe->a[k] = value;
    else
      lobe->b[k - PAIRS] = value;
  }
}

// What a record brings to the lobe at d from it, seen along `view`, by f0 and by f90.
FN void apply_lobe(global const float* record, const LobeCoefficients* lobe, v3 d, v3 view, v3* by_f0, v3* by_f90) {
  v3 m = vector_at(record, CACHE_NORMAL), tangent, bitangent;
  basis3(m, &tangent, &bitangent);
  vf dx = dot3(d, tangent), dy = dot3(d, bitangent);
  vf vx = dot3(view, tangent), vy = dot3(view, bitangent), across = vx * vx + vy * vy;
  vi turned = across > (vf)1e-12f;
  vf scale = one_f() / sqrt(pick(one_f(), across, turned));
  vf cosine = pick(one_f(), vx * scale, turned), sine = pick(zero_f(), vy * scale, turned);
  vf c = one_f(), s = zero_f();
  *by_f0 = splat3(zero_f());
  *by_f90 = splat3(zero_f());
  for (uint k = 0; k < SPLAT_ORDER; ++k) {
    for (uint l = k; l < SPLAT_ORDER; ++l) {
      uint pair = l * (l + 1u) / 2u + k;
      global const float* w = record + CACHE_WORDS + RADIANCE_PAIR_WORDS * pair;
      vf cx = c * dx, cy = c * dy, sx = s * dx, sy = s * dy;
      v3 light = make3(c * w[0] + cx * w[1] + cy * w[2] + s * w[9] + sx * w[10] + sy * w[11],
                       c * w[3] + cx * w[4] + cy * w[5] + s * w[12] + sx * w[13] + sy * w[14],
                       c * w[6] + cx * w[7] + cy * w[8] + s * w[15] + sx * w[16] + sy * w[17]);
      *by_f0 = mad3(light, lobe->a[pair], *by_f0);
      *by_f90 = mad3(light, lobe->b[pair], *by_f90);
    }
    vf next = c * cosine - s * sine;
    s = s * cosine + c * sine;
    c = next;
  }
}

// As splat_accumulate() of kernels/splat/shade.cl, with the points' lobes and the lobes' table.
kernel WIDE void splat_accumulate_lobes(global const float* restrict points, global const float* restrict lobes,
                                        global const float* restrict table, global const float* restrict cache,
                                        global const uint* restrict offsets, global const uint* restrict list,
                                        uint tile_points, uint count, global float* restrict radiance) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  uint tile = first_lane / tile_points;
  vu lane = (vu)first_lane + lane_index(), row = min(lane, (vu)(count - 1u));
  vf point[16], own[16];
  load_words(points, row * SPLAT_POINT_WORDS, point);
  load_words(lobes, row * LOBE_WORDS, own);
  vi there = (point[SPLAT_FOOTPRINT] > zero_f()) & (lane < count);
  v3 sum = splat3(zero_f());
  vf weights = zero_f();
  if (any_lane(there)) {
    v3 p = words3(point, SPLAT_POSITION), n = words3(point, SPLAT_NORMAL), view = words3(own, LOBE_VIEW);
    v3 f0 = words3(own, LOBE_F0);
    vf alpha = pick(one_f(), own[LOBE_ALPHA], there), toward = dot3(view, n);
    v3 mirrored = sub3(scale3(n, 2.0f * toward), view);
    vu level = level_of_point(as_vu(point[SPLAT_TABLE]));
    LobeCoefficients own_lobe, turned_lobe;
    load_lobe(table, alpha, toward, &own_lobe);
    uint end = offsets[tile + 1u];
    for (uint i = offsets[tile]; i < end; ++i) {
      global const float* record = cache + (ulong)RADIANCE_WORDS(SPLAT_ORDER) * list[i];
      RecordRead read = read_record(record, p, n, level, there);
      if (!any_lane(read.counts)) continue;
      v3 d = read.from, m = read.normal;
      vf toward_record = dot3(mirrored, m);
      v3 seen = sub3(scale3(m, 2.0f * toward_record), mirrored);
      v3 by_f0, by_f90;
      if (any_lane(read.counts & (fabs(dot3(n, m) - one_f()) > (vf)1e-5f))) {
        load_lobe(table, alpha, toward_record, &turned_lobe);
        apply_lobe(record, &turned_lobe, d, seen, &by_f0, &by_f90);
      } else {
        apply_lobe(record, &own_lobe, d, seen, &by_f0, &by_f90);
      }
      v3 light = mad3(by_f90, own[LOBE_F90], mul3(by_f0, f0));
      sum = mad3(make3(max_f(light.x, zero_f()), max_f(light.y, zero_f()), max_f(light.z, zero_f())), read.weight, sum);
      weights += read.weight;
    }
  }
  write_shown(radiance, sum, weights, words3(own, LOBE_THROUGHPUT), there, lane, count);
}
