// Samples of pixels: camera rays, a slot for what each finds, and the sums that are an item's record.
//
//   camera_generate   camera rays of items' samples; every sample has a slot
//   ...               the method's own kernels add radiance to slots (add_to_slots, write_features)
//   camera_resolve    slots are summed to the items' records, in the order of the samples
//
// Every program that includes this file has both kernels. Include it where an item is a chunk of samples of a pixel
// (kernels/path_records.h); worker/stages/camera_samples.h runs them. A sample's random numbers are keyed by seed,
// pixel, sequence and sample alone.
#ifndef GLEANER_KERNELS_TRANSPORT_CAMERA_SAMPLES_H
#define GLEANER_KERNELS_TRANSPORT_CAMERA_SAMPLES_H

#include "kernels/camera.h"
#include "kernels/lost_samples.h"
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

// Fields of PathParameters are read one by one: the struct itself never lands in registers.
kernel WIDE void camera_generate(global const PathParameters* restrict parameters, global const uint* restrict items,
                                 uint listed, uint first_item_low, uint first_item_high, uint first_path, uint base,
                                 uint count, global float* restrict paths, global float* restrict slots,
                                 global float* restrict features, uint media_high, uint media_low) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vu path = lane + first_path;
  uint samples = parameters->samples_per_item;
  uint log_samples = 31u - clz(samples);
  vu local_item = path >> log_samples;
  vu sample = path & (samples - 1u);
  uint width = parameters->width, height = parameters->height;
  vu pixel, chunk;
  // Items of one batch are far fewer than 2^32; only the first needs 64 bits.
  ulong first_item = ((ulong)first_item_high << 32) | first_item_low;
  ulong total = ((ulong)parameters->items_high << 32) | parameters->items_low;
  if (listed) {
    pixel = gather_u(items, local_item * 2u);
    chunk = gather_u(items + 1, local_item * 2u);
  } else {
    uint pixels = width * height;
    uint start_chunk = (uint)(first_item / pixels), start_pixel = (uint)(first_item % pixels);
    vu index = local_item + start_pixel;
    vu turns = index / pixels;
    pixel = index - turns * pixels;
    chunk = turns + (start_chunk + parameters->first_chunk);
  }
  // Chunks go by turns to the pixel's two sequences, each going on where its last one ended.
  uint log_chunks = 31u - clz(GLEANER_PATH_SEQUENCE) - log_samples;
  vu turn = chunk >> 1;
  sample += (turn & ((1u << log_chunks) - 1u)) << log_samples;
  vu sequence = (chunk & 1u) | ((turn >> log_chunks) << 1);
  vu key =
      hash_combine(hash_combine(hash_combine((vu)parameters->seed_low, (vu)parameters->seed_high), pixel), sequence);
  vf jx, jy;
  sample_pair(key, sample, GLEANER_PATH_SEQUENCE, 0u, &jx, &jy);
  v3 origin, direction;
  camera_ray(&parameters->camera, width, height, pixel, jx, jy, &origin, &direction);
  // The stage's last item may have fewer samples than the others.
  uint last_local = (uint)min(total - 1u - first_item, (ulong)0xfffffffeu);
  vi idle = (local_item > last_local) |
            ((local_item == last_local) & ((path & (samples - 1u)) >= parameters->last_item_samples)) | (lane >= count);
  uint at = (base + first_lane) / LANES;
  set_ray(paths, PATH_ROWS, at, origin, direction, pick((vf)INFINITY, (vf)-1.0f, idle), (vu)GLEANER_NONE, (vu)0u);
  set_row_u(paths, PATH_ROWS, at, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_3(paths, PATH_ROWS, at, ROW_THROUGHPUT, splat3(one_f()));
  set_row_f(paths, PATH_ROWS, at, ROW_PDF, zero_f());
  set_row_f(paths, PATH_ROWS, at, ROW_TOTAL, one_f());
  set_row_u(paths, PATH_ROWS, at, ROW_SLOT, path);
  set_row_u(paths, PATH_ROWS, at, ROW_META, (sample << META_SAMPLE) | pick_u((vu)0u, (vu)META_IDLE, idle));
  set_row_u(paths, PATH_ROWS, at, ROW_KEY, key);
  set_row_f(paths, PATH_ROWS, at, ROW_ETA, one_f());
#ifdef TRANSPARENT_SHADOWS
  set_row_f(paths, PATH_ROWS, at, ROW_TRAVELLED, zero_f());
#endif
#ifdef NEED_MEDIA
  set_row_u(paths, PATH_ROWS, at, ROW_MEDIA, (vu)media_high);
  set_row_u(paths, PATH_ROWS, at, ROW_MEDIA + 1u, (vu)media_low);
#endif
#ifdef PATH_FILTER
  set_row_f(paths, PATH_ROWS, at, ROW_FILTER, (vf)FILTER_NO_SURFACE);
#endif
  for (uint k = 0; k < SLOT_WORDS; ++k)
    store_f(slots + (ulong)SLOT_WORDS * (first_path + first_lane) + k * LANES, 0, zero_f());
  if (parameters->features)
    for (uint k = 0; k < FEATURE_WORDS; ++k)
      store_f(features + (ulong)FEATURE_WORDS * (first_path + first_lane) + k * LANES, 0, zero_f());
}

// What a camera ray met first.
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

// `direction`: of the ray, `distance`: its length. Lanes in `first_hit` have one.
FN void write_features(global float* features, uint slot_count, vu slot, v3 direction, vf distance, const Vertex* v,
                       vi first_hit) {
  if (!any_lane(first_hit)) return;
  vf words[FEATURE_WORDS];
  put_words3(words, 0u, v->surface.base);
  v3 n = v->hit.normal;
  put_words3(words, 3u, pick3(n, negate3(n), dot3(n, direction) > zero_f()));
  words[6] = distance;
  words[7] = one_f();
  scatter_words(features, 1u, pick_u((vu)slot_count, slot, first_hit) * FEATURE_WORDS, words, FEATURE_WORDS);
}

#ifdef PATH_FILTER
#define SUMS 9u
#else
#define SUMS 6u
#endif

// Sums each item's samples in their order. Samples that are not finite are left out and reported.
kernel void camera_resolve(global const PathParameters* restrict parameters, uint first_item_low, uint first_item_high,
                           uint count, global const float* restrict slots, global const float* restrict features,
                           global float* restrict records, global uint* restrict report, uint base) {
  uint item = base + (uint)get_global_id(0);
  if (item >= count) return;
  uint samples = parameters->samples_per_item;
  ulong index = (((ulong)first_item_high << 32) | first_item_low) + item;
  ulong total = ((ulong)parameters->items_high << 32) | parameters->items_low;
  uint used = index == total - 1u ? parameters->last_item_samples : samples;
  float sum[SLOT_WORDS] = {0};
  uint lost = 0;
  for (uint s = 0; s < used; ++s) {
    global const float* slot = slots + (ulong)SLOT_WORDS * (item * samples + s);
    if (finite_words(slot, SUMS))
      for (uint k = 0; k < SUMS; ++k) sum[k] += slot[k];
    else
      ++lost;
  }
  uint words = (parameters->features ? 14u : 6u) + (SUMS - 6u);
  global float* record = records + (ulong)words * item;
  for (uint k = 0; k < 6; ++k) record[k] = sum[k];
  if (parameters->features) {
    float f[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    for (uint s = 0; s < used; ++s)
      for (uint k = 0; k < 8; ++k) f[k] += features[(ulong)FEATURE_WORDS * (item * samples + s) + k];
    for (uint k = 0; k < 8; ++k) record[6 + k] = f[k];
  }
  // What the partner lacks stands last.
  for (uint k = 6u; k < SUMS; ++k) record[words - SUMS + k] = sum[k];
  report_lost(report, item, lost);
}

#endif
