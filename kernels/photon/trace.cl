// Photons from light paths. Stage kind "photon_trace".
//
//   photon_emit          a light path's first ray, lights chosen by power           (kernels/transport/emission.h)
//                        or as an emission guide tells                              (kernels/photon/guide.h)
//   repeat
//     trace              closest hits
//     photon_trace_step  at a surface with a broad part: store a photon of the arriving flux
//                        scatter with Russian roulette                              (kernels/transport/scattering.h)
//                        class <- which part of the surface scattered it            (kernels/transport/parts.h)
//     pack_paths         where many paths have ended                            (kernels/transport/pack_paths.h)
//   until no path is left
//
// A path that arrives more often than it has slots keeps a random choice of its photons (reservoir sampling: Vitter
// 1985, algorithm R); the host gives those the others' power. Unlike the light paths of virtual point lights these
// follow punctual lights through mirrors and glass: no other method finds that light.
#include "kernels/photon/guide.h"
#include "kernels/photon/pack.h"
#include "kernels/photon_records.h"
#include "kernels/transport/light_paths.h"
#include "kernels/transport/pack_paths.h"
#include "kernels/transport/parts.h"
#include "kernels/wide.h"

// ROW_META of a light path.
#define LIGHT_ARRIVALS 16u  // photons left so far
#define LIGHT_CLASS 24u

// Words of a path's balance: power absorbed, power that left the scene, RGB each.
#define BALANCE_WORDS 6u
#define BALANCE_ABSORBED 0u
#define BALANCE_ESCAPED 3u

#ifdef NEED_LIGHTS

kernel WIDE void photon_emit(global const PhotonTraceParameters* restrict parameters, SCENE_PARAMETERS,
                             global const float* restrict emission, global const float* restrict guide, uint guided,
                             uint first_low, uint first_high, uint count, global float* restrict paths) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  LightStart start = begin_light_paths(first_low, first_high, first_lane, parameters->seed_low, parameters->seed_high,
                                       parameters->pass ^ 0x50480000u);
  EmissionNumbers numbers = emission_numbers(start.key, start.sample);
  vf density = one_f();
  if (guided != 0u) density = guide_emission(guide, &numbers);
  emit_light_paths(scene, emission, count, numbers, &start);
  ulong items = ((ulong)parameters->items_high << 32) | parameters->items_low;
  start.ray.throughput = scale3(start.ray.throughput, (vf)(1.0f / (float)items));
  if (guided != 0u) start.ray.throughput = scale3(start.ray.throughput, one_f() / density);
  set_light_path(paths, block, &start, (vu)(PHOTON_DIRECT << LIGHT_CLASS));
}

// What is left of a light path's flux where it meets a surface, and the numbers that are drawn there.
typedef struct {
  v3 origin, direction, power;
  vu slot, key, sample, bounce, depth, arrivals, class_;
} LightPath;

FN LightPath load_light_path(global const float* paths, uint block, vu meta) {
  LightPath p;
  p.origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  p.direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  p.power = row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT);
  p.slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  p.key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  p.sample = row_u(paths, PATH_ROWS, block, ROW_SAMPLE);
  p.bounce = meta & LIGHT_BOUNCE_MASK;
  p.depth = (meta >> LIGHT_DEPTH) & 255u;
  p.arrivals = (meta >> LIGHT_ARRIVALS) & 255u;
  p.class_ = (meta >> LIGHT_CLASS) & PHOTON_CLASS_MASK;
  return p;
}

// Adds power to a path's balance.
FN void add_balance(global float* balance, uint slots, vu slot, uint word, v3 power, vi active) {
  vu at = pick_u((vu)slots, slot, active) * BALANCE_WORDS + word;
  scatter3(balance, at, add3(gather3(balance, at), power));
}

// Lanes that store a photon here: the surface has a broad part, on this side, and the class is kept.
FN vi stores_photon(const Vertex* v, const LightPath* p, global const PhotonTraceParameters* parameters) {
  vi stores = v->active & none(v->passes) & ((p->class_ & 3u) == p->class_) &
              (((vu)parameters->classes >> p->class_ & 1u) != 0u);
  vi broad = max_component(layer_albedo(&v->surface)) > zero_f();
#ifdef NEED_LOBE
  broad = broad | has_rough_lobe(&v->surface);
#endif
#ifdef NEED_TRANSMISSIVE
  broad = broad & (v->surface.transmission < one_f());
#endif
  return stores & broad;
}

// In the place of a photon's power, the numbers that its path began with: kernels/photon_records.h, PILOT_...
FN void put_pilot(vf* w, const LightPath* p) {
  EmissionNumbers n = emission_numbers(p->key, p->sample);
  vf whole = (vf)65536.0f;
  w[PILOT_LIGHT] = as_vf(to_u(n.light * whole) | (to_u(n.u0 * whole) << 16));
  w[PILOT_POINT] = as_vf(to_u(n.u1 * whole) | (to_u(n.d0 * whole) << 16));
  w[PILOT_DIRECTION] = as_vf(to_u(n.d1 * whole));
}

// One photon a lane; how many photons the path has left goes to `arrivals`.
FN void store_photon(global float* records, global uint* arrivals, uint slots, uint pilot, LightPath* p,
                     const Vertex* v, v3 geometric, vf weight, vi stores) {
  // The place of the j-th: below it at random, and lost where that is no slot.
  vu random = hash_combine(hash_combine(p->key, p->sample), p->arrivals + 0x7265u);
  vu place = pick_u(p->arrivals, min(to_u(unit_float(random) * (to_f(p->arrivals) + one_f())), p->arrivals),
                    p->arrivals >= PHOTON_PATH_SLOTS);
  vi kept = stores & (place < PHOTON_PATH_SLOTS);
  // Lanes with nothing to store do so behind the records.
  vu at = pick_u((vu)slots * PHOTON_PATH_SLOTS, p->slot * PHOTON_PATH_SLOTS + place, kept) * PHOTON_WORDS;
  vf w[PHOTON_WORDS];
  put_words3(w, PHOTON_POSITION, v->hit.p);
  put_words3(w, PHOTON_POWER, scale3(p->power, weight));
  vf length = length3(sub3(v->hit.p, p->origin));
  w[PHOTON_ARRIVAL] = as_vf(pack_unit(p->direction, 12u) | (pack_length(length) << PHOTON_LENGTH_SHIFT));
  w[PHOTON_SURFACE] = as_vf(pack_unit(geometric, 12u) | (p->class_ << PHOTON_CLASS_SHIFT) |
                            (min(p->depth, (vu)PHOTON_MOST_DEPTH) << PHOTON_DEPTH_SHIFT));
  if (pilot) put_pilot(w, p);
  scatter_words(records, 1u, at, w, PHOTON_WORDS);
  p->arrivals = min(p->arrivals + pick_u((vu)0u, (vu)1u, stores), (vu)255u);
  scatter_u(arrivals, pick_u((vu)slots, p->slot, stores), p->arrivals);
}

// The class after this scattering; parts are drawn at random, which the power makes up for.
FN vu next_class(const Scene* scene, const LightPath* p, const Vertex* v, const BsdfSample* scattered, vf u_glass,
                 NextRay* next) {
  vi specular = scattered->pdf <= zero_f();
  vi glass = no_lanes();
#ifdef NEED_TRANSMISSIVE
  glass = u_glass < v->surface.transmission;
#endif
  vi by_broad = none(specular | glass);
#ifdef NEED_LOBE
  const Surface* m = &v->surface;
  vf u_part, u_spare, gain;
  v3 factor;
  sample_pair(hash_combine(p->key, p->bounce * 4u + 17u), p->sample, LIGHT_SEQUENCE, 0u, &u_part, &u_spare);
  vi opaque = by_broad;
  by_broad =
      choose_part(scene, m, v->frame.view, scattered->direction, opaque, has_rough_lobe(m), u_part, &gain, &factor);
  vi changes = opaque & none(v->passes);
  next->throughput = pick3(next->throughput, mul3(next->throughput, factor), changes);
  next->alive = next->alive & (max_component(next->throughput) > zero_f());
#endif
  vi from_light = (p->class_ == PHOTON_DIRECT) | (p->class_ == PHOTON_CAUSTIC);
  vu class_ = pick_u((vu)PHOTON_MIXED, (vu)PHOTON_CAUSTIC, from_light);
  class_ = pick_u(class_, (vu)PHOTON_BROAD, by_broad);
  return pick_u(class_, p->class_, v->passes);
}

// Paths, of which the first `count` lanes hold some. They store in slots of their own, of `slots`.
kernel WIDE void photon_trace_step(global const PhotonTraceParameters* restrict parameters, SCENE_PARAMETERS,
                                   uint count, uint slots, global float* paths, global float* records,
                                   global uint* arrivals, global float* balance, global uint* counters) {
  uint block = (uint)get_global_id(0);
  if (block * LANES >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi alive = path_lanes(block, count, meta);
  if (!any_lane(alive)) return;
  meta = pick_u((vu)META_IDLE, meta, alive);
  LightPath p = load_light_path(paths, block, meta);
  vi active = take_hits(paths, block, meta);
  if (parameters->balance) add_balance(balance, slots, p.slot, BALANCE_ESCAPED, p.power, alive & none(active));
  if (!any_lane(active)) return;
  v3 arrived = p.power;
  LightVertex met =
      meet_light_surface(scene, paths, block, active, p.origin, p.direction, p.power, p.key, p.sample, p.bounce);
  Vertex v = met.v;
  v3 geometric = met.geometric;
  vf correction = met.correction;
  p.power = met.flux;

  vf weight = correction * lit_share(&v, p.direction);
  vi stores = stores_photon(&v, &p, parameters) & finite3(scale3(p.power, weight)) & finite3(v.hit.p);
  if (any_lane(stores)) store_photon(records, arrivals, slots, parameters->pilot, &p, &v, geometric, weight, stores);

  vi straight = no_lanes();
  BsdfSample scattered;
  uint most = parameters->most_depth == GLEANER_NONE ? 0u : parameters->most_depth + 1u;
  NextRay next = scatter_flux(scene, &v, geometric, correction, p.direction, p.power, p.depth, most, &met.u, &straight,
                              &scattered);
  vu class_ = next_class(scene, &p, &v, &scattered, met.u.u_glass, &next);
  // Of paths that leave caustics alone, a broad scattering is the end.
  if ((parameters->classes & (PHOTON_CLASS_BIT(PHOTON_BROAD) | PHOTON_CLASS_BIT(PHOTON_MIXED))) == 0u)
    next.alive = next.alive & (class_ != PHOTON_BROAD);
  next.alive = next.alive & (p.bounce < (vu)LIGHT_BOUNCE_MASK);
  if (parameters->balance) {
    // A photon that may not be scattered again has its power for good.
    vi stays = stores & none(next.alive) & (p.depth + 1u >= (vu)most) & ((vu)most != 0u);
    v3 lost = pick3(arrived, sub3(arrived, next.throughput), next.alive);
    lost = pick3(lost, sub3(arrived, scale3(p.power, weight)), stays);
    add_balance(balance, slots, p.slot, BALANCE_ABSORBED, lost, active);
  }
  uint kept;
  rank_lanes(next.alive, &kept);
  if (kept == 0u) return;
  atomic_add(counters, kept);
  vu next_meta = ((p.bounce + 1u) & LIGHT_BOUNCE_MASK) | (next.depth << LIGHT_DEPTH) | (p.arrivals << LIGHT_ARRIVALS) |
                 (class_ << LIGHT_CLASS);
  set_path(paths, block, &next, p.slot, next_meta, p.key);
  set_row_f(paths, PATH_ROWS, block, ROW_RANGE, zero_f());
}

#endif
