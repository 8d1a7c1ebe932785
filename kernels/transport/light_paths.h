// Light paths: how each begins, and what a surface that it meets is told of it.
//
//   start_light_paths    a path's numbers and its first ray; set_light_path() writes its rows. In two steps,
//                        begin_light_paths() and emit_light_paths(), where the numbers are changed between
//   meet_light_surface   the surface it met, prepared for scattering: scatter_flux() (kernels/transport/scattering.h)
//
// Include it where light is followed from its source; NEED_LIGHTS must be defined where these functions are used. Rows
// are those of kernels/path_layout.h, some with meanings of their own.
#ifndef GLEANER_KERNELS_TRANSPORT_LIGHT_PATHS_H
#define GLEANER_KERNELS_TRANSPORT_LIGHT_PATHS_H

#include "kernels/transport/emission.h"
#include "kernels/transport/scattering.h"

#define ROW_RANGE ROW_PDF     // of the punctual light's window; 0: none, or passed already
#define ROW_SAMPLE ROW_TOTAL  // place in the path's sequence
// ROW_META of a light path; the bits above are the method's.
#define LIGHT_BOUNCE_MASK 255u
#define LIGHT_DEPTH 8u

// Paths of one sequence.
#define LIGHT_SEQUENCE 65536u

#ifdef NEED_LIGHTS

typedef struct {
  NextRay ray;  // throughput: the flux
  vf range;
  vi punctual;
  vu slot, key, sample;
} LightStart;

// What is drawn for a path's first ray: the light by `light`, the point on it by u0 and u1, the direction by d0 and d1.
typedef struct {
  vf light, spare, u0, u1, d0, d1;
} EmissionNumbers;

FN EmissionNumbers emission_numbers(vu key, vu sample) {
  EmissionNumbers n;
  sample_pair(key, sample, LIGHT_SEQUENCE, 0u, &n.light, &n.spare);
  sample_pair(key, sample, LIGHT_SEQUENCE, 1u, &n.u0, &n.u1);
  sample_pair(key, sample, LIGHT_SEQUENCE, 2u, &n.d0, &n.d1);
  return n;
}

// Slot, key and place in the sequence: lane i of a block that begins at `first_lane` has path i from `first` on.
// `stream` keeps methods' and passes' numbers apart.
FN LightStart begin_light_paths(uint first_low, uint first_high, uint first_lane, uint seed_low, uint seed_high,
                                uint stream) {
  LightStart start;
  start.slot = (vu)first_lane + lane_index();
  ulong first = (((ulong)first_high << 32) | first_low) + first_lane;
  start.sample = ((vu)(uint)(first & (LIGHT_SEQUENCE - 1u)) + lane_index()) & (LIGHT_SEQUENCE - 1u);
  // Each run of 65,536 paths has a sequence of its own; blocks of 16 never straddle two.
  uint sequence = (uint)(first >> 16);
  start.key = hash_combine(hash_combine(hash_combine((vu)seed_low, (vu)seed_high), (vu)stream), (vu)sequence);
  return start;
}

// The first rays of `count` paths.
FN void emit_light_paths(const Scene* scene, global const float* emission, uint count, EmissionNumbers n,
                         LightStart* start) {
  EmittedRay ray = emit_light(scene, emission, n.light, n.u0, n.u1, n.d0, n.d1);
  start->ray.origin = ray.origin;
  start->ray.direction = ray.direction;
  start->ray.throughput = ray.flux;
  start->ray.alive = (start->slot < count) & ray.valid;
#ifdef NEED_MEDIA
  start->ray.media.high = ray.media_high;
  start->ray.media.low = ray.media_low;
#endif
  start->range = ray.range;
  start->punctual = ray.punctual;
}

FN LightStart start_light_paths(const Scene* scene, global const float* emission, uint first_low, uint first_high,
                                uint first_lane, uint count, uint seed_low, uint seed_high, uint stream) {
  LightStart start = begin_light_paths(first_low, first_high, first_lane, seed_low, seed_high, stream);
  emit_light_paths(scene, emission, count, emission_numbers(start.key, start.sample), &start);
  return start;
}

FN void set_light_path(global float* paths, uint block, const LightStart* start, vu meta) {
  set_path(paths, block, &start->ray, start->slot, meta, start->key);
  set_row_f(paths, PATH_ROWS, block, ROW_RANGE, start->range);
  set_row_u(paths, PATH_ROWS, block, ROW_SAMPLE, start->sample);
}

typedef struct {
  Vertex v;
  v3 flux;       // what arrives
  v3 geometric;  // the triangle's normal on the path's side
  vf correction;
  ScatterNumbers u;
} LightVertex;

// What lanes in `active` met. `flux`: what left the last vertex.
FN LightVertex meet_light_surface(const Scene* scene, global float* paths, uint block, vi active, v3 origin,
                                  v3 direction, v3 flux, vu key, vu sample, vu bounce) {
  LightVertex met;
  met.v = meet_surface(scene, paths, PATH_ROWS, block, active);
  // KHR_lights_punctual's window over the first segment.
  vf range = row_f(paths, PATH_ROWS, block, ROW_RANGE);
  vf ratio = length3(sub3(met.v.hit.p, origin)) / range;
  vf window = clamp_f(one_f() - ratio * ratio * ratio * ratio, zero_f(), one_f());
  met.flux = scale3(flux, pick(one_f(), window, range > zero_f()));
  met.flux = through_media(scene, &met.v, paths, block, origin, direction, met.flux);
  vu pair_key = hash_combine(key, bounce * 4u + 16u);
  vf u_spare;
  sample_pair(pair_key, sample, LIGHT_SEQUENCE, 0u, &u_spare, &met.u.u_roulette);
  sample_pair(pair_key, sample, LIGHT_SEQUENCE, 2u, &met.u.u_lobe, &met.u.u_glass);
  sample_pair(pair_key, sample, LIGHT_SEQUENCE, 3u, &met.u.d0, &met.u.d1);
  choose_alpha(&met.v, &met.u.u_glass);
  prepare_scattering(scene, &met.v, direction);
  // A camera path sees no light from behind the normal for shading.
  met.v.active = met.v.active & ((met.v.frame.facing > (vf)1e-6f) | met.v.passes);
  met.geometric =
      pick3(met.v.hit.geometric, negate3(met.v.hit.geometric), dot3(met.v.hit.geometric, direction) > zero_f());
  met.correction = shading_normal_correction(&met.v, met.geometric, direction);
  return met;
}

#endif

#endif
