// Camera rays of pixels' samples, and their sums (kernels/transport/camera_samples.h). One program for all scenes whose
// paths have the same rows: of the scene's needs it is built with what kernels/path_layout.h asks for, and PATH_FILTER
// stands for any filter. A sample's random numbers are keyed by seed, pixel, sequence and sample alone.

#include "kernels/camera.h"
#include "kernels/lost_samples.h"
#include "kernels/transport/camera_samples.h"

// What is known of a sample beside its light is written.
FN bool has_features(global const PathParameters* parameters) {
  return parameters->features || parameters->seen == PATH_SEEN_APART;
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
  if (has_features(parameters))
    for (uint k = 0; k < FEATURE_WORDS; ++k)
      store_f(features + (ulong)FEATURE_WORDS * (first_path + first_lane) + k * LANES, 0, zero_f());
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
  bool apart = parameters->seen == PATH_SEEN_APART;
  float sum[SLOT_WORDS] = {0}, seen[3] = {0, 0, 0};
  uint lost = 0;
  for (uint s = 0; s < used; ++s) {
    global const float* slot = slots + (ulong)SLOT_WORDS * (item * samples + s);
    if (!finite_words(slot, SUMS)) {
      ++lost;
      continue;
    }
    for (uint k = 0; k < SUMS; ++k) sum[k] += slot[k];
    if (apart)
      for (uint k = 0; k < 3; ++k) seen[k] += features[(ulong)FEATURE_WORDS * (item * samples + s) + FEATURE_SEEN + k];
  }
  uint own = parameters->features ? 14u : 6u, words = own + (apart ? 3u : 0u) + (SUMS - 6u);
  global float* record = records + (ulong)words * item;
  for (uint k = 0; k < 6; ++k) record[k] = sum[k];
  if (parameters->features) {
    float f[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    for (uint s = 0; s < used; ++s)
      for (uint k = 0; k < 8; ++k) f[k] += features[(ulong)FEATURE_WORDS * (item * samples + s) + k];
    for (uint k = 0; k < 8; ++k) record[6 + k] = f[k];
  }
  if (apart)
    for (uint k = 0; k < 3; ++k) record[own + k] = seen[k];
  // What the partner lacks stands last.
  for (uint k = 6u; k < SUMS; ++k) record[words - SUMS + k] = sum[k];
  report_lost(report, item, lost);
}
