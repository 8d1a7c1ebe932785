// The path filter of PATH_CLASS_RADIOSITY, PATH_CLASS_SAMPLED_RADIOSITY and PATH_CLASS_METAL_RADIOSITY
// (kernels/path_filter.h says what a filter is): the partner has what radiosity computes.
//
// The first surface that a camera path meets past mirrors and glass shows the partner's light where that leaves by its
// diffuse layer and came straight from another surface's diffuse layer, this from another's, and so on to one that a
// light lit: a chain of diffuse layers. A lobe, mirror or glass anywhere on the way makes the light the path tracer's,
// as does a surface that it passed straight (alpha, panes) between two layers. Passing on the way from the light is no
// break: vertices' shadow rays pass such surfaces as well. Unlit surfaces light no vertex: what they send is the path
// tracer's. So is what leaves a first surface within a solid.
//
// With METAL_RADIOSITY all but the first surface of a chain may pass light on by a lobe of rough metal as well.
#ifndef GLEANER_KERNELS_RADIOSITY_FILTER_H
#define GLEANER_KERNELS_RADIOSITY_FILTER_H

#include "kernels/rough_metal.h"

// States of a path.
#define FILTER_NO_SURFACE 0.0f  // has met nothing but mirrors and glass
#define FILTER_KEEP -1.0f       // all that is found from here on is the path tracer's
#define FILTER_FIRST 1.0f       // left the first surface's diffuse layer: a light that it finds is direct light
#define FILTER_CHAIN 2.0f       // left a later one, of a chain of diffuse layers: lights are the partner's
#define FILTER_PASSED 3.0f      // the same, and has passed a surface since: lights alone are the partner's

// Where no other part could turn up on a path's way, it ends at the second surface.
#if !defined(NEED_LOBE) && !defined(NEED_TRANSMISSIVE) && !defined(NEED_ALPHA) && !defined(NEED_UNLIT)
#define FILTER_ENDS_CHAINS
#if PATH_FILTER == PATH_CLASS_SAMPLED_RADIOSITY
#define FILTER_ENDS_AT_ONCE
#endif
#endif

// Lobes of a chain's later surfaces that are the partner's.
FN vi chained_lobes(vi chained, const Surface* m) {
#if PATH_FILTER == PATH_CLASS_METAL_RADIOSITY && defined(NEED_LOBE)
  return chained & is_rough_metal(m);
#else
  return no_lanes();
#endif
}

typedef struct {
  vf state;
  vi compensates;  // never: the partner lacks nothing
  vi chained;      // lanes whose diffuse layer here is the partner's
} PathFilter;

FN PathFilter load_filter(global const float* paths, uint block) {
  PathFilter f;
  f.state = row_f(paths, PATH_ROWS, block, ROW_FILTER);
  f.compensates = no_lanes();
  f.chained = no_lanes();
  return f;
}

FN vi shows_emission(const PathFilter* f, vi found) { return found & (f->state < (vf)FILTER_CHAIN); }
FN vi shows_unlit(const PathFilter* f, vi found) { return found; }

FN void filter_vertex(PathFilter* f, float clamp_to, v3 origin, v3 direction, Vertex* v) {
  f->chained = v->active & none(v->passes) & ((f->state == (vf)FILTER_FIRST) | (f->state == (vf)FILTER_CHAIN));
#ifdef FILTER_ENDS_CHAINS
  v->active = v->active & none(f->chained);
#endif
}

FN v3 filter_reflectance(const PathFilter* f, const Scene* scene, const Surface* m, float clamp_to, vf nl,
                         v3 reflectance) {
  v3 kept = sub3(reflectance, eval_layer(scene, m, max_f(nl, (vf)1e-6f)));
  kept = make3(max_f(kept.x, zero_f()), max_f(kept.y, zero_f()), max_f(kept.z, zero_f()));
  return pick3(pick3(reflectance, kept, f->chained), splat3(zero_f()), chained_lobes(f->chained, m));
}

FN v3 filter_sharp(const PathFilter* f, v3 glass) { return glass; }

FN vf filter_scattering(const PathFilter* f, const Scene* scene, const Vertex* v, float clamp_to, v3 direction,
                        vi specular, vi glass, vu pair_key, vu sample, v3* throughput) {
  LayerChoice c = choose_layer(scene, v, direction, specular, glass, chained_lobes(f->chained, &v->surface), pair_key,
                               sample, throughput);
  vi first = f->state == (vf)FILTER_NO_SURFACE;
  vf state = pick((vf)FILTER_KEEP, f->state, first & c.through);
  vi begins = begins_by_layer(v, &c, first);
  state = pick(state, (vf)FILTER_FIRST, begins);
  return pick(state, (vf)FILTER_CHAIN, f->chained & c.by_layer);
}

FN vf filter_passing(const PathFilter* f, const Vertex* v, vf state) {
  vf passing = pick((vf)FILTER_KEEP, f->state, f->state == (vf)FILTER_NO_SURFACE);
  passing = pick(passing, (vf)FILTER_PASSED, f->state >= (vf)FILTER_CHAIN);
  return pick(state, passing, v->passes);
}

#endif
