// Contribution of a virtual point light to a point: both may have a rough specular lobe over a diffuse layer
// (bsdf/lobe.h).
#ifndef GLEANER_KERNELS_VPL_LOBES_H
#define GLEANER_KERNELS_VPL_LOBES_H

#include "kernels/bsdf.h"
#include "kernels/scene_layout.h"
#include "kernels/vpl/geometry.h"

#ifdef NEED_LOBE
// What the lobe with this albedo table leaves to the layer below it, towards `cosine`.
FN vf left_at(const Scene* scene, vu table, vf table_row, vf cosine) {
  Surface m;
  m.table = table;
  m.table_row = table_row;
  return left_to_layer(scene, &m, cosine);
}
#endif

// What a point has beside its row: its triangle's normal, and lobes.
typedef struct {
#ifdef NEED_BENT_NORMALS
  v3 geometric;  // not of unit length
#endif
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

#ifdef NEED_BENT_NORMALS
// What geometry at a point leaves of light from `toward`, of any length.
FN vf lit_at_point(const PointLobe* lobe, v3 n, v3 toward) {
  return terminator(dot3(lobe->geometric, toward), dot3(n, toward), dot3(lobe->geometric, n));
}
#endif

// `row`: of the point in `lobes`.
FN PointLobe load_point_lobe(const Scene* scene, const vf* point, global const float* lobes, vu row, vi active) {
  PointLobe lobe;
#ifdef NEED_BENT_NORMALS
  vf t[16];
  load_words(scene->triangles, pick_u((vu)0u, as_vu(point[POINT_TRIANGLE]), active) * TRIANGLE_WORDS, t);
  v3 p0 = words3(t, TRIANGLE_P0);
  v3 e1 = sub3(words3(t, TRIANGLE_P1), p0), e2 = sub3(words3(t, TRIANGLE_P2), p0);
#ifdef NEED_INSTANCES
  vf place[16];
  load_words(scene->instances, instance_row(pick_u((vu)GLEANER_NONE, as_vu(point[POINT_INSTANCE]), active)), place);
  e1 = place_vector(place, e1);
  e2 = place_vector(place, e2);
#endif
  lobe.geometric = cross3(e1, e2);
  // The point's normal is on the viewer's side.
  lobe.geometric =
      pick3(lobe.geometric, negate3(lobe.geometric), dot3(lobe.geometric, words3(point, POINT_NORMAL)) < zero_f());
#endif
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

// Of a light's flux, what its diffuse layer sends: the lobe's mean is taken off. A cluster's members may be of other
// materials, so that less than nothing may be left.
FN v3 layer_flux(v3 flux, v3 mean) {
  return make3(max_f(flux.x - mean.x, zero_f()), max_f(flux.y - mean.y, zero_f()), max_f(flux.z - mean.z, zero_f()));
}

#endif
