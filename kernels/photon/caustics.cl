// Caustics: the density of caustic photons at what the camera sees. Stage kind "photon_caustics".
//
//   photon_camera_rays     camera rays of pixels and samples
//   repeat
//     trace                closest hits
//     photon_point_step    through mirrors and glass, to a diffuse layer or a rough lobe   (surface_points.h)
//   until no path is left
//   photon_caustics_radii  a pixel's radius <- distance from its first point to the k-th photon of the guide
//   photon_caustics_read   radius   <- the pixel's, or the point's own where that is elsewhere, * shrink
//                          radiance <- sum over the map's photons of BSDF * power * kernel
//   photon_caustics_resolve  a pixel's samples -> its record
//
// The guide is a map of other photons: a radius that depended on those that it weighs would bias their density. From
// pass to pass the radius shrinks, so that the mean over the passes has no bias in the end (Knaus & Zwicker 2011,
// "Progressive Photon Mapping: A Probabilistic Approach"). The kernel falls off as 1 - (distance / radius)^2.
#define POINTS_WITHIN_SOLIDS

#include "kernels/camera.h"
#include "kernels/lost_samples.h"
#include "kernels/photon/layer.h"
#include "kernels/transport/surface_points.h"
#include "kernels/wide.h"

// Path i is sample i % samples of the pixel i / samples from `first` on.
kernel WIDE void photon_camera_rays(global const PhotonCausticsParameters* restrict parameters, uint first_low,
                                    uint first_high, uint count, global float* restrict paths,
                                    global float* restrict reads, uint media_high, uint media_low) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  uint samples = parameters->samples;
  vu pixel = (lane >> (31u - clz(samples))) + first_low;
  // Passes go on in a pixel's sequence where the one before has ended.
  uint first = parameters->pass * samples;
  vu sample = (lane & (samples - 1u)) + (first & (GLEANER_PATH_SEQUENCE - 1u));
  NextRay ray;
  ray.alive = lane < count;
  vu key = hash_combine(hash_combine(hash_combine((vu)parameters->seed_low, (vu)parameters->seed_high), pixel),
                        (vu)((first / GLEANER_PATH_SEQUENCE) ^ 0x43415500u));
  vf jx, jy;
  sample_pair(key, sample, GLEANER_PATH_SEQUENCE, 0u, &jx, &jy);
  camera_ray(&parameters->camera, parameters->width, parameters->height, pixel, jx, jy, &ray.origin, &ray.direction);
  ray.throughput = splat3(one_f());
#ifdef NEED_MEDIA
  ray.media = media_of(media_high, media_low);
#endif
  set_path(paths, block, &ray, lane, sample << META_SAMPLE, key);
  scatter_u((global uint*)reads + READ_SLOT, lane * READ_WORDS, (vu)GLEANER_NONE);
}

kernel WIDE void photon_point_step(global const PhotonCausticsParameters* restrict parameters, SCENE_PARAMETERS,
                                   uint count, global float* paths, global float* reads, global float* restrict lobes,
                                   global uint* counters) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint most = parameters->depth;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  // A caustic photon was scattered once at least.
  SurfacePoint point = step_to_surface_point(scene, paths, block, GLEANER_PATH_SEQUENCE, most, 2u, counters);
  if (!any_lane(point.found)) return;
  vu row = pick_u((vu)count, point.slot, point.found);
  vf w[READ_WORDS];
  put_words3(w, READ_POSITION, point.vertex.hit.p);
  put_words3(w, READ_GEOMETRIC, point.vertex.frame.geometric);
  put_words3(w, READ_NORMAL, point.vertex.frame.normal);
  w[READ_TABLE] = as_vf(point.table);
  w[READ_ROW] = point.table_row;
  put_words3(w, READ_FACTOR, scale3(mul3(point.throughput, point.albedo), (vf)INV_PI));
  w[READ_SLOT] = as_vf(point.slot);
  w[READ_LIMITS] = as_vf(scatterings_left(most, meta & META_DEPTH_MASK));
  store_words(reads, row * READ_WORDS, w);
#ifdef NEED_LOBE
  write_lobe(lobes, row, &point);
#endif
}

#ifdef NEED_LOBE
// What the rough lobe of a point sends to the viewer of the photons in `near` lanes.
FN v3 lobe_sends(const PhotonMap* map, uint block, uint part, global const float* read, global const float* lobe,
                 vi near) {
  v3 power = make3(photon_f(map, block, part, PHOTON_POWER), photon_f(map, block, part, PHOTON_POWER + 1u),
                   photon_f(map, block, part, PHOTON_POWER + 2u));
  v3 from = negate3(unpack_unit(photon_u(map, block, part, PHOTON_ARRIVAL), 12u));
  v3 n = uniform3(read[READ_NORMAL], read[READ_NORMAL + 1u], read[READ_NORMAL + 2u]);
  v3 view = uniform3(lobe[LOBE_VIEW], lobe[LOBE_VIEW + 1u], lobe[LOBE_VIEW + 2u]);
  v3 f0 = uniform3(lobe[LOBE_F0], lobe[LOBE_F0 + 1u], lobe[LOBE_F0 + 2u]);
  v3 value = rough_lobe(f0, (vf)lobe[LOBE_F90], (vf)lobe[LOBE_ALPHA], n, view, from);
  return pick3(splat3(zero_f()), mul3(power, value), near & (dot3(n, from) > zero_f()));
}
#endif

// A pixel's other points take its first one's radius within this squared distance, over the squared radius, and where
// the cosine between the normals is no less.
#define RADIUS_NEAR2 0.04f
#define RADIUS_LEAST_COSINE 0.95f

FN bool takes_radius(global const float* read, global const float* other, float radius2) {
  float distance2 = 0.0f, cosine = 0.0f;
  for (uint k = 0; k < 3u; ++k) {
    float off = read[READ_POSITION + k] - other[READ_POSITION + k];
    distance2 += off * off;
    cosine += read[READ_GEOMETRIC + k] * other[READ_GEOMETRIC + k];
  }
  return distance2 < RADIUS_NEAR2 * radius2 && cosine > RADIUS_LEAST_COSINE &&
         as_uint(read[READ_LIMITS]) == as_uint(other[READ_LIMITS]);
}

// To search for the nearest photons takes as long as to read them, and a pixel's points mostly lie near each other.
kernel void photon_caustics_radii(global const float* restrict reads, uint samples, uint count,
                                  global const float* restrict guide, uint guide_nodes, uint neighbours,
                                  float most_radius, global float* restrict radii) {
  uint pixel = (uint)get_global_id(0);
  if (pixel >= count) return;
  uint first = pixel * samples, end = first + samples;
  while (first < end && ((global const uint*)reads)[READ_WORDS * first + READ_SLOT] != first) ++first;
  float radius2 = 0.0f;
  if (first < end) {
    PhotonMap photons = photon_map(guide, guide_nodes);
    MapPlace place = map_place(reads + READ_WORDS * first);
    radius2 = estimate_radius2(&photons, &place, neighbours, most_radius);
  }
  radii[CAUSTIC_RADIUS_WORDS * pixel] = radius2;
  radii[CAUSTIC_RADIUS_WORDS * pixel + 1u] = as_float(first < end ? first : GLEANER_NONE);
}

kernel void photon_caustics_read(global const float* restrict reads, global const float* restrict lobes, uint count,
                                 SCENE_PARAMETERS, global const float* restrict guide, uint guide_nodes,
                                 global const float* restrict map, uint map_nodes, uint neighbours, float most_radius,
                                 float shrink, global const float* restrict radii, uint samples,
                                 global float* restrict radiance) {
  uint i = (uint)get_global_id(0);
  if (i >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  global const float* read = reads + READ_WORDS * i;
  float r = 0.0f, g = 0.0f, b = 0.0f;
  if (((global const uint*)read)[READ_SLOT] == i) {
    MapPlace place = map_place(read);
    global const float* pixel = radii + CAUSTIC_RADIUS_WORDS * (i / samples);
    float radius2 = pixel[0];
    if (!takes_radius(read, reads + READ_WORDS * as_uint(pixel[1]), radius2)) {
      PhotonMap photons = photon_map(guide, guide_nodes);
      radius2 = estimate_radius2(&photons, &place, neighbours, most_radius);
    }
    radius2 *= shrink * shrink;
    PhotonMap photons = photon_map(map, map_nodes);
    v3 layer = splat3(zero_f()), glossy = layer;
    uint at = 0u;
    float reach2;
    for (;;) {
      uint block = next_leaf(&photons, &place, radius2, false, &at, &reach2);
      if (block == GLEANER_NONE) break;
      for (uint part = 0; part < MAP_PARTS; ++part) {
        vf distance2;
        vi near = photons_near(&photons, block, part, &place, radius2, &distance2);
        if (!any_lane(near)) continue;
        vf weight = pick(zero_f(), fma(distance2, (vf)(-2.0f / radius2), (vf)2.0f), near);
        layer = add3(layer, scale3(layer_takes(&scene_value, &photons, block, part, read, near), weight));
#ifdef NEED_LOBE
        global const float* lobe = lobes + LOBE_WORDS * i;
        if (lobe[LOBE_ALPHA] > 0.0f)
          glossy = add3(glossy, scale3(lobe_sends(&photons, block, part, read, lobe, near), weight));
#endif
      }
    }
    float scale = INV_PI / radius2;
    r = read[READ_FACTOR] * scale * sum_lanes(layer.x);
    g = read[READ_FACTOR + 1u] * scale * sum_lanes(layer.y);
    b = read[READ_FACTOR + 2u] * scale * sum_lanes(layer.z);
#ifdef NEED_LOBE
    global const float* seen = lobes + LOBE_WORDS * i + LOBE_THROUGHPUT;
    r += seen[0] * scale * sum_lanes(glossy.x);
    g += seen[1] * scale * sum_lanes(glossy.y);
    b += seen[2] * scale * sum_lanes(glossy.z);
#endif
  }
  radiance[3u * i] = r;
  radiance[3u * i + 1u] = g;
  radiance[3u * i + 2u] = b;
}

// Samples that are not finite are left out and reported.
kernel void photon_caustics_resolve(global const float* restrict radiance, uint samples, uint count,
                                    global float* restrict records, global uint* restrict report) {
  uint item = (uint)get_global_id(0);
  if (item >= count) return;
  float sum[3] = {0.0f, 0.0f, 0.0f};
  uint lost = 0u;
  for (uint s = 0; s < samples; ++s) {
    global const float* one = radiance + 3u * (item * samples + s);
    if (finite_words(one, 3u))
      for (uint k = 0; k < 3u; ++k) sum[k] += one[k];
    else
      ++lost;
  }
  for (uint k = 0; k < 3u; ++k) records[3u * item + k] = sum[k] / (float)samples;
  report_lost(report, item, lost);
}
