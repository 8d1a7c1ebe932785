// Points that virtual point lights light. Stage kinds "vpl_points" and "vpl_shade".
//
//   vpl_camera_rays   camera rays of pixels and samples
//   repeat
//     trace           closest hits
//     vpl_point_step  through mirrors and glass, to a diffuse layer or a rough lobe: its row is the path's point
//   until no path is left                                             (kernels/transport/surface_points.h)
#include "kernels/camera.h"
#include "kernels/transport/surface_points.h"
#include "kernels/vpl_records.h"
#include "kernels/wide.h"

// Camera rays of `count` paths from item `first` on. Sixteen pixels in a row, then their next samples: what a work-item
// handles at once are neighbours that look at one slice of the lights. by_point: an item is one path, of which
// every stride-th pixel has one or some.
kernel WIDE void vpl_camera_rays(global const VplPointParameters* restrict parameters, uint first_low, uint first_high,
                                 uint count, uint by_point, global float* restrict paths, global float* restrict points,
                                 uint media_high, uint media_low) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  uint samples = parameters->samples;
  ulong first = ((ulong)first_high << 32) | first_low;
  ulong total = ((ulong)parameters->items_high << 32) | parameters->items_low;
  vu item, sample;
  if (by_point) {
    item = lane + (uint)first;
    sample = item & (samples - 1u);
  } else {
    vu row = lane >> 4;
    sample = row & (samples - 1u);
    item = (row / samples) * 16u + (lane & 15u) + (uint)first;
  }
  NextRay ray;
  ray.alive = (lane < count) & (item < (vu)(uint)total);
  if (by_point) item = item / max(parameters->points, 1u) * parameters->stride;
  vu pixel = min(item, (vu)(parameters->width * parameters->height - 1u));
  vu key = hash_combine(hash_combine(hash_combine((vu)parameters->seed_low, (vu)parameters->seed_high), pixel),
                        (vu)(parameters->pass ^ 0x53505400u));
  vf jx, jy;
  sample_pair(key, sample, samples, 0u, &jx, &jy);
  camera_ray(&parameters->camera, parameters->width, parameters->height, pixel, jx, jy, &ray.origin, &ray.direction);
  ray.throughput = splat3(one_f());
#ifdef NEED_MEDIA
  ray.media = media_of(media_high, media_low);
#endif
  set_path(paths, block, &ray, lane, sample << META_SAMPLE, key);
  for (uint k = 0; k < POINT_WORDS; ++k)
    store_f(points + POINT_WORDS * first_lane + k * LANES, 0, as_vf((vu)GLEANER_NONE));
}

// `lobed`: the points' rough lobes are kept too.
kernel WIDE void vpl_point_step(global const VplPointParameters* restrict parameters, SCENE_PARAMETERS, uint count,
                                global float* paths, global float* points, global uint* counters, uint lobed,
                                global float* restrict lobes) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  // Of the scatterings that are allowed, the VPL and this point need two.
  SurfacePoint point = step_to_surface_point(scene, paths, block, parameters->samples, parameters->depth, 2u, counters);
  if (!any_lane(point.found)) return;
  const Hit* h = &point.vertex.hit;
  vu row = pick_u((vu)count, point.slot, point.found);
  vf w[POINT_WORDS];
  put_words3(w, POINT_POSITION, h->p);
  put_words3(w, POINT_NORMAL, point.vertex.frame.normal);
  w[POINT_TABLE] = as_vf(point.table);
  w[POINT_ROW] = point.table_row;
  w[POINT_WEIGHT] = one_f();
  put_words3(w, POINT_ALBEDO, scale3(mul3(point.throughput, point.albedo), (vf)INV_PI));
  w[POINT_TRIANGLE] = as_vf(point.vertex.primitive);
  w[POINT_B1] = h->b1;
#ifdef NEED_INSTANCES
  w[POINT_INSTANCE] = as_vf(h->instance);
#else
  w[POINT_B2] = h->b2;
#endif
  w[POINT_COS] = one_f();
  store_words(points, row * POINT_WORDS, w);
#ifdef NEED_LOBE
  if (lobed) write_lobe(lobes, row, &point);
#endif
}
