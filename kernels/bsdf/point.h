// A point's material, evaluated, and a direction that is drawn from it.
#ifndef GLEANER_KERNELS_BSDF_POINT_H
#define GLEANER_KERNELS_BSDF_POINT_H

#include "kernels/sampling.h"
#include "kernels/scene_access.h"

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

typedef struct {
  v3 direction;  // local
  v3 weight;     // BSDF n.l / pdf
  vf pdf;        // per steradian; 0 = the direction was not drawn from a density that light sampling could share
  vf eta;        // n_t / n_i of a refraction, else 1
  vi straight;   // goes on as it came: through a smooth pane, or where glass bends nothing
  vi crosses;    // into a solid or out of it
} BsdfSample;

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

#endif
