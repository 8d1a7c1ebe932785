// Layers above the metallic-roughness material: a clear coat (KHR_materials_clearcoat: GGX of index 1.5, with a normal
// of its own) over sheen (KHR_materials_sheen: the "Charlie" lobe of Conty & Kulla 2017). Both take from all that lies
// below what they reflect themselves, reciprocally: min(1 - w E(n.v), 1 - w E(n.l)), as Conty & Kulla scale albedos.
// The diffuse layer has a table of what all lobes above leave to it (Material::albedo_table), so that white stays
// white. They lie on what does not transmit; virtual point lights know nothing of them but that table.
#ifndef GLEANER_KERNELS_BSDF_LAYERS_H
#define GLEANER_KERNELS_BSDF_LAYERS_H

#include "kernels/bsdf/albedo_tables.h"

#ifdef NEED_LAYERS

#ifdef NEED_CLEARCOAT

#define COAT_F0 0.04f

FN vf coat_fresnel(vf cosine) {
  return fma(pow5(max_f(one_f() - fabs(cosine), zero_f())), (vf)(1.0f - COAT_F0), (vf)COAT_F0);
}

// What the coat leaves to what lies below it, at a cosine to its normal.
FN vf left_by_coat(const Scene* scene, const Surface* m, vf mu) {
  vi has = m->coat > zero_f();
  vf left = table_lookup(scene, pick_u((vu)0u, m->coat_table, has), pick(zero_f(), m->coat_row, has), mu);
  return pick(one_f(), fma(left - one_f(), m->coat, one_f()), has);
}

// BSDF times the cosine to the coat's own normal; 0 of a coat that is a mirror. *pdf: of sample_coat().
FN vf eval_coat(const Surface* m, v3 v, v3 l, vf* pdf) {
  v3 n = m->coat_normal, h = normalize3(add3(v, l));
  vf nv = dot3(n, v), nl = dot3(n, l), nh = dot3(n, h);
  vi rough = (m->coat > zero_f()) & none(m->coat_mirror) & (nl > (vf)1e-6f);
  vf a2 = pick(one_f(), m->coat_alpha * m->coat_alpha, rough);
  v3 across = cross3(n, h);
  vf t = dot3(across, across) / a2 + nh * nh;
  vf d = INV_PI / (a2 * t * t);
  vf gv = nv + sqrt(fma(one_f() - a2, nv * nv, a2));
  vf gl = nl + sqrt(fma(one_f() - a2, nl * nl, a2));
  *pdf = pick(zero_f(), d / (2.0f * gv), rough);
  return pick(zero_f(), m->coat * coat_fresnel(dot3(v, h)) * nl * d / (gv * gl), rough);
}

// A direction by the coat's visible normals, local; *weight: of a mirror, before its chance.
FN v3 sample_coat(const Surface* m, v3 v, vf u0, vf u1, vf* weight) {
  v3 n = m->coat_normal, s, t;
  basis3(n, &s, &t);
  vf alpha = pick(m->coat_alpha, zero_f(), m->coat_mirror);
  v3 h = sample_visible_normal(make3(dot3(s, v), dot3(t, v), dot3(n, v)), alpha, alpha, u0, u1);
  h = add3(add3(scale3(s, h.x), scale3(t, h.y)), scale3(n, h.z));
  h = pick3(h, n, m->coat_mirror);
  vf vh = dot3(v, h);
  v3 l = sub3(scale3(h, 2.0f * vh), v);
#ifdef NEED_NORMAL_MAPS
  // What a bent mirror sends below the horizon is turned to it.
  v3 level = normalize3(make3(l.x, l.y, (vf)1e-3f));
  l = pick3(l, level, m->coat_mirror & (l.z < (vf)1e-3f));
#endif
  *weight = m->coat * coat_fresnel(vh);
  return l;
}

#endif

#ifdef NEED_SHEEN

// Shadowing of fibres, fitted by Conty & Kulla (their L(x) and its symmetric continuation).
FN vf sheen_fit(vf x, vf k) {
  vf a = mix((vf)21.5473f, (vf)25.3245f, k), b = mix((vf)3.82987f, (vf)3.32435f, k);
  vf c = mix((vf)0.19823f, (vf)0.16801f, k), d = mix((vf)-1.97760f, (vf)-1.27393f, k);
  vf e = mix((vf)-4.32054f, (vf)-4.85967f, k);
  return a / (one_f() + b * pow(x, c)) + d * x + e;
}
FN vf sheen_lambda(vf cosine, vf alpha) {
  vf k = (one_f() - alpha) * (one_f() - alpha);
  vi low = cosine < (vf)0.5f;
  vf fit = sheen_fit(pick(one_f() - cosine, cosine, low), k);
  return exp(pick(2.0f * sheen_fit((vf)0.5f, k) - fit, fit, low));
}

// Directional albedo of white sheen as the lobe stands; narrow lobes have more than 1 at grazing angles.
FN vf sheen_albedo(const Scene* scene, const Surface* m, vf mu) {
  vi has = m->sheen_most > zero_f();
  vf left = table_lookup(scene, pick_u((vu)0u, m->sheen_table, has), pick(zero_f(), m->sheen_row, has), mu);
  return pick(zero_f(), (one_f() - left) * (vf)GLEANER_SHEEN_SCALE, has);
}
FN vf left_by_sheen(const Surface* m, vf albedo) { return one_f() - m->sheen_most * min_f(albedo, one_f()); }

// BSDF of white sheen times n.l. `albedo_v`, `albedo_l`: its albedos at the two cosines; what exceeds 1 is taken off.
FN vf eval_sheen(const Surface* m, v3 v, v3 l, vf albedo_v, vf albedo_l) {
  v3 h = normalize3(add3(v, l));
  vf inverse = one_f() / m->sheen_alpha;
  vf d = (2.0f + inverse) * pow(min_f(h.x * h.x + h.y * h.y, one_f()), 0.5f * inverse) * (vf)(0.5f * INV_PI);
  vf masking = one_f() + sheen_lambda(v.z, m->sheen_alpha) + sheen_lambda(min_f(l.z, one_f()), m->sheen_alpha);
  return d / (4.0f * v.z * masking * max_f(max_f(albedo_v, albedo_l), one_f()));
}

FN v3 sample_hemisphere(vf u0, vf u1) {
  vf s, c;
  sincos_2pi(u0, &s, &c);
  vf r = safe_sqrt(one_f() - u1 * u1);
  return make3(r * c, r * s, u1);
}
#define HEMISPHERE_PDF (0.5f * INV_PI)

#endif

// What the layers above do with light between two directions, v.z and l.z > 0.
typedef struct {
  v3 value;      // BSDF times cosine of what they reflect
  vf pdf;        // of their share of sample_bsdf()'s lobes
  vf left;       // what they leave to the lobe below
  vf left_bent;  // what a bent coat takes from the diffuse layer beyond its table
} Layers;

OUTLINED Layers eval_layers(const Scene* scene, const Surface* m, v3 v, v3 l) {
  Layers r;
  r.value = splat3(zero_f());
  r.pdf = zero_f();
  r.left = one_f();
  r.left_bent = one_f();
#ifdef NEED_CLEARCOAT
  if (any_lane(m->coat > zero_f())) {
    vf pdf;
    r.value = splat3(eval_coat(m, v, l, &pdf));
    r.pdf = m->coat_chance * pdf;
    vf left_l = left_by_coat(scene, m, fabs(dot3(m->coat_normal, l)));
    r.left = min_f(m->coat_left_view, left_l);
#ifdef NEED_NORMAL_MAPS
    if (any_lane(m->coat_bent)) {
      // The table is for the base's cosines.
      vf more_v = m->coat_left_view / left_by_coat(scene, m, v.z), more_l = left_l / left_by_coat(scene, m, l.z);
      r.left_bent = pick(one_f(), min_f(more_v, one_f()) * min_f(more_l, one_f()), m->coat_bent);
    }
#endif
  }
#endif
#ifdef NEED_SHEEN
  if (any_lane(m->sheen_most > zero_f())) {
    vf albedo = sheen_albedo(scene, m, l.z);
    vf white = pick(zero_f(), eval_sheen(m, v, l, m->sheen_albedo_view, albedo), m->sheen_most > zero_f());
    r.value = mad3(m->sheen, white * r.left, r.value);
    r.pdf = fma(m->sheen_chance, (vf)HEMISPHERE_PDF, r.pdf);
    r.left *= min_f(left_by_sheen(m, m->sheen_albedo_view), left_by_sheen(m, albedo));
  }
#endif
  return r;
}

// After orient_layers() (kernels/surface.h), before prepare_lobe().
FN void prepare_layers(const Scene* scene, Surface* m, v3 v) {
#ifdef NEED_CLEARCOAT
#ifdef NEED_NORMAL_MAPS
  // As shading_frame() does with the base's: a normal that faces away is seen at grazing incidence.
  vf facing = dot3(m->coat_normal, v);
  v3 turned = normalize3(mad3(v, (vf)1e-3f - facing, m->coat_normal));
  m->coat_normal = pick3(m->coat_normal, turned, facing < (vf)1e-3f);
#endif
  m->coat_left_view = left_by_coat(scene, m, fabs(dot3(m->coat_normal, v)));
  m->coat_mirror = m->coat_alpha < (vf)1e-10f;
#endif
#ifdef NEED_SHEEN
  m->sheen_albedo_view = sheen_albedo(scene, m, v.z);
#endif
}

// Deals the samples of the lobes out to coat, sheen and the lobe itself. `lobe`: what the lobe sends this way, before
// the layers above; `has_lobe`: lanes that have one. Returns what all of them send together.
FN vf share_lobes(Surface* m, vf lobe, vi has_lobe) {
  vf coat = zero_f(), sheen = zero_f(), left = one_f();
#ifdef NEED_CLEARCOAT
  coat = one_f() - m->coat_left_view;
  left = m->coat_left_view;
#endif
#ifdef NEED_SHEEN
  vf below = left_by_sheen(m, m->sheen_albedo_view);
  sheen = left * (one_f() - below);
  left *= below;
#endif
  lobe *= left;
  vf all = lobe + coat + sheen, least = 0.1f * all, sum = zero_f();
  lobe = pick(zero_f(), max_f(lobe, least), has_lobe);
  sum = lobe;
#ifdef NEED_CLEARCOAT
  coat = pick(zero_f(), max_f(coat, least), m->coat > zero_f());
  sum += coat;
#endif
#ifdef NEED_SHEEN
  sheen = pick(zero_f(), max_f(sheen, least), m->sheen_most > zero_f());
  sum += sheen;
#endif
  vf scale = pick(zero_f(), one_f() / sum, sum > zero_f());
  m->base_chance = lobe * scale;
#ifdef NEED_CLEARCOAT
  m->coat_chance = coat * scale;
#endif
#ifdef NEED_SHEEN
  m->sheen_chance = sheen * scale;
#endif
  return all;
}

#endif

#endif
