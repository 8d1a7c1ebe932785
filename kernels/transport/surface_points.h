// Surface points: camera paths through mirrors and glass to the first surface that scatters diffusely.
//
//   repeat
//     trace                   closest hits
//     step_to_surface_point   a bare mirror or glass sends the path on; any other surface ends it with a point
//   until no path is left
//
// Points within solids are found where POINTS_WITHIN_SOLIDS is defined: by methods whose light knows of media.
//
// Include it where a method shades or clusters what the camera sees. How camera rays are dealt out to items, and what
// is kept of a point, is the method's own (kernels/vpl/points.cl).
#ifndef GLEANER_KERNELS_TRANSPORT_SURFACE_POINTS_H
#define GLEANER_KERNELS_TRANSPORT_SURFACE_POINTS_H

#include "kernels/lobe_rows.h"
#include "kernels/transport/scattering.h"

typedef struct {
  Vertex vertex;
  vi found;       // lanes whose path ends here, with a point
  vu depth;       // scatterings before it
  vu slot;        // the path's
  v3 direction;   // of the ray that found it
  v3 throughput;  // of the camera path
  v3 albedo;      // of the diffuse layer, as seen from the ray
  vu table;       // the albedo table of the lobe above that layer, or GLEANER_NONE
  vf table_row;
  vi rough;  // the surface has a rough lobe (kernels/bsdf/lobe.h)
} SurfacePoint;

// What the surface at a path's vertex is, and whether a point is found there; its depth is set. Returns the lanes that
// go on, as through mirrors and glass.
FN vi describe_point(const Vertex* v, vf u_glass, uint max_depth, uint needed, SurfacePoint* point) {
  const Surface* m = &v->surface;
  vi here = v->active & none(v->passes);
  point->albedo = layer_albedo(m);
  point->table = (vu)GLEANER_NONE;
  point->table_row = zero_f();
#ifdef NEED_LOBE
  // A bare metal has no layer below its lobe; unless it is rough, a path goes through it as through a mirror.
  point->rough = has_rough_lobe(m);
  vi bare = (m->lobe_share >= one_f()) & none(point->rough);
  point->table = m->table;
  point->table_row = m->table_row;
#else
  point->rough = no_lanes();
  vi bare = no_lanes();
#endif
#ifdef NEED_TRANSMISSIVE
  vi glass = u_glass < m->transmission;
#else
  vi glass = no_lanes();
#endif
  vi continues = here & (bare | glass);
  point->found = here & none(continues) & ((max_component(point->albedo) > zero_f()) | point->rough);
  if (max_depth) point->found = point->found & (point->depth + needed <= (vu)max_depth);
#if defined(NEED_MEDIA) && !defined(POINTS_WITHIN_SOLIDS)
  // Within a solid paths find all light: other lights would have to be weakened by it.
  point->found = point->found & (filling(v->media) == 0u);
#endif
  return continues;
}

// Moves one block of camera paths. samples: length of the pixels' sequences of random numbers. max_depth: most
// scatterings on a light's way, of which `needed` are still to come where a point is found (0 = no limit). `counters`
// gets the number of paths that continue.
FN SurfacePoint step_to_surface_point(const Scene* scene, global float* paths, uint block, uint samples, uint max_depth,
                                      uint needed, global uint* counters) {
  SurfacePoint point;
  vu meta = row_u(paths, PATH_ROWS, block, ROW_META);
  vi active = take_hits(paths, block, meta);
  point.found = no_lanes();
  if (!any_lane(active)) return point;
  v3 origin = row_3(paths, PATH_ROWS, block, ROW_ORIGIN);
  v3 direction = row_3(paths, PATH_ROWS, block, ROW_DIRECTION);
  v3 throughput = row_3(paths, PATH_ROWS, block, ROW_THROUGHPUT);
  vu slot = row_u(paths, PATH_ROWS, block, ROW_SLOT);
  vu key = row_u(paths, PATH_ROWS, block, ROW_KEY);
  vu depth = meta & META_DEPTH_MASK;
  vu bounce = (meta >> META_BOUNCE) & META_BOUNCE_MASK;
  vu sample = (meta >> META_SAMPLE) & META_SAMPLE_MASK;
  Vertex v = meet_surface(scene, paths, PATH_ROWS, block, active);
  throughput = through_media(scene, &v, paths, block, origin, direction, throughput);
  vu pair_key = hash_combine(key, bounce * 4u + 1u);
  vf u_lobe, u_glass, d0, d1, u_roulette, u_spare;
  sample_pair(pair_key, sample, samples, 0u, &u_roulette, &u_spare);
  sample_pair(pair_key, sample, samples, 2u, &u_lobe, &u_glass);
  sample_pair(pair_key, sample, samples, 3u, &d0, &d1);
  choose_alpha(&v, &u_glass);
  prepare_scattering(scene, &v, direction);

  point.slot = slot;
  point.depth = depth;
  point.direction = direction;
  point.throughput = throughput;
  vi continues = describe_point(&v, u_glass, max_depth, needed, &point);

  BsdfSample scattered = sample_bsdf(scene, &v.surface, v.frame.view, u_lobe, u_glass, d0, d1);
  vi smooth = scattered.pdf <= zero_f();
  NextRay next;
  next.direction = scattered_direction(&v.frame, scattered.direction, smooth);
  next.throughput = mul3(throughput, scattered.weight);
#ifdef NEED_BENT_NORMALS
  next.throughput =
      scale3(next.throughput, pick(geometric_share(&v.frame, next.direction, scattered.direction.z), one_f(), smooth));
#endif
  next.alive =
      continues & (max_component(next.throughput) > zero_f()) & finite3(next.throughput) & finite3(next.direction);
  next.depth = min(depth + 1u, (vu)META_DEPTH_MASK);
  // Two mirrors may face each other.
  russian_roulette(&next, next.depth >= 8u, min_f(max_component(next.throughput), (vf)ROULETTE_MOST), u_roulette);
  v3 passed = pass_glass(&v, &scattered, throughput, &next);
  leave_vertex(&v, direction, passed, depth, &next);
  next.alive = next.alive & (bounce < (vu)META_BOUNCE_MASK);
  uint kept;
  rank_lanes(next.alive, &kept);
  if (kept) {
    atomic_add(counters, kept);
    set_path(paths, block, &next, slot, next.depth | ((bounce + 1u) << META_BOUNCE) | (sample << META_SAMPLE), key);
  }
  point.vertex = v;
  return point;
}

#ifdef NEED_LOBE
// Row `row` of `lobes`.
FN void write_lobe(global float* lobes, vu row, const SurfacePoint* point) {
  const Surface* m = &point->vertex.surface;
  vf w[LOBE_WORDS];
  put_words3(w, LOBE_VIEW, negate3(point->direction));
  put_words3(w, LOBE_THROUGHPUT, point->throughput);
  put_words3(w, LOBE_F0, lobe_f0(m));
  w[LOBE_F90] = lobe_f90(m);
  w[LOBE_ALPHA] = pick(zero_f(), m->alpha, point->rough);
  for (uint k = LOBE_ALPHA + 1u; k < LOBE_WORDS; ++k) w[k] = zero_f();
  store_words(lobes, row * LOBE_WORDS, w);
}
#endif

#endif
