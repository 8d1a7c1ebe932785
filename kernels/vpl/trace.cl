// Virtual point lights (VPLs) from light paths. Stage kind "vpl_trace".
//
//   vpl_emit        a light path's first ray                                  (kernels/transport/emission.h)
//   repeat
//     trace         closest hits
//     vpl_trace_step   the path's carried flux + what this diffuse layer or rough lobe sends on
//                      while that sum passes the next of its evenly spaced thresholds: leave a VPL of one spacing's
//                      flux scatter                                                (kernels/transport/scattering.h)
//   until no path is left
//
// The thresholds begin at a random offset, so that VPLs represent the light without bias; all of a path's VPLs have one
// luminance, however long it is. A path whose slots are full keeps every second VPL at twice the flux, and doubles its
// spacing.
#include "kernels/transport/light_paths.h"
#include "kernels/vpl_records.h"
#include "kernels/wide.h"

// Light paths in flight: rows of kernels/path_layout.h with meanings of their own.
#define ROW_SENT ROW_ETA        // what the path's surfaces have sent on so far, by vpl_weight
#define ROW_SPACING ROW_FILTER  // of the thresholds at first, in the same unit
// ROW_META of a light path.
#define LIGHT_COUNT 16u      // slots taken
#define LIGHT_DOUBLINGS 20u  // of the spacing
#define MAX_DOUBLINGS 20u
// Of a punctual light, and not yet scattered: where a mirror or smooth glass turned it aside, no shadow ray of a camera
// path could find it, so that it ends there; methods' means agree.
#define LIGHT_STRAIGHT (1u << 25)

#ifdef NEED_LIGHTS

// What decides how many VPLs represent some flux: its luminance, or a small share of the sum of its channels where that
// is nearly 0.
FN vf vpl_weight(v3 flux) { return max_f(luminance(flux), (flux.x + flux.y + flux.z) * 1e-3f); }

kernel WIDE void vpl_emit(global const VplTraceParameters* restrict parameters, SCENE_PARAMETERS,
                          global const float* restrict emission, uint first_low, uint first_high, uint count,
                          global float* restrict paths) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  LightStart start = start_light_paths(scene, emission, first_low, first_high, first_lane, count, parameters->seed_low,
                                       parameters->seed_high, parameters->pass ^ 0x56504c00u);
  set_light_path(paths, block, &start, pick_u((vu)0u, (vu)LIGHT_STRAIGHT, start.punctual));
  set_row_f(paths, PATH_ROWS, block, ROW_SENT, zero_f());
  // A white surface sends on 1 / pi of it.
  set_row_f(paths, PATH_ROWS, block, ROW_SPACING, vpl_weight(start.ray.throughput) * (vf)(0.25f * INV_PI));
}

// What of the flux that meets a surface its diffuse layer and rough lobe send on.
typedef struct {
  v3 flux;  // sent on, W/sr at a cosine of 1
  vu table;
  vf table_row;
#ifdef NEED_LOBE
  vi rough;
  v3 f0;
  vf f90;
#endif
} Reflection;

FN Reflection reflect_flux(const Vertex* v, v3 flux, vf correction) {
  Reflection r;
  const Surface* m = &v->surface;
  v3 layer = scale3(m->base, (vf)INV_PI);
  r.table = (vu)GLEANER_NONE;
  r.table_row = zero_f();
#ifdef NEED_LOBE
  layer = scale3(layer, m->left_view * (one_f() - m->metallic) / m->left_mean);
#ifdef NEED_LAYERS
  layer = pick3(splat3(zero_f()), layer, has_plain_layer(m));
#endif
  r.table = m->table;
  r.table_row = m->table_row;
  r.rough = has_rough_lobe(m);
  r.f0 = lobe_f0(m);
  r.f90 = lobe_f90(m);
  layer = pick3(layer, add3(layer, mean_lobe(r.f0, r.f90, v->frame.view.z)), r.rough);
#endif
  r.flux = scale3(mul3(flux, layer), correction);
  return r;
}

// Of the VPLs in a path's slots every second one is dropped, and the others carry twice as much.
FN void halve_vpls(global float* records, vu slot, vu odd) {
  vu first = slot * VPL_PATH_SLOTS;
  // Loops, not unrolled: this is rare, and unrolled it would be most of the kernel.
  __attribute__((opencl_unroll_hint(1))) for (uint k = 0; k < VPL_PATH_SLOTS / 2u; ++k) {
    vu from = (first + 2u * k + odd) * VPL_WORDS, to = (first + k) * VPL_WORDS;
    vf w[VPL_WORDS];
    load_words(records, from, w);
    load_words(records + 16u, from, w + 16u);
    put_words3(w, VPL_FLUX, scale3(words3(w, VPL_FLUX), (vf)2.0f));
    put_words3(w, VPL_SENT, scale3(words3(w, VPL_SENT), (vf)2.0f));
    store_words(records, to, w);
    store_words(records + 16u, to, w + 16u);
  }
  __attribute__((opencl_unroll_hint(1))) for (uint k = VPL_PATH_SLOTS / 2u; k < VPL_PATH_SLOTS; ++k)
      scatter3(records + VPL_FLUX, (first + k) * VPL_WORDS, splat3(zero_f()));
}

// `flux`: of the VPL. `incoming`: what the surface scatters for it; a rough lobe shines by that.
FN void write_vpl(global float* records, vu at, const Vertex* v, const Reflection* r, v3 geometric, v3 direction,
                  v3 flux, v3 incoming, vu depth) {
  vf w[VPL_WORDS];
  put_words3(w, VPL_POSITION, v->hit.p);
  put_words3(w, VPL_NORMAL, v->frame.normal);
  put_words3(w, VPL_GEOMETRIC, geometric);
  put_words3(w, VPL_FLUX, flux);
  w[VPL_TABLE] = as_vf(r->table);
  w[VPL_ROW] = r->table_row;
  w[VPL_RADIUS] = zero_f();
  w[VPL_DEPTH] = to_f(depth) + 1.0f;
  w[VPL_COUNT] = one_f();
  put_words3(w, VPL_ERROR, v->hit.error);
  w[VPL_COS] = one_f();
#ifdef NEED_LOBE
  put_words3(w, VPL_SENT, pick3(splat3(zero_f()), incoming, r->rough));
  put_words3(w, VPL_F0, r->f0);
  w[VPL_F90] = r->f90;
  w[VPL_ALPHA] = pick(zero_f(), v->surface.alpha, r->rough);
  put_words3(w, VPL_INCOMING, negate3(direction));
#else
  for (uint k = VPL_SENT; k < VPL_WORDS; ++k) w[k] = zero_f();
#endif
  store_words(records, at, w);
  store_words(records + 16u, at, w + 16u);
}

// The thresholds of a block's paths: `sent` over `spacing`, VPLs made so far, doublings of the spacing.
typedef struct {
  vf sent, spacing;
  vu made, doublings;
} Thresholds;

// Leaves a VPL for each threshold that the flux of this reflection passes, in `layered` lanes.
FN void leave_vpls(global float* records, uint count, vu slot, vu key, vu sample, const Vertex* v, const Reflection* r,
                   v3 geometric, v3 direction, v3 flux, vf correction, vu depth, vi layered, Thresholds* t) {
  vf weight = vpl_weight(r->flux);
  v3 share = scale3(r->flux, one_f() / weight);
  t->sent += pick(zero_f(), weight, layered);
  vf offset, unused;
  sample_pair(key, sample, LIGHT_SEQUENCE, 0u, &unused, &offset);
  vu random = hash_combine(hash_combine(key, sample), 0x6d61726bu);
  for (;;) {
    // Doubled spacings shift the thresholds by whole old ones.
    vf shift = offset + to_f(random & (((vu)1u << t->doublings) - 1u));
    vf scale = to_f((vu)1u << t->doublings);
    vi passed = layered & ((shift + to_f(t->made) * scale) * t->spacing < t->sent);
    if (!any_lane(passed)) break;
    vi full = passed & (t->made >= VPL_PATH_SLOTS);
    // Lanes with nothing to write do so behind the records.
    if (any_lane(full)) {
      layered = layered & (none(full) | (t->doublings < MAX_DOUBLINGS));
      vu odd = (random >> t->doublings) & 1u;
      halve_vpls(records, pick_u((vu)count, slot, full), odd);
      t->made = pick_u(t->made, (vu)(VPL_PATH_SLOTS / 2u), full);
      t->doublings = pick_u(t->doublings, min(t->doublings + 1u, (vu)MAX_DOUBLINGS), full);
      continue;
    }
    vu at = pick_u((vu)count * VPL_PATH_SLOTS, slot * VPL_PATH_SLOTS + t->made, passed) * VPL_WORDS;
    vf carried = t->spacing * scale;
    write_vpl(records, at, v, r, geometric, direction, scale3(share, carried),
              scale3(flux, correction * carried / weight), depth);
    t->made += pick_u((vu)0u, (vu)1u, passed);
  }
}

kernel WIDE void vpl_trace_step(global const VplTraceParameters* restrict parameters, SCENE_PARAMETERS, uint count,
                                global float* paths, global float* records, global uint* counters) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi active = take_hits(paths, block, meta);
  if (!any_lane(active)) return;
  v3 direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  vu slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  vu key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  vu sample = row_u(paths, PATH_ROWS, block, ROW_SAMPLE);
  vu bounce = meta & LIGHT_BOUNCE_MASK;
  vu depth = (meta >> LIGHT_DEPTH) & 255u;
  Thresholds thresholds;
  thresholds.sent = row_f(paths, PATH_ROWS, block, ROW_SENT);
  thresholds.spacing = row_f(paths, PATH_ROWS, block, ROW_SPACING);
  thresholds.made = (meta >> LIGHT_COUNT) & 15u;
  thresholds.doublings = (meta >> LIGHT_DOUBLINGS) & 31u;
  LightVertex met = meet_light_surface(scene, paths, block, active, row_3(paths, PATH_ROWS, block, ROW_ORIGIN),
                                       direction, row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT), key, sample, bounce);
  Vertex v = met.v;
  v3 flux = met.flux, geometric = met.geometric;
  vf correction = met.correction;

  vi layered = v.active & none(v.passes) & ((depth < parameters->depth) | ((vu)parameters->depth == 0u));
#ifdef NEED_TRANSMISSIVE
  // What glass does with the path is not the diffuse layer's.
  layered = layered & (met.u.u_glass >= v.surface.transmission);
#endif
  vf reflected = correction * lit_share(&v, direction);
  Reflection r = reflect_flux(&v, flux, reflected);
  layered = layered & (max_component(r.flux) > zero_f()) & finite3(r.flux);
  if (any_lane(layered))
    leave_vpls(records, count, slot, key, sample, &v, &r, geometric, direction, flux, reflected, depth, layered,
               &thresholds);

  vi straight = (meta & LIGHT_STRAIGHT) != 0u;
  BsdfSample unused;
  NextRay next = scatter_flux(scene, &v, geometric, correction, direction, flux, depth, parameters->depth, &met.u,
                              &straight, &unused);
  next.alive = next.alive & (bounce < (vu)LIGHT_BOUNCE_MASK);
  uint kept;
  rank_lanes(next.alive, &kept);
  if (kept == 0u) return;
  atomic_add(counters, kept);
  vu next_meta = ((bounce + 1u) & LIGHT_BOUNCE_MASK) | (next.depth << LIGHT_DEPTH) | (thresholds.made << LIGHT_COUNT) |
                 (thresholds.doublings << LIGHT_DOUBLINGS) | pick_u((vu)0u, (vu)LIGHT_STRAIGHT, straight);
  set_row_f(paths, PATH_ROWS, block, ROW_SENT, thresholds.sent);
  set_path(paths, block, &next, slot, next_meta, key);
  set_row_f(paths, PATH_ROWS, block, ROW_RANGE, zero_f());
}

#endif
