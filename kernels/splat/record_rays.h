// Rays over strata of records' hemispheres, which gather what arrives there, and how far their first surfaces are.
// RECORD_STATE(place), a macro, is the state of the path filter that they begin with. Strata are of equal
// cosine-weighted solid angle, with RECORD_RADIANCE of equal solid angle.
#ifndef GLEANER_KERNELS_SPLAT_RECORD_RAYS_H
#define GLEANER_KERNELS_SPLAT_RECORD_RAYS_H

#include "kernels/splat/level.h"
#include "kernels/splat/strata.h"
#include "kernels/splat_records.h"

// Of a ray's slot.
#define SLOT_NEARNESS 9u    // 1/m: one over the distance to its first surface; 0: there is none
#define SLOT_DIRECTION 10u  // x and y in the record's frame (basis3() of its normal)

// What of the light from the local direction d the diffuse layer at a place takes, over what it takes in the mean. Of
// incoming radiance: what geometry leaves of it.
FN vf layer_share(const Scene* scene, const vf* place, v3 d, v3 direction) {
  vf share = one_f();
#if defined(NEED_LOBE) && !defined(RECORD_RADIANCE)
  Surface m;
  m.table = table_of_point(as_vu(place[SPLAT_TABLE]));
  m.table_row = place[SPLAT_ROW];
  share = left_to_layer(scene, &m, clamp_f(d.z, (vf)1e-6f, one_f())) / left_mean_of(scene, &m);
#endif
#ifdef NEED_BENT_NORMALS
  ShadingFrame frame;
  frame.normal = words3(place, SPLAT_NORMAL);
  frame.geometric = words3(place, SPLAT_GEOMETRIC);
  share *= geometric_share(&frame, direction, d.z);
#endif
  return share;
}

// Through a stratum of the hemisphere, local.
FN v3 stratum_direction(vf u0, vf u1) {
#ifdef RECORD_RADIANCE
  vf s, c, z = one_f() - u1;
  sincos_2pi(u0, &s, &c);
  vf r = safe_sqrt(one_f() - z * z);
  return make3(r * c, r * s, z);
#else
  return sample_cosine(u0, u1);
#endif
}

// Ray i is that of stratum i % strata of the batch's record i / strata, ring by ring from the normal on, in rings of
// `azimuthal`.
kernel WIDE void splat_gather_rays(global const SplatGatherParameters* restrict parameters, SCENE_PARAMETERS,
                                   global const float* restrict places, uint first_record, uint first_path, uint base,
                                   uint count, global float* restrict paths, global float* restrict slots) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint azimuthal = parameters->azimuthal, polar = parameters->polar, strata = polar * azimuthal;
  // A block of lanes never straddles two records.
  uint record = (first_path + first_lane) / strata;
  vu stratum = (vu)(first_path + first_lane - record * strata) + lane_index();
  vf place[16];
  load_words(places, (vu)((first_record + record) * SPLAT_POINT_WORDS), place);
  vu record_key = hash_combine(hash_combine((vu)parameters->samples.seed_low, (vu)parameters->samples.seed_high),
                               as_vu(place[SPLAT_KEY]));
  vu key = hash_combine(record_key, stratum / GLEANER_PATH_SEQUENCE);
  vu sample = stratum & (GLEANER_PATH_SEQUENCE - 1u);
  vf u0, u1;
  stratum_sample(record_key, stratum, polar, azimuthal, &u0, &u1);
  v3 d = stratum_direction(u0, u1);
  v3 n = words3(place, SPLAT_NORMAL), s, t;
  basis3(n, &s, &t);
  NextRay ray;
  ray.origin = words3(place, SPLAT_POSITION);
  ray.direction = normalize3(add3(add3(scale3(s, d.x), scale3(t, d.y)), scale3(n, d.z)));
  vf share = layer_share(scene, place, d, ray.direction);
  ray.throughput = splat3(share);
  ray.alive = ((vu)first_lane + lane_index() < count) & (share > zero_f()) & (d.z > (vf)1e-6f) & finite3(ray.origin) &
              finite3(ray.direction) & finite_f(share);
#ifdef NEED_MEDIA
  ray.media = media_of(0u, 0u);
#endif
  uint at = (base + first_lane) / LANES;
  vu slot = (vu)(first_path + first_lane) + lane_index();
  vu scatterings = 1u + level_of_point(as_vu(place[SPLAT_TABLE]));
  set_path(paths, at, &ray, slot,
           scatterings | (vu)((1u << META_DIFFUSE) | (1u << META_BOUNCE)) | (sample << META_SAMPLE), key);
#ifdef RECORD_RADIANCE
  set_row_f(paths, PATH_ROWS, at, ROW_PDF, (vf)(0.5f * INV_PI));
#else
  set_row_f(paths, PATH_ROWS, at, ROW_PDF, d.z * (vf)INV_PI);
#endif
  set_row_f(paths, PATH_ROWS, at, ROW_TOTAL, one_f());
  set_row_f(paths, PATH_ROWS, at, ROW_ETA, one_f());
  set_row_f(paths, PATH_ROWS, at, ROW_FILTER, RECORD_STATE(place));
#ifdef TRANSPARENT_SHADOWS
  set_row_f(paths, PATH_ROWS, at, ROW_TRAVELLED, zero_f());
#endif
  vf words[SLOT_WORDS];
  for (uint k = 0; k < SLOT_WORDS; ++k) words[k] = zero_f();
  words[SLOT_DIRECTION] = d.x;
  words[SLOT_DIRECTION + 1u] = d.y;
  scatter_words(slots, 1u, slot * SLOT_WORDS, words, SLOT_WORDS);
}

// The `count` rays from `base` on are at their first hits.
kernel WIDE void splat_first_hits(global const float* restrict paths, uint base, uint count,
                                  global float* restrict slots, uint slot_count) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  uint at = (base + first_lane) / LANES;
  vi hit = ((vu)first_lane + lane_index() < count) & ((row_u(paths, PATH_ROWS, at, ROW_META) & META_IDLE) == 0u) &
           (row_u(paths, PATH_ROWS, at, ROW_GEOMETRY) != GLEANER_NONE);
  vf nearness = pick(zero_f(), one_f() / max_f(row_f(paths, PATH_ROWS, at, ROW_FAR), (vf)1e-20f), hit);
  vu slot = pick_u((vu)slot_count, row_u(paths, PATH_ROWS, at, ROW_SLOT), hit);
  scatter_f(slots + SLOT_NEARNESS, slot * SLOT_WORDS, nearness);
}

#endif
