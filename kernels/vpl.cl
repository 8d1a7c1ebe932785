// Virtual point lights with clusters, after Colom, Marques & Santos 2022, "Interactive VPL-based global illumination on
// the GPU using fuzzy clustering" (numbers of equations below are its own):
//
//   vpl_emit, vpl_walk_light    light paths; every diffuse layer they meet becomes a VPL
//   vpl_generate, vpl_walk      camera paths through mirrors and glass to the points that are shaded
//   visibility_least, _rays, _pack   bits: which light does a point (cluster) see
//   vpl_members                 the point clusters a point belongs to, with weights (eq. 9-10)
//   vpl_gather                  eq. 6
//   vpl_doubt, _rays, vpl_settle, vpl_resolve   how far the clusters are off, by lights that points ask themselves
//
// A surface's diffuse layer is lit by VPLs and makes them, and so does a rough specular lobe (bsdf.h). What other lobes
// carry is left to the path tracer (COVERED in kernels/path.cl), whose paths end where a VPL has been. The two add up
// to everything.

// How steeply a cluster's place may rise above a point's plane (as a sine) for the two to be of one surface.
#define SAME_SURFACE 0.25f

#include "kernels/camera.h"
#include "kernels/cluster_grid.h"
#include "kernels/lights.h"
#include "kernels/path_layout.h"
#include "kernels/stage_records.h"
#include "kernels/surface.h"
#include "kernels/wide.h"

// Light paths in flight: the rows of kernels/path_layout.h with meanings of their own.
#define ROW_RANGE ROW_PDF  // of the light's window; 0: none, or passed already
#define LIGHT_BOUNCE_MASK 255u
#define LIGHT_DEPTH 8u
#define LIGHT_COUNT 16u      // slots taken
#define LIGHT_DOUBLINGS 20u  // of the spacing
#define MOST_DOUBLINGS 20u
#define ROW_PASSED ROW_ETA     // what the path's diffuse layers have sent on so far, by vpl_weight
#define ROW_SPACING ROW_COVER  // of its VPLs at first

#define VPL_SEQUENCE 65536u

FN void set_walk(global float* paths, uint block, v3 origin, v3 direction, vi idle, v3 throughput, vu slot, vu meta,
                 vu key, vf range) {
  set_ray(paths, PATH_ROWS, block, origin, direction, pick((vf)INFINITY, (vf)-1.0f, idle), (vu)GLEANER_NONE);
  set_row_u(paths, PATH_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT, throughput);
  set_row_f(paths, PATH_ROWS, block, ROW_RANGE, range);
  set_row_u(paths, PATH_ROWS, block, ROW_SLOT, slot);
  set_row_u(paths, PATH_ROWS, block, ROW_META, meta);
  set_row_u(paths, PATH_ROWS, block, ROW_KEY, key);
}

// Luminance.
FN vf brightness(v3 c) { return c.x * 0.2126f + c.y * 0.7152f + c.z * 0.0722f; }
FN float brightness_of(float r, float g, float b) { return 0.2126f * r + 0.7152f * g + 0.0722f * b; }

// --- Light paths ---

#ifdef NEED_LIGHTS

// What decides how many VPLs stand for some flux: its luminance, or a trace of it all where it has next to none.
FN vf vpl_weight(v3 flux) { return max_f(brightness(flux), (flux.x + flux.y + flux.z) * 1e-3f); }

// Of the lights in a path's slots, every second one goes, and the others carry twice as much.
FN void halve_lights(global float* records, vu slot, vu odd) {
  vu first = slot * VPL_PATH_SLOTS;
  for (uint k = 0; k < VPL_PATH_SLOTS / 2u; ++k) {
    vu from = (first + 2u * k + odd) * VPL_WORDS, to = (first + k) * VPL_WORDS;
    for (uint word = 0; word < VPL_WORDS; ++word) {
      vf value = gather_f(records, from + word);
      uint twice = (word >= VPL_FLUX && word < VPL_FLUX + 3u) || (word >= VPL_SENT && word < VPL_SENT + 3u);
      scatter_f(records, to + word, twice ? value * 2.0f : value);
    }
  }
  for (uint k = VPL_PATH_SLOTS / 2u; k < VPL_PATH_SLOTS; ++k)
    for (uint word = VPL_FLUX; word < VPL_FLUX + 3u; ++word)
      scatter_f(records, (first + k) * VPL_WORDS + word, zero_f());
}

// Light paths' starts: a light by its power, a point on it, a direction from it. Throughput is the flux that the path
// stands for, W; the mean over all paths is the scene's light.
kernel WIDE void vpl_emit(global const VplTraceParameters* restrict parameters, SCENE_PARAMETERS,
                          global const float* restrict emission, uint first_low, uint first_high, uint count,
                          global float* restrict paths) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu lane = (vu)first_lane + lane_index();
  ulong first = (((ulong)first_high << 32) | first_low) + first_lane;
  vu sample = ((vu)(uint)(first & (VPL_SEQUENCE - 1u)) + lane_index()) & (VPL_SEQUENCE - 1u);
  // Each run of 65,536 paths has a sequence of its own; blocks of 16 never straddle two.
  uint sequence = (uint)(first >> 16);
  vu key = hash_combine(hash_combine(hash_combine((vu)parameters->seed_low, (vu)parameters->seed_high),
                                     (vu)(parameters->set ^ 0x56504c00u)),
                        (vu)sequence);
  vf u_light, u_spare, u0, u1, d0, d1;
  sample_pair(key, sample, VPL_SEQUENCE, 0u, &u_light, &u_spare);
  sample_pair(key, sample, VPL_SEQUENCE, 1u, &u0, &u1);
  sample_pair(key, sample, VPL_SEQUENCE, 2u, &d0, &d1);
  global const uint* header = (global const uint*)emission;
  uint entries = header[EMISSION_COUNT];
  global const float* cdf = emission + EMISSION_HEADER;
  vu low = (vu)0u;
  for (uint step = header[EMISSION_STEP]; step > 0u; step >>= 1) {
    vu probe = low + step;
    vi inside = probe < entries;
    low = pick_u(low, probe, inside & (gather_f(cdf, pick_u((vu)0u, probe - 1u, inside)) <= u_light));
  }
  vf share = gather_f(cdf, low) - pick(zero_f(), gather_f(cdf, pick_u((vu)0u, low - 1u, low > 0u)), low > 0u);
  v3 center = uniform3(emission[EMISSION_CENTER], emission[EMISSION_CENTER + 1], emission[EMISSION_CENTER + 2]);
  vf radius = (vf)emission[EMISSION_RADIUS];
  vi sky = (low == entries - 1u) & ((vu)header[EMISSION_ENVIRONMENT] != 0u);
  vf e[16];
  load_words(scene->emitters, pick_u(low, (vu)0u, sky) * EMITTER_WORDS, e);
  vu kind = gather_u((global const uint*)scene->clusters + CLUSTER_KIND, as_vu(e[EMITTER_CLUSTER]) * CLUSTER_WORDS);
  v3 origin = center, direction = uniform3(0.0f, 0.0f, 1.0f), flux = splat3(zero_f());
  vf range = zero_f();
#ifdef NEED_EMISSIVE_TRIANGLES
  {
    vi here = none(sky) & (kind == CLUSTER_TRIANGLES);
    v3 e1 = words3(e, EMITTER_E1), e2 = words3(e, EMITTER_E2);
    vf b1, b2;
    sample_triangle(u0, u1, &b1, &b2);
    v3 error;
    v3 q = surface_point(words3(e, EMITTER_P0), e1, e2, b1, b2, &error);
    v3 n = cross3(e1, e2);
    vf doubled = length3(n);
    n = normalize3(n);
    v3 s, t;
    basis3(n, &s, &t);
    v3 around = sample_cosine(d0, d1);
    v3 w = normalize3(add3(add3(scale3(s, around.x), scale3(t, around.y)), scale3(n, around.z)));
    origin = pick3(origin, leave_surface(q, error, n, w), here);
    direction = pick3(direction, w, here);
    // Cosine-weighted over the front: pi times the area.
    flux = pick3(flux, scale3(emitter_radiance(scene, e, b1, b2, here), doubled * (vf)1.5707963267948966f), here);
  }
#endif
#ifdef NEED_PUNCTUAL_LIGHTS
  {
    vi here = none(sky) & (kind == CLUSTER_POSITIONAL);
    v3 axis = words3(e, EMITTER_DIRECTION), intensity = words3(e, EMITTER_RADIANCE);
    vf inner = e[EMITTER_COS_INNER], outer = e[EMITTER_COS_OUTER];
    // Uniform over the cone (a point light's is the sphere).
    vf z = one_f() - d1 * (one_f() - outer);
    vf r = safe_sqrt(one_f() - z * z), sine, cosine;
    sincos_2pi(d0, &sine, &cosine);
    v3 s, t;
    v3 pole = pick3(axis, uniform3(0.0f, 0.0f, 1.0f), dot3(axis, axis) <= zero_f());
    basis3(pole, &s, &t);
    v3 w = normalize3(add3(add3(scale3(s, r * cosine), scale3(t, r * sine)), scale3(pole, z)));
    vf cone = clamp_f((z - outer) / max_f((vf)1e-4f, inner - outer), zero_f(), one_f());
    cone = pick(cone * cone, one_f(), outer <= (vf)-1.0f);
    origin = pick3(origin, words3(e, EMITTER_POSITION), here);
    direction = pick3(direction, w, here);
    flux = pick3(flux, scale3(intensity, cone * (one_f() - outer) * (vf)6.28318530717958648f), here);
    range = pick(range, e[EMITTER_RANGE], here);
    vi far = none(sky) & (kind == CLUSTER_DIRECTIONAL);
    basis3(axis, &s, &t);
    vf dr = radius * sqrt(u1);
    sincos_2pi(u0, &sine, &cosine);
    v3 disc = add3(scale3(s, dr * cosine), scale3(t, dr * sine));
    origin = pick3(origin, add3(center, mad3(axis, -radius, disc)), far);
    direction = pick3(direction, axis, far);
    flux = pick3(flux, scale3(intensity, radius * radius * (vf)3.14159265358979324f), far);
  }
#endif
#ifdef NEED_ENVIRONMENT
  if (any_lane(sky)) {
    vf pdf, sine, cosine;
    v3 radiance, s, t;
    v3 w = environment_sample(scene, d0, d1, &pdf, &radiance);
    basis3(w, &s, &t);
    vf dr = radius * sqrt(u1);
    sincos_2pi(u0, &sine, &cosine);
    v3 disc = add3(scale3(s, dr * cosine), scale3(t, dr * sine));
    origin = pick3(origin, add3(center, mad3(w, radius, disc)), sky);
    direction = pick3(direction, negate3(w), sky);
    flux = pick3(flux, scale3(radiance, radius * radius * (vf)3.14159265358979324f / pdf), sky & (pdf > zero_f()));
  }
#endif
  flux = scale3(flux, one_f() / share);
  vi idle = (lane >= count) | none(share > zero_f()) | none(finite3(flux)) | none(max_component(flux) > zero_f());
  set_walk(paths, block, origin, direction, idle, flux, lane, pick_u((vu)0u, (vu)META_IDLE, idle), key, range);
  set_row_u(paths, PATH_ROWS, block, ROW_TOTAL, sample);
  set_row_f(paths, PATH_ROWS, block, ROW_PASSED, zero_f());
  // A white surface sends on 1 / pi of it.
  set_row_f(paths, PATH_ROWS, block, ROW_SPACING, vpl_weight(flux) * (vf)(0.25f * INV_PI));
}

// One step of the light paths: a VPL where a diffuse layer was met, then a scattered ray in place of the old one.
kernel WIDE void vpl_walk_light(global const VplTraceParameters* restrict parameters, SCENE_PARAMETERS, uint count,
                                global float* paths, global float* records, global uint* counters) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi active = ((meta & META_IDLE) == 0u) & (row_u(paths, PATH_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  set_row_f(paths, PATH_ROWS, block, ROW_FAR, (vf)-1.0f);
  set_row_u(paths, PATH_ROWS, block, ROW_META, (vu)META_IDLE);
  if (!any_lane(active)) return;
  v3 origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  v3 flux = row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT);
  vf range = row_f(paths, PATH_ROWS, block, ROW_RANGE);
  vu slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  vu key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  vu sample = row_u(paths, PATH_ROWS, block, ROW_TOTAL);
  vu bounce = meta & LIGHT_BOUNCE_MASK;
  vu depth = (meta >> LIGHT_DEPTH) & 255u;
  vu made = (meta >> LIGHT_COUNT) & 15u, doublings = (meta >> LIGHT_DOUBLINGS) & 31u;
  vu primitive = pick_u((vu)0u, row_u(paths, PATH_ROWS, block, ROW_PRIMITIVE), active);
  Hit h =
      load_hit(scene, primitive, row_f(paths, PATH_ROWS, block, ROW_U), row_f(paths, PATH_ROWS, block, ROW_V), active);
  Surface m;
  load_color(scene, &h, &m, active);
  // KHR_lights_punctual's window over the first segment.
  {
    vf ratio = length3(sub3(h.p, origin)) / range;
    vf window = clamp_f(one_f() - ratio * ratio * ratio * ratio, zero_f(), one_f());
    flux = scale3(flux, pick(one_f(), window, range > zero_f()));
  }
  flux = absorbed(scene, &h, origin, direction, flux, active);
  vu pair_key = hash_combine(key, bounce * 4u + 16u);
  vf u_lobe, u_glass, d0, d1, u_spare, u_roulette;
  sample_pair(pair_key, sample, VPL_SEQUENCE, 0u, &u_spare, &u_roulette);
  sample_pair(pair_key, sample, VPL_SEQUENCE, 2u, &u_lobe, &u_glass);
  sample_pair(pair_key, sample, VPL_SEQUENCE, 3u, &d0, &d1);
  vi passes = passes_by_lot(&m, active, &u_glass);
#ifdef NEED_UNLIT
  active = active & (passes | ((as_vu(h.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) == 0u));
#endif
  load_lobes(scene, &h, &m, active);
  ShadingFrame f = shading_frame(h.normal, direction);
  v3 geometric = pick3(h.geometric, negate3(h.geometric), dot3(h.geometric, direction) > zero_f());
  active = active & ((f.view.z > (vf)1e-6f) | passes);
#ifdef NEED_LOBE
  prepare_lobe(scene, &m, max_f(f.view.z, (vf)1e-6f));
#endif
  // Flux is per area of the triangle, scattering by the cosine to the shading normal (Veach 1997, 5.3).
  vf bend = f.view.z / max_f(fabs(dot3(geometric, direction)), (vf)1e-6f);

  // The VPL. What glass does with the path is not the diffuse layer's.
  vi layered = active & none(passes) & ((depth < parameters->depth) | ((vu)parameters->depth == 0u));
#ifdef NEED_TRANSMISSIVE
  layered = layered & (u_glass >= m.transmission);
#endif
  v3 layer = scale3(m.base, (vf)INV_PI);
  vu table = (vu)GLEANER_NONE;
  vf table_row = zero_f();
#ifdef NEED_LOBE
  layer = scale3(layer, m.left_view * (one_f() - m.metallic) / m.left_mean);
  table = m.table;
  table_row = m.table_row;
#endif
#ifdef NEED_LOBE
  vi rough = has_rough_lobe(&m);
  v3 f0 = lobe_f0(&m);
  vf f90 = lobe_f90(&m);
  layer = pick3(layer, add3(layer, mean_lobe(f0, f90, f.view.z)), rough);
#endif
  v3 sent = scale3(mul3(flux, layer), bend);
  layered = layered & (max_component(sent) > zero_f()) & finite3(sent);
  vf passed = row_f(paths, PATH_ROWS, block, ROW_PASSED), spacing = row_f(paths, PATH_ROWS, block, ROW_SPACING);
  if (any_lane(layered)) {
    // A mark every `spacing` of what the path sends on: where it passes one, a VPL of just that flux stays. However
    // long the path is, its VPLs are of one brightness, and where they lie is left to what is sent.
    vf weight = vpl_weight(sent);
    v3 share = scale3(sent, one_f() / weight);
    passed += pick(zero_f(), weight, layered);
    vf offset, unused;
    sample_pair(key, sample, VPL_SEQUENCE, 0u, &unused, &offset);
    vu lot = hash_combine(hash_combine(key, sample), 0x6d61726bu);
    for (;;) {
      // Doubled spacings shift the marks by whole old ones.
      vf shift = offset + to_f(lot & (((vu)1u << doublings) - 1u));
      vf scale = to_f((vu)1u << doublings);
      vi passes_mark = layered & ((shift + to_f(made) * scale) * spacing < passed);
      if (!any_lane(passes_mark)) break;
      vi full = passes_mark & (made >= VPL_PATH_SLOTS);
      // Lanes with nothing to write do so behind the records.
      if (any_lane(full)) {
        layered = layered & (none(full) | (doublings < MOST_DOUBLINGS));
        vu odd = (lot >> doublings) & 1u;
        halve_lights(records, pick_u((vu)count, slot, full), odd);
        made = pick_u(made, (vu)(VPL_PATH_SLOTS / 2u), full);
        doublings = pick_u(doublings, min(doublings + 1u, (vu)MOST_DOUBLINGS), full);
        continue;
      }
      vu at = pick_u((vu)count * VPL_PATH_SLOTS, slot * VPL_PATH_SLOTS + made, passes_mark) * VPL_WORDS;
      vf carried = spacing * scale;
      scatter_f(records + VPL_POSITION, at, h.p.x);
      scatter_f(records + VPL_POSITION + 1u, at, h.p.y);
      scatter_f(records + VPL_POSITION + 2u, at, h.p.z);
      scatter_f(records + VPL_NORMAL, at, f.normal.x);
      scatter_f(records + VPL_NORMAL + 1u, at, f.normal.y);
      scatter_f(records + VPL_NORMAL + 2u, at, f.normal.z);
      scatter_f(records + VPL_GEOMETRIC, at, geometric.x);
      scatter_f(records + VPL_GEOMETRIC + 1u, at, geometric.y);
      scatter_f(records + VPL_GEOMETRIC + 2u, at, geometric.z);
      scatter_f(records + VPL_FLUX, at, share.x * carried);
      scatter_f(records + VPL_FLUX + 1u, at, share.y * carried);
      scatter_f(records + VPL_FLUX + 2u, at, share.z * carried);
      global uint* words = (global uint*)records;
      scatter_u(words + VPL_TABLE, at, table);
      scatter_f(records + VPL_ROW, at, table_row);
      scatter_f(records + VPL_ERROR, at, h.error.x);
      scatter_f(records + VPL_ERROR + 1u, at, h.error.y);
      scatter_f(records + VPL_ERROR + 2u, at, h.error.z);
      scatter_f(records + VPL_RADIUS, at, zero_f());
      scatter_f(records + VPL_COS, at, one_f());
      scatter_f(records + VPL_COUNT, at, one_f());
      scatter_f(records + VPL_DEPTH, at, to_f(depth) + 1.0f);
#ifdef NEED_LOBE
      // Slots may hold what halve_lights() left there.
      v3 scattered_flux = pick3(splat3(zero_f()), scale3(flux, bend * carried / weight), rough);
      scatter_f(records + VPL_SENT, at, scattered_flux.x);
      scatter_f(records + VPL_SENT + 1u, at, scattered_flux.y);
      scatter_f(records + VPL_SENT + 2u, at, scattered_flux.z);
      scatter_f(records + VPL_F0, at, f0.x);
      scatter_f(records + VPL_F0 + 1u, at, f0.y);
      scatter_f(records + VPL_F0 + 2u, at, f0.z);
      scatter_f(records + VPL_F90, at, f90);
      scatter_f(records + VPL_ALPHA, at, pick(zero_f(), m.alpha, rough));
      scatter_f(records + VPL_INCOMING, at, -direction.x);
      scatter_f(records + VPL_INCOMING + 1u, at, -direction.y);
      scatter_f(records + VPL_INCOMING + 2u, at, -direction.z);
#endif
      made += pick_u((vu)0u, (vu)1u, passes_mark);
    }
  }

  BsdfSample scattered = sample_bsdf(scene, &m, f.view, f.from_back, u_lobe, u_glass, d0, d1);
  v3 out = from_frame(&f, scattered.direction);
  // Flux is not squeezed by refraction as radiance is; and the other half of the shading normals' bend.
  vf unbend = fabs(dot3(geometric, out)) / max_f(fabs(scattered.direction.z), (vf)1e-6f);
  vf adjoint = bend * unbend * scattered.eta * scattered.eta;
  v3 weight = scale3(scattered.weight, adjoint);
  v3 next = mul3(flux, weight);
  vu next_depth = min(depth + 1u, (vu)255u);
  vi alive = active & none(passes) & (max_component(next) > zero_f()) & finite3(next) & finite3(out);
  if (parameters->depth) alive = alive & (next_depth < (vu)parameters->depth);
  vf survival = min_f(max_component(next) / max_component(flux), (vf)ROULETTE_MOST);
  vi roulette = alive & (next_depth >= 2u);
  alive = alive & (none(roulette) | (u_roulette < survival));
  next = pick3(next, scale3(next, one_f() / survival), roulette);
#ifdef NEED_ALPHA
  out = pick3(out, direction, passes);
  next = pick3(next, flux, passes);
  next_depth = pick_u(next_depth, depth, passes);
  alive = (alive & none(passes)) | (active & passes);
#endif
  v3 start = leave_surface(h.p, h.error, h.geometric, out);
  alive = alive & (bounce < (vu)LIGHT_BOUNCE_MASK) & finite3(start);
  uint kept;
  rank_lanes(alive, &kept);
  if (kept == 0u) return;
  atomic_add(counters, kept);
  vu next_meta = ((bounce + 1u) & LIGHT_BOUNCE_MASK) | (next_depth << LIGHT_DEPTH) | (made << LIGHT_COUNT) |
                 (doublings << LIGHT_DOUBLINGS);
  set_row_f(paths, PATH_ROWS, block, ROW_PASSED, passed);
  set_walk(paths, block, start, out, none(alive), next, slot, pick_u((vu)META_IDLE, next_meta, alive), key, zero_f());
}

#endif

// --- Shading points ---

// Camera rays of `count` paths from `first_path` on. Sixteen pixels in a row, then their next samples: what a
// work-item handles at once are neighbours that look at one slice of the lights.
kernel WIDE void vpl_generate(global const VplPointParameters* restrict parameters, uint first_low, uint first_high,
                              uint count, uint by_point, global float* restrict paths, global float* restrict points) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  uint samples = parameters->samples;
  ulong first = ((ulong)first_high << 32) | first_low;
  ulong total = ((ulong)parameters->items_high << 32) | parameters->items_low;
  vu item, sample;
  vi idle = lane >= count;
  if (by_point) {
    item = lane + (uint)first;
    sample = item & (samples - 1u);
    idle = idle | (item >= (vu)(uint)total);
    item *= parameters->stride;
  } else {
    vu row = lane >> 4;
    sample = row & (samples - 1u);
    item = (row / samples) * 16u + (lane & 15u) + (uint)first;
    idle = idle | (item >= (vu)(uint)total);
  }
  vu pixel = min(item, (vu)(parameters->width * parameters->height - 1u));
  vu key = hash_combine(hash_combine(hash_combine((vu)parameters->seed_low, (vu)parameters->seed_high), pixel),
                        (vu)(parameters->set ^ 0x53505400u));
  vf jx, jy;
  sample_pair(key, sample, samples, 0u, &jx, &jy);
  v3 origin, direction;
  camera_ray(&parameters->camera, parameters->width, parameters->height, pixel, jx, jy, &origin, &direction);
  set_walk(paths, block, origin, direction, idle, splat3(one_f()), lane,
           pick_u(sample << META_SAMPLE, (vu)META_IDLE, idle), key, zero_f());
  for (uint k = 0; k < POINT_WORDS; ++k)
    store_f(points + POINT_WORDS * first_lane + k * LANES, 0, as_vf((vu)GLEANER_NONE));
}

// One step of the camera paths: those that met a diffuse layer have their point, those that met a mirror or glass go
// on.
// `lobed`: the points' rough lobes are kept too.
kernel WIDE void vpl_walk(global const VplPointParameters* restrict parameters, SCENE_PARAMETERS, uint count,
                          global float* paths, global float* points, global uint* counters, uint lobed,
                          global float* restrict lobes) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi active = ((meta & META_IDLE) == 0u) & (row_u(paths, PATH_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  set_row_f(paths, PATH_ROWS, block, ROW_FAR, (vf)-1.0f);
  set_row_u(paths, PATH_ROWS, block, ROW_META, (vu)META_IDLE);
  if (!any_lane(active)) return;
  v3 origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  v3 throughput = row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT);
  vu slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  vu key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  vu depth = meta & META_DEPTH_MASK;
  vu bounce = (meta >> META_BOUNCE) & META_BOUNCE_MASK;
  vu sample = (meta >> META_SAMPLE) & META_SAMPLE_MASK;
  vu primitive = pick_u((vu)0u, row_u(paths, PATH_ROWS, block, ROW_PRIMITIVE), active);
  Hit h =
      load_hit(scene, primitive, row_f(paths, PATH_ROWS, block, ROW_U), row_f(paths, PATH_ROWS, block, ROW_V), active);
  Surface m;
  load_color(scene, &h, &m, active);
  throughput = absorbed(scene, &h, origin, direction, throughput, active);
  vu pair_key = hash_combine(key, bounce * 4u + 1u);
  vf u_lobe, u_glass, d0, d1, u_roulette, u_spare;
  sample_pair(pair_key, sample, parameters->samples, 0u, &u_roulette, &u_spare);
  sample_pair(pair_key, sample, parameters->samples, 2u, &u_lobe, &u_glass);
  sample_pair(pair_key, sample, parameters->samples, 3u, &d0, &d1);
  vi passes = passes_by_lot(&m, active, &u_glass);
#ifdef NEED_UNLIT
  active = active & (passes | ((as_vu(h.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) == 0u));
#endif
  load_lobes(scene, &h, &m, active);
  ShadingFrame f = shading_frame(h.normal, direction);
  active = active & ((f.view.z > (vf)1e-6f) | passes);
#ifdef NEED_LOBE
  prepare_lobe(scene, &m, max_f(f.view.z, (vf)1e-6f));
#endif
  vi stops = active & none(passes);
  // Of the scatterings that are allowed, the VPL and this point need two.
  if (parameters->depth) stops = stops & (depth + 2u <= (vu)parameters->depth);
  vi on = active & none(passes);
  vu table = (vu)GLEANER_NONE;
  vf table_row = zero_f();
  v3 albedo = m.base;
#ifdef NEED_LOBE
  // A bare metal has no layer below its lobe; unless it is rough, it is walked through as a mirror is.
  vi rough = has_rough_lobe(&m);
  vi bare = (m.lobe_share >= one_f()) & none(rough);
  albedo = scale3(albedo, m.left_view * (one_f() - m.metallic) / m.left_mean);
  table = m.table;
  table_row = m.table_row;
#else
  vi bare = no_lanes(), rough = no_lanes();
#endif
#ifdef NEED_TRANSMISSIVE
  vi glass = u_glass < m.transmission;
#else
  vi glass = no_lanes();
#endif
  on = on & (bare | glass);
  stops = stops & none(on) & ((max_component(albedo) > zero_f()) | rough);
  if (any_lane(stops)) {
    vu at = pick_u((vu)count, slot, stops) * POINT_WORDS;
    global uint* words = (global uint*)points;
    v3 sent = scale3(mul3(throughput, albedo), (vf)INV_PI);
    scatter_f(points + POINT_POSITION, at, h.p.x);
    scatter_f(points + POINT_POSITION + 1u, at, h.p.y);
    scatter_f(points + POINT_POSITION + 2u, at, h.p.z);
    scatter_f(points + POINT_NORMAL, at, f.normal.x);
    scatter_f(points + POINT_NORMAL + 1u, at, f.normal.y);
    scatter_f(points + POINT_NORMAL + 2u, at, f.normal.z);
    scatter_u(words + POINT_TABLE, at, table);
    scatter_f(points + POINT_ROW, at, table_row);
    scatter_f(points + POINT_WEIGHT, at, one_f());
    scatter_f(points + POINT_ALBEDO, at, sent.x);
    scatter_f(points + POINT_ALBEDO + 1u, at, sent.y);
    scatter_f(points + POINT_ALBEDO + 2u, at, sent.z);
    scatter_u(words + POINT_TRIANGLE, at, primitive);
    scatter_f(points + POINT_B1, at, h.b1);
    scatter_f(points + POINT_B2, at, h.b2);
    scatter_f(points + POINT_COS, at, one_f());
#ifdef NEED_LOBE
    if (lobed) {
      vu lobe_at = pick_u((vu)count, slot, stops) * LOBE_WORDS;
      v3 f0 = lobe_f0(&m);
      scatter_f(lobes + LOBE_VIEW, lobe_at, -direction.x);
      scatter_f(lobes + LOBE_VIEW + 1u, lobe_at, -direction.y);
      scatter_f(lobes + LOBE_VIEW + 2u, lobe_at, -direction.z);
      scatter_f(lobes + LOBE_THROUGHPUT, lobe_at, throughput.x);
      scatter_f(lobes + LOBE_THROUGHPUT + 1u, lobe_at, throughput.y);
      scatter_f(lobes + LOBE_THROUGHPUT + 2u, lobe_at, throughput.z);
      scatter_f(lobes + LOBE_F0, lobe_at, f0.x);
      scatter_f(lobes + LOBE_F0 + 1u, lobe_at, f0.y);
      scatter_f(lobes + LOBE_F0 + 2u, lobe_at, f0.z);
      scatter_f(lobes + LOBE_F90, lobe_at, lobe_f90(&m));
      scatter_f(lobes + LOBE_ALPHA, lobe_at, pick(zero_f(), m.alpha, rough));
    }
#endif
  }
  BsdfSample scattered = sample_bsdf(scene, &m, f.view, f.from_back, u_lobe, u_glass, d0, d1);
  v3 out = from_frame(&f, scattered.direction);
  v3 next = mul3(throughput, scattered.weight);
  vi alive = on & (max_component(next) > zero_f()) & finite3(next) & finite3(out);
  vu next_depth = min(depth + 1u, (vu)META_DEPTH_MASK);
  // Two mirrors may face each other.
  vf survival = min_f(max_component(next), (vf)ROULETTE_MOST);
  vi roulette = alive & (next_depth >= 8u);
  alive = alive & (none(roulette) | (u_roulette < survival));
  next = pick3(next, scale3(next, one_f() / survival), roulette);
#ifdef NEED_ALPHA
  out = pick3(out, direction, passes);
  next = pick3(next, throughput, passes);
  next_depth = pick_u(next_depth, depth, passes);
  alive = alive | (active & passes);
#endif
  v3 start = leave_surface(h.p, h.error, h.geometric, out);
  alive = alive & (bounce < (vu)META_BOUNCE_MASK) & finite3(start);
  uint kept;
  rank_lanes(alive, &kept);
  if (kept == 0u) return;
  atomic_add(counters, kept);
  vu next_meta = next_depth | ((bounce + 1u) << META_BOUNCE) | (sample << META_SAMPLE);
  set_walk(paths, block, start, out, none(alive), next, slot, pick_u((vu)META_IDLE, next_meta, alive), key, zero_f());
}

// --- Visibility ---

// From a point to a light's place, both off their surfaces. The query's own rounding grows with the distance, as in
// sample_light().
FN void connect_light(v3 p, v3 p_error, v3 p_geometric, v3 q, v3 q_error, v3 q_geometric, v3* start, v3* direction) {
  v3 d = sub3(q, p);
  const vf unit = (vf)(16.0f * 5.9604645e-8f);
  q_error = add3(q_error, make3(unit * fabs(d.x), unit * fabs(d.y), unit * fabs(d.z)));
  *start = leave_surface(p, p_error, p_geometric, d);
  *direction = sub3(leave_surface(q, q_error, q_geometric, negate3(d)), *start);
}

FN void set_visibility_ray(global float* rays, uint block, v3 start, v3 direction, vi active, vu source) {
  set_ray(rays, VISIBILITY_ROWS, block, start, direction, pick((vf)-1.0f, (vf)SHADOW_FAR, active), source);
}

// The bounded geometry term (eq. 4) between a point and a light, 1/m^2. `side`: the cosine at the light, by its normal
// for shading, times the distance; `at_point` as well; `inverse`: one over the squared distance.
FN vf bounded_geometry(v3 p, v3 n, v3 q, v3 light_normal, v3 light_geometric, vf clamp_to, vf* at_point, vf* side,
                       vf* inverse) {
  v3 d = sub3(q, p);
  vf d2 = dot3(d, d);
  *at_point = dot3(n, d);
  *side = -dot3(light_normal, d);
  *inverse = one_f() / d2;
  vf g = min_f(*at_point * fabs(dot3(light_geometric, d)) * *inverse * *inverse, clamp_to);
  return pick(zero_f(), g, (*at_point > zero_f()) & (*side > zero_f()) & (d2 > zero_f()));
}

FN vf plain_geometry(global const float* light, v3 p, v3 n, vf clamp_to, vf* at_point, vf* side, vf* inverse) {
  return bounded_geometry(p, n, uniform3(light[VPL_POSITION], light[VPL_POSITION + 1], light[VPL_POSITION + 2]),
                          uniform3(light[VPL_NORMAL], light[VPL_NORMAL + 1], light[VPL_NORMAL + 2]),
                          uniform3(light[VPL_GEOMETRIC], light[VPL_GEOMETRIC + 1], light[VPL_GEOMETRIC + 2]), clamp_to,
                          at_point, side, inverse);
}

FN float light_brightness(global const float* light) {
  return brightness_of(light[VPL_FLUX], light[VPL_FLUX + 1], light[VPL_FLUX + 2]);
}

// What lights bring to points if nothing stands between, times `share`: what less than that brings is not worth a
// ray (see visibility_rays). Of `count` points from point_base on; a multiple of 32 lights.
kernel WIDE void visibility_least(global const float* restrict points, uint point_base, uint count,
                                  global const float* restrict lights, uint width, float clamp_to, float share,
                                  global float* restrict least) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(points, ((vu)point_base + min(lane, (vu)(count - 1u))) * POINT_WORDS, w);
  v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL);
  vf sum = zero_f();
  for (uint k = 0; k < width; ++k) {
    global const float* light = lights + VPL_WORDS * k;
    vf at_point, side, inverse;
    vf g = plain_geometry(light, p, n, (vf)clamp_to, &at_point, &side, &inverse);
    sum += g * light_brightness(light);
  }
  // A point on a light without a bound asks for all.
  store_f(least + first_lane, 0, pick(zero_f(), sum * (share / (float)width), sum < (vf)INFINITY));
}

// Rays from points to lights: `rows` points, each asked for `width` lights (a multiple of 32) from its own first one
// on; ray r is point r / width, light r % width of it. Pairs that face away from each other are not asked: neither ray
// nor answer (a point's and a light's clusters are told by the cones and spheres that hold their members). Nor are
// those that cannot bring a point more than `least` of row r / width. `left_out`: for each row, how many faced away,
// then how many brought too little.
kernel WIDE void visibility_rays(SCENE_PARAMETERS, global const float* restrict points,
                                 global const uint* restrict chosen, uint listed, global const float* restrict lights,
                                 uint width, uint slices, uint point_base, uint ray_base, uint count,
                                 global float* restrict rays, global uint* counters, global uint* left_out,
                                 global const float* restrict least, float clamp_to) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint ray = ray_base + first_lane;
  uint row = ray / width;  // of one point in all lanes: width is a multiple of 32
  uint point = listed ? chosen[row] : point_base + row;
  vi active = all_lanes();
  if (point == GLEANER_NONE) {
    active = no_lanes();
    point = 0u;
  }
  // A point's sample looks at a slice of its own (vpl_generate).
  uint slice = slices > 1u ? (point >> 4) & (slices - 1u) : 0u;
  vu light = (vu)(slice * width + (ray - row * width)) + lane_index();
  global const float* p_words = points + POINT_WORDS * point;
  uint triangle = ((global const uint*)p_words)[POINT_TRIANGLE];
  active = active & ((vu)triangle != GLEANER_NONE);
  vf l[16];
  vu at = pick_u((vu)0u, light, active) * VPL_WORDS;
  load_words(lights, at, l);
  active = active & ((l[VPL_FLUX] > zero_f()) | (l[VPL_FLUX + 1u] > zero_f()) | (l[VPL_FLUX + 2u] > zero_f()));
  vf second[16];
  load_words(lights + 8u, at, second);  // words 8 to 23
  v3 p = uniform3(p_words[POINT_POSITION], p_words[POINT_POSITION + 1], p_words[POINT_POSITION + 2]);
  v3 n = uniform3(p_words[POINT_NORMAL], p_words[POINT_NORMAL + 1], p_words[POINT_NORMAL + 2]);
  v3 q = words3(l, VPL_POSITION);
  v3 d = sub3(q, p);
  vf d2 = dot3(d, d);
  vf inverse = one_f() / sqrt(d2);
  v3 w = scale3(d, inverse);
  // The cosine a member could have at best: the cone's sine more, and the members' sphere seen from the other end.
  vf cone_p = (vf)p_words[POINT_COS], cone_q = second[VPL_COS - 8u];
  vf reach = second[VPL_RADIUS - 8u] * inverse;
  vf at_point = dot3(n, w) + safe_sqrt(one_f() - cone_p * cone_p) + reach;
  vf at_light = -dot3(words3(l, VPL_NORMAL), w) + safe_sqrt(one_f() - cone_q * cone_q) + reach;
  vi facing = (at_point > zero_f()) & (at_light > zero_f()) & (d2 > zero_f());
  // The most that a member could bring: as near as the members' sphere comes.
  vf nearest = max_f(one_f() - reach, zero_f());
  vf most = min_f(min_f(at_point, one_f()) * min_f(at_light, one_f()) * inverse * inverse / (nearest * nearest),
                  (vf)clamp_to) *
            brightness(words3(l, VPL_FLUX));
  vi much = most > (vf)least[row];
  uint away, little, asked;
  rank_lanes(active & none(facing), &away);
  active = active & facing;
  rank_lanes(active & none(much), &little);
  active = active & much;
  rank_lanes(active, &asked);
  if (away) atomic_add(left_out + 2u * row, away);
  if (little) atomic_add(left_out + 2u * row + 1u, little);
  if (asked) atomic_add(counters, asked);
  uint t_row = triangle == GLEANER_NONE ? 0u : triangle;
  global const float* t = scene->triangles + (ulong)TRIANGLE_WORDS * t_row;
  v3 p0 = uniform3(t[TRIANGLE_P0], t[TRIANGLE_P0 + 1], t[TRIANGLE_P0 + 2]);
  v3 e1 = sub3(uniform3(t[TRIANGLE_P1], t[TRIANGLE_P1 + 1], t[TRIANGLE_P1 + 2]), p0);
  v3 e2 = sub3(uniform3(t[TRIANGLE_P2], t[TRIANGLE_P2 + 1], t[TRIANGLE_P2 + 2]), p0);
  v3 error;
  surface_point(p0, e1, e2, (vf)p_words[POINT_B1], (vf)p_words[POINT_B2], &error);
  v3 start, direction;
  connect_light(p, error, normalize3(cross3(e1, e2)), q, words3(second, VPL_ERROR - 8u), words3(l, VPL_GEOMETRIC),
                &start, &direction);
  active = active & finite3(direction) & finite3(start);
  set_visibility_ray(rays, block, start, direction, active, (vu)triangle);
}

// Answers to bits: word first + k of `bits` holds rays 32 k to 32 k + 31 of this launch.
kernel void visibility_pack(global const float* restrict rays, uint words, uint first, global uint* restrict bits) {
  uint word = (uint)get_global_id(0);
  if (word >= words) return;
  uint value = 0u;
  for (uint part = 0; part < 2u; ++part) {
    global const float* far = rays + (ulong)16u * (VISIBILITY_ROWS * (2u * word + part) + ROW_FAR);
    for (uint k = 0; k < 16u; ++k) value |= far[k] > 0.0f ? 1u << (16u * part + k) : 0u;
  }
  bits[first + word] = value;
}

// --- Shading ---

// The point clusters that each point belongs to (algorithm 2), with weights by eq. 9-10. Rows of no meaning have
// weight 0. A point that no cluster within the threshold is near is lonely: it has to ask for itself.
kernel WIDE void vpl_members(global const VplPointParameters* restrict parameters, global const float* restrict points,
                             uint count, global const float* restrict grid, global const uint* restrict cells,
                             global const float* restrict seeds, float least_cosine, global uint* restrict rows,
                             global float* restrict weights, global uint* restrict lonely) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(points, min(lane, (vu)(count - 1u)) * POINT_WORDS, w);
  vi active = (as_vu(w[POINT_TRIANGLE]) != GLEANER_NONE) & (lane < count);
  vf best[FUZZINESS];
  vu who[FUZZINESS];
  nearest_seeds(words3(w, POINT_POSITION), words3(w, POINT_NORMAL), active, grid, cells, seeds, least_cosine, best,
                who);
  // A point on a representative is that one's alone.
  vi on_it = best[0] <= zero_f();
  vf total = zero_f();
  vf share[FUZZINESS];
  for (uint f = 0; f < FUZZINESS; ++f) {
    share[f] = parameters->equal_weights ? one_f() : one_f() / sqrt(best[f]);
    share[f] = pick(share[f], f == 0u ? one_f() : zero_f(), on_it);
    share[f] = pick(zero_f(), share[f], who[f] != GLEANER_NONE);
    total += share[f];
  }
  for (uint f = 0; f < FUZZINESS; ++f) {
    store_u(rows + (ulong)FUZZINESS * first_lane + f * LANES, 0, pick_u((vu)0u, who[f], who[f] != GLEANER_NONE));
    store_f(weights + (ulong)FUZZINESS * first_lane + f * LANES, 0, pick(zero_f(), share[f] / total, total > zero_f()));
  }
  store_u(lonely + first_lane, 0, pick_u((vu)0u, (vu)1u, active & (who[0] == GLEANER_NONE)));
}

#ifdef NEED_LOBE
FN vf left_at(const Scene* scene, vu table, vf table_row, vf cosine) {
  Surface m;
  m.table = table;
  m.table_row = table_row;
  return left_to_layer(scene, &m, cosine);
}
#endif

// What a point is lit by beside its row: lobes.
typedef struct {
#ifdef NEED_LOBE
  vu table;
  vf table_row;
  v3 view, throughput, f0;
  vf f90, alpha;
  vi rough;
  uint tables, lobes;  // any lane has one
#else
  uint none;
#endif
} PointLobe;

// `row`: of the point in `lobes`.
FN PointLobe load_point_lobe(const vf* point, global const float* lobes, vu row, vi active) {
  PointLobe lobe;
#ifdef NEED_LOBE
  lobe.table = pick_u((vu)GLEANER_NONE, as_vu(point[POINT_TABLE]), active);
  lobe.table_row = pick(zero_f(), point[POINT_ROW], active);
  lobe.tables = any_lane(lobe.table != GLEANER_NONE) ? 1u : 0u;
  vf w[16];
  load_words(lobes, row * LOBE_WORDS, w);
  lobe.alpha = w[LOBE_ALPHA];
  lobe.rough = active & (lobe.alpha > zero_f());
  lobe.lobes = any_lane(lobe.rough) ? 1u : 0u;
  lobe.view = words3(w, LOBE_VIEW);
  lobe.throughput = words3(w, LOBE_THROUGHPUT);
  lobe.f0 = words3(w, LOBE_F0);
  lobe.f90 = w[LOBE_F90];
#else
  lobe.none = 0u;
#endif
  return lobe;
}

// What a light would bring to a point if nothing stood between: to the diffuse layer, and to `glossy` what the point's
// rough lobe makes of it. The geometry term g is bounded (eq. 4), together with the lobes' gain at both ends; lobes
// take their part from the layers below them.
FN v3 light_brings(const Scene* scene, global const float* light, v3 p, v3 n, const PointLobe* lobe, vf clamp_to,
                   vf* inverse_out, v3* glossy) {
  v3 flux = uniform3(light[VPL_FLUX], light[VPL_FLUX + 1], light[VPL_FLUX + 2]);
  *glossy = splat3(zero_f());
  vf at_point, side, inverse;
#ifdef NEED_LOBE
  uint light_table = ((global const uint*)light)[VPL_TABLE];
  uint rough_light = light[VPL_ALPHA] > 0.0f;
  if (!lobe->lobes && !rough_light) {
    vf g = plain_geometry(light, p, n, clamp_to, &at_point, &side, &inverse);
    *inverse_out = inverse;
    vf r = sqrt(inverse);
    if (lobe->tables) g *= left_at(scene, lobe->table, lobe->table_row, at_point * r);
    if (light_table != GLEANER_NONE) g *= left_at(scene, (vu)light_table, (vf)light[VPL_ROW], side * r);
    return scale3(flux, g);
  }
  vf g = plain_geometry(light, p, n, (vf)INFINITY, &at_point, &side, &inverse);
  *inverse_out = inverse;
  vi facing = g > zero_f();
  vf r = sqrt(inverse), gain = one_f(), cosine = pick(one_f(), side * r, facing);
  vf left = light_table != GLEANER_NONE ? left_at(scene, (vu)light_table, (vf)light[VPL_ROW], cosine) : one_f();
  v3 q = uniform3(light[VPL_POSITION], light[VPL_POSITION + 1], light[VPL_POSITION + 2]);
  v3 toward = scale3(sub3(q, p), r);
  if (rough_light) {
    v3 normal = uniform3(light[VPL_NORMAL], light[VPL_NORMAL + 1], light[VPL_NORMAL + 2]);
    v3 incoming = uniform3(light[VPL_INCOMING], light[VPL_INCOMING + 1], light[VPL_INCOMING + 2]);
    v3 sent = uniform3(light[VPL_SENT], light[VPL_SENT + 1], light[VPL_SENT + 2]);
    v3 f0 = uniform3(light[VPL_F0], light[VPL_F0 + 1], light[VPL_F0 + 2]);
    vf f90 = (vf)light[VPL_F90];
    v3 value = rough_lobe(f0, f90, (vf)light[VPL_ALPHA], normal, incoming, negate3(toward));
    v3 mean = mul3(sent, mean_lobe(f0, f90, dot3(normal, incoming)));
    // A cluster's members may be of other materials.
    v3 layer =
        make3(max_f(flux.x - mean.x, zero_f()), max_f(flux.y - mean.y, zero_f()), max_f(flux.z - mean.z, zero_f()));
    flux = add3(scale3(layer, left), mul3(sent, value));
    gain = lobe_gain(value);
  } else {
    flux = scale3(flux, left);
  }
  v3 own = splat3(zero_f());
  if (lobe->lobes) {
    own = rough_lobe(lobe->f0, lobe->f90, pick(one_f(), lobe->alpha, lobe->rough), n, lobe->view, toward);
    own = pick3(splat3(zero_f()), own, lobe->rough & facing);
    gain *= lobe_gain(own);
  }
  g = pick(zero_f(), min_f(g, clamp_to / gain), facing);
  flux = pick3(splat3(zero_f()), scale3(flux, g), facing);
  if (lobe->lobes) *glossy = mul3(flux, mul3(own, lobe->throughput));
  if (lobe->tables)
    flux = scale3(flux, left_at(scene, lobe->table, lobe->table_row, pick(one_f(), at_point * r, facing)));
  return flux;
#else
  vf g = plain_geometry(light, p, n, clamp_to, &at_point, &side, &inverse);
  *inverse_out = inverse;
  return scale3(flux, g);
#endif
}

// NEAR_RADII of kernels/stage_records.h.
FN vi is_near(global const float* light, vf inverse) {
  return inverse * (light[VPL_RADIUS] * light[VPL_RADIUS] * (NEAR_RADII * NEAR_RADII)) > one_f();
}

// How many members of a light are looked at one by one where it is near; they begin at the row VPL_FIRST.
FN uint light_members(global const float* light) { return light[VPL_RADIUS] > 0.0f ? (uint)light[VPL_COUNT] : 0u; }
FN uint first_member(global const float* light) { return ((global const uint*)light)[VPL_FIRST]; }

// The point clusters of a block's points: weights, and where each one's bits of a slice begin.
FN void load_members(global const uint* rows, global const float* weights, uint first_lane, uint row_words,
                     uint first_word, vu* row, vf* weight) {
  for (uint f = 0; f < FUZZINESS; ++f) {
    row[f] = load_u(rows + (ulong)FUZZINESS * first_lane + f * LANES, 0) * row_words + first_word;
    weight[f] = load_f(weights + (ulong)FUZZINESS * first_lane + f * LANES, 0);
  }
}

// Which of 32 lights a member sees; none where it counts for nothing.
FN vu member_bits(global const uint* bits, vu word, vi member) {
  return pick_u((vu)0u, gather_u(bits, pick_u((vu)0u, word, member)), member);
}

// A point in deep shadow is as exact as one that gets this much of what the lights its clusters see would bring it.
#define LEAST_LIT 0.1f

// Eq. 6 over one slice of the lights, which the sixteen points of a block share. `own`: point `chosen[i]` reads row i
// of `bits`, which holds its slice alone; else every point reads its clusters' rows of `bits`.
kernel WIDE void vpl_gather(global const VplPointParameters* restrict parameters, SCENE_PARAMETERS,
                            global const float* restrict points, global const uint* restrict chosen, uint own,
                            uint count, global const float* restrict lights, uint width, uint slices,
                            global const uint* restrict bits, uint row_words, global const uint* restrict rows,
                            global const float* restrict weights, uint behind, global float* restrict radiance,
                            global float* restrict level, global const float* restrict lobes) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu lane = (vu)first_lane + lane_index();
  uint leader = own ? chosen[first_lane] : first_lane;
  vu point = own ? load_u(chosen + first_lane, 0) : lane;
  vi active = (lane < count) & (point != GLEANER_NONE);
  point = pick_u((vu)leader, point, active);
  vf w[16];
  load_words(points, point * POINT_WORDS, w);
  active = active & (as_vu(w[POINT_TRIANGLE]) != GLEANER_NONE);
  v3 sum = splat3(zero_f()), glossy = sum;
  vf unshadowed = zero_f();
  if (any_lane(active)) {
    v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL);
    PointLobe lobe = load_point_lobe(w, lobes, point, active);
    uint words = width / 32u;
    uint slice = (leader >> 4) & (slices - 1u);
    vf clamp_to = (vf)parameters->clamp;
    vu row[FUZZINESS];
    vf weight[FUZZINESS];
    if (own) {
      for (uint f = 0; f < FUZZINESS; ++f) {
        row[f] = lane * words;
        weight[f] = f == 0u ? one_f() : zero_f();
      }
    } else {
      load_members(rows, weights, first_lane, row_words, slice * words, row, weight);
    }
    for (uint word = 0; word < words; ++word) {
      vu seen[FUZZINESS];
      vu any = (vu)0u;
      for (uint f = 0; f < FUZZINESS; ++f) {
        seen[f] = member_bits(bits, row[f] + word, active & (weight[f] > zero_f()));
        any |= seen[f];
      }
      uint asked = any_bits(any);
      global const float* l = lights + (ulong)VPL_WORDS * (slice * width + 32u * word);
      for (; asked; asked &= asked - 1u) {
        uint k = 31u - clz(asked & (0u - asked));
        global const float* light = l + VPL_WORDS * k;
        vf visible = zero_f();
        for (uint f = 0; f < FUZZINESS; ++f) visible += pick(zero_f(), weight[f], (seen[f] & (1u << k)) != 0u);
        vf inverse;
        v3 gloss;
        v3 brought = light_brings(scene, light, p, n, &lobe, clamp_to, &inverse, &gloss);
        vi near = active & is_near(light, inverse);
        if (any_lane(near)) {
          v3 all = splat3(zero_f()), all_gloss = all;
          global const float* member = lights + (ulong)VPL_WORDS * first_member(light);
          for (uint left = light_members(light); left; --left, member += VPL_WORDS) {
            v3 its_gloss;
            all = add3(all, light_brings(scene, member, p, n, &lobe, clamp_to, &inverse, &its_gloss));
            all_gloss = add3(all_gloss, its_gloss);
          }
          brought = pick3(brought, all, near);
          gloss = pick3(gloss, all_gloss, near);
        }
        sum = mad3(brought, visible, sum);
        glossy = mad3(gloss, visible, glossy);
        unshadowed += brought.y;
      }
    }
    if (!own) store_f(level + first_lane, 0, pick(zero_f(), max_f(brightness(sum), LEAST_LIT * unshadowed), active));
    sum = pick3(splat3(zero_f()), add3(mul3(sum, words3(w, POINT_ALBEDO)), glossy), active);
  } else if (!own) {
    store_f(level + first_lane, 0, zero_f());
  }
  // Others of a listed block write behind the points.
  vu at = pick_u(own ? (vu)behind : lane, point, active) * 3u;
  scatter_f(radiance, at, sum.x);
  scatter_f(radiance + 1u, at, sum.y);
  scatter_f(radiance + 2u, at, sum.z);
}

// Lights that a point asks itself, so that its light does not hang on its clusters alone: how far those are off is
// measured with a few lights and taken off again (control variates). A light that would bring more than `doubt` of the
// point's light is asked, of lesser ones each with a chance in proportion to what it would bring; lights on which the
// point's clusters agree count a fifth of that. A point near no cluster has nothing but what it asks. At most
// MOST_DOUBTS of them; `counts` tells how many.
#define AGREED 0.2f
// Lights too weak to be asked for certain, were they so many times brighter, are looked at one in so many.
#define THINNED 4u
#define THINNED_BITS 0x11111111u
kernel WIDE void vpl_doubt(global const VplPointParameters* restrict parameters, global const float* restrict points,
                           uint count, global const float* restrict lights, global const float* restrict boxes,
                           uint width, uint slices, global const uint* restrict bits, uint row_words,
                           global const uint* restrict rows, global const float* restrict weights,
                           global const float* restrict level, global uint* restrict doubt_light, uint behind,
                           global uint* restrict counts, global float* restrict spacings) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(points, min(lane, (vu)(count - 1u)) * POINT_WORDS, w);
  vi active = (as_vu(w[POINT_TRIANGLE]) != GLEANER_NONE) & (lane < count);
  if (!any_lane(active)) {
    store_u(counts + first_lane, 0, (vu)0u);
    return;
  }
  vu row[FUZZINESS];
  vf weight[FUZZINESS];
  uint words = width / 32u;
  uint slice = (first_lane >> 4) & (slices - 1u);
  load_members(rows, weights, first_lane, row_words, slice * words, row, weight);
  vi lonely = active & none(weight[0] > zero_f());
  // A sole cluster has nobody to disagree with.
  vu alone = (vu)0u;
  if (FUZZINESS > 1u) alone = pick_u((vu)0xffffffffu, (vu)0u, weight[1u % FUZZINESS] > zero_f());
  alone = pick_u(alone, (vu)0xffffffffu, lonely);
  v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL);
  vf clamp_to = (vf)parameters->clamp;
  global const float* first_light = lights + (ulong)VPL_WORDS * (slice * width);
  uint shared_lot = ((global const uint*)points)[(ulong)POINT_WORDS * first_lane + POINT_B1] * 0x9e3779b9u;
  // The samples of a pixel see a slice each: what one of them lacks is so much less of the pixel's light.
  vf spacing = load_f(level + first_lane, 0) * parameters->doubt * (float)slices;
  if (any_lane(lonely)) {
    vf all = zero_f();
    for (uint k = shared_lot & (THINNED - 1u); k < width; k += THINNED) {
      global const float* light = first_light + VPL_WORDS * k;
      vf at_point, side, inverse;
      all += plain_geometry(light, p, n, clamp_to, &at_point, &side, &inverse) * light_brightness(light);
    }
    spacing = pick(spacing, all * (vf)(THINNED / (0.75f * MOST_DOUBTS)), lonely);
  }
  spacing = max_f(spacing, (vf)1e-30f);
  vu lot = hash_combine(hash_combine(as_vu(w[POINT_B1]), as_vu(w[POINT_B2])), (vu)parameters->set);
  vf offset = to_f(lot >> 8) * (vf)5.9604644775390625e-8f;
  vu found = (vu)0u;
  // A point with more doubts than there is room for begins again and asks fewer.
  vi open = active;
  while (any_lane(open)) {
    vf mark = offset * spacing, passed = zero_f();
    found = pick_u(found, (vu)0u, open);
    for (uint word = 0; word < words; ++word) {
      vu any = (vu)0u, all = (vu)0xffffffffu;
      for (uint f = 0; f < FUZZINESS; ++f) {
        vi member = open & (weight[f] > zero_f());
        vu seen = member_bits(bits, row[f] + word, member);
        any |= seen;
        all &= pick_u((vu)0xffffffffu, seen, member);
      }
      vu doubtful = (any & ~all) | alone;
      // The same ones for all lanes. No number of this launch enters: pixels are the same in any batch.
      uint thinned = THINNED_BITS << (any_bits(hash_u((vu)(shared_lot + word))) & (THINNED - 1u));
      global const float* l = first_light + VPL_WORDS * 32u * word;
      global const float* box = boxes + LIGHT_BOX_WORDS * (slice * words + word);
      v3 beyond = make3(max_f(fabs(p.x - box[0]) - box[3], zero_f()), max_f(fabs(p.y - box[1]) - box[4], zero_f()),
                        max_f(fabs(p.z - box[2]) - box[5], zero_f()));
      // Both cosines are at most 1, the point's at most what its plane leaves.
      vf above = n.x * (box[0] - p.x) + n.y * (box[1] - p.y) + n.z * (box[2] - p.z) + fabs(n.x) * box[3] +
                 fabs(n.y) * box[4] + fabs(n.z) * box[5];
      vf near2 = dot3(beyond, beyond);
      vf most =
          min_f(clamp_to, min_f(one_f(), max_f(above, zero_f()) / sqrt(near2)) / near2) * box[LIGHT_BOX_BRIGHTEST];
      vi thin = most * (vf)(float)THINNED <= spacing;
      vf stands = pick(one_f(), (vf)(float)THINNED, thin);
      for (uint looked = any_lane(open & none(thin)) ? 0xffffffffu : thinned; looked; looked &= looked - 1u) {
        uint bit = looked & (0u - looked), k = 31u - clz(bit);
        global const float* light = l + VPL_WORDS * k;
        vf at_point, side, inverse;
        vf g = plain_geometry(light, p, n, clamp_to, &at_point, &side, &inverse);
        vi near = open & is_near(light, inverse);
        vi disputed = (doubtful & bit) != 0u;
        // The light itself, then, where it is near, its members.
        uint members = any_lane(near) ? light_members(light) : 0u;
        uint row_of = slice * width + 32u * word + k;
        for (uint m = 0; m <= members; ++m) {
          if (m) {
            row_of = first_member(light) + m - 1u;
            global const float* member = lights + (ulong)VPL_WORDS * row_of;
            g = plain_geometry(member, p, n, clamp_to, &at_point, &side, &inverse) * light_brightness(member);
          } else {
            g *= light_brightness(light);
          }
          vi turn = open & (m ? near : none(near));
          vf at_stake = pick(zero_f(), g * pick((vf)AGREED, one_f(), disputed) * stands, turn);
          if (!(thinned & bit)) at_stake = pick(at_stake, zero_f(), thin);
          vi certain = at_stake >= spacing;
          passed += pick(at_stake, zero_f(), certain);
          vi here = turn & (certain | (passed > mark));
          if (!any_lane(here)) continue;
          mark += pick(zero_f(), spacing, here & none(certain));
          found += pick_u((vu)0u, (vu)1u, here);
          here = here & (found <= MOST_DOUBTS);
          vu at = pick_u((vu)behind, lane * MOST_DOUBTS + found - 1u, here);
          // What nobody else told of the point is no correction, and is not held against its noise.
          vu by_lot = pick_u((vu)DOUBT_BY_LOT, (vu)0u, lonely | (certain & none(thin)));
          vu agreed = pick_u((vu)DOUBT_AGREED, (vu)0u, disputed);
          vu sure = pick_u((vu)0u, pick_u((vu)DOUBT_CERTAIN, (vu)(DOUBT_CERTAIN | DOUBT_THIN), thin), certain);
          scatter_u(doubt_light, at, (vu)row_of | by_lot | agreed | sure);
        }
      }
    }
    open = open & (found > MOST_DOUBTS) & (spacing < (vf)INFINITY);
    spacing *= pick(one_f(), to_f(found) * (vf)(1.25f / MOST_DOUBTS), open);
  }
  store_u(counts + first_lane, 0, pick_u((vu)0u, min(found, (vu)MOST_DOUBTS), active));
  store_f(spacings + first_lane, 0, spacing);
}

// The rays for `count` doubts, by their places; and their terms: what radiance the answer of each is worth, RGB.
kernel WIDE void vpl_doubt_rays(global const VplPointParameters* restrict parameters, SCENE_PARAMETERS,
                                global const float* restrict points, global const float* restrict lights,
                                global const uint* restrict places, uint base, uint count,
                                global const uint* restrict doubt_light, global const float* restrict spacings,
                                global float* restrict rays, global float* restrict doubt_terms,
                                global const float* restrict lobes) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vi active = (vu)first_lane + lane_index() < count;
  vu place = gather_u(places, (vu)base + min((vu)first_lane + lane_index(), (vu)(count - 1u)));
  vf w[16], l[16], second[16], t[16];
  vu point = place / MOST_DOUBTS;
  load_words(points, point * POINT_WORDS, w);
  vu doubt = gather_u(doubt_light, place);
  vu at = (doubt & (vu)DOUBT_LIGHT) * VPL_WORDS;
  load_words(lights, at, l);
  load_words(lights + 16u, at, second);
  vu triangle = as_vu(w[POINT_TRIANGLE]);
  load_words(scene->triangles, triangle * TRIANGLE_WORDS, t);
  v3 p0 = words3(t, TRIANGLE_P0);
  v3 e1 = sub3(words3(t, TRIANGLE_P1), p0), e2 = sub3(words3(t, TRIANGLE_P2), p0), error;
  v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL), q = words3(l, VPL_POSITION);
  v3 light_normal = words3(l, VPL_NORMAL), flux = words3(l, VPL_FLUX);
  vf clamp_to = (vf)parameters->clamp;
  vf at_point, side, inverse;
  vf g = bounded_geometry(p, n, q, light_normal, words3(l, VPL_GEOMETRIC), clamp_to, &at_point, &side, &inverse);
  vf stake = g * brightness(flux) * pick(one_f(), (vf)AGREED, (doubt & DOUBT_AGREED) != 0u);
  // One that came by lot stands for as much as lies between two marks.
  vf times = pick(gather_f(spacings, point) / stake, pick(one_f(), (vf)(float)THINNED, (doubt & DOUBT_THIN) != 0u),
                  (doubt & DOUBT_CERTAIN) != 0u);
  v3 glossy = splat3(zero_f());
#ifdef NEED_LOBE
  // As light_brings(), of a light a lane.
  PointLobe lobe = load_point_lobe(w, lobes, point, active);
  vf r = sqrt(inverse), gain = one_f(), alpha = second[VPL_ALPHA - 16u];
  vi rough_light = alpha > zero_f();
  v3 toward = scale3(sub3(q, p), r);
  v3 layer = flux, sent = splat3(zero_f());
  if (any_lane(rough_light)) {
    v3 incoming = words3(second, VPL_INCOMING - 16u), f0 = words3(second, VPL_F0 - 16u);
    vf f90 = second[VPL_F90 - 16u];
    v3 value = rough_lobe(f0, f90, pick(one_f(), alpha, rough_light), light_normal, incoming, negate3(toward));
    v3 mean = mul3(words3(second, VPL_SENT - 16u), mean_lobe(f0, f90, dot3(light_normal, incoming)));
    mean = pick3(splat3(zero_f()), mean, rough_light);
    layer = make3(max_f(flux.x - mean.x, zero_f()), max_f(flux.y - mean.y, zero_f()), max_f(flux.z - mean.z, zero_f()));
    sent = pick3(sent, mul3(words3(second, VPL_SENT - 16u), value), rough_light);
    gain = pick(gain, lobe_gain(value), rough_light);
  }
  flux = mad3(layer, left_at(scene, as_vu(l[VPL_TABLE]), l[VPL_ROW], side * r), sent);
  v3 own = splat3(zero_f());
  if (lobe.lobes) {
    own = rough_lobe(lobe.f0, lobe.f90, pick(one_f(), lobe.alpha, lobe.rough), n, lobe.view, toward);
    own = pick3(splat3(zero_f()), own, lobe.rough);
    gain *= lobe_gain(own);
  }
  g = bounded_geometry(p, n, q, light_normal, words3(l, VPL_GEOMETRIC), clamp_to / gain, &at_point, &side, &inverse);
  glossy = mul3(mul3(flux, own), lobe.throughput);
  flux = scale3(flux, left_at(scene, lobe.table, lobe.table_row, at_point * r));
#endif
  v3 term = scale3(add3(mul3(flux, words3(w, POINT_ALBEDO)), glossy), g * times);
  // Of lanes without a doubt the last one's is written once more, and the same.
  scatter_f(doubt_terms, place * 3u, term.x);
  scatter_f(doubt_terms, place * 3u + 1u, term.y);
  scatter_f(doubt_terms, place * 3u + 2u, term.z);
  surface_point(p0, e1, e2, w[POINT_B1], w[POINT_B2], &error);
  v3 start, direction;
  connect_light(p, error, normalize3(cross3(e1, e2)), q, words3(second, VPL_ERROR - 16u), words3(l, VPL_GEOMETRIC),
                &start, &direction);
  active = active & finite3(start) & finite3(direction);
  set_visibility_ray(rays, block, start, direction, active, triangle);
}

// What the answers change, point by point, doubt by doubt: at once where the light was asked for certain. What was
// asked by lot goes to `sampled`, its sum and the sum of its squared luminance.
kernel void vpl_settle(uint count, global const uint* restrict firsts, global const uint* restrict counts,
                       global const uint* restrict doubt_light, global const float* restrict doubt_terms,
                       global const uint* restrict answers, global const float* restrict lights, uint clusters,
                       global const uint* restrict bits, uint row_words, global const uint* restrict rows,
                       global const float* restrict weights, global float* restrict radiance,
                       global float* restrict sampled) {
  uint point = (uint)get_global_id(0);
  if (point >= count) return;
  float certain[3] = {0, 0, 0}, by_lot[3] = {0, 0, 0}, square = 0;
  ulong member = (ulong)FUZZINESS * (point / LANES * LANES) + point % LANES;
  for (uint k = 0; k < counts[point]; ++k) {
    uint place = point * MOST_DOUBTS + k;
    uint doubt = doubt_light[place], row = doubt & DOUBT_LIGHT;
    // Of a member the clusters told what they told of its cluster.
    if (row >= clusters) row = ((global const uint*)lights)[(ulong)VPL_WORDS * row + VPL_FIRST];
    float told = 0;
    for (uint f = 0; f < FUZZINESS; ++f) {
      float weight = weights[member + f * LANES];
      if (weight > 0.0f && ((bits[(ulong)rows[member + f * LANES] * row_words + row / 32u] >> (row & 31u)) & 1u))
        told += weight;
    }
    uint ray = firsts[point] + k;
    float seen = (answers[ray >> 5] >> (ray & 31u)) & 1u ? 1.0f : 0.0f;
    float brought[3];
    for (uint c = 0; c < 3; ++c) brought[c] = doubt_terms[3 * place + c] * (seen - told);
    if (doubt & DOUBT_BY_LOT) {
      float much = brightness_of(brought[0], brought[1], brought[2]);
      square += much * much;
      for (uint c = 0; c < 3; ++c) by_lot[c] += brought[c];
    } else {
      for (uint c = 0; c < 3; ++c) certain[c] += brought[c];
    }
  }
  for (uint c = 0; c < 3; ++c) radiance[3 * point + c] += certain[c];
  for (uint c = 0; c < 3; ++c) sampled[4 * point + c] = by_lot[c];
  sampled[4 * point + 3] = square;
}

// A pixel's samples, in their order, each of which saw a slice of the lights: their sum saw all of them. What was
// sampled of the clusters' error is taken off as far as it stands out of its own noise (James & Stein 1961).
kernel void vpl_resolve(global const VplPointParameters* restrict parameters, uint count,
                        global const float* restrict radiance, global const float* restrict sampled,
                        global float* restrict records, global uint* restrict report) {
  uint item = (uint)get_global_id(0);
  if (item >= count) return;
  uint samples = parameters->samples;
  float sum[3] = {0, 0, 0}, change[3] = {0, 0, 0}, square = 0;
  for (uint s = 0; s < samples; ++s) {
    uint path = ((item >> 4) * samples + s) * 16u + (item & 15u);
    for (uint k = 0; k < 3; ++k) sum[k] += radiance[3 * path + k];
    for (uint k = 0; k < 3; ++k) change[k] += sampled[4 * path + k];
    square += sampled[4 * path + 3];
  }
  float mean = brightness_of(change[0], change[1], change[2]);
  float share = mean * mean > square ? 1.0f - square / (mean * mean) : 0.0f;
  int fine = 1;
  for (uint k = 0; k < 3; ++k) {
    // Where all its light is in doubt, the sum may come out below nothing.
    float all = sum[k] + share * change[k];
    fine = fine && fabs(all) <= 3.402823466e38f;
    sum[k] = all > 0.0f ? all : 0.0f;
  }
  if (!fine) {
    atomic_add(report, samples);
    uint at = atomic_inc(report + 1);
    if (at < REPORTED_ITEMS) report[2 + at] = item;
  }
  for (uint k = 0; k < 3; ++k) records[3 * item + k] = fine ? sum[k] : 0.0f;
}
