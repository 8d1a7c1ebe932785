// Scattering: one step of a path, from the surface that its ray met to the ray that leaves it.
//
//   meet_surface         hit point, normals, colour and opacity
//   through_media        what the solids along the ray left of its light
//   choose_alpha         at random: scattered here, or passed on where the surface is alpha-transparent
//   prepare_scattering   the material's other terms and the frame in which it scatters
//   sample_bsdf          (kernels/bsdf.h) a direction and its weight
//   pass_glass           glass lets go straight on: no scattering either
//   russian_roulette, leave_vertex   whether the path continues, and with what throughput
//
// Camera paths carry radiance, light paths carry flux: scatter_flux() has the adjoint's corrections. Every kernel that
// moves paths includes this file; their rows in memory are those of kernels/path_layout.h.
#ifndef GLEANER_KERNELS_TRANSPORT_SCATTERING_H
#define GLEANER_KERNELS_TRANSPORT_SCATTERING_H

#include "kernels/path_layout.h"
#include "kernels/surface.h"

// Where a path's ray met a surface.
typedef struct {
  vu primitive;  // triangle 0 in lanes that met nothing
  Hit hit;
  Surface surface;
  ShadingFrame frame;  // after prepare_scattering()
  vi active;           // lanes whose path scatters here or passes on
  vi passes;           // of these: lanes that pass the surface unscattered
#ifdef NEED_MEDIA
  Media media, beyond;  // what the ray came through, and what lies behind the surface
#endif
} Vertex;

// The hits of a block of paths or shadow rays of `rows` rows, in `active` lanes.
OUTLINED Vertex meet_surface(const Scene* scene, global const float* rays, uint rows, uint block, vi active) {
  Vertex v;
  v.active = active;
  v.passes = no_lanes();
  v.primitive = pick_u((vu)0u, row_u(rays, rows, block, ROW_PRIMITIVE), active);
  v.hit = load_hit(scene, v.primitive, row_u(rays, rows, block, ROW_INSTANCE), row_f(rays, rows, block, ROW_U),
                   row_f(rays, rows, block, ROW_V), active);
  load_color(scene, &v.hit, &v.surface, active);
  return v;
}

// `carried`: throughput or flux of the path, whose ray began at `origin`.
FN v3 through_media(const Scene* scene, Vertex* v, global const float* paths, uint block, v3 origin, v3 direction,
                    v3 carried) {
#ifdef NEED_MEDIA
  Media media;
  media.high = row_u(paths, PATH_ROWS, block, ROW_MEDIA);
  media.low = row_u(paths, PATH_ROWS, block, ROW_MEDIA + 1u);
  v->media = media_at_end(media, &v->hit, scene, meets_back(&v->hit, direction), v->active);
  carried = mul3(carried, absorption(scene, v->media, length3(sub3(v->hit.p, origin)), v->active));
#endif
  return carried;
}

// u_glass decides on alpha first; what is left of it decides between glass and the layer. Unlit surfaces scatter
// nothing.
FN void choose_alpha(Vertex* v, vf* u_glass) {
  v->passes = stochastic_alpha(&v->surface, v->active, u_glass);
#ifdef NEED_UNLIT
  v->active = v->active & (v->passes | ((as_vu(v->hit.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) == 0u));
#endif
}

// `direction`: of the ray that came here.
OUTLINED void prepare_scattering(const Scene* scene, Vertex* v, v3 direction) {
  load_lobes(scene, &v->hit, &v->surface, v->active);
  v->frame = shading_frame(&v->hit, direction);
  v->active = v->active & ((v->frame.view.z > (vf)1e-6f) | v->passes);
  set_side(&v->surface, v->frame.from_back);
#ifdef NEED_MEDIA
  v->beyond = media_beyond(v->media, &v->hit, scene, v->frame.from_back, v->active);
  set_boundary(scene, &v->surface, v->media, v->beyond, v->active);
#endif
#if defined(NEED_ANISOTROPY) || defined(NEED_CLEARCOAT)
  orient_layers(scene, &v->hit, &v->frame, &v->surface);
#endif
#ifdef NEED_LAYERS
  prepare_layers(scene, &v->surface, make3(v->frame.view.x, v->frame.view.y, max_f(v->frame.view.z, (vf)1e-6f)));
#endif
#ifdef NEED_LOBE
  prepare_lobe(scene, &v->surface, max_f(v->frame.view.z, (vf)1e-6f));
#endif
}

// The ray that leaves a vertex.
typedef struct {
  v3 origin, direction;
  v3 throughput;  // or flux
  vu depth;       // scatterings so far
  vi alive;
#ifdef NEED_MEDIA
  Media media;
#endif
} NextRay;

// Lanes that glass lets go straight on, weakened, pass as well. The direction is the sample's own; `carried`:
// throughput or flux. Then what passing lanes carry.
FN v3 pass_glass(Vertex* v, const BsdfSample* scattered, v3 carried, NextRay* next) {
#ifdef NEED_MEDIA
  vi crosses = scattered->crosses & none(v->passes);
  next->media.high = pick_u(v->media.high, v->beyond.high, crosses);
  next->media.low = pick_u(v->media.low, v->beyond.low, crosses);
#endif
#ifdef PASSES_GLASS
  vi unbent = v->active & none(v->passes) & scattered->straight;
  carried = pick3(carried, mul3(carried, scattered->weight), unbent);
  v->passes = v->passes | unbent;
#endif
  return carried;
}

// Those at risk survive with chance `survival`, and then carry 1 / survival as much.
FN void russian_roulette(NextRay* next, vi at_risk, vf survival, vf u) {
  vi roulette = next->alive & at_risk;
  next->alive = next->alive & (none(roulette) | (u < survival));
  next->throughput = pick3(next->throughput, scale3(next->throughput, one_f() / survival), roulette);
}

// Lanes that pass the surface keep their direction, and have what they carried and their depth. Then the ray's origin.
FN void leave_vertex(const Vertex* v, v3 direction, v3 throughput, vu depth, NextRay* next) {
#if defined(NEED_ALPHA) || defined(PASSES_GLASS)
  next->direction = pick3(next->direction, direction, v->passes);
  next->throughput = pick3(next->throughput, throughput, v->passes);
  next->depth = pick_u(next->depth, depth, v->passes);
  next->alive = (next->alive & none(v->passes)) | (v->active & v->passes & (max_component(throughput) > zero_f()));
#endif
  next->origin = offset_ray_origin(v->hit.p, v->hit.error, v->hit.geometric, next->direction);
  next->alive = next->alive & finite3(next->origin);
}

// Rows of a path that moves in place, in its own block: light paths and camera paths to the first non-specular surface.
FN void set_path(global float* paths, uint block, const NextRay* ray, vu slot, vu meta, vu key) {
  set_ray(paths, PATH_ROWS, block, ray->origin, ray->direction, pick((vf)-1.0f, (vf)INFINITY, ray->alive),
          (vu)GLEANER_NONE, (vu)0u);
  set_row_u(paths, PATH_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT, ray->throughput);
  set_row_u(paths, PATH_ROWS, block, ROW_SLOT, slot);
  set_row_u(paths, PATH_ROWS, block, ROW_META, pick_u((vu)META_IDLE, meta, ray->alive));
  set_row_u(paths, PATH_ROWS, block, ROW_KEY, key);
#ifdef NEED_MEDIA
  set_row_u(paths, PATH_ROWS, block, ROW_MEDIA, ray->media.high);
  set_row_u(paths, PATH_ROWS, block, ROW_MEDIA + 1u, ray->media.low);
#endif
}

// Lanes of the first `count` that hold a path.
FN vi path_lanes(uint block, uint count, vu meta) {
  return ((vu)(block * LANES) + lane_index() < count) & ((meta & META_IDLE) == 0u);
}

// The paths of a block that met something. The block is idle from here on, until set_path() says otherwise.
FN vi take_hits(global float* paths, uint block, vu meta) {
  vi hit = ((meta & META_IDLE) == 0u) & (row_u(paths, PATH_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  set_row_f(paths, PATH_ROWS, block, ROW_FAR, (vf)-1.0f);
  set_row_u(paths, PATH_ROWS, block, ROW_META, (vu)META_IDLE);
  return hit;
}

// --- Light paths ---

// Flux is per area of the triangle, scattering by the cosine to the shading normal (Veach 1997, 5.3): the factor for
// the ray that arrives. `geometric`: the triangle's normal on its side.
FN vf shading_normal_correction(const Vertex* v, v3 geometric, v3 direction) {
  return v->frame.view.z / max_f(fabs(dot3(geometric, direction)), (vf)1e-6f);
}

typedef struct {
  vf u_lobe, u_glass, d0, d1, u_roulette;
} ScatterNumbers;

// The share of the light from -direction that rough scattering back over the surface takes, as a camera path would
// weigh it (geometric_share).
FN vf lit_share(const Vertex* v, v3 direction) {
#ifdef NEED_BENT_NORMALS
  return geometric_share(&v->frame, negate3(direction), v->frame.facing);
#else
  return one_f();
#endif
}

// The scattered ray of a light path's vertex, and the sample that it is made of. `correction`: of the ray that arrived.
// max_depth: most scatterings; 0: until Russian roulette ends the path, which is played from the second scattering on.
// *straight: lanes whose light no mirror and no smooth glass may turn aside; those that still are so come back.
FN NextRay scatter_flux(const Scene* scene, Vertex* v, v3 geometric, vf correction, v3 direction, v3 flux, vu depth,
                        uint max_depth, const ScatterNumbers* u, vi* straight, BsdfSample* sample) {
  BsdfSample scattered = sample_bsdf(scene, &v->surface, v->frame.view, u->u_lobe, u->u_glass, u->d0, u->d1);
  *sample = scattered;
  vi smooth = scattered.pdf <= zero_f();
  NextRay next;
  next.direction = scattered_direction(&v->frame, scattered.direction, smooth);
  vf cosine = fabs(scattered.direction.z);
#ifdef NEED_BENT_NORMALS
  cosine = fabs(dot3(v->frame.normal, next.direction));
#endif
  // Flux is not squeezed by refraction as radiance is; and the other half of the shading normals' correction.
  vf leaving = fabs(dot3(geometric, next.direction)) / max_f(cosine, (vf)1e-6f);
  vf adjoint = correction * leaving * scattered.eta * scattered.eta;
#ifdef NEED_BENT_NORMALS
  vi over = scattered.direction.z > zero_f();
  vi lost = none(smooth) & ((dot3(v->frame.geometric, next.direction) > zero_f()) != over);
  adjoint *= pick(one_f(), lit_share(v, direction), none(smooth) & over);
  adjoint = pick(adjoint, zero_f(), lost);
#endif
  v3 weight = scale3(scattered.weight, adjoint);
  next.throughput = mul3(flux, weight);
  next.depth = min(depth + 1u, (vu)255u);
  next.alive = v->active & none(v->passes) & (max_component(next.throughput) > zero_f()) & finite3(next.throughput) &
               finite3(next.direction) & none(*straight & smooth);
  if (max_depth) next.alive = next.alive & (next.depth < (vu)max_depth);
  vf survival = min_f(max_component(next.throughput) / max_component(flux), (vf)ROULETTE_MOST);
  russian_roulette(&next, next.depth >= 2u, survival, u->u_roulette);
  v3 passed = pass_glass(v, &scattered, flux, &next);
  *straight = *straight & v->passes;
  leave_vertex(v, direction, passed, depth, &next);
  return next;
}

#endif
