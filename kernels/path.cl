// The path tracer, as a wave of paths that moves in step. Stage kind "path".
//
//   repeat
//     camera_generate   new camera paths fill the room that ended ones left; fresh blocks: 16 paths of neighbours
//     trace             closest hits; fresh blocks as coherent packets, others one ray at a time
//     path_shade        emission with MIS; one light sample -> a shadow ray; one scattered ray, packed to the front
//     trace             any hit on the shadow rays
//     shadow_connect    light samples that arrived are added to their paths' slots
//   until no path is left
//   camera_resolve      slots are summed to the items' records, in the order of the samples
//
// camera_samples.cl and shadow_rays.h have the kernels of those names. Where light passes surfaces straight, trace
// (closest hits) and shadow_pass take turns on the shadow rays until none is left. With -D PATH_FILTER a partner method
// has some of the light, and the path tracer the rest (kernels/path_filter.h). Photon maps gather by paths of this file
// that leave places where a map is to be read, in `reads` (kernels/photon/gather.cl).
//
// What a path gathers depends on (scene, parameters, pixel, chunk, sample) alone: its random numbers are keyed by them,
// its slot is its own, and survivors are traced one by one, so neither their order nor the wave's size can be seen in
// the result.

#include "kernels/lights.h"
#include "kernels/transport/camera_samples.h"
#include "kernels/transport/shadow_rays.h"

// A block of paths at the end of their rays.
typedef struct {
  v3 origin, direction, throughput;
  vf segment_length;
  vf pdf, total;  // ROW_PDF and ROW_TOTAL
#ifdef TRANSPARENT_SHADOWS
  vf travelled;  // ROW_TRAVELLED
#endif
  vu slot, key, depth, diffuse_count, bounce, sample;
  vi specular_since;
  vi indirect;  // light found here is
} Path;

FN Path load_path(global const float* paths, uint block, vu meta) {
  Path path;
  path.origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  path.direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  path.throughput = row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT);
  path.pdf = row_f(paths, PATH_ROWS, block, ROW_PDF);
  path.total = row_f(paths, PATH_ROWS, block, ROW_TOTAL);
#ifdef TRANSPARENT_SHADOWS
  path.travelled = row_f(paths, PATH_ROWS, block, ROW_TRAVELLED);
#endif
  path.slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  path.key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  path.depth = meta & META_DEPTH_MASK;
  path.diffuse_count = (meta >> META_DIFFUSE) & 3u;
  path.specular_since = (meta & META_SPECULAR_SINCE) != 0u;
  path.bounce = (meta >> META_BOUNCE) & META_BOUNCE_MASK;
  path.sample = (meta >> META_SAMPLE) & META_SAMPLE_MASK;
  // Light counts as direct where it was reflected at most once, and then came straight.
  path.indirect = (path.diffuse_count > 1u) | ((path.diffuse_count == 1u) & path.specular_since);
  return path;
}

// Light that the path itself found. `seen`: what a camera path finds before any scattering is to stand apart.
FN void add_found(global float* slots, global float* features, bool seen, uint slot_count, const Path* path,
                  const PathFilter* filter, v3 found, vi active) {
  add_to_slots(slots, slot_count, path->slot, path->indirect, found, active);
  add_compensation(slots, slot_count, path->slot, found, active & filter->compensates);
  if (seen) add_seen(features, slot_count, path->slot, found, active & (path->depth == 0u));
}

#ifdef NEED_ENVIRONMENT
FN void find_environment(const Scene* scene, global float* slots, global float* features, bool seen, uint slot_count,
                         const Path* path, const PathFilter* filter, vi missed) {
  if (!any_lane(missed)) return;
  vf u, v;
  // Lanes that hold no path may hold anything, and what they look up must lie within the table all the same.
  v3 d = normalize3(pick3(uniform3(0.0f, 1.0f, 0.0f), path->direction, missed));
  environment_uv(d, &u, &v);
  v3 radiance = environment_radiance(scene, u, v);
  vf light = environment_pdf(scene, u, v, safe_sqrt(one_f() - d.y * d.y)) * environment_chance(scene, path->total);
  vf weight = pick(one_f(), power_heuristic(path->pdf, light), path->pdf > zero_f());
  add_found(slots, features, seen, slot_count, path, filter, scale3(mul3(path->throughput, radiance), weight),
            shows_emission(filter, missed));
}
#endif

#ifdef NEED_EMISSIVE_TRIANGLES
FN void find_emission(const Scene* scene, global float* slots, global float* features, bool seen, uint slot_count,
                      const Path* path, const PathFilter* filter, const Vertex* v) {
  const Hit* h = &v->hit;
  vu emitter = as_vu(h->first[TRIANGLE_EMITTER]);
  vi emits = v->active & shines_towards(h, path->direction) & (emitter != GLEANER_NONE);
  if (!any_lane(emits)) return;
  vf e[16];
  load_words(scene->emitters, pick_u((vu)0u, emitter, emits) * EMITTER_WORDS, e);
  v3 radiance = words3(e, EMITTER_RADIANCE);
#ifdef NEED_EMISSION_TEXTURES
  vu texture = material_u(scene, h->material, MATERIAL_EMISSION_TEXTURE);
  vi textured = emits & (texture != GLEANER_NONE);
  vf unused;
  radiance = pick3(radiance, mul3(radiance, texture_at(scene, h, texture, textured, &unused)), textured);
#endif
#ifdef NEED_ALPHA_EMITTERS
  radiance = scale3(radiance, v->surface.opacity);
#endif
#ifdef TRANSPARENT_SHADOWS
  // From where the direction was drawn.
  vf light = light_pdf(scene, e, sub3(path->origin, scale3(path->direction, path->travelled)), path->direction,
                       path->travelled + path->segment_length, path->total);
#else
  vf light = light_pdf(scene, e, path->origin, path->direction, path->segment_length, path->total);
#endif
  vf weight = pick(one_f(), power_heuristic(path->pdf, light), path->pdf > zero_f());
  add_found(slots, features, seen, slot_count, path, filter, scale3(mul3(path->throughput, radiance), weight),
            shows_emission(filter, emits));
}
#endif

// Lanes that a light sample can light: perfect mirrors and smooth glass cannot see it.
FN vi sees_lights(const Vertex* v, vi spent) {
  vi lit = v->active & none(v->passes) & none(spent);
  const Surface* m = &v->surface;
#ifdef NEED_TRANSMISSIVE
  vi opaque = m->transmission < one_f();
#ifdef NEED_ROUGH_TRANSMISSIVE
  opaque = opaque | scatters_through(m);
#endif
  lit = lit & opaque;
#endif
#ifdef NEED_LOBE
  // A bare mirror: no layer below and no rough lobe.
  vi bare = is_bare_mirror(m);
#ifdef NEED_ROUGH_TRANSMISSIVE
  bare = bare & none(scatters_through(m));
#endif
  lit = lit & none(bare);
#endif
  return lit;
}

#ifdef NEED_LIGHTS
// The reflectance (BSDF times cosine) towards a light, as far as the filter leaves it to the path tracer, and the
// density of scattering there. *seen: lanes whose surface light from there reaches.
FN v3 light_reflectance(const Scene* scene, const Vertex* v, const PathFilter* filter, float clamp_to, v3 direction,
                        vf* pdf, vi* seen) {
  const Surface* m = &v->surface;
  const ShadingFrame* frame = &v->frame;
  v3 toward = make3(dot3(frame->tangent, direction), dot3(frame->bitangent, direction), dot3(frame->normal, direction));
  *seen = toward.z > (vf)1e-6f;
  v3 f = eval_bsdf(scene, m, frame->view, make3(toward.x, toward.y, max_f(toward.z, (vf)1e-6f)), pdf);
  f = filter_reflectance(filter, scene, m, clamp_to, toward.z, f);
#ifdef NEED_TRANSMISSIVE
  f = scale3(f, one_f() - m->transmission);
  *pdf *= one_f() - m->transmission;
#endif
#ifdef NEED_ROUGH_TRANSMISSIVE
  vi scatters = scatters_through(m);
  if (any_lane(scatters)) {
    vf glass_pdf;
    v3 g = filter_sharp(filter, eval_transmissive(scene, m, frame->view, toward, &glass_pdf));
    vi through = scatters & (toward.z < (vf)-1e-6f);
    f = mad3(g, m->transmission, pick3(f, splat3(zero_f()), through));
    *pdf = fma(m->transmission, glass_pdf, pick(*pdf, zero_f(), through));
    *seen = *seen | through;
  }
#endif
#ifdef NEED_BENT_NORMALS
  f = scale3(f, geometric_share(frame, direction, toward.z));
#endif
  return f;
}
#endif

// `spent`: lanes of paths that may not scatter again.
OUTLINED Connection sample_direct_light(const Scene* scene, const Path* path, const PathFilter* filter, const Vertex* v,
                                        vi spent, float clamp_to, vu pair_key, vf u_choice) {
  Connection c;
  c.origin = v->hit.p;
  c.direction = path->direction;
  c.contribution = splat3(zero_f());
  c.far = (vf)-1.0f;
  c.total = one_f();
  c.connected = no_lanes();
  c.bits = pick_u((vu)0u, (vu)SHADOW_INDIRECT, path->diffuse_count > 0u) |
           pick_u((vu)0u, (vu)SHADOW_COMPENSATES, filter->compensates);
#ifdef NEED_MEDIA
  c.media = v->media;
#endif
#ifdef NEED_LIGHTS
  vi lit = sees_lights(v, spent);
  if (!any_lane(lit)) return c;
  vf l0, l1, pdf;
  sample_pair(pair_key, path->sample, GLEANER_PATH_SEQUENCE, 1u, &l0, &l1);
  LightSample light = sample_light(scene, v->hit.p, u_choice, l0, l1);
  c.total = light.total;
  vi seen;
  v3 f = light_reflectance(scene, v, filter, clamp_to, light.direction, &pdf, &seen);
  vf weight = power_heuristic(light.pdf, pdf);
  weight = pick(weight, one_f(), light.delta);
#ifdef FILTER_ENDS_AT_ONCE
  weight = one_f();
#endif
  c.contribution = scale3(mul3(mul3(path->throughput, f), light.radiance), weight / light.pdf);
  c.connected = lit & seen & (light.pdf > zero_f()) & (max_component(c.contribution) > zero_f());
  c.origin = offset_ray_origin(v->hit.p, v->hit.error, v->hit.geometric, light.direction);
  c.direction = pick3(sub3(light.target, c.origin), light.direction, light.infinite);
  c.far = pick((vf)-1.0f, pick((vf)SHADOW_FAR, (vf)INFINITY, light.infinite), c.connected);
#ifdef NEED_MEDIA
  vi beneath = dot3(v->frame.normal, light.direction) < zero_f();
  c.media.high = pick_u(v->media.high, v->beyond.high, beneath);
  c.media.low = pick_u(v->media.low, v->beyond.low, beneath);
#endif
#ifdef TRANSPARENT_SHADOWS
  c.bits |= pick_u((vu)0u, (vu)SHADOW_INFINITE, light.infinite);
#endif
#endif
  return c;
}

// What a path carries beside its ray.
typedef struct {
  vf pdf, total, eta, travelled, filter_state;
  vu diffuse_count;
  vi specular_since;
} Carried;

// One scattered ray. `eta`: ROW_ETA of the path. `total`: LightSample::total here.
OUTLINED NextRay scatter_path(const Scene* scene, const Path* path, const PathFilter* filter, Vertex* v, vi spent,
                              global const PathParameters* parameters, vu pair_key, vf u_lobe, vf u_glass,
                              vf u_roulette, vf eta, vf total, Carried* carried) {
  vf d0, d1;
  sample_pair(pair_key, path->sample, GLEANER_PATH_SEQUENCE, 3u, &d0, &d1);
  BsdfSample scattered = sample_bsdf(scene, &v->surface, v->frame.view, u_lobe, u_glass, d0, d1);
  vi specular = scattered.pdf <= zero_f();
  NextRay next;
  next.direction = scattered_direction(&v->frame, scattered.direction, specular);
  next.throughput = mul3(path->throughput, scattered.weight);
#ifdef NEED_BENT_NORMALS
  next.throughput = scale3(next.throughput,
                           pick(geometric_share(&v->frame, next.direction, scattered.direction.z), one_f(), specular));
#endif
  vi glass = no_lanes();
#ifdef NEED_TRANSMISSIVE
  glass = u_glass < v->surface.transmission;
#endif
  carried->filter_state = filter_scattering(filter, scene, v, parameters->clamp, scattered.direction, specular, glass,
                                            pair_key, path->sample, &next.throughput);
  v3 passed = pass_glass(v, &scattered, path->throughput, &next);
  carried->filter_state = filter_passing(filter, v, carried->filter_state);
  next.alive = v->active & none(v->passes) & none(spent) & (max_component(next.throughput) > zero_f()) &
               finite3(next.throughput) & finite3(next.direction);
  next.depth = min(path->depth + 1u, (vu)META_DEPTH_MASK);
#if !defined(NEED_EMISSIVE_TRIANGLES) && !defined(NEED_ENVIRONMENT) && !defined(NEED_UNLIT)
  // The last scattering's ray could find emission alone, and here is none.
  if (parameters->depth) next.alive = next.alive & (next.depth < parameters->depth);
#endif
  // Russian roulette on what the path still carries; radiance squeezed by refraction is taken at its worth outside.
  carried->eta = eta * scattered.eta;
  vf worth = max_component(next.throughput) * carried->eta * carried->eta;
  russian_roulette(&next, next.depth >= ROULETTE_DEPTH, min_f(worth, (vf)ROULETTE_MOST), u_roulette);
  carried->diffuse_count = min(path->diffuse_count + pick_u((vu)1u, (vu)0u, specular), (vu)2u);
  carried->specular_since = specular;
  carried->pdf = scattered.pdf;
  carried->total = total;
#if defined(NEED_ALPHA) || defined(PASSES_GLASS)
  carried->diffuse_count = pick_u(carried->diffuse_count, path->diffuse_count, v->passes);
  carried->specular_since = (specular & none(v->passes)) | (path->specular_since & v->passes);
  carried->eta = pick(carried->eta, eta, v->passes);
#ifdef TRANSPARENT_SHADOWS
  carried->travelled = pick(zero_f(), path->travelled + path->segment_length, v->passes);
  carried->pdf = pick(carried->pdf, path->pdf, v->passes);
  carried->total = pick(carried->total, path->total, v->passes);
#else
  carried->pdf = pick(carried->pdf, zero_f(), v->passes);
#endif
#endif
  leave_vertex(v, path->direction, passed, path->depth, &next);
  next.alive = next.alive & (path->bounce + 1u <= (vu)META_BOUNCE_MASK);
  return next;
}

// Survivors, packed from `place` on; lanes that ended write behind the wave, where nobody reads.
FN void write_survivors(global float* paths, uint capacity, uint place, vu rank, const Path* path, const NextRay* ray,
                        const Carried* carried, const Vertex* v) {
  vu to = ray_address(pick_u((vu)capacity, (vu)place + rank, ray->alive), PATH_ROWS);
  vu meta = ray->depth | (carried->diffuse_count << META_DIFFUSE) |
            pick_u((vu)0u, (vu)META_SPECULAR_SINCE, carried->specular_since) | ((path->bounce + 1u) << META_BOUNCE) |
            (path->sample << META_SAMPLE);
  vf rows[PATH_ROWS];
  put_ray(rows, ray->origin, ray->direction, (vf)INFINITY, v->primitive, hit_instance(&v->hit));
  rows[ROW_GEOMETRY] = as_vf((vu)GLEANER_NONE);
  rows[ROW_INSTANCE] = zero_f();
  put_words3(rows, ROW_THROUGHPUT, ray->throughput);
  rows[ROW_PDF] = carried->pdf;
  rows[ROW_TOTAL] = carried->total;
  rows[ROW_SLOT] = as_vf(path->slot);
  rows[ROW_META] = as_vf(meta);
  rows[ROW_KEY] = as_vf(path->key);
  rows[ROW_ETA] = carried->eta;
  rows[ROW_FILTER] = carried->filter_state;
#ifdef TRANSPARENT_SHADOWS
  rows[ROW_TRAVELLED] = carried->travelled;
#endif
#ifdef NEED_MEDIA
  rows[ROW_MEDIA] = as_vf(ray->media.high);
  rows[ROW_MEDIA + 1u] = as_vf(ray->media.low);
#endif
  store_path(paths, to, rows);
}

#ifdef PHOTON_GATHER
// Where the map is read for these paths, in the place of each.
FN void write_reads(global float* reads, uint block, const Path* path, const PathFilter* filter, const Vertex* v,
                    uint slot_count, uint most) {
  const Surface* m = &v->surface;
  v3 factor = scale3(mul3(path->throughput, layer_albedo(m)), (vf)INV_PI);
#ifdef NEED_TRANSMISSIVE
  factor = scale3(factor, one_f() - m->transmission);
#endif
  vi reading = (filter->reads | filter->reads_caustics) & v->active & none(v->passes) &
               (max_component(factor) > zero_f()) & finite3(factor);
  vf w[READ_WORDS];
  put_words3(w, READ_POSITION, v->hit.p);
  put_words3(w, READ_GEOMETRIC, v->frame.geometric);
  put_words3(w, READ_NORMAL, v->frame.normal);
  w[READ_TABLE] = as_vf((vu)GLEANER_NONE);
  w[READ_ROW] = zero_f();
#ifdef NEED_LOBE
  w[READ_TABLE] = as_vf(m->table);
  w[READ_ROW] = m->table_row;
#endif
  put_words3(w, READ_FACTOR, factor);
  w[READ_SLOT] = as_vf(pick_u((vu)slot_count, path->slot, reading));
  vu limits = min(scatterings_left(most, path->depth), (vu)PHOTON_MOST_DEPTH);
  w[READ_LIMITS] = as_vf(limits | pick_u((vu)READ_CAUSTICS, (vu)0u, filter->reads));
  store_words(reads, ((vu)(block * LANES) + lane_index()) * READ_WORDS, w);
}
#endif

// Of a block without any shadow ray.
FN void write_no_connection(global float* shadows, uint block, uint slot_count) {
  set_row_f(shadows, SHADOW_ROWS, block, ROW_FAR, (vf)-1.0f);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, (vu)slot_count);
}

// Of a block whose paths all end here, before any of them reads a map.
FN void write_end(global float* shadows, global float* reads, uint block, uint slot_count) {
  write_no_connection(shadows, block, slot_count);
#ifdef PHOTON_GATHER
  scatter_u((global uint*)reads + READ_SLOT, ((vu)(block * LANES) + lane_index()) * READ_WORDS, (vu)slot_count);
#endif
}

// `reads`: of PHOTON_GATHER alone.
kernel WIDE void path_shade(global const PathParameters* restrict parameters, SCENE_PARAMETERS, uint survivors,
                            uint fresh_base, uint fresh_count, global const float* restrict paths,
                            global float* restrict next, global float* restrict shadows, global float* slots,
                            global float* features, uint slot_count, uint capacity, global uint* counters,
                            global float* reads) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= (fresh_count ? fresh_base + fresh_count : survivors)) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi active = wave_lanes(block, meta, survivors, fresh_base, fresh_count);
  Path path = load_path(paths, block, meta);
  PathFilter filter = load_filter(paths, block);
  vi hit = active & (row_u(paths, PATH_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  bool apart = parameters->seen == PATH_SEEN_APART, alone = parameters->seen == PATH_SEEN_ALONE;
#ifdef NEED_ENVIRONMENT
  find_environment(scene, slots, features, apart, slot_count, &path, &filter, active & none(hit));
#endif
  if (!any_lane(hit)) {
    write_end(shadows, reads, block, slot_count);
    return;
  }
  Vertex v = meet_surface(scene, paths, PATH_ROWS, block, hit);
  path.segment_length = length3(sub3(v.hit.p, path.origin));
  path.throughput = through_media(scene, &v, paths, block, path.origin, path.direction, path.throughput);
#ifdef NEED_EMISSIVE_TRIANGLES
  find_emission(scene, slots, features, apart, slot_count, &path, &filter, &v);
#endif
  if (parameters->features)
    write_features(features, slot_count, path.slot, path.direction, path.segment_length, &v,
                   v.active & (path.bounce == 0u));

  vu pair_key = hash_combine(path.key, path.bounce * 4u + 1u);
  vf u_lobe, u_glass, u_choice, u_roulette;
  sample_pair(pair_key, path.sample, GLEANER_PATH_SEQUENCE, 2u, &u_lobe, &u_glass);
  v.passes = stochastic_alpha(&v.surface, v.active, &u_glass);
#ifdef NEED_UNLIT
  vi unlit = v.active & none(v.passes) & ((as_vu(v.hit.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) != 0u);
  if (any_lane(unlit))
    add_found(slots, features, apart, slot_count, &path, &filter, mul3(path.throughput, v.surface.base),
              shows_unlit(&filter, unlit));
  v.active = v.active & none(unlit);
#endif
  uint most = parameters->depth;
  vi spent = no_lanes();
#ifdef PASSES_GLASS
  // Paths that may not scatter again may still go straight on.
  spent = v.active & none(v.passes) & (path.depth >= (vu)most) & ((vu)most != 0u);
  if (alone) spent = v.active & none(v.passes);
#else
  if (most) v.active = v.active & ((path.depth < most) | v.passes);
  if (alone) v.active = v.active & v.passes;
#endif
  if (alone && !any_lane(v.active)) {
    write_end(shadows, reads, block, slot_count);
    return;
  }
  filter_vertex(&filter, parameters->clamp, path.origin, path.direction, &v);
  prepare_scattering(scene, &v, path.direction);
#ifdef PASSES_GLASS
  v.active = v.active & (none(spent) | is_passable(&v.surface));
#endif
#ifdef PHOTON_GATHER
  write_reads(reads, block, &path, &filter, &v, slot_count, most);
  // Of lanes too whose neighbours go on: what is left of their light is roundings.
  v.active = goes_on(&filter, &v);
  if (!any_lane(v.active)) {
    write_no_connection(shadows, block, slot_count);
    return;
  }
#endif

  sample_pair(pair_key, path.sample, GLEANER_PATH_SEQUENCE, 0u, &u_choice, &u_roulette);
  Connection c = sample_direct_light(scene, &path, &filter, &v, spent, parameters->clamp, pair_key, u_choice);
  write_connection(shadows, block, &c, &v, path.slot, slot_count);
#ifdef FILTER_ENDS_AT_ONCE
  uint sampled;
  rank_lanes(c.connected, &sampled);
  if (sampled) atomic_add(counters + COUNTER_SHADOW, sampled);
#else
  Carried carried;
  NextRay ray = scatter_path(scene, &path, &filter, &v, spent, parameters, pair_key, u_lobe, u_glass, u_roulette,
                             row_f(paths, PATH_ROWS, block, ROW_ETA), c.total, &carried);
  uint kept, asked;
  vu rank = rank_lanes(ray.alive, &kept);
  rank_lanes(c.connected, &asked);
  if (asked) atomic_add(counters + COUNTER_SHADOW, asked);
  if (kept == 0u) return;
  uint place = atomic_add(counters + COUNTER_ALIVE, kept);
  write_survivors(next, capacity, place, rank, &path, &ray, &carried, &v);
#endif
}
