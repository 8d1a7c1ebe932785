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
// With alpha and punctual lights, trace (closest hits) and path_pass take turns on the shadow rays until none is left.
//
// What a path gathers depends on (scene, parameters, pixel, chunk, sample) alone: its random numbers are keyed by them,
// its slot is its own, and survivors are traced one by one, so neither their order nor the wave's size can be seen in
// the result.

#include "kernels/bsdf.h"
#include "kernels/lights.h"
#include "kernels/path_layout.h"
#include "kernels/stage_records.h"

#ifdef __has_attribute
#if __has_attribute(min_vector_width)
#define WIDE __attribute__((min_vector_width(512)))
#endif
#endif
#ifndef WIDE
#define WIDE
#endif

// Fields of PathParameters are read one by one: the struct itself never lands in registers.
FN void add_to_slots(global float* slots, uint slot_count, vu slot, vi indirect, v3 value, vi active) {
  // Lanes with nothing to add write to a slot that nobody reads.
  vu at = pick_u((vu)slot_count, slot, active) * SLOT_WORDS + pick_u((vu)0u, (vu)3u, indirect & active);
  v3 sum = add3(gather3(slots, at), value);
  scatter_f(slots, at, sum.x);
  scatter_f(slots + 1, at, sum.y);
  scatter_f(slots + 2, at, sum.z);
}

#ifdef NEED_ALPHA
// What of a material of opacity `alpha` is in light's way.
FN vf opacity_of(const Scene* scene, vu material, vu flags, vf alpha) {
  vf masked = pick(zero_f(), one_f(), alpha >= material_f(scene, material, MATERIAL_ALPHA_CUTOFF));
  alpha = pick(alpha, masked, (flags & GLEANER_MATERIAL_ALPHA_MASK) != 0u);
  return pick(one_f(), alpha, (flags & (GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ALPHA_BLEND)) != 0u);
}
#endif

// How far shadow rays go, the light being at 1.
#define SHADOW_FAR 0.9999999f

kernel WIDE void path_generate(global const PathParameters* restrict parameters, global const uint* restrict items,
                               uint listed, uint first_item_low, uint first_item_high, uint first_path, uint base,
                               uint count, global float* restrict paths, global float* restrict slots,
                               global float* restrict features) {
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
  vu row = pixel / width;
  vu column = pixel - row * width;
  vf sx = 2.0f * (to_f(column) + jx) / (float)width - 1.0f;
  vf sy = 1.0f - 2.0f * (to_f(row) + jy) / (float)height;
  global const Camera* camera = &parameters->camera;
  v3 origin = uniform3(camera->origin[0], camera->origin[1], camera->origin[2]);
  v3 right = uniform3(camera->right[0], camera->right[1], camera->right[2]);
  v3 up = uniform3(camera->up[0], camera->up[1], camera->up[2]);
  v3 direction = uniform3(camera->forward[0], camera->forward[1], camera->forward[2]);
  vf ax = sx * camera->half_width, ay = sy * camera->half_height;
  v3 aside = mad3(right, ax, scale3(up, ay));
  if (camera->type == GLEANER_CAMERA_ORTHOGRAPHIC) {
    origin = add3(origin, aside);
  } else {
    direction = normalize3(add3(direction, aside));
  }
  // The stage's last item may have fewer samples than the others.
  uint last_local = (uint)min(total - 1u - first_item, (ulong)0xfffffffeu);
  vi idle = (local_item > last_local) |
            ((local_item == last_local) & ((path & (samples - 1u)) >= parameters->last_item_samples)) | (lane >= count);
  uint at = (base + first_lane) / LANES;
  set_row_3(paths, PATH_ROWS, at, ROW_ORIGIN, origin);
  set_row_f(paths, PATH_ROWS, at, ROW_NEAR, zero_f());
  set_row_3(paths, PATH_ROWS, at, ROW_DIRECTION, direction);
  set_row_f(paths, PATH_ROWS, at, ROW_TIME, zero_f());
  set_row_f(paths, PATH_ROWS, at, ROW_FAR, pick((vf)INFINITY, (vf)-1.0f, idle));
  set_row_u(paths, PATH_ROWS, at, ROW_MASK, (vu)0xffffffffu);
  set_row_u(paths, PATH_ROWS, at, ROW_SOURCE, (vu)GLEANER_NONE);
  set_row_u(paths, PATH_ROWS, at, ROW_FLAGS, (vu)0u);
  set_row_u(paths, PATH_ROWS, at, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_3(paths, PATH_ROWS, at, ROW_THROUGHPUT, splat3(one_f()));
  set_row_f(paths, PATH_ROWS, at, ROW_PDF, zero_f());
  set_row_f(paths, PATH_ROWS, at, ROW_TOTAL, one_f());
  set_row_u(paths, PATH_ROWS, at, ROW_SLOT, path);
  set_row_u(paths, PATH_ROWS, at, ROW_META, (sample << META_SAMPLE) | pick_u((vu)0u, (vu)META_IDLE, idle));
  set_row_u(paths, PATH_ROWS, at, ROW_KEY, key);
  set_row_f(paths, PATH_ROWS, at, ROW_ETA, one_f());
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
    add_to_slots(slots, slot_count, slot, found_indirect, scale3(mul3(throughput, radiance), weight), missed);
  }
#endif
  active = hit;
  if (!any_lane(active)) {
    set_row_f(shadows, SHADOW_ROWS, block, ROW_FAR, (vf)-1.0f);
    set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, (vu)slot_count);
    return;
  }

  // The hit: from the corners, not along the ray, so that its error is the corners' and not the distance's.
  vf t[16];
  load_words(scene->triangles, triangle, t);
#if defined(NEED_SMOOTH_NORMALS) || defined(NEED_TEXTURES)
  vf t2[16];
  load_words(scene->triangles + TRIANGLE_SECOND, triangle, t2);
#endif
  v3 p0 = words3(t, TRIANGLE_P0);
  v3 p1 = words3(t, TRIANGLE_P1);
  v3 p2 = words3(t, TRIANGLE_P2);
  vf b1 = row_f(paths, PATH_ROWS, block, ROW_U), b2 = row_f(paths, PATH_ROWS, block, ROW_V);
  vf b0 = one_f() - b1 - b2;
  v3 e1 = sub3(p1, p0), e2 = sub3(p2, p0), error;
  v3 p = surface_point(p0, e1, e2, b1, b2, &error);
  v3 geometric = normalize3(cross3(e1, e2));
  vi front = dot3(geometric, direction) < zero_f();
  vu material = as_vu(t[TRIANGLE_MATERIAL]);
  vf w[16];  // the material's first line
  load_words(scene->materials, material * MATERIAL_WORDS, w);
#ifdef NEED_TEXTURES
  vf tu = b0 * t2[TRIANGLE_UV0 - TRIANGLE_SECOND] + b1 * t2[TRIANGLE_UV1 - TRIANGLE_SECOND] +
          b2 * t2[TRIANGLE_UV2 - TRIANGLE_SECOND];
  vf tv = b0 * t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1] + b1 * t2[TRIANGLE_UV1 - TRIANGLE_SECOND + 1] +
          b2 * t2[TRIANGLE_UV2 - TRIANGLE_SECOND + 1];
#endif

#ifdef NEED_ATTENUATION
  // A solid's back face was reached from within it: what it absorbs of this segment.
  {
    vi within = active & none(front) & ((as_vu(w[MATERIAL_FLAGS]) & GLEANER_MATERIAL_ATTENUATES) != 0u);
    if (any_lane(within)) {
      vf distance = length3(sub3(p, origin));
      v3 k = material_3(scene, material, MATERIAL_ATTENUATION);
      v3 left = make3(exp(-k.x * distance), exp(-k.y * distance), exp(-k.z * distance));
      throughput = pick3(throughput, mul3(throughput, left), within);
    }
  }
#endif

#ifdef NEED_EMISSIVE_TRIANGLES
  {
    vu emitter = as_vu(t[TRIANGLE_EMITTER]);
    vi emits = active & front & (emitter != GLEANER_NONE);
    if (any_lane(emits)) {
      emitter = pick_u((vu)0u, emitter, emits);
      v3 radiance = gather3(scene->emitters + EMITTER_RADIANCE, emitter * EMITTER_WORDS);
#ifdef NEED_EMISSION_TEXTURES
      vu texture = material_u(scene, material, MATERIAL_EMISSION_TEXTURE);
      vi textured = emits & (texture != GLEANER_NONE);
      vf unused;
      radiance = pick3(radiance, mul3(radiance, texture_lookup(scene, texture, tu, tv, textured, &unused)), textured);
#endif
      v3 to_hit = sub3(p, origin);
      vf distance = length3(to_hit);
      vf light = light_pdf(scene, emitter, origin, direction, distance, last_total);
      vf weight = pick(one_f(), power_heuristic(last_pdf, light), last_pdf > zero_f());
      add_to_slots(slots, slot_count, slot, found_indirect, scale3(mul3(throughput, radiance), weight), emits);
    }
  }
#endif

  // The material.
  Surface m;
  m.base = words3(w, MATERIAL_BASE_COLOR);
#ifdef NEED_ALPHA
  vu flags = as_vu(w[MATERIAL_FLAGS]);
  m.opacity = w[MATERIAL_ALPHA];
#elif defined(NEED_UNLIT) || defined(NEED_TRANSMISSIVE)
  vu flags = as_vu(w[MATERIAL_FLAGS]);
#endif
#ifdef NEED_TEXTURES
  {
    vu texture = as_vu(w[MATERIAL_BASE_COLOR_TEXTURE]);
    vi textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      vf alpha;
      v3 color = texture_lookup(scene, texture, tu, tv, textured, &alpha);
      m.base = pick3(m.base, mul3(m.base, color), textured);
#ifdef NEED_ALPHA
      m.opacity = pick(m.opacity, m.opacity * alpha, textured);
#endif
    }
  }
#endif
#ifdef NEED_ALPHA
  m.opacity = opacity_of(scene, material, flags, m.opacity);
#endif

  // The shading frame: interpolated normals decide the side and the cosine; both sides scatter.
  v3 normal = geometric;
#ifdef NEED_SMOOTH_NORMALS
  {
    v3 n = mad3(
        words3(t2, TRIANGLE_N0 - TRIANGLE_SECOND), b0,
        mad3(words3(t2, TRIANGLE_N1 - TRIANGLE_SECOND), b1, scale3(words3(t2, TRIANGLE_N2 - TRIANGLE_SECOND), b2)));
    vf l2 = dot3(n, n);
    normal = pick3(geometric, scale3(n, one_f() / sqrt(l2)), l2 > (vf)1e-12f);
  }
#endif
#ifdef NEED_NORMAL_MAPS
  {
    vu texture = material_u(scene, material, MATERIAL_NORMAL_TEXTURE);
    vi mapped = active & (texture != GLEANER_NONE);
    if (any_lane(mapped)) {
      vf unused;
      v3 n = texture_lookup(scene, texture, tu, tv, mapped, &unused);
      vf strength = material_f(scene, material, MATERIAL_NORMAL_SCALE);
      n = make3((2.0f * n.x - 1.0f) * strength, (2.0f * n.y - 1.0f) * strength, 2.0f * n.z - 1.0f);
      vf du1 = t2[TRIANGLE_UV1 - TRIANGLE_SECOND] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND];
      vf dv1 = t2[TRIANGLE_UV1 - TRIANGLE_SECOND + 1] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1];
      vf du2 = t2[TRIANGLE_UV2 - TRIANGLE_SECOND] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND];
      vf dv2 = t2[TRIANGLE_UV2 - TRIANGLE_SECOND + 1] - t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1];
      vf area = du1 * dv2 - du2 * dv1;
      // dp/du, made perpendicular to the normal; the bitangent's sense is that of -dv (v grows downwards in glTF).
      v3 tangent = scale3(sub3(scale3(e1, dv2), scale3(e2, dv1)), pick((vf)-1.0f, one_f(), area > zero_f()));
      tangent = sub3(tangent, scale3(normal, dot3(normal, tangent)));
      vi usable = mapped & (dot3(tangent, tangent) > zero_f()) & (area != zero_f());
      tangent = normalize3(tangent);
      v3 bitangent = scale3(cross3(normal, tangent), pick(one_f(), (vf)-1.0f, area > zero_f()));
      v3 bent = normalize3(mad3(tangent, n.x, mad3(bitangent, n.y, scale3(normal, n.z))));
      normal = pick3(normal, bent, usable & (dot3(bent, bent) > zero_f()));
    }
  }
#endif

  if (parameters->features) {
    vi first_hit = active & (bounce == 0u);
    if (any_lane(first_hit)) {
      vu at = pick_u((vu)slot_count, slot, first_hit) * FEATURE_WORDS;
      v3 facing = pick3(normal, negate3(normal), dot3(normal, direction) > zero_f());
      scatter_f(features, at, m.base.x);
      scatter_f(features + 1, at, m.base.y);
      scatter_f(features + 2, at, m.base.z);
      scatter_f(features + 3, at, facing.x);
      scatter_f(features + 4, at, facing.y);
      scatter_f(features + 5, at, facing.z);
      scatter_f(features + 6, at, length3(sub3(p, origin)));
      scatter_f(features + 7, at, one_f());
    }
  }

  uint dimension_stride = 4u;
  vu dimension = bounce * dimension_stride + 1u;
  vu pair_key = hash_combine(key, dimension);
  vf u_lobe, u_glass;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 2u, &u_lobe, &u_glass);

#ifdef NEED_ALPHA
  // What is not opaque lets light go on unbent, in proportion.
  vi passes = active & (m.opacity < one_f()) & (u_glass >= m.opacity);
  u_glass = pick(u_glass, min_f(u_glass / m.opacity, (vf)0.99999994f), m.opacity > zero_f());
#else
  vi passes = no_lanes();
#endif
#ifdef NEED_UNLIT
  {
    vi unlit = active & none(passes) & ((flags & GLEANER_MATERIAL_UNLIT) != 0u);
    if (any_lane(unlit)) {
      add_to_slots(slots, slot_count, slot, found_indirect, mul3(throughput, m.base), unlit);
      active = active & none(unlit);
    }
  }
#endif
  uint most = parameters->depth;
  if (most) active = active & ((depth < most) | passes);

#if defined(NEED_LOBE) || defined(NEED_TRANSMISSIVE)
  m.alpha = w[MATERIAL_ROUGHNESS];
#ifdef NEED_LOBE
  m.metallic = w[MATERIAL_METALLIC];
  m.specular = w[MATERIAL_SPECULAR];
  m.f0 = words3(w, MATERIAL_F0);
  m.table = as_vu(w[MATERIAL_ALBEDO_TABLE]);
  m.table_row = zero_f();
#endif
#ifdef NEED_TRANSMISSIVE
  m.transmission = w[MATERIAL_TRANSMISSION];
  m.ior = w[MATERIAL_IOR];
  m.solid = (flags & GLEANER_MATERIAL_SOLID) != 0u;
#endif
#ifdef NEED_MATERIAL_TEXTURES
  {
    vf unused;
    vu texture = material_u(scene, material, MATERIAL_METALLIC_ROUGHNESS_TEXTURE);
    vi textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      v3 c = texture_lookup(scene, texture, tu, tv, textured, &unused);
      m.alpha = pick(m.alpha, m.alpha * c.y, textured);
#ifdef NEED_LOBE
      m.metallic = pick(m.metallic, m.metallic * c.z, textured);
#endif
    }
#ifdef NEED_LOBE
    vu rows = as_vu(w[MATERIAL_ALBEDO_ROWS]);
    m.table_row = pick(zero_f(), clamp_f(m.alpha, zero_f(), one_f()) * (vf)(float)(GLEANER_ALBEDO_ROWS - 1), rows > 1u);
    texture = material_u(scene, material, MATERIAL_SPECULAR_TEXTURE);
    textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      vf a;
      texture_lookup(scene, texture, tu, tv, textured, &a);
      m.specular = pick(m.specular, m.specular * a, textured);
    }
    texture = material_u(scene, material, MATERIAL_SPECULAR_COLOR_TEXTURE);
    textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      v3 c = texture_lookup(scene, texture, tu, tv, textured, &unused);
      m.f0 = pick3(m.f0, mul3(m.f0, c), textured);
    }
#endif
#ifdef NEED_TRANSMISSIVE
    texture = material_u(scene, material, MATERIAL_TRANSMISSION_TEXTURE);
    textured = active & (texture != GLEANER_NONE);
    if (any_lane(textured)) {
      v3 c = texture_lookup(scene, texture, tu, tv, textured, &unused);
      m.transmission = pick(m.transmission, m.transmission * c.x, textured);
    }
#endif
  }
#endif
  m.alpha = m.alpha * m.alpha;
#ifdef NEED_LOBE
  m.alpha2 = m.alpha * m.alpha;
#endif
#endif

  v3 tangent, bitangent;
  vf facing = dot3(normal, direction);
  vi from_back = facing > zero_f();
  normal = pick3(normal, negate3(normal), from_back);
  basis3(normal, &tangent, &bitangent);
  v3 view = make3(-dot3(tangent, direction), -dot3(bitangent, direction), fabs(facing));
  // Grazing beyond what the interpolated normal can tell: nothing is scattered.
  active = active & ((view.z > (vf)1e-6f) | passes);
#ifdef NEED_LOBE
  prepare_lobe(scene, &m, max_f(view.z, (vf)1e-6f));
#endif

  // One light sample. Perfect mirrors and glass cannot see it.
  v3 shadow_origin = p, shadow_direction = direction, contribution = splat3(zero_f());
  vf shadow_far = (vf)-1.0f, u_choice, u_roulette;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 0u, &u_choice, &u_roulette);
  vf light_total = one_f();
  vi connected = no_lanes();
  vu shadow_bits = pick_u((vu)0u, (vu)SHADOW_INDIRECT, diffuse_count > 0u);
#ifdef NEED_LIGHTS
  {
    vi lit = active & none(passes);
#ifdef NEED_TRANSMISSIVE
    vf opaque_share = one_f() - m.transmission;
    lit = lit & (opaque_share > zero_f());
#endif
#ifdef NEED_LOBE
    // A bare mirror: no layer below and no rough lobe.
    lit = lit & none(m.mirror & (m.lobe_share >= one_f()));
#endif
    vf l0, l1;
    if (any_lane(lit)) {
      sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 1u, &l0, &l1);
      LightSample light = sample_light(scene, p, u_choice, l0, l1);
      light_total = light.total;
      v3 toward =
          make3(dot3(tangent, light.direction), dot3(bitangent, light.direction), dot3(normal, light.direction));
      vi seen = lit & (light.pdf > zero_f()) & (toward.z > (vf)1e-6f);
      vf pdf;
      v3 f = eval_bsdf(scene, &m, view, make3(toward.x, toward.y, max_f(toward.z, (vf)1e-6f)), &pdf);
#ifdef NEED_TRANSMISSIVE
      f = scale3(f, opaque_share);
      pdf *= opaque_share;
#endif
      vf weight = power_heuristic(light.pdf, pdf);
      weight = pick(weight, one_f(), light.delta);
      contribution = scale3(mul3(mul3(throughput, f), light.radiance), weight / light.pdf);
      connected = seen & (max_component(contribution) > zero_f());
      shadow_origin = leave_surface(p, error, geometric, light.direction);
      shadow_direction = pick3(sub3(light.target, shadow_origin), light.direction, light.infinite);
      shadow_far = pick((vf)-1.0f, pick((vf)SHADOW_FAR, (vf)INFINITY, light.infinite), connected);
#ifdef VEILS
      shadow_bits |=
          pick_u((vu)0u, (vu)SHADOW_PASSES, light.delta) | pick_u((vu)0u, (vu)SHADOW_INFINITE, light.infinite);
#endif
    }
  }
#endif
  set_row_3(shadows, SHADOW_ROWS, block, ROW_ORIGIN, shadow_origin);
  set_row_f(shadows, SHADOW_ROWS, block, ROW_NEAR, zero_f());
  set_row_3(shadows, SHADOW_ROWS, block, ROW_DIRECTION, shadow_direction);
  set_row_f(shadows, SHADOW_ROWS, block, ROW_TIME, zero_f());
  set_row_f(shadows, SHADOW_ROWS, block, ROW_FAR, shadow_far);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_MASK, (vu)0xffffffffu);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SOURCE, primitive);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_FLAGS, (vu)0u);
  set_row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION, contribution);
  set_row_u(shadows, SHADOW_ROWS, block, ROW_SHADOW_SLOT, pick_u((vu)slot_count, slot | shadow_bits, connected));
#ifdef VEILS
  set_row_u(shadows, SHADOW_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
#endif

  // One scattered ray.
  vf d0, d1;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 3u, &d0, &d1);
  BsdfSample scattered = sample_bsdf(scene, &m, view, from_back, u_lobe, u_glass, d0, d1);
  v3 out = add3(add3(scale3(tangent, scattered.direction.x), scale3(bitangent, scattered.direction.y)),
                scale3(normal, scattered.direction.z));
  out = normalize3(out);
  v3 next_throughput = mul3(throughput, scattered.weight);
  vi specular = scattered.pdf <= zero_f();
  vf eta = row_f(paths, PATH_ROWS, block, ROW_ETA) * scattered.eta;
  vi alive =
      active & none(passes) & (max_component(next_throughput) > zero_f()) & finite3(next_throughput) & finite3(out);
  vu next_depth = min(depth + 1u, (vu)META_DEPTH_MASK);
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

#ifdef NEED_ALPHA
  out = pick3(out, direction, passes);
  next_throughput = pick3(next_throughput, throughput, passes);
  next_depth = pick_u(next_depth, depth, passes);
  next_diffuse = pick_u(next_diffuse, diffuse_count, passes);
  next_specular = (next_specular & none(passes)) | (specular_since & passes);
  eta = pick(eta, row_f(paths, PATH_ROWS, block, ROW_ETA), passes);
  scattered.pdf = pick(scattered.pdf, zero_f(), passes);
  alive = (alive & none(passes)) | (active & passes);
#endif
  v3 start = leave_surface(p, error, geometric, out);
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
}

#ifdef VEILS

// Shadow rays and their closest hits: adds the light samples that arrived, and sends on, weakened, those of point, spot
// and directional lights that met a surface which is not opaque. The others are blocked by it: their light is found by
// paths that pass it themselves.
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
  vi arrived = asked & none(hit);
  if (any_lane(arrived))
    add_to_slots(slots, slot_count, slot & ~SHADOW_BITS, (slot & SHADOW_INDIRECT) != 0u, contribution, arrived);

  vi passes = hit & ((slot & SHADOW_PASSES) != 0u);
  v3 origin = row_3(shadows, SHADOW_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(shadows, SHADOW_ROWS, block, ROW_DIRECTION);
  vu primitive = pick_u((vu)0u, row_u(shadows, SHADOW_ROWS, block, ROW_PRIMITIVE), passes);
  vu triangle = primitive * TRIANGLE_WORDS;
  vf b1 = row_f(shadows, SHADOW_ROWS, block, ROW_U), b2 = row_f(shadows, SHADOW_ROWS, block, ROW_V);
  vf t[16];
  load_words(scene->triangles, triangle, t);
  vu material = as_vu(t[TRIANGLE_MATERIAL]);
  vf opacity = material_f(scene, material, MATERIAL_ALPHA);
#ifdef NEED_TEXTURES
  vu texture = material_u(scene, material, MATERIAL_BASE_COLOR_TEXTURE);
  vi textured = passes & (texture != GLEANER_NONE);
  if (any_lane(textured)) {
    vf t2[16], alpha, b0 = one_f() - b1 - b2;
    load_words(scene->triangles + TRIANGLE_SECOND, triangle, t2);
    vf tu = b0 * t2[TRIANGLE_UV0 - TRIANGLE_SECOND] + b1 * t2[TRIANGLE_UV1 - TRIANGLE_SECOND] +
            b2 * t2[TRIANGLE_UV2 - TRIANGLE_SECOND];
    vf tv = b0 * t2[TRIANGLE_UV0 - TRIANGLE_SECOND + 1] + b1 * t2[TRIANGLE_UV1 - TRIANGLE_SECOND + 1] +
            b2 * t2[TRIANGLE_UV2 - TRIANGLE_SECOND + 1];
    texture_lookup(scene, texture, tu, tv, textured, &alpha);
    opacity = pick(opacity, opacity * alpha, textured);
  }
#endif
  opacity = opacity_of(scene, material, material_u(scene, material, MATERIAL_FLAGS), opacity);
  contribution = scale3(contribution, one_f() - opacity);
  passes = passes & (max_component(contribution) > zero_f());
  v3 p0 = words3(t, TRIANGLE_P0);
  v3 e1 = sub3(words3(t, TRIANGLE_P1), p0), e2 = sub3(words3(t, TRIANGLE_P2), p0), error;
  v3 p = surface_point(p0, e1, e2, b1, b2, &error);
  v3 start = leave_surface(p, error, normalize3(cross3(e1, e2)), direction);
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
  add_to_slots(slots, slot_count, slot & ~SHADOW_BITS, indirect, row_3(shadows, SHADOW_ROWS, block, ROW_CONTRIBUTION),
               arrived);
}

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
  float sum[6] = {0, 0, 0, 0, 0, 0};
  uint lost = 0;
  for (uint s = 0; s < used; ++s) {
    global const float* slot = slots + (ulong)SLOT_WORDS * (item * samples + s);
    int fine = 1;
    for (uint k = 0; k < 6; ++k) fine = fine && fabs(slot[k]) <= 3.402823466e38f;
    if (fine)
      for (uint k = 0; k < 6; ++k) sum[k] += slot[k];
    else
      ++lost;
  }
  uint words = parameters->features ? 14u : 6u;
  global float* record = records + (ulong)words * item;
  for (uint k = 0; k < 6; ++k) record[k] = sum[k];
  if (parameters->features) {
    float f[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    for (uint s = 0; s < used; ++s)
      for (uint k = 0; k < 8; ++k) f[k] += features[(ulong)FEATURE_WORDS * (item * samples + s) + k];
    for (uint k = 0; k < 8; ++k) record[6 + k] = f[k];
  }
  if (lost) {
    atomic_add(report, lost);
    uint at = atomic_inc(report + 1);
    if (at < REPORTED_ITEMS) report[2 + at] = item;
  }
}
