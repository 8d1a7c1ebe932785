// The specular lobe: GGX with separable Smith masking and Schlick's Fresnel, smooth or rough, plain or under a film,
// with a grain or without.
#ifndef GLEANER_KERNELS_BSDF_LOBE_H
#define GLEANER_KERNELS_BSDF_LOBE_H

#include "kernels/bsdf/layers.h"
#include "kernels/lobe_rows.h"
#ifdef NEED_IRIDESCENCE
#include "kernels/bsdf/thin_film.h"
#endif

#ifdef NEED_LOBE

// Colour of the specular lobe at half-vector cosine vh: dielectric and metal mixed linearly.
FN v3 lobe_fresnel(const Surface* m, vf vh) {
  vf s = pow5(max_f(one_f() - fabs(vh), zero_f()));
  vf dielectric = m->specular * (one_f() - m->metallic);
  v3 fd =
      make3(fma(one_f() - m->f0.x, s, m->f0.x), fma(one_f() - m->f0.y, s, m->f0.y), fma(one_f() - m->f0.z, s, m->f0.z));
  v3 fm = make3(fma(one_f() - m->base.x, s, m->base.x), fma(one_f() - m->base.y, s, m->base.y),
                fma(one_f() - m->base.z, s, m->base.z));
#ifdef NEED_IRIDESCENCE
  if (any_lane(m->film > zero_f())) {
    vf mu = fabs(vh);
    fd = mad3(sub3(thin_film(mu, m->film_ior, m->film_thickness, m->f0), fd), m->film, fd);
#ifdef NEED_METALLIC
    if (any_lane(m->metallic > zero_f()))
      fm = mad3(sub3(thin_film(mu, m->film_ior, m->film_thickness, m->base), fm), m->film, fm);
#endif
  }
#endif
  return mad3(fm, m->metallic, scale3(fd, dielectric));
}

// --- Rough lobes: those that virtual point lights may stand in for ---

// The lobe's colours: f0 at normal incidence, f90 at grazing incidence (lobe_fresnel()).
FN v3 lobe_f0(const Surface* m) {
  return mad3(m->base, m->metallic, scale3(m->f0, m->specular * (one_f() - m->metallic)));
}
FN vf lobe_f90(const Surface* m) { return m->metallic + m->specular * (one_f() - m->metallic); }

FN v3 schlick(v3 f0, vf f90, vf cosine) {
  vf s = pow5(max_f(one_f() - fabs(cosine), zero_f()));
  return make3(fma(f90 - f0.x, s, f0.x), fma(f90 - f0.y, s, f0.y), fma(f90 - f0.z, s, f0.z));
}

// The lobe as in eval_bsdf(), without the cosine; in any frame, of unit vectors on the normal's side.
FN v3 rough_lobe(v3 f0, vf f90, vf alpha, v3 n, v3 v, v3 l) {
  v3 h = normalize3(add3(v, l));
  vf a2 = alpha * alpha, nh = dot3(n, h), nv = dot3(n, v), nl = dot3(n, l);
  vf t = (one_f() - nh * nh) / a2 + nh * nh;
  vf d = INV_PI / (a2 * t * t);
  vf gv = nv + sqrt(fma(one_f() - a2, nv * nv, a2));
  vf gl = nl + sqrt(fma(one_f() - a2, nl * nl, a2));
  return scale3(schlick(f0, f90, dot3(v, h)), d / (gv * gl));
}

// What a lobe sends in the mean over the hemisphere, roughly: its share of a light's flux is estimated by this.
FN v3 mean_lobe(v3 f0, vf f90, vf nv) { return scale3(schlick(f0, f90, nv), (vf)INV_PI); }

// How many times as bright as a white diffuse surface a lobe may make a light: the geometry term's bound is on the
// product with it, of both ends.
FN vf lobe_gain(v3 lobe) {
  return one_f() + (lobe.x * 0.2126f + lobe.y * 0.7152f + lobe.z * 0.0722f) * (vf)3.14159265358979324f;
}

// What does not depend on the outgoing direction; nv > 0.
FN void prepare_lobe(const Scene* scene, Surface* m, vf nv) {
  m->left_view = left_to_layer(scene, m, nv);
  m->left_mean = left_mean_of(scene, m);
  vi has = (m->metallic > zero_f()) | (m->specular > zero_f());
  vf s = max_component(lobe_fresnel(m, nv));
#ifdef NEED_LAYERS
  vi has_lobe = has;
  s = share_lobes(m, s, has_lobe);
#ifdef NEED_CLEARCOAT
  has = has | (m->coat > zero_f());
#endif
#ifdef NEED_SHEEN
  has = has | (m->sheen_most > zero_f());
#endif
#endif
  vf color = max_component(m->base);
#ifdef NEED_DIFFUSE_TRANSMISSION
  color = max_f(color, pick(zero_f(), max_component(m->shining_color), m->shining > zero_f()));
#endif
  vf d = color * m->left_view * (one_f() - m->metallic);
  vf share = clamp_f(s / max_f(s + d, (vf)1e-6f), (vf)0.1f, (vf)0.9f);
  share = pick(share, one_f(), m->metallic >= one_f());
  m->lobe_share = pick(zero_f(), share, has);
  // Of a roughness below 1e-5 the densities soon leave the range of float, and no picture shows it.
#ifdef NEED_LAYERS
  m->mirror = has_lobe & (m->alpha2 < (vf)1e-20f);
#else
  m->mirror = has & (m->alpha2 < (vf)1e-20f);
#endif
}

// After prepare_lobe(). Virtual point lights know the plain lobe alone: not under layers or a film, nor with a grain.
FN vi has_rough_lobe(const Surface* m) {
  vi rough = (m->lobe_share > zero_f()) & (m->alpha >= (vf)ROUGH_LOBE_ALPHA);
#ifdef NEED_CLEARCOAT
  rough = rough & none(m->coat > zero_f());
#endif
#ifdef NEED_SHEEN
  rough = rough & none(m->sheen_most > zero_f());
#endif
#ifdef NEED_IRIDESCENCE
  rough = rough & none(m->film > zero_f());
#endif
#ifdef NEED_ANISOTROPY
  rough = rough & (m->alpha_along == m->alpha);
#endif
  return rough;
}

// A surface that is nothing but a perfect mirror.
FN vi is_bare_mirror(const Surface* m) {
  vi bare = m->mirror & (m->lobe_share >= one_f());
#ifdef NEED_CLEARCOAT
  bare = bare & ((m->coat <= zero_f()) | m->coat_mirror);
#endif
#ifdef NEED_SHEEN
  bare = bare & (m->sheen_most <= zero_f());
#endif
  return bare;
}

// Is the diffuse layer one that virtual point lights can stand for? What a bent coat leaves to it no table tells.
FN vi has_plain_layer(const Surface* m) {
#if defined(NEED_CLEARCOAT) && defined(NEED_NORMAL_MAPS)
  return none(m->coat_bent);
#else
  return all_lanes();
#endif
}

// GGX in the directions v and l of half-vector h: the distribution, and of masking at each end n.x + sqrt(...).
typedef struct {
  vf d, gv, gl;
} LobeTerms;

FN LobeTerms lobe_terms(const Surface* m, v3 v, v3 l, v3 h, vi rough) {
  LobeTerms r;
#ifdef NEED_ANISOTROPY
  vf gx = m->grain_x, gy = m->grain_y;
  vf at = pick(one_f(), m->alpha_along, rough), ab = pick(one_f(), m->alpha, rough);
  vf ht = (h.x * gx + h.y * gy) / at, hb = (h.y * gx - h.x * gy) / ab;
  vf t = ht * ht + hb * hb + h.z * h.z;
  r.d = INV_PI / (at * ab * t * t);
  vf vt = at * (v.x * gx + v.y * gy), vb = ab * (v.y * gx - v.x * gy);
  vf lt = at * (l.x * gx + l.y * gy), lb = ab * (l.y * gx - l.x * gy);
  r.gv = v.z + sqrt(v.z * v.z + vt * vt + vb * vb);
  r.gl = l.z + sqrt(l.z * l.z + lt * lt + lb * lb);
#else
  vf a2 = pick(one_f(), m->alpha2, rough);
  vf t = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
  r.d = INV_PI / (a2 * t * t);
  r.gv = v.z + sqrt(fma(one_f() - a2, v.z * v.z, a2));
  r.gl = l.z + sqrt(fma(one_f() - a2, l.z * l.z, a2));
#endif
  return r;
}

FN v3 sample_lobe_normal(const Surface* m, v3 v, vf u0, vf u1) {
#ifdef NEED_ANISOTROPY
  vf gx = m->grain_x, gy = m->grain_y;
  v3 turned = make3(v.x * gx + v.y * gy, v.y * gx - v.x * gy, v.z);
  v3 h = sample_visible_normal(turned, m->alpha_along, m->alpha, u0, u1);
  return make3(h.x * gx - h.y * gy, h.x * gy + h.y * gx, h.z);
#else
  return sample_visible_normal(v, m->alpha, m->alpha, u0, u1);
#endif
}

#endif

#endif
