// What does not transmit: the diffuse layer under the lobe, and all that lies on both.
#ifndef GLEANER_KERNELS_BSDF_OPAQUE_H
#define GLEANER_KERNELS_BSDF_OPAQUE_H

#include "kernels/bsdf/lobe.h"

// BSDF times n.l and the solid-angle density of sample_bsdf() for local directions on the same side (v.z, l.z > 0).
// A perfect mirror lobe and glass count as zero here.
OUTLINED v3 eval_bsdf(const Scene* scene, const Surface* m, v3 v, v3 l, vf* pdf) {
  vf nl = l.z;
  vf diffuse_pdf = nl * INV_PI;
#ifdef NEED_DIFFUSE_TRANSMISSION
  diffuse_pdf *= m->layer_kept;
#endif
#ifdef NEED_LOBE
  vf layer = m->left_view * left_to_layer(scene, m, nl) * (one_f() - m->metallic) / m->left_mean;
#ifdef NEED_DIFFUSE_TRANSMISSION
  layer *= m->layer_kept;
#endif
  vf lobe_chance = m->lobe_share;
#ifdef NEED_LAYERS
  Layers above = eval_layers(scene, m, v, l);
  layer *= above.left_bent;
  lobe_chance *= m->base_chance;
#endif
  v3 f = scale3(m->base, layer * INV_PI);
  vf p = (one_f() - m->lobe_share) * diffuse_pdf;
  vi rough = none(m->mirror) & (lobe_chance > zero_f());
  if (any_lane(rough)) {
    v3 h = normalize3(add3(v, l));
    LobeTerms g = lobe_terms(m, v, l, h, rough);
    v3 lobe = scale3(lobe_fresnel(m, dot3(v, h)), g.d / (g.gv * g.gl));
#ifdef NEED_LAYERS
    lobe = scale3(lobe, above.left);
#endif
    f = pick3(f, add3(f, lobe), rough);
    // Visible-normal sampling: D G1(v) / (4 v.z) = D / (2 gv).
    p += pick(zero_f(), lobe_chance * g.d / (2.0f * g.gv), rough);
  }
#ifdef NEED_LAYERS
  p = fma(m->lobe_share, above.pdf, p);
  *pdf = p;
  return add3(scale3(f, nl), above.value);
#else
  *pdf = p;
  return scale3(f, nl);
#endif
#else
  *pdf = diffuse_pdf;
  return scale3(m->base, diffuse_pdf);
#endif
}

// The part of eval_bsdf() that the diffuse layer scatters, where it is plain.
FN v3 eval_layer(const Scene* scene, const Surface* m, vf nl) {
#ifdef NEED_LOBE
  vf layer = m->left_view * left_to_layer(scene, m, nl) * (one_f() - m->metallic) / m->left_mean;
#ifdef NEED_LAYERS
  layer = pick(zero_f(), layer, has_plain_layer(m));
#endif
  return scale3(m->base, layer * nl * INV_PI);
#else
  return scale3(m->base, nl * INV_PI);
#endif
}

// The diffuse layer's colour as seen from the prepared lobe's view: eval_layer() without what the lobe leaves to it at
// the light's angle, times pi over its cosine.
FN v3 layer_albedo(const Surface* m) {
#ifdef NEED_LOBE
  v3 albedo = scale3(m->base, m->left_view * (one_f() - m->metallic) / m->left_mean);
#ifdef NEED_LAYERS
  albedo = pick3(splat3(zero_f()), albedo, has_plain_layer(m));
#endif
  return albedo;
#else
  return m->base;
#endif
}

// A sample of the opaque surface. *by_lobe: lanes that the lobe sends, or a layer above it; *mirrored: of these, lanes
// that a perfect mirror sends.
OUTLINED BsdfSample sample_opaque(const Scene* scene, const Surface* m, v3 v, vf u_lobe, vf u0, vf u1, vi* by_lobe,
                                  vi* mirrored_lanes) {
  BsdfSample b;
  b.eta = one_f();
  b.straight = no_lanes();
  b.crosses = no_lanes();
  b.direction = sample_cosine(u0, u1);
  *by_lobe = no_lanes();
  *mirrored_lanes = no_lanes();
#ifdef NEED_LOBE
  vi specular = u_lobe < m->lobe_share;
  if (any_lane(specular)) {
    v3 h = sample_lobe_normal(m, v, u0, u1);
    h = pick3(h, uniform3(0.0f, 0.0f, 1.0f), m->mirror);
    vf vh = dot3(v, h);
    v3 r = sub3(scale3(h, 2.0f * vh), v);
    b.direction = pick3(b.direction, r, specular);
  }
  vi mirrored = specular & m->mirror;
#ifdef NEED_LAYERS
  vf u_layer = u_lobe / m->lobe_share, taken = zero_f();
#ifdef NEED_CLEARCOAT
  vi by_coat = specular & (u_layer < m->coat_chance);
  taken = m->coat_chance;
  vf coat_weight = zero_f();
  if (any_lane(by_coat)) b.direction = pick3(b.direction, sample_coat(m, v, u0, u1, &coat_weight), by_coat);
  mirrored = mirrored & none(by_coat);
#endif
#ifdef NEED_SHEEN
  vi by_sheen = specular & (u_layer >= taken) & (u_layer < taken + m->sheen_chance);
  b.direction = pick3(b.direction, sample_hemisphere(u0, u1), by_sheen);
  mirrored = mirrored & none(by_sheen);
#endif
#endif
  vf pdf;
  v3 f = eval_bsdf(scene, m, v, b.direction, &pdf);
  vi ok = (b.direction.z > (vf)1e-6f) & (pdf > zero_f());
  b.weight = pick3(splat3(zero_f()), scale3(f, one_f() / pdf), ok);
  b.pdf = pick(zero_f(), pdf, ok);
#ifdef NEED_LAYERS
  if (any_lane(mirrored)) {
    vf left = eval_layers(scene, m, v, make3(-v.x, -v.y, v.z)).left;
    b.weight = pick3(b.weight, scale3(lobe_fresnel(m, v.z), left / (m->lobe_share * m->base_chance)), mirrored);
  }
#ifdef NEED_CLEARCOAT
  vi coat_mirrored = by_coat & m->coat_mirror;
  b.weight = pick3(b.weight, splat3(coat_weight / (m->lobe_share * m->coat_chance)), coat_mirrored);
  mirrored = mirrored | coat_mirrored;
#endif
#else
  b.weight = pick3(b.weight, scale3(lobe_fresnel(m, v.z), one_f() / m->lobe_share), mirrored);
#endif
  b.pdf = pick(b.pdf, zero_f(), mirrored);
  *by_lobe = specular;
  *mirrored_lanes = mirrored;
#else
  b.pdf = b.direction.z * INV_PI;
  b.weight = pick3(splat3(zero_f()), m->base, b.direction.z > (vf)1e-6f);
#endif
  return b;
}

#endif
