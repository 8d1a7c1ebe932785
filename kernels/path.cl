// The path tracer, as a wave of paths that moves in step:
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
// left.
//
// What a path gathers depends on (scene, parameters, pixel, chunk, sample) alone: its random numbers are keyed by them,
// its slot is its own, and survivors are traced one by one, so neither their order nor the wave's size can be seen in
// the result.

#include "kernels/camera.h"
#include "kernels/lights.h"
#include "kernels/path_layout.h"
#include "kernels/path_records.h"
#include "kernels/surface.h"
#include "kernels/wide.h"

// Fields of PathParameters are read one by one: the struct itself never lands in registers.
FN void add_to_slots(global float* slots, uint slot_count, vu slot, vi indirect, v3 value, vi active) {
  // Lanes with nothing to add write to a slot that nobody reads.
  vu at = pick_u((vu)slot_count, slot, active) * SLOT_WORDS + pick_u((vu)0u, (vu)SLOT_INDIRECT, indirect & active);
  v3 sum = add3(gather3(slots, at), value);
  scatter_f(slots, at, sum.x);
  scatter_f(slots + 1, at, sum.y);
  scatter_f(slots + 2, at, sum.z);
}

#ifdef COVERED
// What bounding the geometry term takes of it, in lanes whose light comes from a virtual point light's place.
FN vf clamped_share(float clamp_to, vf geometry, vi straight) {
  return pick(one_f(), clamp_f(one_f() - clamp_to / geometry, zero_f(), one_f()), straight);
}

FN void add_clamped(global float* slots, uint slot_count, vu slot, v3 value, vi active) {
  if (any_lane(active)) add_to_slots(slots + (SLOT_CLAMPED - SLOT_INDIRECT), slot_count, slot, active, value, active);
}
#else
FN void add_clamped(global float* slots, uint slot_count, vu slot, v3 value, vi active) {}
#endif

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
#ifdef COVERED
  set_row_f(paths, PATH_ROWS, at, ROW_COVER, zero_f());
#endif
  for (uint k = 0; k < SLOT_WORDS; ++k)
    store_f(slots + (ulong)SLOT_WORDS * (first_path + first_lane) + k * LANES, 0, zero_f());
  if (parameters->features)
    for (uint k = 0; k < FEATURE_WORDS; ++k)
      store_f(features + (ulong)FEATURE_WORDS * (first_path + first_lane) + k * LANES, 0, zero_f());
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
  v3 origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  v3 throughput = row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT);
  vf last_pdf = row_f(paths, PATH_ROWS, block, ROW_PDF);
  vf last_total = row_f(paths, PATH_ROWS, block, ROW_TOTAL);
  vu slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  vu key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  vu depth = meta & META_DEPTH_MASK;
  vu diffuse_count = (meta >> META_DIFFUSE) & 3u;
  vi specular_since = (meta & META_SPECULAR_SINCE) != 0u;
  vu bounce = (meta >> META_BOUNCE) & META_BOUNCE_MASK;
  vu sample = (meta >> META_SAMPLE) & META_SAMPLE_MASK;
#ifdef COVERED
  vf cover = row_f(paths, PATH_ROWS, block, ROW_COVER);
  vi clamped = cover < (vf)(0.5f * (COVER_FREE + COVER_CLAMPED));
#else
  vi clamped = no_lanes();
#endif
  // Light found from here counts as direct where it was reflected at most once, and then came straight.
  vi found_indirect = (diffuse_count > 1u) | ((diffuse_count == 1u) & specular_since);

  vi hit = active & (row_u(paths, PATH_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  vu primitive = pick_u((vu)0u, row_u(paths, PATH_ROWS, block, ROW_PRIMITIVE), hit);
  vu triangle = primitive * TRIANGLE_WORDS;

#ifdef NEED_ENVIRONMENT
  vi missed = active & none(hit);
  if (any_lane(missed)) {
    vf u, v;
    // Lanes that hold no path may hold anything, and what they look up must lie within the table all the same.
    v3 d = normalize3(pick3(uniform3(0.0f, 1.0f, 0.0f), direction, missed));
    environment_uv(d, &u, &v);
    v3 radiance = environment_radiance(scene, u, v);
    vf light = environment_pdf(scene, u, v, safe_sqrt(one_f() - d.y * d.y)) * environment_chance(scene, last_total);
    vf weight = pick(one_f(), power_heuristic(last_pdf, light), last_pdf > zero_f());
    v3 found = scale3(mul3(throughput, radiance), weight);
    add_to_slots(slots, slot_count, slot, found_indirect, found, missed);
    add_clamped(slots, slot_count, slot, found, missed & clamped);
  }
#endif
  active = hit;
  if (!any_lane(active)) {
    set_row_f(shadows, SHADOW_ROWS, block, ROW_FAR, (vf)-1.0f);
    set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, (vu)slot_count);
    return;
  }

  Hit h =
      load_hit(scene, primitive, row_f(paths, PATH_ROWS, block, ROW_U), row_f(paths, PATH_ROWS, block, ROW_V), active);
  v3 p = h.p;
  vf segment_length = length3(sub3(p, origin));
#ifdef NEED_MEDIA
  Media media;
  media.high = row_u(paths, PATH_ROWS, block, ROW_MEDIA);
  media.low = row_u(paths, PATH_ROWS, block, ROW_MEDIA + 1u);
  media = media_at_end(media, &h, scene, meets_back(&h, direction), active);
  throughput = mul3(throughput, absorption(scene, media, segment_length, active));
#endif

  Surface m;
  load_color(scene, &h, &m, active);

#ifdef NEED_EMISSIVE_TRIANGLES
  {
    vu emitter = as_vu(h.first[TRIANGLE_EMITTER]);
    vi emits = active & shines_towards(&h, direction) & (emitter != GLEANER_NONE);
    if (any_lane(emits)) {
      emitter = pick_u((vu)0u, emitter, emits);
      v3 radiance = gather3(scene->emitters + EMITTER_RADIANCE, emitter * EMITTER_WORDS);
#ifdef NEED_EMISSION_TEXTURES
      vu texture = material_u(scene, h.material, MATERIAL_EMISSION_TEXTURE);
      vi textured = emits & (texture != GLEANER_NONE);
      vf unused;
      radiance = pick3(radiance, mul3(radiance, texture_at(scene, &h, texture, textured, &unused)), textured);
#endif
#ifdef NEED_ALPHA_EMITTERS
      radiance = scale3(radiance, m.opacity);
#endif
#ifdef TRANSPARENT_SHADOWS
      // From where the direction was drawn.
      vf travelled = row_f(paths, PATH_ROWS, block, ROW_TRAVELLED);
      vf light = light_pdf(scene, emitter, sub3(origin, scale3(direction, travelled)), direction,
                           travelled + segment_length, last_total);
#else
      vf light = light_pdf(scene, emitter, origin, direction, segment_length, last_total);
#endif
      vf weight = pick(one_f(), power_heuristic(last_pdf, light), last_pdf > zero_f());
      v3 found = scale3(mul3(throughput, radiance), weight);
      add_to_slots(slots, slot_count, slot, found_indirect, found, emits);
      add_clamped(slots, slot_count, slot, found, emits & clamped);
    }
  }
#endif

  if (parameters->features) {
    vi first_hit = active & (bounce == 0u);
    if (any_lane(first_hit)) {
      vu at = pick_u((vu)slot_count, slot, first_hit) * FEATURE_WORDS;
      v3 facing = pick3(h.normal, negate3(h.normal), dot3(h.normal, direction) > zero_f());
      scatter_f(features, at, m.base.x);
      scatter_f(features + 1, at, m.base.y);
      scatter_f(features + 2, at, m.base.z);
      scatter_f(features + 3, at, facing.x);
      scatter_f(features + 4, at, facing.y);
      scatter_f(features + 5, at, facing.z);
      scatter_f(features + 6, at, segment_length);
      scatter_f(features + 7, at, one_f());
    }
  }

  uint dimension_stride = 4u;
  vu dimension = bounce * dimension_stride + 1u;
  vu pair_key = hash_combine(key, dimension);
  vf u_lobe, u_glass;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 2u, &u_lobe, &u_glass);

  vi passes = stochastic_alpha(&m, active, &u_glass);
#ifdef NEED_UNLIT
  {
    vi unlit = active & none(passes) & ((as_vu(h.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) != 0u);
    if (any_lane(unlit)) {
      add_to_slots(slots, slot_count, slot, found_indirect, mul3(throughput, m.base), unlit);
      add_clamped(slots, slot_count, slot, mul3(throughput, m.base), unlit & clamped);
      active = active & none(unlit);
    }
  }
#endif
  uint most = parameters->depth;
#ifdef PASSES_GLASS
  // Paths that may not scatter again may still go straight on.
  vi spent = active & none(passes) & (depth >= (vu)most) & ((vu)most != 0u);
#else
  if (most) active = active & ((depth < most) | passes);
#endif

#ifdef COVERED
  // A virtual point light's place, reached straight from a surface that it lights: of what the diffuse layer here
  // scatters, what clamping that light's geometry term (eq. 4) leaves out is all there is to find.
  vi straight = active & none(passes) & (cover > zero_f());
  v3 segment = sub3(p, origin);
  vf geometry = cover * fabs(dot3(h.geometric, direction)) / dot3(segment, segment);
  vf layer_share = clamped_share(parameters->clamp, geometry, straight);
#if !defined(NEED_LOBE) && !defined(NEED_TRANSMISSIVE)
  active = active & (passes | (layer_share > zero_f()));
  clamped = clamped | straight;
#endif
#endif
  load_lobes(scene, &h, &m, active);

  ShadingFrame frame = shading_frame(&h, direction);
  active = active & ((frame.view.z > (vf)1e-6f) | passes);
  set_side(&m, frame.from_back);
#ifdef NEED_MEDIA
  Media beyond = media_beyond(media, &h, scene, frame.from_back, active);
  set_boundary(scene, &m, media, beyond, active);
#endif
#ifdef PASSES_GLASS
  active = active & (none(spent) | is_passable(&m));
#endif
#ifdef NEED_LOBE
  prepare_lobe(scene, &m, max_f(frame.view.z, (vf)1e-6f));
#ifdef COVERED
  // Virtual point lights stand for the diffuse layer and, where it is rough, the lobe.
  vi rough = has_rough_lobe(&m);
#endif
#endif

  // One light sample. Perfect mirrors and glass cannot see it.
  v3 shadow_origin = p, shadow_direction = direction, contribution = splat3(zero_f());
  vf shadow_far = (vf)-1.0f, u_choice, u_roulette;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 0u, &u_choice, &u_roulette);
  vf light_total = one_f();
  vi connected = no_lanes();
  vu shadow_bits =
      pick_u((vu)0u, (vu)SHADOW_INDIRECT, diffuse_count > 0u) | pick_u((vu)0u, (vu)SHADOW_CLAMPED, clamped);
#ifdef NEED_LIGHTS
  {
    vi lit = active & none(passes);
#ifdef PASSES_GLASS
    lit = lit & none(spent);
#endif
#ifdef NEED_TRANSMISSIVE
    vf opaque_share = one_f() - m.transmission;
    vi sees_light = opaque_share > zero_f();
#ifdef NEED_ROUGH_TRANSMISSIVE
    sees_light = sees_light | m.blurs;
#endif
    lit = lit & sees_light;
#endif
#ifdef NEED_LOBE
    // A bare mirror: no layer below and no rough lobe.
    vi bare = m.mirror & (m.lobe_share >= one_f());
#ifdef NEED_ROUGH_TRANSMISSIVE
    bare = bare & none(m.blurs);
#endif
    lit = lit & none(bare);
#endif
    vf l0, l1;
    if (any_lane(lit)) {
      sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 1u, &l0, &l1);
      LightSample light = sample_light(scene, p, u_choice, l0, l1);
      light_total = light.total;
      v3 toward = make3(dot3(frame.tangent, light.direction), dot3(frame.bitangent, light.direction),
                        dot3(frame.normal, light.direction));
      vi above = toward.z > (vf)1e-6f;
      vi seen = lit & (light.pdf > zero_f()) & above;
      vf pdf;
      v3 f = eval_bsdf(scene, &m, frame.view, make3(toward.x, toward.y, max_f(toward.z, (vf)1e-6f)), &pdf);
#ifdef COVERED
      v3 layer = eval_layer(scene, &m, max_f(toward.z, (vf)1e-6f));
      vf share = layer_share;
#ifdef NEED_LOBE
      // Of a rough surface the bound is on the product with the lobe, which this direction decides.
      vf gain = lobe_gain(scale3(sub3(f, layer), one_f() / max_f(toward.z, (vf)1e-6f)));
      share = pick(share, clamped_share(parameters->clamp, geometry * gain, straight), rough);
      layer = pick3(layer, f, rough);
#endif
      f = sub3(f, scale3(layer, one_f() - share));
      f = make3(max_f(f.x, zero_f()), max_f(f.y, zero_f()), max_f(f.z, zero_f()));
#endif
#ifdef NEED_TRANSMISSIVE
      f = scale3(f, opaque_share);
      pdf *= opaque_share;
#endif
#ifdef NEED_ROUGH_TRANSMISSIVE
      if (any_lane(m.blurs)) {
        vf glass_pdf;
        v3 g = eval_glass(&m, frame.view, toward, &glass_pdf);
        vi through = m.blurs & (toward.z < (vf)-1e-6f);
        f = mad3(g, m.transmission, pick3(f, splat3(zero_f()), through));
        pdf = fma(m.transmission, glass_pdf, pick(pdf, zero_f(), through));
        seen = lit & (light.pdf > zero_f()) & (above | through);
      }
#endif
#ifdef NEED_BENT_NORMALS
      f = scale3(f, geometric_share(&frame, light.direction, toward.z));
#endif
      vf weight = power_heuristic(light.pdf, pdf);
      weight = pick(weight, one_f(), light.delta);
      contribution = scale3(mul3(mul3(throughput, f), light.radiance), weight / light.pdf);
      connected = seen & (max_component(contribution) > zero_f());
      shadow_origin = offset_ray_origin(p, h.error, h.geometric, light.direction);
      shadow_direction = pick3(sub3(light.target, shadow_origin), light.direction, light.infinite);
      shadow_far = pick((vf)-1.0f, pick((vf)SHADOW_FAR, (vf)INFINITY, light.infinite), connected);
#ifdef NEED_MEDIA
      vi beneath = toward.z < zero_f();
      set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA, pick_u(media.high, beyond.high, beneath));
      set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_MEDIA + 1u, pick_u(media.low, beyond.low, beneath));
#endif
#ifdef TRANSPARENT_SHADOWS
      shadow_bits |= pick_u((vu)0u, (vu)SHADOW_INFINITE, light.infinite);
#endif
    }
  }
#endif
  set_ray(shadows, SHADOW_ROWS, block, shadow_origin, shadow_direction, shadow_far, primitive);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION, contribution);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, pick_u((vu)slot_count, slot | shadow_bits, connected));
#ifdef TRANSPARENT_SHADOWS
  set_row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
#endif

  // One scattered ray.
  vf d0, d1;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 3u, &d0, &d1);
  BsdfSample scattered = sample_bsdf(scene, &m, frame.view, u_lobe, u_glass, d0, d1);
  vi specular = scattered.pdf <= zero_f();
  v3 out = scattered_direction(&frame, scattered.direction, specular);
  v3 next_throughput = mul3(throughput, scattered.weight);
#ifdef NEED_BENT_NORMALS
  next_throughput =
      scale3(next_throughput, pick(geometric_share(&frame, out, scattered.direction.z), one_f(), specular));
#endif
  vf eta = row_f(paths, PATH_ROWS, block, ROW_ETA) * scattered.eta;
#ifdef COVERED
  // Whether the diffuse layer scattered it or the lobe: by lot, in proportion to what each sends this way. A rough lobe
  // is one with the layer.
  vi unfiltered = specular;
#ifdef NEED_ROUGH_TRANSMISSIVE
  // Rough glass has a density too, but virtual point lights know nothing of it.
  unfiltered = unfiltered | (u_glass < m.transmission);
#endif
  vi by_layer = none(unfiltered);
  vf gain = one_f();
  vi through = no_lanes();
#ifdef NEED_LOBE
  {
    vf unused_pdf, u_class, u_spare;
    sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 4u, &u_class, &u_spare);
    vf z = max_f(scattered.direction.z, (vf)1e-6f);
    v3 both = eval_bsdf(scene, &m, frame.view, make3(scattered.direction.x, scattered.direction.y, z), &unused_pdf);
    v3 layer = eval_layer(scene, &m, z);
    gain = pick(gain, lobe_gain(scale3(sub3(both, layer), one_f() / z)), rough & by_layer);
    layer = pick3(layer, both, rough);
    vf chance = clamp_f((layer.x + layer.y + layer.z) / (both.x + both.y + both.z), zero_f(), one_f());
    by_layer = by_layer & (u_class < chance);
    v3 part = pick3(sub3(both, layer), layer, by_layer);
    vf odds = one_f() / pick(one_f() - chance, chance, by_layer);
    v3 factor = make3(pick(zero_f(), max_f(part.x, zero_f()) / both.x * odds, both.x > zero_f()),
                      pick(zero_f(), max_f(part.y, zero_f()) / both.y * odds, both.y > zero_f()),
                      pick(zero_f(), max_f(part.z, zero_f()) / both.z * odds, both.z > zero_f()));
    next_throughput = pick3(mul3(next_throughput, factor), next_throughput, unfiltered);
    through = (m.lobe_share >= one_f()) & none(rough);
    layer_share = pick(layer_share, clamped_share(parameters->clamp, geometry * gain, straight), rough);
  }
#endif
#ifdef NEED_TRANSMISSIVE
  through = through | (u_glass < m.transmission);
#endif
  vi first_surface = cover == zero_f();
#ifdef NEED_MEDIA
  // Within a solid virtual point lights would have to be weakened by it: paths find all light there.
  by_layer = by_layer & (none(first_surface) | (filling(media) == 0u));
#endif
  next_throughput = pick3(next_throughput, scale3(next_throughput, layer_share), straight & by_layer);
  vf next_cover = pick(cover, (vf)COVER_FREE, straight);
  next_cover = pick(next_cover, (vf)COVER_CLAMPED, straight & by_layer);
  next_cover = pick(next_cover, (vf)COVER_FREE, first_surface & none(through));
  next_cover =
      pick(next_cover, max_f(scattered.direction.z, (vf)1e-6f) * gain, first_surface & by_layer & none(through));
#endif
#ifdef NEED_MEDIA
  vi opaque_passed = passes;  // through what is not opaque, which is no boundary
#endif
#ifdef PASSES_GLASS
  vi unbent = active & none(passes) & scattered.straight;
  v3 passed = pick3(throughput, next_throughput, unbent);
  passes = passes | unbent;
#else
  v3 passed = throughput;
#endif
#ifdef COVERED
  // Through a surface that is passed straight no virtual point light is seen: what stands behind it is found by paths.
  next_cover = pick(next_cover, pick(cover, (vf)COVER_FREE, cover > zero_f()), passes);
#endif
  vi alive =
      active & none(passes) & (max_component(next_throughput) > zero_f()) & finite3(next_throughput) & finite3(out);
  vu next_depth = min(depth + 1u, (vu)META_DEPTH_MASK);
#ifdef PASSES_GLASS
  alive = alive & none(spent);
#endif
#if !defined(NEED_EMISSIVE_TRIANGLES) && !defined(NEED_ENVIRONMENT) && !defined(NEED_UNLIT)
  // The last scattering's ray could find emission alone, and here is none.
  if (most) alive = alive & (next_depth < most);
#endif
  // Russian roulette on what the path still carries; radiance squeezed by refraction is taken at its worth outside.
  vf carried = max_component(next_throughput) * eta * eta;
  vi roulette = alive & (next_depth >= ROULETTE_DEPTH);
  vf survival = min_f(carried, (vf)ROULETTE_MOST);
  alive = alive & (none(roulette) | (u_roulette < survival));
  next_throughput = pick3(next_throughput, scale3(next_throughput, one_f() / survival), roulette);
  vu next_diffuse = min(diffuse_count + pick_u((vu)1u, (vu)0u, specular), (vu)2u);
  vi next_specular = specular;

#if defined(NEED_ALPHA) || defined(PASSES_GLASS)
  out = pick3(out, direction, passes);
  next_throughput = pick3(next_throughput, passed, passes);
  next_depth = pick_u(next_depth, depth, passes);
  next_diffuse = pick_u(next_diffuse, diffuse_count, passes);
  next_specular = (next_specular & none(passes)) | (specular_since & passes);
  eta = pick(eta, row_f(paths, PATH_ROWS, block, ROW_ETA), passes);
#ifdef TRANSPARENT_SHADOWS
  vf next_travelled = pick(zero_f(), row_f(paths, PATH_ROWS, block, ROW_TRAVELLED) + segment_length, passes);
  scattered.pdf = pick(scattered.pdf, last_pdf, passes);
  light_total = pick(light_total, last_total, passes);
#else
  scattered.pdf = pick(scattered.pdf, zero_f(), passes);
#endif
  alive = (alive & none(passes)) | (active & passes & (max_component(passed) > zero_f()));
#endif
  v3 start = offset_ray_origin(p, h.error, h.geometric, out);
  vu next_bounce = bounce + 1u;
  alive = alive & (next_bounce <= (vu)META_BOUNCE_MASK) & finite3(start);

  uint kept, asked;
  vu rank = rank_lanes(alive, &kept);
  rank_lanes(connected, &asked);
  if (asked) atomic_add(counters + COUNTER_SHADOW, asked);
  if (kept == 0u) return;
  uint place = atomic_add(counters + COUNTER_ALIVE, kept);
  // Lanes that ended write behind the wave, where nobody reads.
  vu to = ray_address(pick_u((vu)capacity, (vu)place + rank, alive), PATH_ROWS);
  vu next_meta = next_depth | (next_diffuse << META_DIFFUSE) | pick_u((vu)0u, (vu)META_SPECULAR_SINCE, next_specular) |
                 (next_bounce << META_BOUNCE) | (sample << META_SAMPLE);
  global uint* next_words = (global uint*)next;
  scatter_f(next + 16u * (ROW_ORIGIN + 0u), to, start.x);
  scatter_f(next + 16u * (ROW_ORIGIN + 1u), to, start.y);
  scatter_f(next + 16u * (ROW_ORIGIN + 2u), to, start.z);
  scatter_f(next + 16u * ROW_NEAR, to, zero_f());
  scatter_f(next + 16u * (ROW_DIRECTION + 0u), to, out.x);
  scatter_f(next + 16u * (ROW_DIRECTION + 1u), to, out.y);
  scatter_f(next + 16u * (ROW_DIRECTION + 2u), to, out.z);
  scatter_f(next + 16u * ROW_TIME, to, zero_f());
  scatter_f(next + 16u * ROW_FAR, to, (vf)INFINITY);
  scatter_u(next_words + 16u * ROW_MASK, to, (vu)0xffffffffu);
  scatter_u(next_words + 16u * ROW_SOURCE, to, primitive);
  scatter_u(next_words + 16u * ROW_FLAGS, to, (vu)0u);
  scatter_u(next_words + 16u * ROW_GEOMETRY, to, (vu)GLEANER_NONE);
  scatter_f(next + 16u * (ROW_THROUGHPUT + 0u), to, next_throughput.x);
  scatter_f(next + 16u * (ROW_THROUGHPUT + 1u), to, next_throughput.y);
  scatter_f(next + 16u * (ROW_THROUGHPUT + 2u), to, next_throughput.z);
  scatter_f(next + 16u * ROW_PDF, to, scattered.pdf);
  scatter_f(next + 16u * ROW_TOTAL, to, light_total);
  scatter_u(next_words + 16u * ROW_SLOT, to, slot);
  scatter_u(next_words + 16u * ROW_META, to, next_meta);
  scatter_u(next_words + 16u * ROW_KEY, to, key);
  scatter_f(next + 16u * ROW_ETA, to, eta);
#ifdef TRANSPARENT_SHADOWS
  scatter_f(next + 16u * ROW_TRAVELLED, to, next_travelled);
#endif
#ifdef NEED_MEDIA
  scatter_u(next_words + 16u * ROW_MEDIA, to, pick_u(media.high, beyond.high, scattered.crosses & none(opaque_passed)));
  scatter_u(next_words + 16u * (ROW_MEDIA + 1u), to,
            pick_u(media.low, beyond.low, scattered.crosses & none(opaque_passed)));
#endif
#ifdef COVERED
  scatter_f(next + 16u * ROW_COVER, to, next_cover);
#endif
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
    add_clamped(slots, slot_count, slot & ~SHADOW_BITS, contribution, arrived & ((slot & SHADOW_CLAMPED) != 0u));
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
  add_clamped(slots, slot_count, slot & ~SHADOW_BITS, contribution, arrived & ((slot & SHADOW_CLAMPED) != 0u));
}

#endif

#ifdef COVERED
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
  // What was clamped stands last.
  for (uint k = 6u; k < SUMS; ++k) record[words - SUMS + k] = sum[k];
  if (lost) {
    atomic_add(report, lost);
    uint at = atomic_inc(report + 1);
    if (at < REPORTED_ITEMS) report[2 + at] = item;
  }
}
