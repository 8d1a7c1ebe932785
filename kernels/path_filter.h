// A path filter: which light the path tracer leaves to a partner method, so that the two add up to the whole picture.
//
// The first surface that a camera path meets, seen past mirrors and glass, shows direct light (reflected there once)
// and indirect light. That is of one of four classes (PATH_CLASS_... in kernels/path_records.h), by how it leaves the
// first surface and how it came there. Broad and sharp parts: kernels/transport/parts.h.
//
//   leaves by      arrives from                               class
//   broad part     another surface's broad part, straight     DIFFUSE
//   broad part     a light, by way of sharp parts             CAUSTIC
//   broad part     a broad part, by way of sharp parts        MIXED
//   sharp part     any                                        GLOSSY
//
// Contract: with -D PATH_FILTER=<classes> the path tracer computes all light but these classes, and the partner
// computes these alone, with the same BSDFs. The partner may fall short of DIFFUSE: partner_lacks() is the share of a
// straight connection's light that it leaves out (virtual point lights bound the geometry term); the path tracer adds
// just that, and sums it in a layer of its own as well. Light at a first surface within a solid, and light that passes
// a surface straight (alpha, panes) behind the first one, is the partner's only where it takes CAUSTIC or gathers:
// photons find it as any other.
//
// Virtual point lights take DIFFUSE (kernels/vpl/). Photon maps take CAUSTIC, and DIFFUSE and MIXED with it. These two
// they gather by the path tracer itself (PHOTON_GATHER, kernels/photon/gather.cl): a path that has left the first
// surface by its broad part reads the diffuse layers that it meets off the map, instead of lighting them and being
// scattered by them. Their lobes it goes on with: a rough lobe sends it all light, a sharp one all but CAUSTIC. A layer
// nearer than `spacing` is a first surface of its own, since the density of photons says little there: it is lit, it
// scatters, and the map is read for its CAUSTIC light alone.
// With LAYER as well, records of shading clusters carry what leaves the first surface by its diffuse layer, but for
// CAUSTIC light. Paths that left by the layer then find direct light and, where photons do not carry CAUSTIC, that;
// those that left by a rough lobe gather as before. With LOBE beside it, what leaves by a rough lobe that harmonics of
// LOBE_ORDER hold is the records' just as what leaves by the layer.
// Radiance links between vertices take another class, by itself: RADIOSITY, or METAL_RADIOSITY where metal is rough
// (kernels/radiosity_filter.h). So does an
// irradiance cache: IRRADIANCE; and with rough lobes a radiance cache: RADIANCE (kernels/irradiance_filter.h).
//
// The path tracer calls, in this order: load_filter(); shows_emission() where its ray finds light; filter_vertex() at a
// surface; filter_reflectance() and filter_sharp() of a light sample; filter_scattering() and filter_passing() for the
// path's next state, ROW_FILTER. Without PATH_FILTER these compile to nothing.
#ifndef GLEANER_KERNELS_PATH_FILTER_H
#define GLEANER_KERNELS_PATH_FILTER_H

#include "kernels/lobe_rows.h"
#include "kernels/path_records.h"
#include "kernels/transport/parts.h"
#include "kernels/transport/scattering.h"

// For two of the branches below: each file is included once, and within an #if that would be in the first branch alone.
#include "kernels/layer_filter.h"

#if defined(PATH_FILTER) && (PATH_FILTER == PATH_CLASS_RADIOSITY || PATH_FILTER == PATH_CLASS_SAMPLED_RADIOSITY || \
                             PATH_FILTER == PATH_CLASS_METAL_RADIOSITY)
#include "kernels/radiosity_filter.h"
#elif defined(PATH_FILTER) && (PATH_FILTER == PATH_CLASS_IRRADIANCE || PATH_FILTER == PATH_CLASS_RADIANCE)
#include "kernels/irradiance_filter.h"
#elif defined(PATH_FILTER)

// States. Above 0: the ray left the first surface's broad part, at this cosine (times the gain of a rough lobe); what
// it meets decides the class.
#define FILTER_NO_SURFACE 0.0f    // has met nothing but mirrors and glass
#define FILTER_KEEP -1.0f         // all that is found from here on is the path tracer's
#define FILTER_COMPENSATE -2.0f   // likewise, and is what the partner lacks
#define FILTER_SHARP_CHAIN -3.0f  // left the first surface's broad part, and then sharp parts alone
#define FILTER_GLOSSY -4.0f       // left the first surface by its sharp part, which is the partner's
#define FILTER_GATHERS \
  -5.0f  // PHOTON_GATHER: then a layer that was not read or a rough lobe: no light is the
         // partner's but what layers are read for

#define FILTER_LAYERED \
  -6.0f  // PATH_CLASS_LAYER: left the first surface by its layer (or a lobe of PATH_CLASS_LOBE), and has met nothing
         // but sharp parts since: all light but direct light and CAUSTIC is the records'

#define FILTERS(classes) ((PATH_FILTER & (classes)) != 0)
#if defined(PHOTON_GATHER) && PATH_FILTER & PATH_CLASS_LAYER
#define FILTERS_LAYER
#endif
#ifndef LOBE_ORDER
#define LOBE_ORDER 4
#endif
// Of a gather path that leaves a first surface of its own. Paths from records carry their spacing, m, in its place.
#ifdef PHOTON_RECORDS
#define GATHER_STATE(cosine) ((vf)1e-6f)
#else
#define GATHER_STATE(cosine) (max_f(cosine, (vf)1e-6f))
#endif
#define FILTERS_CHAINS FILTERS(PATH_CLASS_CAUSTIC | PATH_CLASS_MIXED)
#if defined(PHOTON_GATHER) || PATH_FILTER & PATH_CLASS_CAUSTIC
#define FILTERS_PASSING
#endif

typedef struct {
  vf state;
  vi compensates;     // light found in these lanes is what the partner lacks
  vi straight;        // lanes whose ray came straight from the first surface's broad part
  vi chained;         // lanes that came from there by way of sharp parts
  vf geometry;        // of a straight segment: cosines over the squared distance, 1/m^2
  vf broad_share;     // of this vertex's diffuse layer, what the path tracer computes
#ifdef PHOTON_GATHER
  vi gathers;         // lanes that left the first surface by its broad part
  vi reads;           // of these: lanes whose diffuse layer is read off the map here
  vi reads_caustics;  // the others, where caustics are the partner's: caustic photons alone are read
#endif
#ifdef FILTERS_LAYER
  vi layered;         // lanes of FILTER_LAYERED that scatter here
#endif
} PathFilter;

// The share of a straight connection of this geometry term that the partner leaves out: it bounds the term by clamp_to.
FN vf partner_lacks(float clamp_to, vf geometry, vi straight) {
  return pick(one_f(), clamp_f(one_f() - clamp_to / geometry, zero_f(), one_f()), straight);
}

FN PathFilter load_filter(global const float* paths, uint block) {
  PathFilter f;
  f.state = row_f(paths, PATH_ROWS, block, ROW_FILTER);
  f.compensates = f.state == (vf)FILTER_COMPENSATE;
  f.straight = no_lanes();
  f.chained = no_lanes();
#if FILTERS_CHAINS
  f.chained = f.state == (vf)FILTER_SHARP_CHAIN;
#endif
  f.geometry = zero_f();
  f.broad_share = one_f();
#ifdef PHOTON_GATHER
  f.gathers = (f.state > zero_f()) | f.chained | (f.state == (vf)FILTER_GATHERS);
  f.reads = no_lanes();
  f.reads_caustics = no_lanes();
#endif
#ifdef FILTERS_LAYER
  f.layered = no_lanes();
#endif
  return f;
}

// Of lanes whose ray found a light, those in which it is the path tracer's.
FN vi shows_emission(const PathFilter* f, vi found) {
#if FILTERS(PATH_CLASS_CAUSTIC)
  found = found & none(f->chained);
#endif
  return found;
}
// The same where the light is an unlit surface.
FN vi shows_unlit(const PathFilter* f, vi found) { return shows_emission(f, found); }

// At a surface, before its lobes are loaded: ends paths whose light is all the partner's. `limit`: the bound of the
// geometry term; of PHOTON_GATHER the spacing, m.
FN void filter_vertex(PathFilter* f, float limit, v3 origin, v3 direction, Vertex* v) {
  f->straight = v->active & none(v->passes) & (f->state > zero_f());
#ifdef PHOTON_GATHER
  v3 segment = sub3(v->hit.p, origin);
#ifdef PHOTON_RECORDS
  vf least = max_f((vf)limit, f->state);
  f->reads = v->active & none(v->passes) & f->gathers & (dot3(segment, segment) >= least * least);
#else
  f->reads = v->active & none(v->passes) & f->gathers & (dot3(segment, segment) >= (vf)(limit * limit));
#endif
  f->broad_share = pick(one_f(), zero_f(), f->reads);
#if FILTERS(PATH_CLASS_CAUSTIC)
  f->reads_caustics = v->active & none(v->passes) & f->gathers & none(f->reads);
#endif
#ifdef FILTERS_LAYER
  f->layered = v->active & none(v->passes) & (f->state == (vf)FILTER_LAYERED);
#if FILTERS(PATH_CLASS_CAUSTIC) && !defined(NEED_TRANSMISSIVE)
  v->active = v->active & none(f->layered);
#endif
#endif
#else
#if FILTERS(PATH_CLASS_DIFFUSE)
  v3 segment = sub3(v->hit.p, origin);
  f->geometry = f->state * fabs(dot3(v->hit.geometric, direction)) / dot3(segment, segment);
  f->broad_share = partner_lacks(limit, f->geometry, f->straight);
#if !defined(NEED_LOBE) && !defined(NEED_TRANSMISSIVE)
  v->active = v->active & (v->passes | (f->broad_share > zero_f()));
  f->compensates = f->compensates | f->straight;
#endif
#endif
#if FILTERS(PATH_CLASS_MIXED)
  f->broad_share = pick(f->broad_share, zero_f(), f->chained);
#endif
#endif
#if FILTERS(PATH_CLASS_GLOSSY)
  v->active = v->active & (v->passes | (f->state != (vf)FILTER_GLOSSY));
#endif
}

#ifdef PHOTON_GATHER
// Lanes that a light sample or a scattering may still bring light: all but those whose one layer is read.
FN vi goes_on(const PathFilter* f, const Vertex* v) {
  vi read = f->reads;
#ifdef NEED_LOBE
  read = read & (v->surface.lobe_share <= zero_f());
#endif
#ifdef NEED_TRANSMISSIVE
  read = read & (v->surface.transmission <= zero_f());
#endif
  return v->active & none(read);
}
#endif

// Of a rough surface the partner's bound is on the product with the lobe's gain, which a direction decides.
FN vf share_of_rough(const PathFilter* f, float clamp_to, vf gain, vi rough) {
#if FILTERS(PATH_CLASS_DIFFUSE) && !defined(PHOTON_GATHER)
  return pick(f->broad_share, partner_lacks(clamp_to, f->geometry * gain, f->straight), rough & f->straight);
#else
  return f->broad_share;
#endif
}

// Of a reflectance (BSDF times the cosine nl), without glass, what the path tracer computes.
FN v3 filter_reflectance(const PathFilter* f, const Scene* scene, const Surface* m, float clamp_to, vf nl,
                         v3 reflectance) {
  vf z = max_f(nl, (vf)1e-6f);
  v3 broad = eval_layer(scene, m, z);
  vf share = f->broad_share;
#ifdef NEED_LOBE
  vi rough = has_rough_lobe(m);
#ifdef PHOTON_GATHER
  v3 lobes = pick3(splat3(zero_f()), sub3(reflectance, broad), rough);
#else
  share = share_of_rough(f, clamp_to, lobe_gain(scale3(sub3(reflectance, broad), one_f() / z)), rough);
  broad = pick3(broad, reflectance, rough);
#endif
#endif
  v3 kept = sub3(reflectance, scale3(broad, one_f() - share));
#if FILTERS(PATH_CLASS_CAUSTIC)
  v3 plain = scale3(broad, share);
#if defined(PHOTON_GATHER) && defined(NEED_LOBE)
  plain = add3(plain, lobes);
#endif
  kept = pick3(kept, plain, f->straight | f->chained);
#endif
#ifdef FILTERS_LAYER
  v3 sharp = splat3(zero_f());
#if defined(NEED_LOBE) && !FILTERS(PATH_CLASS_CAUSTIC)
  sharp = pick3(sub3(reflectance, broad), sharp, rough);
#endif
  kept = pick3(kept, sharp, f->layered);
#endif
  return make3(max_f(kept.x, zero_f()), max_f(kept.y, zero_f()), max_f(kept.z, zero_f()));
}

// The same of rough glass.
FN v3 filter_sharp(const PathFilter* f, v3 glass) {
#if FILTERS(PATH_CLASS_CAUSTIC)
  glass = pick3(glass, splat3(zero_f()), f->straight | f->chained);
#ifdef FILTERS_LAYER
  glass = pick3(glass, splat3(zero_f()), f->layered);
#endif
#endif
  return glass;
}

#ifdef FILTERS_LAYER
// The end of filter_scattering(): the first surface's layer and its rough lobe part ways, and what is the records' ends
// behind the layer. No record lies within a solid.
FN vf layered_state(const PathFilter* f, const Vertex* v, vi leaves, vi by_layer, vi by_rough, vf cosine, vf state,
                    v3* throughput) {
#if FILTERS(PATH_CLASS_CAUSTIC)
  vi kept = no_lanes();
#else
  vi kept = none(by_layer | by_rough);
#endif
  *throughput = pick3(*throughput, splat3(zero_f()), f->layered & none(kept));
  state = pick(state, (vf)FILTER_LAYERED, f->layered);
  vi carried = leaves & by_layer;
#if defined(NEED_LOBE) && FILTERS(PATH_CLASS_LOBE)
  carried = carried | (leaves & by_rough & (v->surface.alpha >= (vf)HARMONIC_LEAST_ALPHA(LOBE_ORDER)));
#endif
#ifdef NEED_MEDIA
  carried = carried & (filling(v->media) == 0u);
#endif
  state = pick(state, max_f(cosine, (vf)1e-6f), leaves & (by_layer | by_rough));
  return pick(state, (vf)FILTER_LAYERED, carried);
}
#endif

// A scattered ray, `direction` in the local frame: weighs its throughput and gives the path's next state. `glass`:
// lanes in which glass sends it on.
OUTLINED vf filter_scattering(const PathFilter* f, const Scene* scene, const Vertex* v, float clamp_to, v3 direction,
                              vi specular, vi glass, vu pair_key, vu sample, v3* throughput) {
  vi by_broad = none(specular | glass), through = glass;
  vf gain = one_f(), share = f->broad_share;
#ifdef PHOTON_GATHER
  vi by_rough = no_lanes();
#endif
#ifdef NEED_LOBE
  const Surface* m = &v->surface;
  vi rough = has_rough_lobe(m);
  vf u_part, u_spare;
  v3 factor;
  sample_pair(pair_key, sample, GLEANER_PATH_SEQUENCE, 4u, &u_part, &u_spare);
  vi opaque = by_broad, joined = rough;
#ifdef FILTERS_LAYER
  joined = no_lanes();
#elif defined(PHOTON_GATHER)
  joined = rough & none(f->gathers);
#endif
  by_broad = choose_part(scene, m, v->frame.view, direction, opaque, joined, u_part, &gain, &factor);
  *throughput = pick3(*throughput, mul3(*throughput, factor), opaque);
  through = through | ((m->lobe_share >= one_f()) & none(rough));
  share = share_of_rough(f, clamp_to, gain, joined);
#ifdef PHOTON_GATHER
  by_rough = opaque & rough & none(by_broad);
#endif
#endif
  vi first = f->state == (vf)FILTER_NO_SURFACE;
  vi within = no_lanes();
#if defined(NEED_MEDIA) && !defined(FILTERS_PASSING)
  within = first & (filling(v->media) != 0u);
#endif
  by_broad = by_broad & none(within);
#ifdef PHOTON_GATHER
  *throughput = pick3(*throughput, scale3(*throughput, share), f->gathers & by_broad);
  vi turns = by_broad | by_rough | (f->state == (vf)FILTER_GATHERS);
  vf state = pick(f->state, pick((vf)FILTER_SHARP_CHAIN, (vf)FILTER_GATHERS, turns), f->gathers);
#if FILTERS(PATH_CLASS_CAUSTIC)
  state = pick(state, GATHER_STATE(direction.z), f->gathers & by_broad);
#endif
#else
  *throughput = pick3(*throughput, scale3(*throughput, share), (f->straight | f->chained) & by_broad);
  vf state = pick(f->state, (vf)(FILTERS_CHAINS ? FILTER_SHARP_CHAIN : FILTER_KEEP), f->straight);
  state = pick(state, (vf)(FILTERS(PATH_CLASS_DIFFUSE) ? FILTER_COMPENSATE : FILTER_KEEP), f->straight & by_broad);
#if FILTERS_CHAINS
  state = pick(state, (vf)FILTER_KEEP, f->chained & by_broad);
#endif
#endif
  vi leaves = first & none(through);
  state = pick(state, (vf)FILTER_KEEP, leaves);
#if FILTERS(PATH_CLASS_GLOSSY)
  state = pick(state, (vf)FILTER_GLOSSY, leaves & none(by_broad) & none(within));
#endif
#if FILTERS(PATH_CLASS_DIFFUSE) || FILTERS_CHAINS
#ifdef FILTERS_LAYER
  return layered_state(f, v, leaves, by_broad, by_rough, direction.z, state, throughput);
#else
  state = pick(state, max_f(direction.z, (vf)1e-6f) * gain, leaves & by_broad);
#endif
#endif
  return state;
}

// The same where the path passes the vertex instead.
FN vf filter_passing(const PathFilter* f, const Vertex* v, vf state) {
  vf passing = f->state;
#ifndef FILTERS_PASSING
  vi decided = (f->state != (vf)FILTER_NO_SURFACE) & (f->state != (vf)FILTER_COMPENSATE);
  passing = pick(passing, (vf)FILTER_KEEP, decided);
#endif
  return pick(state, passing, v->passes);
}

#else

typedef struct {
  vi compensates;
} PathFilter;

FN PathFilter load_filter(global const float* paths, uint block) {
  PathFilter f;
  f.compensates = no_lanes();
  return f;
}
FN vi shows_emission(const PathFilter* f, vi found) { return found; }
FN vi shows_unlit(const PathFilter* f, vi found) { return found; }
FN void filter_vertex(PathFilter* f, float clamp_to, v3 origin, v3 direction, Vertex* v) {}
FN v3 filter_reflectance(const PathFilter* f, const Scene* scene, const Surface* m, float clamp_to, vf nl,
                         v3 reflectance) {
  return reflectance;
}
FN v3 filter_sharp(const PathFilter* f, v3 glass) { return glass; }
OUTLINED vf filter_scattering(const PathFilter* f, const Scene* scene, const Vertex* v, float clamp_to, v3 direction,
                              vi specular, vi glass, vu pair_key, vu sample, v3* throughput) {
  return zero_f();
}
FN vf filter_passing(const PathFilter* f, const Vertex* v, vf state) { return state; }

#endif

#endif
