// Scattering: one step of a path, from the surface that its ray met to the ray that leaves it.
//
//   meet_surface         hit point, normals, colour and opacity
//   choose_alpha         at random: scattered here, or passed on where the surface is alpha-transparent
//   prepare_scattering   the material's other terms and the frame in which it scatters
//   sample_bsdf          (kernels/bsdf.h) a direction and its weight
//   russian_roulette, pass_through   whether the path continues, and with what throughput
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
  vi passes;           // of these: lanes that pass an alpha-transparent surface unscattered
} Vertex;

// The hits of a block of paths or shadow rays of `rows` rows, in `active` lanes.
FN Vertex meet_surface(const Scene* scene, global const float* rays, uint rows, uint block, vi active) {
  Vertex v;
  v.active = active;
  v.passes = no_lanes();
  v.primitive = pick_u((vu)0u, row_u(rays, rows, block, ROW_PRIMITIVE), active);
  v.hit = load_hit(scene, v.primitive, row_f(rays, rows, block, ROW_U), row_f(rays, rows, block, ROW_V), active);
  load_color(scene, &v.hit, &v.surface, active);
  return v;
}

// u_glass decides on alpha first; what is left of it decides between glass and the layer. Unlit surfaces scatter
// nothing.
FN void choose_alpha(Vertex* v, vf* u_glass) {
  v->passes = stochastic_alpha(&v->surface, v->active, u_glass);
#ifdef NEED_UNLIT
  v->active = v->active & (v->passes | ((as_vu(v->hit.words[MATERIAL_FLAGS]) & GLEANER_MATERIAL_UNLIT) == 0u));
#endif
}

// `direction`: of the ray that came here. A ray that grazes the interpolated normal's back scatters nothing.
FN void prepare_scattering(const Scene* scene, Vertex* v, v3 direction) {
  load_lobes(scene, &v->hit, &v->surface, v->active);
  v->frame = shading_frame(v->hit.normal, direction);
  v->active = v->active & ((v->frame.view.z > (vf)1e-6f) | v->passes);
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
} NextRay;

// Those at risk survive with chance `survival`, and then carry 1 / survival as much.
FN void russian_roulette(NextRay* next, vi at_risk, vf survival, vf u) {
  vi roulette = next->alive & at_risk;
  next->alive = next->alive & (none(roulette) | (u < survival));
  next->throughput = pick3(next->throughput, scale3(next->throughput, one_f() / survival), roulette);
}

// Lanes that pass an alpha-transparent surface keep their direction, throughput and depth. Then the ray's origin.
FN void leave_vertex(const Vertex* v, v3 direction, v3 throughput, vu depth, NextRay* next) {
#ifdef NEED_ALPHA
  next->direction = pick3(next->direction, direction, v->passes);
  next->throughput = pick3(next->throughput, throughput, v->passes);
  next->depth = pick_u(next->depth, depth, v->passes);
  next->alive = (next->alive & none(v->passes)) | (v->active & v->passes);
#endif
  next->origin = offset_ray_origin(v->hit.p, v->hit.error, v->hit.geometric, next->direction);
  next->alive = next->alive & finite3(next->origin);
}

// Rows of a path that moves in place, in its own block: light paths and camera paths to the first non-specular surface.
FN void set_path(global float* paths, uint block, const NextRay* ray, vu slot, vu meta, vu key) {
  set_ray(paths, PATH_ROWS, block, ray->origin, ray->direction, pick((vf)-1.0f, (vf)INFINITY, ray->alive),
          (vu)GLEANER_NONE);
  set_row_u(paths, PATH_ROWS, block, ROW_GEOMETRY, (vu)GLEANER_NONE);
  set_row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT, ray->throughput);
  set_row_u(paths, PATH_ROWS, block, ROW_SLOT, slot);
  set_row_u(paths, PATH_ROWS, block, ROW_META, pick_u((vu)META_IDLE, meta, ray->alive));
  set_row_u(paths, PATH_ROWS, block, ROW_KEY, key);
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

// The scattered ray of a light path's vertex. `correction`: of the ray that arrived. max_depth: most scatterings; 0:
// until Russian roulette ends the path, which is played from the second scattering on.
FN NextRay scatter_flux(const Scene* scene, const Vertex* v, v3 geometric, vf correction, v3 direction, v3 flux,
                        vu depth, uint max_depth, const ScatterNumbers* u) {
  BsdfSample scattered =
      sample_bsdf(scene, &v->surface, v->frame.view, v->frame.from_back, u->u_lobe, u->u_glass, u->d0, u->d1);
  NextRay next;
  next.direction = from_frame(&v->frame, scattered.direction);
  // Flux is not squeezed by refraction as radiance is; and the other half of the shading normals' correction.
  vf leaving = fabs(dot3(geometric, next.direction)) / max_f(fabs(scattered.direction.z), (vf)1e-6f);
  vf adjoint = correction * leaving * scattered.eta * scattered.eta;
  v3 weight = scale3(scattered.weight, adjoint);
  next.throughput = mul3(flux, weight);
  next.depth = min(depth + 1u, (vu)255u);
  next.alive = v->active & none(v->passes) & (max_component(next.throughput) > zero_f()) & finite3(next.throughput) &
               finite3(next.direction);
  if (max_depth) next.alive = next.alive & (next.depth < (vu)max_depth);
  vf survival = min_f(max_component(next.throughput) / max_component(flux), (vf)ROULETTE_MOST);
  russian_roulette(&next, next.depth >= 2u, survival, u->u_roulette);
  leave_vertex(v, direction, flux, depth, &next);
  return next;
}

#endif
