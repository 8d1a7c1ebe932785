// Glass: exact Fresnel, smooth or GGX (Walter et al. 2007), solid or a thin sheet.
#ifndef GLEANER_KERNELS_BSDF_GLASS_H
#define GLEANER_KERNELS_BSDF_GLASS_H

#include "kernels/bsdf/point.h"

// Exact unpolarized Fresnel reflectance from cos_i > 0 with eta = n_t / n_i; cos_t = 0 on total reflection.
FN vf fresnel_dielectric(vf cos_i, vf eta, vf* cos_t) {
  vf sin2_t = (one_f() - cos_i * cos_i) / (eta * eta);
  vi total = sin2_t >= one_f();
  vf ct = safe_sqrt(one_f() - sin2_t);
  vf rs = (cos_i - eta * ct) / (cos_i + eta * ct);
  vf rp = (eta * cos_i - ct) / (eta * cos_i + ct);
  *cos_t = pick(ct, zero_f(), total);
  return pick(0.5f * (rs * rs + rp * rp), one_f(), total);
}

#ifdef NEED_TRANSMISSIVE
// Reflectance of glass at half-vector cosine vh > 0; cos_t as in fresnel_dielectric(). A thin sheet sums its inner
// reflections: 2 F / (1 + F), so that (1 - F) / (1 + F) goes on.
FN vf glass_fresnel(const Surface* m, vf vh, vf* cos_t) {
  vf fresnel = fresnel_dielectric(min_f(vh, one_f()), m->eta, cos_t);
  return pick(2.0f * fresnel / (one_f() + fresnel), fresnel, m->solid);
}
#endif

#ifdef NEED_MEDIA
// Does the surface bound a solid and yet bend nothing: hidden, or between equals?
FN vi bends_nothing(const Surface* m) { return m->hidden | (m->solid & (m->eta == one_f())); }
#endif

#ifdef NEED_ROUGH_TRANSMISSIVE
// Rough glass in the directions v and l, v.z > 0, l on either side: BSDF times |n.l| and the density with which
// sample_bsdf() takes l once it has chosen glass; 0 in lanes of other glass. A thin sheet transmits the lobe that it
// reflects, flipped to the other side.
FN v3 eval_glass(const Surface* m, v3 v, v3 l, vf* pdf) {
  vi above = l.z > zero_f();
  v3 across = make3(l.x, l.y, fabs(l.z));
  vf eta = pick(one_f(), m->eta, none(above) & m->solid);
  // The half-vector: between v and l, of refraction along v + eta l (Walter et al. 2007, eq. 16).
  v3 h = add3(v, scale3(pick3(across, l, m->solid), eta));
  h = normalize3(pick3(h, negate3(h), h.z < zero_f()));
  vf vh = dot3(v, h), lh = dot3(pick3(across, l, m->solid), h);
  vi valid = m->blurs & (vh > zero_f()) & ((lh < zero_f()) == (m->solid & none(above))) & (fabs(l.z) > (vf)1e-6f);
  vf unused;
  vf fresnel = glass_fresnel(m, max_f(vh, zero_f()), &unused);
  vf a2 = pick(one_f(), m->alpha * m->alpha, m->blurs);
  vf t = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
  vf d = INV_PI / (a2 * t * t);
  vf gv = v.z + sqrt(fma(one_f() - a2, v.z * v.z, a2));
  vf nl = fabs(l.z);
  vf masking = 2.0f * nl / (nl + sqrt(fma(one_f() - a2, nl * nl, a2)));
  // Density of the half-vector, D G1(v) v.h / v.z, times its change with l: 1 / (4 v.h) of a reflection,
  // eta^2 |l.h| / (v.h + eta l.h)^2 of a refraction (eq. 17).
  vf sum = fma(eta, lh, vh);
  vf refraction = 2.0f * d / gv * vh * eta * eta * fabs(lh) / (sum * sum);
  vf density = pick(d / (2.0f * gv), refraction, none(above) & m->solid);
  density *= pick(one_f() - fresnel, fresnel, above);
  valid = valid & finite_f(density);
  *pdf = pick(zero_f(), density, valid);
  // Radiance is squeezed into a smaller solid angle on its way into the denser side: (n_i / n_t)^2.
  v3 weight = pick3(scale3(m->base, one_f() / (eta * eta)), splat3(one_f()), above);
  return scale3(weight, *pdf * masking);
}
#endif

#ifdef NEED_TRANSMISSIVE
// Makes of the sample, in `glass` lanes, one of glass.
OUTLINED void sample_glass(const Surface* m, v3 v, vf u_lobe, vf u0, vf u1, vi glass, BsdfSample* b) {
  v3 h = uniform3(0.0f, 0.0f, 1.0f);
#ifdef NEED_ROUGH_TRANSMISSIVE
  vf glass_alpha = pick(one_f(), m->alpha, m->blurs);
  h = pick3(h, sample_visible_normal(v, glass_alpha, glass_alpha, u0, u1), m->blurs);
#endif
  vf eta = m->eta;
  vf vh = dot3(v, h);
  vf ct;
  vf fresnel = glass_fresnel(m, vh, &ct);
  vi reflected = u_lobe < fresnel;
#ifdef NEED_MEDIA
  vi unbent = bends_nothing(m);
  reflected = reflected & none(unbent);
#endif
  v3 mirror = sub3(scale3(h, 2.0f * vh), v);
  v3 refracted = sub3(scale3(h, vh / eta - ct), scale3(v, one_f() / eta));
  refracted = pick3(negate3(v), refracted, m->solid);
#ifdef NEED_ROUGH_TRANSMISSIVE
  refracted = pick3(refracted, make3(mirror.x, mirror.y, -mirror.z), m->blurs & none(m->solid));
#endif
  v3 direction = pick3(refracted, mirror, reflected);
  // Radiance is squeezed into a smaller solid angle on its way into the denser side: (n_i / n_t)^2.
  vf squeeze = pick(one_f(), one_f() / (eta * eta), m->solid);
  v3 weight = pick3(scale3(m->base, squeeze), splat3(one_f()), reflected);
  vf masking = one_f();
#ifdef NEED_ROUGH_TRANSMISSIVE
  {
    vf nl = fabs(direction.z);
    vf a2 = m->alpha * m->alpha;
    masking = pick(one_f(), 2.0f * nl / (nl + sqrt(fma(one_f() - a2, nl * nl, a2))), m->blurs);
    vi wrong_side = pick(direction.z, -direction.z, reflected) > (vf)-1e-6f;
    masking = pick(masking, zero_f(), m->blurs & wrong_side);
  }
#endif
#ifdef NEED_MEDIA
  direction = pick3(direction, negate3(v), unbent);
  weight = pick3(weight, pick3(m->base, splat3(one_f()), m->hidden), unbent);
  eta = pick(eta, one_f(), unbent);
#endif
  b->direction = pick3(b->direction, direction, glass);
  b->weight = pick3(b->weight, scale3(weight, masking), glass);
  b->pdf = pick(b->pdf, zero_f(), glass);
  vi refracts = glass & none(reflected) & m->solid;
  b->crosses = b->crosses | refracts;
  b->eta = pick(b->eta, eta, refracts);
  b->straight = glass & none(reflected) & none(m->solid | m->blurs);
#ifdef NEED_MEDIA
  b->straight = b->straight | (glass & unbent);
#endif
}
#endif

#endif
