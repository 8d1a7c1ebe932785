// The pixel buffer: surface points that pixels show. Stage kind "splat_points".
//
//   splat_camera_rays   camera rays of a tile's pixels and samples
//   repeat
//     trace             closest hits
//     splat_point_step  through mirrors and glass, to a diffuse layer: its row is the path's point
//   until no path is left                                               (kernels/transport/surface_points.h)
#include "kernels/camera.h"
#include "kernels/splat_records.h"
#include "kernels/transport/surface_points.h"
#include "kernels/wide.h"

// A path's length so far, m.
#define ROW_LENGTH ROW_ETA

// Path i is point i % (64 samples) of tile first + i / (64 samples).
kernel WIDE void splat_camera_rays(global const SplatPointParameters* restrict parameters, uint first, uint count,
                                   global float* restrict paths, global float* restrict points, uint media_high,
                                   uint media_low) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  uint samples = parameters->samples, width = parameters->width, height = parameters->height;
  uint log_samples = 31u - clz(samples);
  vu sample = lane & (samples - 1u);
  vu place = (lane >> log_samples) & (SPLAT_TILE_PIXELS - 1u);
  vu tile = (lane >> (log_samples + 6u)) + first;
  uint tiles = (width + SPLAT_TILE - 1u) / SPLAT_TILE;
  vu tile_row = tile / tiles;
  vu x = (tile - tile_row * tiles) * SPLAT_TILE + (place & (SPLAT_TILE - 1u));
  vu y = tile_row * SPLAT_TILE + (place >> 3);
  NextRay ray;
  ray.alive = (x < width) & (y < height) & (lane < count);
  vu pixel = pick_u((vu)0u, y * width + x, ray.alive);
  vu key = hash_combine(hash_combine(hash_combine((vu)parameters->seed_low, (vu)parameters->seed_high), pixel),
                        (vu)0x53504c54u);
  vf jx, jy;
  sample_pair(key, sample, SPLAT_MOST_SAMPLES, 0u, &jx, &jy);
  camera_ray(&parameters->camera, width, height, pixel, jx, jy, &ray.origin, &ray.direction);
  ray.throughput = splat3(one_f());
#ifdef NEED_MEDIA
  ray.media = media_of(media_high, media_low);
#endif
  set_path(paths, block, &ray, lane, sample << META_SAMPLE, key);
  set_row_f(paths, PATH_ROWS, block, ROW_LENGTH, zero_f());
  for (uint k = 0; k < SPLAT_POINT_WORDS; ++k)
    store_f(points + SPLAT_POINT_WORDS * first_lane + k * LANES, 0, zero_f());
}

kernel WIDE void splat_point_step(global const SplatPointParameters* restrict parameters, SCENE_PARAMETERS, uint count,
                                  global float* paths, global float* points, global uint* counters) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  v3 origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  vu key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  // Of the scatterings that are allowed, a record's light takes one at least, and this point one more.
  SurfacePoint point = step_to_surface_point(scene, paths, block, SPLAT_MOST_SAMPLES, parameters->depth, 2u, counters);
  const Vertex* v = &point.vertex;
  vf length = row_f(paths, PATH_ROWS, block, ROW_LENGTH);
  if (!any_lane(point.found | (row_u(paths, PATH_ROWS, block, ROW_META) != META_IDLE))) return;
  length += length3(sub3(v->hit.p, origin));
  set_row_f(paths, PATH_ROWS, block, ROW_LENGTH, length);
  v3 geometric = pick3(v->hit.geometric, negate3(v->hit.geometric), dot3(v->hit.geometric, point.direction) > zero_f());
  v3 factor = scale3(mul3(point.throughput, point.albedo), (vf)INV_PI);
#ifdef NEED_LOBE
  // Records hold irradiance weakened by the lobe above the layer, over what that leaves in the mean.
  factor = scale3(factor, left_mean_of(scene, &v->surface));
#endif
  global const Camera* camera = &parameters->camera;
  float across = 2.0f * camera->half_width / (float)parameters->width;
  vf footprint = camera->type == GLEANER_CAMERA_ORTHOGRAPHIC ? (vf)across : length * across;
#ifdef NEED_LOBE
  if (parameters->what != SPLAT_LAYERS) {
    vi shown = point.rough;
    if (parameters->order) shown = shown & (v->surface.alpha >= (vf)HARMONIC_LEAST_ALPHA(parameters->order));
    factor = pick3(splat3(zero_f()), point.throughput, shown);
  }
#else
  if (parameters->what != SPLAT_LAYERS) return;
#endif
  // Rays from here begin on the viewer's side.
  v3 place = offset_ray_origin(v->hit.p, v->hit.error, geometric, geometric);
  vi found = point.found & (max_component(factor) > zero_f()) & finite3(factor) & finite3(place) &
             (footprint > zero_f()) & finite_f(footprint);
  if (!any_lane(found)) return;
  vu row = pick_u((vu)count, point.slot, found);
#ifdef NEED_LOBE
  if (parameters->what == SPLAT_LOBE_ROWS) {
    write_lobe(points, row, &point);
    return;
  }
#endif
  vu free_ones = (vu)parameters->free_scatterings;
  vu level = min(point.depth - min(point.depth, free_ones), (vu)(SPLAT_LEVEL - 1u));
  vf w[SPLAT_POINT_WORDS];
  put_words3(w, SPLAT_POSITION, place);
  put_words3(w, SPLAT_NORMAL, v->frame.normal);
  put_words3(w, SPLAT_GEOMETRIC, geometric);
  put_words3(w, SPLAT_FACTOR, factor);
  w[SPLAT_FOOTPRINT] = footprint;
  w[SPLAT_TABLE] = as_vf(point.table ^ (level << SPLAT_LEVEL_SHIFT));
  w[SPLAT_ROW] = point.table_row;
  w[SPLAT_KEY] = as_vf(hash_combine(key, point.slot & (SPLAT_MOST_SAMPLES - 1u)));
  store_words(points, row * SPLAT_POINT_WORDS, w);
}
