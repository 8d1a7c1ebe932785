// Slots of pixels' samples: what the kernels of a method add to them. kernels/camera_samples.cl makes the rays and sums
// the slots:
//
//   camera_generate   camera rays of items' samples; every sample has a slot
//   ...               the method's own kernels add radiance to slots (add_to_slots, write_features)
//   camera_resolve    slots are summed to the items' records, in the order of the samples
//
// Include it where an item is a chunk of samples of a pixel (kernels/path_records.h); worker/stages/camera_samples.h
// runs them.
#ifndef GLEANER_KERNELS_TRANSPORT_CAMERA_SAMPLES_H
#define GLEANER_KERNELS_TRANSPORT_CAMERA_SAMPLES_H

#include "kernels/path_filter.h"
#include "kernels/path_records.h"
#include "kernels/wide.h"

FN void add_to_slots(global float* slots, uint slot_count, vu slot, vi indirect, v3 value, vi active) {
  // Lanes with nothing to add write to a slot that nobody reads.
  vu at = pick_u((vu)slot_count, slot, active) * SLOT_WORDS + pick_u((vu)0u, (vu)SLOT_INDIRECT, indirect & active);
  vf added[3] = {value.x, value.y, value.z};
  // A loop for the compiler's sake: see scatter_words().
  __attribute__((opencl_unroll_hint(1))) for (uint k = 0; k < 3u; ++k)
      scatter_f(slots + k, at, gather_f(slots + k, at) + added[k]);
}

// What the partner of a filter lacks is also summed apart.
FN void add_compensation(global float* slots, uint slot_count, vu slot, v3 value, vi active) {
#ifdef PATH_FILTER
  if (any_lane(active))
    add_to_slots(slots + (SLOT_COMPENSATION - SLOT_INDIRECT), slot_count, slot, active, value, active);
#endif
}

// Lanes of a wave's block that hold a path. `survivors` stand at the front, `fresh_count` new ones from fresh_base on.
FN vi wave_lanes(uint block, vu meta, uint survivors, uint fresh_base, uint fresh_count) {
  vu lane = (vu)(block * LANES) + lane_index();
  vi fresh = (lane >= fresh_base) & (lane < fresh_base + fresh_count);
  return ((lane < survivors) | fresh) & ((meta & META_IDLE) == 0u);
}

// A path that goes on, to where ray_address() says.
FN void store_path(global float* paths, vu to, const vf* rows) {
  scatter_words(paths, RAY_BLOCK, to, rows, RAY_ROWS);
  scatter_words(paths + RAY_BLOCK * ROW_GEOMETRY, RAY_BLOCK, to, rows + ROW_GEOMETRY, PATH_ROWS - ROW_GEOMETRY);
}

// What a camera ray met first. `direction`: of the ray, `distance`: its length. Lanes in `first_hit` have one.
FN void write_features(global float* features, uint slot_count, vu slot, v3 direction, vf distance, const Vertex* v,
                       vi first_hit) {
  if (!any_lane(first_hit)) return;
  vf words[FEATURE_SEEN];
  put_words3(words, 0u, v->surface.base);
  v3 n = v->hit.normal;
  put_words3(words, 3u, pick3(n, negate3(n), dot3(n, direction) > zero_f()));
  words[6] = distance;
  words[7] = one_f();
  scatter_words(features, 1u, pick_u((vu)slot_count, slot, first_hit) * FEATURE_WORDS, words, FEATURE_SEEN);
}

// Emission seen directly, in lanes of `seen`. A path may pass some and see more behind.
FN void add_seen(global float* features, uint slot_count, vu slot, v3 emission, vi seen) {
  if (!any_lane(seen)) return;
  vu at = pick_u((vu)slot_count, slot, seen) * FEATURE_WORDS + (vu)FEATURE_SEEN;
  vf words[3] = {emission.x, emission.y, emission.z};
  for (uint k = 0; k < 3u; ++k) words[k] += gather_f(features + k, at);
  scatter_words(features, 1u, at, words, 3u);
}

#endif
