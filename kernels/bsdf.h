// The glTF 2.0 material: GGX with separable Smith masking and Schlick's Fresnel (appendix B), over a Lambert layer that
// gets what the specular lobe leaves, reciprocally: f_d = base/pi (1 - s E(n.v)) (1 - s E(n.l)) / (1 - s M), so that a
// white surface reflects exactly 1. Glass: exact Fresnel, smooth or GGX (Walter et al. 2007), solid or a thin sheet.
// Metal hides glass: of a surface's light, `metallic` meets metal, and of the rest `transmission` meets glass. The lobe
// may be longer one way (KHR_materials_anisotropy), lie under a thin film (kernels/thin_film.h), a coat or sheen
// (kernels/layers.h). Of a sheet that light shines through (KHR_materials_diffuse_transmission), a share has, under the
// same lobe, a layer that sends all light to the far side; it is chosen as glass is, and counts as glass for all that
// asks who carries which light. Local frames: z is the normal.
#ifndef GLEANER_KERNELS_BSDF_H
#define GLEANER_KERNELS_BSDF_H

#include "kernels/lobe_rows.h"
#include "kernels/sampling.h"
#include "kernels/scene_access.h"

#ifdef NEED_IRIDESCENCE
#include "kernels/thin_film.h"
#endif

#if defined(NEED_CLEARCOAT) || defined(NEED_SHEEN)
#define NEED_LAYERS
#endif
#if defined(NEED_SPECULAR) || defined(NEED_GLOSSY) || defined(NEED_METALLIC) || defined(NEED_LAYERS)
#define NEED_LOBE
#endif

// Normals for shading that differ from the triangles' own.
#if defined(NEED_SMOOTH_NORMALS) || defined(NEED_NORMAL_MAPS)
#define NEED_BENT_NORMALS
#endif

#define INV_PI 0.31830988618379067f

// What geometry leaves of light that a surface scatters back: gl and nl are its cosines to the triangle's normal and to
// that for shading, ng that between the two; lengths do not matter. Nothing comes from behind the triangle, and ever
// less towards its horizon, so that the terminator has no edge (Chiang et al. 2019, "Taming the shadow terminator").
// The paper's factor begins where gl < nl * ng, on half of every facet: a coarse sphere loses light all over. Ours
// begins at TERMINATOR_START of that, near the horizon alone.
#define TERMINATOR_START 0.5f
FN vf terminator(vf gl, vf nl, vf ng) {
  vf g = min_f(gl / (nl * ng) * (vf)(1.0f / TERMINATOR_START), one_f());
  return pick(zero_f(), g * fma(g, one_f() - g, one_f()), (gl > zero_f()) & (nl > zero_f()));
}

// A point's material, evaluated.
typedef struct {
  v3 base;
  vf opacity;
#ifdef NEED_LOBE
  vf metallic;
  vf specular;
  vf alpha2;  // roughness^4; 0 = a perfect mirror
  vf alpha;
  v3 f0;
  vu table;       // of what the lobe leaves to the layer below, or GLEANER_NONE
  vf table_row;   // fractional row
  vf left_view;   // 1 - s E(n.v)
  vf left_mean;   // 1 - s M
  vf lobe_share;  // chance that sampling takes the specular lobe, or one of the layers above it
  vi mirror;      // the lobe is
#ifdef NEED_ANISOTROPY
  vf alpha_along;       // of the lobe along the grain; `alpha` is across it
  vf grain_x, grain_y;  // the grain's direction, unit, in the local frame (orient_layers())
#endif
#ifdef NEED_IRIDESCENCE
  vf film, film_ior, film_thickness;  // share of the surface under a film; nm
#endif
#ifdef NEED_LAYERS
  vf base_chance;  // of lobe_share's samples, those that the lobe gets
#endif
#ifdef NEED_CLEARCOAT
  vf coat, coat_alpha;  // weight; roughness^2
  v3 coat_normal;       // local
  vu coat_table;
  vf coat_row, coat_left_view, coat_chance;
  vi coat_mirror;
#ifdef NEED_NORMAL_MAPS
  vi coat_bent;  // its normal differs from the base's
#endif
#endif
#ifdef NEED_SHEEN
  v3 sheen;
  vf sheen_most;  // its largest colour
  vf sheen_alpha;
  vu sheen_table;
  vf sheen_row, sheen_albedo_view, sheen_chance;
#endif
#endif
#ifdef NEED_TRANSMISSIVE
  vf transmission;  // share of the light that meets glass, metal taken off, or a layer that it shines through
  vf ior;
  vf eta;  // n_t / n_i for light that arrives on the ray's side
  vi solid;
  vi blurs;   // glass that scatters: not smooth
  vi hidden;  // glass within a solid of higher rank: as if it were not there
#if !defined(NEED_LOBE)
  vf alpha;
#endif
#endif
#ifdef NEED_DIFFUSE_TRANSMISSION
  vf shining;        // of `transmission`, the share of the layer that light shines through
  v3 shining_color;  // of that layer
  vf layer_kept;     // 1, or 0: eval_bsdf() leaves the diffuse layer out
#endif
} Surface;

// A visible normal of GGX (Dupuy & Benyoub 2023, spherical caps), v.z > 0.
FN v3 sample_visible_normal(v3 v, vf alpha_x, vf alpha_y, vf u0, vf u1) {
  v3 s = normalize3(make3(alpha_x * v.x, alpha_y * v.y, v.z));
  vf sp, cp;
  sincos_2pi(u0, &sp, &cp);
  vf z = fma(one_f() - u1, one_f() + s.z, -s.z);
  vf r = safe_sqrt(one_f() - z * z);
  v3 c = make3(fma(r, cp, s.x), fma(r, sp, s.y), z + s.z);
  return normalize3(make3(alpha_x * c.x, alpha_y * c.y, max_f(c.z, zero_f())));
}

#ifdef NEED_LOBE

FN vf pow5(vf x) {
  vf x2 = x * x;
  return x2 * x2 * x;
}

OUTLINED vf table_lookup(const Scene* scene, vu first, vf row, vf mu) {
  vf x = clamp_f(mu * (vf)(float)GLEANER_ALBEDO_NODES - 0.5f, zero_f(), (vf)(float)(GLEANER_ALBEDO_NODES - 1));
  vu i = min(to_u(x), (vu)(GLEANER_ALBEDO_NODES - 2u));
  vf t = x - to_f(i);
#ifdef NEED_MATERIAL_TEXTURES
  vu r = to_u(row);
  vf s = row - to_f(r);
  vu a = first + r * (GLEANER_ALBEDO_NODES + 1u) + i;
  vu b = pick_u(a, a + (GLEANER_ALBEDO_NODES + 1u), s > zero_f());
  vf lower = mix(gather_f(scene->albedo_tables, a), gather_f(scene->albedo_tables, a + 1u), t);
  vf upper = mix(gather_f(scene->albedo_tables, b), gather_f(scene->albedo_tables, b + 1u), t);
  return mix(lower, upper, s);
#else
  vu a = first + i;
  return mix(gather_f(scene->albedo_tables, a), gather_f(scene->albedo_tables, a + 1u), t);
#endif
}

// 1 - s E(mu): what the specular lobe leaves to the layer under it.
FN vf left_to_layer(const Scene* scene, const Surface* m, vf mu) {
  // Lanes without a table read the first row there is, whatever row they hold.
  vi has = m->table != GLEANER_NONE;
  vf row = pick(zero_f(), m->table_row, has);
  return pick(one_f(), table_lookup(scene, pick_u((vu)0u, m->table, has), row, mu), has);
}

FN vf left_mean_of(const Scene* scene, const Surface* m) {
  vi has = m->table != GLEANER_NONE;
  vu first = pick_u((vu)0u, m->table, has) + GLEANER_ALBEDO_NODES;
#ifdef NEED_MATERIAL_TEXTURES
  vf row = pick(zero_f(), m->table_row, has);
  vu r = to_u(row);
  vf s = row - to_f(r);
  vu a = first + r * (GLEANER_ALBEDO_NODES + 1u);
  vu b = pick_u(a, a + (GLEANER_ALBEDO_NODES + 1u), s > zero_f());
  vf mean = mix(gather_f(scene->albedo_tables, a), gather_f(scene->albedo_tables, b), s);
#else
  vf mean = gather_f(scene->albedo_tables, first);
#endif
  return pick(one_f(), mean, has);
}

#ifdef NEED_LAYERS
#include "kernels/layers.h"
#endif

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

typedef struct {
  v3 direction;  // local
  v3 weight;     // BSDF n.l / pdf
  vf pdf;        // per steradian; 0 = the direction was not drawn from a density that light sampling could share
  vf eta;        // n_t / n_i of a refraction, else 1
  vi straight;   // goes on as it came: through a smooth pane, or where glass bends nothing
  vi crosses;    // into a solid or out of it
} BsdfSample;

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

// Does glass scatter, or a layer let light shine through? Light samples find their way then.
FN vi scatters_through(const Surface* m) {
  vi scatters = no_lanes();
#ifdef NEED_ROUGH_TRANSMISSIVE
  scatters = m->blurs;
#endif
#ifdef NEED_DIFFUSE_TRANSMISSION
  scatters = scatters | (m->shining > zero_f());
#endif
  return scatters;
}

#ifdef NEED_DIFFUSE_TRANSMISSION
// The layer that light shines through, under the lobe and all that lies on it: BSDF times |n.l| towards the mirror
// image of `across` below the surface (across.z > 0), and the density with which sample_shining() takes it.
FN v3 eval_shining_layer(const Scene* scene, const Surface* m, v3 v, v3 across, vf* pdf) {
  vf cosine = across.z * INV_PI;
  *pdf = cosine;
#ifdef NEED_LOBE
  cosine *= m->left_view * left_to_layer(scene, m, across.z) * (one_f() - m->metallic) / m->left_mean;
#ifdef NEED_LAYERS
  cosine *= eval_layers(scene, m, v, across).left_bent;
#endif
  *pdf *= one_f() - m->lobe_share;
#endif
  return scale3(m->shining_color, cosine);
}

// What lies above the layer, which reflects alone.
FN v3 eval_above_shining(const Scene* scene, const Surface* m, v3 v, v3 l, vf* pdf) {
  Surface lobes = *m;
  lobes.layer_kept = zero_f();
  return eval_bsdf(scene, &lobes, v, l, pdf);
}
#endif

#ifdef NEED_ROUGH_TRANSMISSIVE
// Rough glass and the layer that light shines through, in the proportion in which they are there; else as eval_glass().
OUTLINED v3 eval_transmissive(const Scene* scene, const Surface* m, v3 v, v3 l, vf* pdf) {
  v3 f = eval_glass(m, v, l, pdf);
#ifdef NEED_DIFFUSE_TRANSMISSION
  if (any_lane(m->shining > zero_f())) {
    vi above = l.z > zero_f();
    v3 across = make3(l.x, l.y, max_f(fabs(l.z), (vf)1e-6f));
    vf pdf_above, pdf_below;
    v3 reflected = eval_above_shining(scene, m, v, across, &pdf_above);
    v3 shining = pick3(eval_shining_layer(scene, m, v, across, &pdf_below), reflected, above);
    f = mad3(shining, m->shining, scale3(f, one_f() - m->shining));
    *pdf = mix(*pdf, pick(pdf_below, pdf_above, above), m->shining);
  }
#endif
  return f;
}
#endif

#ifdef NEED_DIFFUSE_TRANSMISSION
// Makes of a sample of the opaque surface, in `shining` lanes, one of the surface that light shines through: what the
// layer scattered goes to the far side. Lanes of `mirrored` keep their sample.
FN void sample_shining(const Scene* scene, const Surface* m, v3 v, vi shining, vi by_lobe, vi mirrored, BsdfSample* b) {
  v3 d = b->direction;
  v3 across = make3(d.x, d.y, max_f(d.z, (vf)1e-6f));
  vf pdf_above, pdf_below;
  v3 above = eval_above_shining(scene, m, v, across, &pdf_above);
  v3 below = eval_shining_layer(scene, m, v, across, &pdf_below);
  vf pdf = pick(pdf_below, pdf_above, by_lobe);
  v3 weight = scale3(pick3(below, above, by_lobe), one_f() / pdf);
  weight = pick3(splat3(zero_f()), weight, (d.z > (vf)1e-6f) & (pdf > zero_f()));
  vi drawn = shining & none(mirrored);
  b->weight = pick3(b->weight, weight, drawn);
  b->direction.z = pick(d.z, -d.z, drawn & none(by_lobe));
  b->crosses = drawn & none(by_lobe) & m->solid;
}
#endif

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

// Draws a direction: u_lobe chooses, (u0, u1) aim. Weight 0: the path ends. `v` is local, v.z > 0.
OUTLINED BsdfSample sample_bsdf(const Scene* scene, const Surface* m, v3 v, vf u_lobe, vf u_glass, vf u0, vf u1) {
  vi by_lobe, mirrored;
  BsdfSample b = sample_opaque(scene, m, v, u_lobe, u0, u1, &by_lobe, &mirrored);
#ifdef NEED_TRANSMISSIVE
  // Light samples weigh against the density over all samples, of which glass takes its share.
  b.pdf *= one_f() - m->transmission;
  vi glass = u_glass < m->transmission;
#ifdef NEED_DIFFUSE_TRANSMISSION
  vi shining = u_glass < m->transmission * m->shining;
  if (any_lane(shining)) sample_shining(scene, m, v, shining, by_lobe, mirrored, &b);
  glass = glass & none(shining);
#endif
  if (any_lane(glass)) sample_glass(m, v, u_lobe, u0, u1, glass, &b);
#ifdef NEED_ROUGH_TRANSMISSIVE
  // Both kinds of samples may take any direction here; light samples weigh against the density of them together.
  vi scatters = scatters_through(m) & none(glass & none(m->blurs)) & (glass | none(mirrored));
  if (any_lane(scatters)) {
    vf glass_pdf, opaque_pdf;
    eval_transmissive(scene, m, v, b.direction, &glass_pdf);
    eval_bsdf(scene, m, v, make3(b.direction.x, b.direction.y, fabs(b.direction.z)), &opaque_pdf);
    opaque_pdf = pick(zero_f(), opaque_pdf, b.direction.z > zero_f());
    vf both = fma(m->transmission, glass_pdf, (one_f() - m->transmission) * opaque_pdf);
    b.pdf = pick(b.pdf, both, scatters & (max_component(b.weight) > zero_f()));
  }
#endif
#endif
  return b;
}

#endif
