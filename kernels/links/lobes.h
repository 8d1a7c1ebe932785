// Light that rough metal sends on by direction. A vertex of rough metal has, beside the element that its diffuse layer
// is, LOBE_BINS lobe elements (kernels/links_records.h): the light that its lobe sends, in the mean over the directions
// of a bin. They get light over links of their own, whose rays the lobe draws, and send it as any other element: who
// sees the vertex is linked to the bin that the ray came from.
#ifndef GLEANER_KERNELS_LINKS_LOBES_H
#define GLEANER_KERNELS_LINKS_LOBES_H

#include "kernels/links/concentric.h"
#include "kernels/links/mesh.h"
#include "kernels/rough_metal.h"

// Whether an element is one of a lobe; then whose, and which bin.
FN int is_lobe(const Mesh* mesh, uint element) {
#ifdef LINKS_LOBES
  return element >= mesh->elements;
#else
  return 0;
#endif
}
FN uint owner_of(const Mesh* mesh, global const uint* lobes, uint element) {
  return is_lobe(mesh, element) ? lobes[mesh->elements + (element - mesh->elements) / LOBE_BINS] : element;
}
FN uint bin_of(const Mesh* mesh, uint element) {
  return is_lobe(mesh, element) ? (element - mesh->elements) % LOBE_BINS : 0u;
}

#ifdef LINKS_LOBES
// The element's surface about a point, seen from a direction of the bin: `u0`, `u1` say which.
FN Vertex lobe_surface(const Scene* scene, const RingPoint* at, uint owner, uint bin, vf u0, vf u1, vi active) {
  Vertex v = element_hit(scene, at, active), along = v;
  prepare_scattering(scene, &along, against_normal(&v.hit, owner));
  vf x = ((vf)(float)(bin % LOBE_SIDE) + u0) * (vf)(1.0f / LOBE_SIDE);
  vf y = ((vf)(float)(bin / LOBE_SIDE) + u1) * (vf)(1.0f / LOBE_SIDE);
  prepare_scattering(scene, &v, negate3(from_frame(&along.frame, concentric_direction(x, y))));
  // Bent normals may have it below the surface.
  v.active = v.active & none(v.frame.from_back ^ along.frame.from_back) & is_rough_metal(&v.surface);
  return v;
}

// The bin that a surface is seen from, for a piecewise linear look: the direction is moved by up to half a bin.
FN vu seen_bin(const Vertex* v, v3 direction) {
  vf x, y;
  concentric_square(v->frame.view, &x, &y);
  vu key = hash_combine(as_vu(direction.x), as_vu(direction.y));
  x = fma(x, (vf)(float)LOBE_SIDE, unit_float(hash_combine(key, (vu)1u)) - (vf)0.5f);
  y = fma(y, (vf)(float)LOBE_SIDE, unit_float(hash_combine(key, (vu)2u)) - (vf)0.5f);
  vf most = (vf)(LOBE_SIDE - 0.5f);
  return to_u(clamp_f(y, zero_f(), most)) * LOBE_SIDE + to_u(clamp_f(x, zero_f(), most));
}

FN vf lobe_luminance(v3 c) { return c.x * 0.2126f + c.y * 0.7152f + c.z * 0.0722f; }

// The lobe's part of eval_bsdf().
FN v3 eval_lobe(const Scene* scene, const Surface* m, v3 view, v3 l) {
  vf unused;
  v3 lobe = sub3(eval_bsdf(scene, m, view, l, &unused), eval_layer(scene, m, l.z));
  return make3(max_f(lobe.x, zero_f()), max_f(lobe.y, zero_f()), max_f(lobe.z, zero_f()));
}

// A direction of light that the lobe sends to the viewer, and the share of it that it sends; 0 below the surface.
typedef struct {
  v3 above;   // local
  v3 weight;  // RGB
} LobeSample;

FN LobeSample sample_lobe(const Scene* scene, const Vertex* v, vf u0, vf u1) {
  LobeSample s;
  v3 view = v->frame.view;
  v3 h = sample_lobe_normal(&v->surface, view, u0, u1);
  s.above = sub3(scale3(h, 2.0f * dot3(view, h)), view);
  vi up = v->active & (s.above.z > (vf)1e-6f);
  s.above = pick3(uniform3(0.0f, 0.0f, 1.0f), s.above, up);
  LobeTerms g = lobe_terms(&v->surface, view, s.above, h, all_lanes());
  v3 weight = scale3(eval_lobe(scene, &v->surface, view, s.above), 2.0f * g.gv / g.d);
  s.weight = pick3(splat3(zero_f()), weight, up);
  return s;
}
#endif

#endif
