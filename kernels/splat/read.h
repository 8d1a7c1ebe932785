// How points read a record of the cache (Gautron et al. 2005, algorithm 1), whatever its light is made of.
#ifndef GLEANER_KERNELS_SPLAT_READ_H
#define GLEANER_KERNELS_SPLAT_READ_H

#include "kernels/splat/weight.h"
#include "kernels/splat_records.h"
#include "kernels/wide.h"

FN v3 vector_at(global const float* record, uint word) {
  return uniform3(record[word], record[word + 1u], record[word + 2u]);
}

// Of places by `d` from a record of normal `m`: `across` of splat_error().
FN vf across_of(global const float* record, v3 d, v3 m) {
  float along_s = record[CACHE_NARROW], along_t = record[CACHE_NARROW + 1u];
  if (along_s == 0.0f && along_t == 0.0f) return zero_f();
  v3 s, t;
  basis3(m, &s, &t);
  return along_s * dot3(d, s) + along_t * dot3(d, t);
}

// Lanes whose points, by `d` from a record of normal `m`, lie behind something that stands on its surface (`reach`: how
// far it reaches, m).
FN vi behind_something(global const float* record, v3 d, v3 m, float reach) {
  if (!splat_stands_near(record[CACHE_LEAST_CLEAR], reach)) return no_lanes();
  v3 s, t;
  basis3(m, &s, &t);
  vf away, direction = splat_direction(dot3(d, s), dot3(d, t), &away);
  vu before = min(to_u(direction), (vu)(SPLAT_DIRECTIONS - 1u));
  vf part = direction - to_f(before);
  vf one_over = gather_f(record + CACHE_CLEARANCE, before) * (one_f() - part) +
                gather_f(record + CACHE_CLEARANCE, (before + 1u) & (SPLAT_DIRECTIONS - 1u)) * part;
  return away * one_over > (vf)(1.0f + SPLAT_SLACK);
}

// A record as the lanes' points see it.
typedef struct {
  v3 from;    // it to the point, m
  v3 normal;  // its own
  vf weight;  // what eq. 2 gives beyond 1 / a; 0 where it does not count
  vi counts;
} RecordRead;

// `there`: lanes that have a point.
FN RecordRead read_record(global const float* record, v3 p, v3 n, vu level, vi there) {
  RecordRead read;
  float accuracy = record[CACHE_ACCURACY];
  v3 d = sub3(p, vector_at(record, CACHE_POSITION)), m = vector_at(record, CACHE_NORMAL);
  vf error =
      splat_error(d.x, d.y, d.z, n.x, n.y, n.z, m.x, m.y, m.z, (vf)record[CACHE_RADIUS], across_of(record, d, m));
  read.counts = there & (level == ((global const uint*)record)[CACHE_LEVEL]) &
                (error <= (vf)(accuracy * (1.0f + SPLAT_SLACK))) &
                none(splat_is_hidden(d.x, d.y, d.z, n.x, n.y, n.z, m.x, m.y, m.z, SPLAT_MOST_DEPTH));
  if (any_lane(read.counts))
    read.counts =
        read.counts & none(behind_something(record, d, m, accuracy * record[CACHE_RADIUS] * (1.0f + SPLAT_SLACK)));
  vf least = (vf)(1.0f / accuracy);
  read.weight = pick(zero_f(), max_f(one_f() / error - least, SPLAT_SLACK * least), read.counts);
  read.from = d;
  read.normal = m;
  return read;
}

// Writes RGB of each of `count` points and the sum of its weights: the weighted mean of what records bring, times what
// the point does of it to its pixel. `there`: lanes that have a point.
FN void write_shown(global float* radiance, v3 sum, vf weights, v3 factor, vi there, vu lane, uint count) {
  vi lit = there & (weights > zero_f());
  v3 shown = scale3(mul3(sum, factor), one_f() / pick(one_f(), weights, lit));
  vf words[4];
  put_words3(words, 0u, pick3(splat3(zero_f()), shown, lit));
  words[3] = pick(zero_f(), weights, lit);
  scatter_words(radiance, 1u, pick_u((vu)count, lane, lane < count) * 4u, words, 4u);
}

#endif
