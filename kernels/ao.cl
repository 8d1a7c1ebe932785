// Ambient occlusion: the cosine-weighted share of the hemisphere over a surface that nothing within a radius hides.
// Stage kind "ao".
//
//   repeat
//     camera_generate   new camera rays fill the room that ended ones left
//     trace             closest hits
//     ao_meet           rays that met nothing see it all; the rest end at a point, or pass where alpha lets them
//     for each of a sample's rays
//       ao_ray          a cosine-distributed ray of the radius' length from every point
//       trace           any hit
//       shadow_connect  rays that met nothing add their share to the sample
//   until no ray is left
//   camera_resolve      samples are summed to the items' records
//
// camera_samples.cl and shadow_rays.h have the kernels of those names. The rays are shadow rays: alpha and thin panes
// weaken them as they weaken light.

#include "kernels/ao_records.h"
#include "kernels/transport/camera_samples.h"
#include "kernels/transport/shadow_rays.h"

// Rays that pass a surface unscattered, packed to the front of `next`; `counters` gets their number.
FN void pass_on(global float* next, uint capacity, global uint* counters, const Vertex* v, v3 direction, vu slot,
                vu meta, vu key) {
  uint kept;
  v3 origin = offset_ray_origin(v->hit.p, v->hit.error, v->hit.geometric, direction);
  vi alive = v->passes & finite3(origin) & (((meta >> META_BOUNCE) & META_BOUNCE_MASK) < (vu)META_BOUNCE_MASK);
  vu rank = rank_lanes(alive, &kept);
  if (kept == 0u) return;
  uint place = atomic_add(counters + COUNTER_ALIVE, kept);
  vf rows[PATH_ROWS];
  for (uint k = 0; k < PATH_ROWS; ++k) rows[k] = zero_f();
  put_ray(rows, origin, direction, (vf)INFINITY, v->primitive, hit_instance(&v->hit));
  rows[ROW_GEOMETRY] = as_vf((vu)GLEANER_NONE);
  rows[ROW_SLOT] = as_vf(slot);
  rows[ROW_META] = as_vf(meta + (1u << META_BOUNCE));
  rows[ROW_KEY] = as_vf(key);
  store_path(next, ray_address(pick_u((vu)capacity, (vu)place + rank, alive), PATH_ROWS), rows);
}

// Afterwards the lanes of `paths` that are not idle hold a point of a surface.
kernel WIDE void ao_meet(global const AoParameters* restrict parameters, SCENE_PARAMETERS, uint survivors,
                         uint fresh_base, uint fresh_count, global float* restrict paths, global float* restrict next,
                         global float* slots, global float* features, uint slot_count, uint capacity,
                         global uint* counters) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= (fresh_count ? fresh_base + fresh_count : survivors)) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi active = wave_lanes(block, meta, survivors, fresh_base, fresh_count);
  vi hit = active & (row_u(paths, PATH_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  vu slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  vi missed = active & none(hit);
  if (any_lane(missed)) add_to_slots(slots, slot_count, slot, no_lanes(), splat3(one_f()), missed);
  v3 origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  vu key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  Vertex v = meet_surface(scene, paths, PATH_ROWS, block, hit);
  vu bounce = (meta >> META_BOUNCE) & META_BOUNCE_MASK;
  if (parameters->samples.features)
    write_features(features, slot_count, slot, direction, length3(sub3(v.hit.p, origin)), &v,
                   v.active & (bounce == 0u));
#ifdef NEED_ALPHA
  vf unused, u_alpha;
  sample_pair(hash_combine(key, bounce * 4u + 1u), (meta >> META_SAMPLE) & META_SAMPLE_MASK, GLEANER_PATH_SEQUENCE, 2u,
              &unused, &u_alpha);
  v.passes = stochastic_alpha(&v.surface, v.active, &u_alpha);
  pass_on(next, capacity, counters, &v, direction, slot, meta, key);
#endif
  set_row_u(paths, PATH_ROWS, block, ROW_META, pick_u((vu)META_IDLE, meta, hit & none(v.passes)));
}

// Ray number `ray` of every sample.
kernel WIDE void ao_ray(global const AoParameters* restrict parameters, SCENE_PARAMETERS, uint survivors,
                        uint fresh_base, uint fresh_count, global const float* restrict paths,
                        global float* restrict shadows, uint slot_count, global uint* counters, uint ray) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= (fresh_count ? fresh_base + fresh_count : survivors)) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi points = wave_lanes(block, meta, survivors, fresh_base, fresh_count);
  Vertex v = meet_surface(scene, paths, PATH_ROWS, block, points);
  v.frame = shading_frame(&v.hit, row_3(paths, PATH_ROWS, block, ROW_DIRECTION));
  vf u0, u1;
  // Camera rays take the keys 4 bounce + 1.
  sample_pair(hash_combine(row_u(paths, PATH_ROWS, block, ROW_KEY), (vu)(ray * 4u + 2u)),
              (meta >> META_SAMPLE) & META_SAMPLE_MASK, GLEANER_PATH_SEQUENCE, 0u, &u0, &u1);
  v3 scattered = sample_cosine(u0, u1);
  v3 direction = from_frame(&v.frame, scattered);
  vf share = (vf)(1.0f / (float)parameters->rays);
#ifdef NEED_BENT_NORMALS
  share *= geometric_share(&v.frame, direction, scattered.z);
#endif
  float radius = parameters->radius;
  Connection c;
  c.origin = offset_ray_origin(v.hit.p, v.hit.error, v.hit.geometric, direction);
  c.direction = radius > 0.0f ? scale3(direction, (vf)radius) : direction;
  c.contribution = splat3(share);
  c.connected = points & (v.frame.view.z > (vf)1e-6f) & (share > zero_f());
  c.far = pick((vf)-1.0f, (vf)(radius > 0.0f ? SHADOW_FAR : INFINITY), c.connected);
  c.total = one_f();
  c.bits = (vu)(radius > 0.0f ? 0u : SHADOW_INFINITE);
#ifdef NEED_MEDIA
  c.media = media_of(0u, 0u);
#endif
  write_connection(shadows, block, &c, &v, row_u(paths, PATH_ROWS, block, ROW_SLOT), slot_count);
  uint asked;
  rank_lanes(c.connected, &asked);
  if (asked) atomic_add(counters + COUNTER_SHADOW, asked);
}
