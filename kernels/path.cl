// The path tracer, as a wave of paths that moves in step. Stage kind "path".
//
//   repeat
//     path_generate   new camera paths fill the room that ended ones left; fresh blocks: 16 paths of neighbours
//     trace           closest hits; fresh blocks as coherent packets, others one ray at a time
//     path_shade      emission with MIS; one light sample -> a shadow ray; one scattered ray, packed to the front
//     trace           any hit on the shadow rays
//     path_connect    light samples that arrived are added to their paths' slots
//   until no path is left
//   path_resolve      slots are summed to the items' records, in the order of the samples
//
// Where light passes surfaces straight, trace (closest hits) and path_pass take turns on the shadow rays until none is
// left. With -D PATH_FILTER a partner method has some of the light, and the path tracer the rest
// (kernels/path_filter.h).
//
// What a path gathers depends on (scene, parameters, pixel, chunk, sample) alone: its random numbers are keyed by them,
// its slot is its own, and survivors are traced one by one, so neither their order nor the wave's size can be seen in
// the result.

#include "kernels/camera.h"
#include "kernels/lights.h"
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
kernel WIDE void path_generate(global const PathParameters* restrict parameters, global const uint* restrict items,
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
  set_ray(paths, PATH_ROWS, at, origin, direction, pick((vf)INFINITY, (vf)-1.0f, idle), (vu)GLEANER_NONE);
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

// Light that the path itself found.
FN void add_found(global float* slots, uint slot_count, const Path* path, const PathFilter* filter, v3 found,
                  vi active) {
  active = shows_emission(filter, active);
  add_to_slots(slots, slot_count, path->slot, path->indirect, found, active);
  add_compensation(slots, slot_count, path->slot, found, active & filter->compensates);
}

#ifdef NEED_ENVIRONMENT
FN void find_environment(const Scene* scene, global float* slots, uint slot_count, const Path* path,
                         const PathFilter* filter, vi missed) {
  if (!any_lane(missed)) return;
  vf u, v;
  // Lanes that hold no path may hold anything, and what they look up must lie within the table all the same.
  v3 d = normalize3(pick3(uniform3(0.0f, 1.0f, 0.0f), path->direction, missed));
  environment_uv(d, &u, &v);
  v3 radiance = environment_radiance(scene, u, v);
  vf light = environment_pdf(scene, u, v, safe_sqrt(one_f() - d.y * d.y)) * environment_chance(scene, path->total);
  vf weight = pick(one_f(), power_heuristic(path->pdf, light), path->pdf > zero_f());
  add_found(slots, slot_count, path, filter, scale3(mul3(path->throughput, radiance), weight), missed);
}
#endif

#ifdef NEED_EMISSIVE_TRIANGLES
FN void find_emission(const Scene* scene, global float* slots, uint slot_count, const Path* path,
                      const PathFilter* filter, const Vertex* v) {
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
  add_found(slots, slot_count, path, filter, scale3(mul3(path->throughput, radiance), weight), emits);
}
#endif

// What a camera ray met first.
FN void write_features(global float* features, uint slot_count, const Path* path, const Vertex* v) {
  vi first_hit = v->active & (path->bounce == 0u);
  if (!any_lane(first_hit)) return;
  vf words[FEATURE_WORDS];
  put_words3(words, 0u, v->surface.base);
  v3 n = v->hit.normal;
  put_words3(words, 3u, pick3(n, negate3(n), dot3(n, path->direction) > zero_f()));
  words[6] = path->segment_length;
  words[7] = one_f();
  scatter_words(features, 1u, pick_u((vu)slot_count, path->slot, first_hit) * FEATURE_WORDS, words, FEATURE_WORDS);
}

// A light sample: its shadow ray, and what it adds to the path's slot if nothing is in the way.
typedef struct {
  v3 origin, direction, contribution;
  vf far;    // not positive: no ray
  vf total;  // LightSample::total here
  vu bits;   // SHADOW_...
  vi connected;
#ifdef NEED_MEDIA
  Media media;  // where the ray begins
#endif
} Connection;

// Lanes that a light sample can light: perfect mirrors and smooth glass cannot see it.
FN vi sees_lights(const Vertex* v, vi spent) {
  vi lit = v->active & none(v->passes) & none(spent);
  const Surface* m = &v->surface;
#ifdef NEED_TRANSMISSIVE
  vi opaque = m->transmission < one_f();
#ifdef NEED_ROUGH_TRANSMISSIVE
  opaque = opaque | m->blurs;
#endif
  lit = lit & opaque;
#endif
#ifdef NEED_LOBE
  // A bare mirror: no layer below and no rough lobe.
  vi bare = is_bare_mirror(m);
#ifdef NEED_ROUGH_TRANSMISSIVE
  bare = bare & none(m->blurs);
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
  if (any_lane(m->blurs)) {
    vf glass_pdf;
    v3 g = filter_sharp(filter, eval_glass(m, frame->view, toward, &glass_pdf));
    vi through = m->blurs & (toward.z < (vf)-1e-6f);
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
FN Connection sample_direct_light(const Scene* scene, const Path* path, const PathFilter* filter, const Vertex* v,
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

FN void write_connection(global float* shadows, uint block, const Connection* c, vu primitive, vu slot,
                         uint slot_count) {
  set_ray(shadows, SHADOW_ROWS, block, c->origin, c->direction, c->far, primitive);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION, c->contribution);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, pick_u((vu)slot_count, slot | c->bits, c->connected));
#ifdef TRANSPARENT_SHADOWS
  set_row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
#ifdef NEED_MEDIA
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA, c->media.high);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA + 1u, c->media.low);
#endif
#endif
}

// What a path carries beside its ray.
typedef struct {
  vf pdf, total, eta, travelled, filter_state;
  vu diffuse_count;
  vi specular_since;
} Carried;

// One scattered ray. `eta`: ROW_ETA of the path. `total`: LightSample::total here.
FN NextRay scatter_path(const Scene* scene, const Path* path, const PathFilter* filter, Vertex* v, vi spent,
                        global const PathParameters* parameters, vu pair_key, vf u_lobe, vf u_glass, vf u_roulette,
                        vf eta, vf total, Carried* carried) {
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
                        const Carried* carried, vu primitive) {
  vu to = ray_address(pick_u((vu)capacity, (vu)place + rank, ray->alive), PATH_ROWS);
  vu meta = ray->depth | (carried->diffuse_count << META_DIFFUSE) |
            pick_u((vu)0u, (vu)META_SPECULAR_SINCE, carried->specular_since) | ((path->bounce + 1u) << META_BOUNCE) |
            (path->sample << META_SAMPLE);
  vf rows[PATH_ROWS];
  put_ray(rows, ray->origin, ray->direction, (vf)INFINITY, primitive);
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
  scatter_words(paths, RAY_BLOCK, to, rows, RAY_ROWS);
  scatter_words(paths + RAY_BLOCK * ROW_GEOMETRY, RAY_BLOCK, to, rows + ROW_GEOMETRY, PATH_ROWS - ROW_GEOMETRY);
}

kernel WIDE void path_shade(global const PathParameters* restrict parameters, SCENE_PARAMETERS, uint survivors,
                            uint fresh_base, uint fresh_count, global const float* restrict paths,
                            global float* restrict next, global float* restrict shadows, global float* slots,
                            global float* features, uint slot_count, uint capacity, global uint* counters) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  uint end = fresh_count ? fresh_base + fresh_count : survivors;
  if (first_lane >= end) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu lane = (vu)first_lane + lane_index();
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi active = ((lane < survivors) | ((lane >= fresh_base) & (lane < end))) & ((meta & META_IDLE) == 0u);
  Path path = load_path(paths, block, meta);
  PathFilter filter = load_filter(paths, block);
  vi hit = active & (row_u(paths, PATH_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
#ifdef NEED_ENVIRONMENT
  find_environment(scene, slots, slot_count, &path, &filter, active & none(hit));
#endif
  if (!any_lane(hit)) {
    set_row_f(shadows, SHADOW_ROWS, block, ROW_FAR, (vf)-1.0f);
    set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, (vu)slot_count);
    return;
  }
  Vertex v = meet_surface(scene, paths, PATH_ROWS, block, hit);
  path.segment_length = length3(sub3(v.hit.p, path.origin));
  path.throughput = through_media(scene, &v, paths, block, path.origin, path.direction, path.throughput);
#ifdef NEED_EMISSIVE_TRIANGLES
  find_emission(scene, slots, slot_count, &path, &filter, &v);
#endif
  if (parameters->features) write_features(features, slot_count, &path, &v);

  vu pair_key = hash_combine(path.key, path.bounce * 4u + 1u);
  vf u_lobe, u_glass, u_choice, u_roulette;
  sample_pair(pair_key, path.sample, GLEANER_PATH_SEQUENCE, 2u, &u_lobe, &u_glass);
  v.passes = stochastic_alpha(&v.surface, v.active, &u_glass);
#ifdef NEED_UNLIT
  vi unlit = v.active & none(v.passes) & ((as_vu(v.hit.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) != 0u);
  if (any_lane(unlit)) add_found(slots, slot_count, &path, &filter, mul3(path.throughput, v.surface.base), unlit);
  v.active = v.active & none(unlit);
#endif
  uint most = parameters->depth;
  vi spent = no_lanes();
#ifdef PASSES_GLASS
  // Paths that may not scatter again may still go straight on.
  spent = v.active & none(v.passes) & (path.depth >= (vu)most) & ((vu)most != 0u);
#else
  if (most) v.active = v.active & ((path.depth < most) | v.passes);
#endif
  filter_vertex(&filter, parameters->clamp, path.origin, path.direction, &v);
  prepare_scattering(scene, &v, path.direction);
#ifdef PASSES_GLASS
  v.active = v.active & (none(spent) | is_passable(&v.surface));
#endif

  sample_pair(pair_key, path.sample, GLEANER_PATH_SEQUENCE, 0u, &u_choice, &u_roulette);
  Connection c = sample_direct_light(scene, &path, &filter, &v, spent, parameters->clamp, pair_key, u_choice);
  write_connection(shadows, block, &c, v.primitive, path.slot, slot_count);
  Carried carried;
  NextRay ray = scatter_path(scene, &path, &filter, &v, spent, parameters, pair_key, u_lobe, u_glass, u_roulette,
                             row_f(paths, PATH_ROWS, block, ROW_ETA), c.total, &carried);
  uint kept, asked;
  vu rank = rank_lanes(ray.alive, &kept);
  rank_lanes(c.connected, &asked);
  if (asked) atomic_add(counters + COUNTER_SHADOW, asked);
  if (kept == 0u) return;
  uint place = atomic_add(counters + COUNTER_ALIVE, kept);
  write_survivors(next, capacity, place, rank, &path, &ray, &carried, v.primitive);
}

#ifdef TRANSPARENT_SHADOWS

// Shadow rays and their closest hits: adds the light samples that arrived, and sends on, weakened, those that met a
// surface which light passes straight.
kernel WIDE void path_pass(global float* restrict shadows, global float* restrict slots, uint slot_count, uint count,
                           global uint* counters, SCENE_PARAMETERS) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu slot = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT);
  vi asked = (slot != slot_count) & ((vu)(block * LANES) + lane_index() < count);
  if (!any_lane(asked)) return;
  vi infinite = (slot & SHADOW_INFINITE) != 0u;
  // A tracer that looks on behind the ray's own source may come back with a hit beyond the light.
  vi hit = asked & (row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE) &
           (infinite | (row_f(shadows, SHADOW_ROWS, block, ROW_FAR) <= (vf)SHADOW_FAR));
  v3 contribution = row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION);
  v3 origin = row_3(shadows, SHADOW_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(shadows, SHADOW_ROWS, block, ROW_DIRECTION);
  vu primitive = pick_u((vu)0u, row_u(shadows, SHADOW_ROWS, block, ROW_PRIMITIVE), hit);
  Hit h = load_hit(scene, primitive, row_f(shadows, SHADOW_ROWS, block, ROW_U),
                   row_f(shadows, SHADOW_ROWS, block, ROW_V), hit);
#ifdef NEED_MEDIA
  Media media;
  media.high = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA);
  media.low = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA + 1u);
  media = media_at_end(media, &h, scene, meets_back(&h, direction), hit);
  vf reach = pick(length3(direction), (vf)INFINITY, infinite);
  reach = pick(reach, length3(sub3(h.p, origin)), hit);
  contribution = mul3(contribution, absorption(scene, media, reach, asked));
#endif
  vi arrived = asked & none(hit);
  if (any_lane(arrived)) {
    add_to_slots(slots, slot_count, slot & ~SHADOW_BITS, (slot & SHADOW_INDIRECT) != 0u, contribution, arrived);
    add_compensation(slots, slot_count, slot & ~SHADOW_BITS, contribution,
                     arrived & ((slot & SHADOW_COMPENSATES) != 0u));
  }

  vi passes = hit;
  Surface m;
  load_color(scene, &h, &m, passes);
  vf cosine = one_f();
#ifdef PASSES_GLASS
  load_lobes(scene, &h, &m, passes);
  ShadingFrame frame = shading_frame(&h, normalize3(direction));
  set_side(&m, frame.from_back);
  cosine = frame.view.z;
#endif
#ifdef NEED_MEDIA
  Media beyond = media_beyond(media, &h, scene, frame.from_back, passes);
  set_boundary(scene, &m, media, beyond, passes);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA, beyond.high);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA + 1u, beyond.low);
#endif
  contribution = mul3(contribution, straight_share(&m, cosine));
  passes = passes & (max_component(contribution) > zero_f());
  v3 start = offset_ray_origin(h.p, h.error, h.geometric, direction);
  passes = passes & finite3(start);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_ORIGIN, start);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_DIRECTION,
            pick3(sub3(add3(origin, direction), start), direction, infinite));
  set_row_f(shadows, SHADOW_ROWS, block, ROW_NEAR, zero_f());
  set_row_f(shadows, SHADOW_ROWS, block, ROW_FAR,
            pick((vf)-1.0f, pick((vf)SHADOW_FAR, (vf)INFINITY, infinite), passes));
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SOURCE, primitive);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION, contribution);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, pick_u((vu)slot_count, slot, passes));
  uint passing;
  rank_lanes(passes, &passing);
  if (passing) atomic_add(counters + COUNTER_SHADOW, passing);
}

#else

// Adds the light samples whose shadow rays met nothing.
kernel WIDE void path_connect(global const float* restrict shadows, global float* restrict slots, uint slot_count,
                              uint count) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  vu slot = row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT);
  // Embree and our own tracer set `far` to minus infinity where something is in the way.
  vi arrived = (row_f(shadows, SHADOW_ROWS, block, ROW_FAR) > zero_f()) & (slot != slot_count) &
               ((vu)(block * LANES) + lane_index() < count);
  if (!any_lane(arrived)) return;
  vi indirect = (slot & SHADOW_INDIRECT) != 0u;
  v3 contribution = row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION);
  add_to_slots(slots, slot_count, slot & ~SHADOW_BITS, indirect, contribution, arrived);
  add_compensation(slots, slot_count, slot & ~SHADOW_BITS, contribution, arrived & ((slot & SHADOW_COMPENSATES) != 0u));
}

#endif

#ifdef PATH_FILTER
#define SUMS 9u
#else
#define SUMS 6u
#endif

// Sums each item's samples in their order. Samples that are not finite are left out and reported.
kernel void path_resolve(global const PathParameters* restrict parameters, uint first_item_low, uint first_item_high,
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
    int fine = 1;
    for (uint k = 0; k < SUMS; ++k) fine = fine && fabs(slot[k]) <= 3.402823466e38f;
    if (fine)
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
  if (lost) {
    atomic_add(report, lost);
    uint at = atomic_inc(report + 1);
    if (at < REPORTED_ITEMS) report[2 + at] = item;
  }
}
