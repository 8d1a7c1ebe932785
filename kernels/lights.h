// Choosing a light: first a cluster, by the irradiance it could cause here (power, distance, the cone of its normals,
// after Conty Estevez & Kulla 2018), then one of its emitters by power, then a point on it. Cluster 0..count-1 are few,
// so that all are looked at: no tree is walked and every lane does the same.
#ifndef GLEANER_KERNELS_LIGHTS_H
#define GLEANER_KERNELS_LIGHTS_H

#include "kernels/sampling.h"
#include "kernels/scene_access.h"

// Fields of the row `e` of the emitters.
#ifdef NEED_TWO_SIDED_EMITTERS
FN vu emitter_cluster(const vf* e) { return as_vu(e[EMITTER_CLUSTER]) & (vu)~EMITTER_TWO_SIDED; }
FN vi is_two_sided(const vf* e) { return (as_vu(e[EMITTER_CLUSTER]) & (vu)EMITTER_TWO_SIDED) != 0u; }
#else
FN vu emitter_cluster(const vf* e) { return as_vu(e[EMITTER_CLUSTER]); }
FN vi is_two_sided(const vf* e) { return no_lanes(); }
#endif

#if defined(NEED_EMISSIVE_TRIANGLES) || defined(NEED_PUNCTUAL_LIGHTS) || defined(NEED_ENVIRONMENT)
#define NEED_LIGHTS

// Bound of the irradiance at a point, the cluster's fields given (varying or uniform). The emitters of a two-sided
// cluster have normals in a cone about the axis or in the opposite one.
FN vf cluster_importance_of(v3 offset, vf radius, v3 axis, vf cosine, vf sine, vf power, vi anywhere, vi two_sided) {
  vf d2 = dot3(offset, offset);
  vf r2 = radius * radius;
  vf inverse = one_f() / sqrt(d2);
  vf cos_t = dot3(axis, offset) * inverse;
#ifdef NEED_TWO_SIDED_EMITTERS
  cos_t = pick(cos_t, fabs(cos_t), two_sided);
#endif
  vf sin_t = safe_sqrt(one_f() - cos_t * cos_t);
  vf sin_u = radius * inverse;
  vf cos_u = safe_sqrt(one_f() - sin_u * sin_u);
  // cos of the angle left after the cone's half angle and the sphere's are taken off, each not below 0.
  vi in_cone = cos_t > cosine;
  vf cos_a = pick(cos_t * cosine + sin_t * sine, one_f(), in_cone);
  vf sin_a = pick(sin_t * cosine - cos_t * sine, zero_f(), in_cone);
  vf cos_b = pick(cos_a * cos_u + sin_a * sin_u, one_f(), cos_a > cos_u);
  vf inside = pick(power * max_f(cos_b, zero_f()) / d2, power / r2, d2 <= r2);
  return pick(inside, power, anywhere);
}

FN vf cluster_importance(const Scene* scene, uint k, v3 p) {
  global const float* c = scene->clusters + CLUSTER_WORDS * k;
  uint kind = ((global const uint*)c)[CLUSTER_KIND], two_sided = ((global const uint*)c)[CLUSTER_TWO_SIDED];
  if (kind >= CLUSTER_DIRECTIONAL) return (vf)c[CLUSTER_POWER];
  v3 offset = make3(p.x - c[CLUSTER_CENTER], p.y - c[CLUSTER_CENTER + 1], p.z - c[CLUSTER_CENTER + 2]);
  return cluster_importance_of(offset, (vf)c[CLUSTER_RADIUS],
                               uniform3(c[CLUSTER_AXIS], c[CLUSTER_AXIS + 1], c[CLUSTER_AXIS + 2]), (vf)c[CLUSTER_COS],
                               (vf)c[CLUSTER_SIN], (vf)c[CLUSTER_POWER], no_lanes(), (vu)two_sided != 0u);
}

// The same for a cluster that varies over the lanes.
FN vf cluster_importance_at(const Scene* scene, vu k, v3 p) {
#if CLUSTERS == 1
  return one_f();
#else
  vf c[16];
  load_words(scene->clusters, k * CLUSTER_WORDS, c);
  return cluster_importance_of(sub3(p, words3(c, CLUSTER_CENTER)), c[CLUSTER_RADIUS], words3(c, CLUSTER_AXIS),
                               c[CLUSTER_COS], c[CLUSTER_SIN], c[CLUSTER_POWER],
                               as_vu(c[CLUSTER_KIND]) >= CLUSTER_DIRECTIONAL, as_vu(c[CLUSTER_TWO_SIDED]) != 0u);
#endif
}

typedef struct {
  v3 direction;  // unit, to the light
  v3 target;     // the point on it, moved off its surface (not for `infinite`)
  v3 radiance;   // incoming radiance (delta lights: irradiance on a facing surface)
  vf pdf;        // per steradian, chance of the choice included (delta lights: of the choice alone)
  vi infinite;
  vi delta;  // scattering can never find it
  vf total;  // sum of the clusters' importances here: what light_choice_pdf() needs
} LightSample;

#ifdef NEED_EMISSIVE_TRIANGLES
#ifdef NEED_TEXTURES
// The coordinates at which `texture` is read on a triangle (first word of its row), at the weights of its second and
// third corner.
FN void emitter_uv(const Scene* scene, vu triangle, vu texture, vf b1, vf b2, vi active, vf* u, vf* v) {
  vf b0 = one_f() - b1 - b2;
  global const float* t = scene->triangles;
#ifdef NEED_SECOND_UVS
  triangle += pick_u((vu)0u, (vu)(TRIANGLE_SECOND_UV0 - TRIANGLE_UV0), reads_second_uvs(scene, texture, active));
#endif
  *u = b0 * gather_f(t + TRIANGLE_UV0, triangle) + b1 * gather_f(t + TRIANGLE_UV1, triangle) +
       b2 * gather_f(t + TRIANGLE_UV2, triangle);
  *v = b0 * gather_f(t + TRIANGLE_UV0 + 1, triangle) + b1 * gather_f(t + TRIANGLE_UV1 + 1, triangle) +
       b2 * gather_f(t + TRIANGLE_UV2 + 1, triangle);
}
#endif

#ifdef NEED_ALPHA_EMITTERS
// What load_color() finds for a hit at this place.
FN vf emitter_opacity(const Scene* scene, vu triangle, vu material, vf b1, vf b2, vi active) {
  vf alpha = material_f(scene, material, MATERIAL_ALPHA);
#ifdef NEED_VERTEX_COLORS
  global const uint* words = (global const uint*)scene->triangles;
  vf sum = to_f(gather_u(words + TRIANGLE_COLOR0 + 1, triangle) >> 16) * (one_f() - b1 - b2) +
           to_f(gather_u(words + TRIANGLE_COLOR1 + 1, triangle) >> 16) * b1 +
           to_f(gather_u(words + TRIANGLE_COLOR2_BA, triangle) >> 16) * b2;
  alpha *= sum * (vf)(1.0f / 65535.0f);
#endif
#ifdef NEED_TEXTURES
  vu texture = material_u(scene, material, MATERIAL_BASE_COLOR_TEXTURE);
  vi textured = active & (texture != GLEANER_NONE);
  if (any_lane(textured)) {
    vf texel, u, v;
    emitter_uv(scene, triangle, texture, b1, b2, textured, &u, &v);
    texture_lookup(scene, texture, u, v, textured, &texel);
    alpha = pick(alpha, alpha * texel, textured);
  }
#endif
  return opacity_of(scene, material, material_u(scene, material, MATERIAL_FLAGS), alpha);
}
#endif

// Radiance of an emitting triangle, the row `e` of the emitters, at the weights of its second and third corner.
FN v3 emitter_radiance(const Scene* scene, const vf* e, vf b1, vf b2, vi active) {
  v3 radiance = words3(e, EMITTER_RADIANCE);
#if defined(NEED_EMISSION_TEXTURES) || defined(NEED_ALPHA_EMITTERS)
  vu triangle = pick_u((vu)0u, as_vu(e[EMITTER_TRIANGLE]), active) * TRIANGLE_WORDS;
  vu material = gather_u((global const uint*)scene->triangles + TRIANGLE_MATERIAL, triangle);
#endif
#ifdef NEED_EMISSION_TEXTURES
  vu texture = material_u(scene, material, MATERIAL_EMISSION_TEXTURE);
  vi textured = active & (texture != GLEANER_NONE);
  if (any_lane(textured)) {
    vf unused, u, v;
    emitter_uv(scene, triangle, texture, b1, b2, textured, &u, &v);
    radiance = pick3(radiance, mul3(radiance, texture_lookup(scene, texture, u, v, textured, &unused)), textured);
  }
#endif
#ifdef NEED_ALPHA_EMITTERS
  radiance = scale3(radiance, emitter_opacity(scene, triangle, material, b1, b2, active));
#endif
  return radiance;
}
#endif

// A cluster by its share of all that light from here, *total. *chance: that it is chosen; *rest: what is left of the
// random number, in [0, 1).
FN vu choose_cluster(const Scene* scene, v3 p, vf u_choice, vf* total, vf* chance, vf* rest) {
  vu cluster = (vu)0u;
  *chance = one_f();
  *rest = u_choice;
#if CLUSTERS == 1
  *total = one_f();
#else
  vf importance[CLUSTERS];
  vf all = zero_f();
  for (uint k = 0; k < CLUSTERS; ++k) {
    importance[k] = cluster_importance(scene, k, p);
    all += importance[k];
  }
  *total = all;
  vf aim = u_choice * all;
  vf sum = zero_f(), chosen = zero_f(), below = zero_f();
  for (uint k = 0; k < CLUSTERS; ++k) {
    // The last cluster with any importance stands where rounding leaves the sum short of the aim.
    vi take = (sum <= aim) & (importance[k] > zero_f());
    cluster = pick_u(cluster, (vu)k, take);
    chosen = pick(chosen, importance[k], take);
    below = pick(below, sum, take);
    sum += importance[k];
  }
  vi any = chosen > zero_f();
  *chance = pick(zero_f(), chosen / all, any);
  *rest = clamp_f(pick(zero_f(), (aim - below) / chosen, any), zero_f(), (vf)0.99999994f);
#endif
  return cluster;
}

#if defined(NEED_EMISSIVE_TRIANGLES) || defined(NEED_PUNCTUAL_LIGHTS)
// Of `count` emitters from row `first` on, the row that the random number falls to.
FN vu emitter_in_cluster(const Scene* scene, vu first, vu count, vf rest) {
  global const uint* cluster_words = (global const uint*)scene->clusters;
  vu low = (vu)0u;
  for (uint step = cluster_words[CLUSTERS * CLUSTER_WORDS]; step > 0u; step >>= 1) {
    vu probe = low + step;
    vi inside = probe < count;
    vu at = first + pick_u((vu)0u, probe - 1u, inside);
    low = pick_u(low, probe, inside & (gather_f(scene->emitters + EMITTER_CDF, at * EMITTER_WORDS) <= rest));
  }
  return first + low;
}
#endif

#ifdef NEED_EMISSIVE_TRIANGLES
// A point of the triangle of the emitter's row `e`, in lanes `here`.
FN void sample_shining_triangle(const Scene* scene, const vf* e, v3 p, vf u0, vf u1, vf chance, vi here,
                                LightSample* light) {
  v3 corner = words3(e, EMITTER_P0);
  v3 e1 = words3(e, EMITTER_E1);
  v3 e2 = words3(e, EMITTER_E2);
  vf b1, b2;
  sample_triangle(u0, u1, &b1, &b2);
  v3 error;
  v3 q = surface_point(corner, e1, e2, b1, b2, &error);
  v3 n = cross3(e1, e2);  // its length is twice the area
  v3 d = sub3(q, p);
  vf d2 = dot3(d, d);
  vf distance = sqrt(d2);
  v3 w = scale3(d, one_f() / distance);
  vf projected = -dot3(n, w);  // front face alone, or both
  projected = pick(projected, fabs(projected), is_two_sided(e));
  vf pdf = chance * 2.0f * d2 / projected;
  vi ok = here & (projected > zero_f()) & (d2 > zero_f()) & finite_f(pdf);
  // A query knows the light's corners by their offsets from where it begins: their rounding, and that of its sums of
  // products, grow with the distance. A target within that of the light would be in its own light's way.
  const vf unit = (vf)(16.0f * 5.9604645e-8f);
  error = add3(error, make3(unit * fabs(d.x), unit * fabs(d.y), unit * fabs(d.z)));
  light->target = pick3(light->target, offset_ray_origin(q, error, normalize3(n), negate3(w)), ok);
  light->direction = pick3(light->direction, w, ok);
  light->radiance = pick3(light->radiance, emitter_radiance(scene, e, b1, b2, ok), ok);
  light->pdf = pick(light->pdf, pdf, ok);
}
#endif

#ifdef NEED_PUNCTUAL_LIGHTS
// The light of the emitter's row `e`, in lanes of such a `kind`.
FN void aim_at_light(const vf* e, v3 p, vf chance, vu kind, LightSample* light) {
  vi here = kind == CLUSTER_POSITIONAL;
  v3 position = words3(e, EMITTER_POSITION);
  v3 axis = words3(e, EMITTER_DIRECTION);
  v3 intensity = words3(e, EMITTER_RADIANCE);
  vf inner = e[EMITTER_COS_INNER];
  vf outer = e[EMITTER_COS_OUTER];
  vf range = e[EMITTER_RANGE];
  v3 d = sub3(position, p);
  vf d2 = dot3(d, d);
  vf distance = sqrt(d2);
  v3 w = scale3(d, one_f() / distance);
  // KHR_lights_punctual: the cone's falloff and the window that ends at the range.
  vf cone = clamp_f((-dot3(axis, w) - outer) / max_f((vf)1e-4f, inner - outer), zero_f(), one_f());
  cone = pick(cone * cone, one_f(), outer <= (vf)-1.0f);
  vf ratio = distance / range;
  vf window = clamp_f(one_f() - ratio * ratio * ratio * ratio, zero_f(), one_f());
  vf factor = cone * pick(one_f(), window, range > zero_f()) / d2;
  vi ok = here & (d2 > zero_f()) & finite_f(factor);
  light->target = pick3(light->target, position, ok);
  light->direction = pick3(light->direction, w, ok);
  light->radiance = pick3(light->radiance, scale3(intensity, factor), ok);
  light->pdf = pick(light->pdf, chance, ok);
  vi far = kind == CLUSTER_DIRECTIONAL;
  light->direction = pick3(light->direction, negate3(axis), far);
  light->radiance = pick3(light->radiance, intensity, far);
  light->pdf = pick(light->pdf, chance, far);
  light->infinite = light->infinite | far;
  light->delta = here | far;
}
#endif

OUTLINED LightSample sample_light(const Scene* scene, v3 p, vf u_choice, vf u0, vf u1) {
  LightSample light;
  light.infinite = no_lanes();
  light.delta = no_lanes();
  vf chance, rest;
  vu cluster = choose_cluster(scene, p, u_choice, &light.total, &chance, &rest);
#if CLUSTERS == 1
  global const uint* cluster_words = (global const uint*)scene->clusters;
  vu kind = (vu)cluster_words[CLUSTER_KIND];
#else
  vf c[16];
  load_words(scene->clusters, cluster * CLUSTER_WORDS, c);
  vu kind = as_vu(c[CLUSTER_KIND]);
#endif
  light.pdf = zero_f();
  light.radiance = splat3(zero_f());
  light.direction = uniform3(0.0f, 0.0f, 1.0f);
  light.target = p;
#if defined(NEED_EMISSIVE_TRIANGLES) || defined(NEED_PUNCTUAL_LIGHTS)
#if CLUSTERS == 1
  vu first = (vu)cluster_words[CLUSTER_FIRST], count = (vu)cluster_words[CLUSTER_COUNT];
#else
  vu first = as_vu(c[CLUSTER_FIRST]), count = as_vu(c[CLUSTER_COUNT]);
#endif
  vf e[16];
  load_words(scene->emitters, emitter_in_cluster(scene, first, count, rest) * EMITTER_WORDS, e);
#ifdef NEED_ENVIRONMENT
  chance *= pick(e[EMITTER_PMF], one_f(), kind == CLUSTER_ENVIRONMENT);  // which has no row of its own
#else
  chance *= e[EMITTER_PMF];
#endif
#endif
#ifdef NEED_EMISSIVE_TRIANGLES
  sample_shining_triangle(scene, e, p, u0, u1, chance, kind == CLUSTER_TRIANGLES, &light);
#endif
#ifdef NEED_PUNCTUAL_LIGHTS
  aim_at_light(e, p, chance, kind, &light);
#endif
#ifdef NEED_ENVIRONMENT
  {
    vi here = kind == CLUSTER_ENVIRONMENT;
    if (any_lane(here)) {
      vf pdf;
      v3 radiance;
      v3 w = environment_sample(scene, u0, u1, &pdf, &radiance);
      light.direction = pick3(light.direction, w, here);
      light.radiance = pick3(light.radiance, radiance, here);
      light.pdf = pick(light.pdf, pdf * chance, here);
      light.infinite = light.infinite | here;
    }
  }
#endif
  return light;
}

#ifdef NEED_EMISSIVE_TRIANGLES
// Density, per steradian, with which sample_light() at `p` would have come upon the point of an emitter, the row `e` of
// the emitters, at `distance` along unit `w`; `total` is LightSample::total at p.
OUTLINED vf light_pdf(const Scene* scene, const vf* e, v3 p, v3 w, vf distance, vf total) {
  v3 n = cross3(words3(e, EMITTER_E1), words3(e, EMITTER_E2));
  vf projected = -dot3(n, w);
  projected = pick(projected, fabs(projected), is_two_sided(e));
  vf chance = e[EMITTER_PMF];
#if CLUSTERS > 1
  chance *= cluster_importance_at(scene, emitter_cluster(e), p) / total;
#endif
  vf pdf = chance * 2.0f * distance * distance / projected;
  return pick(zero_f(), pdf, (projected > zero_f()) & finite_f(pdf));
}
#endif

#ifdef NEED_ENVIRONMENT
// The chance that sample_light() at `p` chooses the environment (its cluster is the last).
FN vf environment_chance(const Scene* scene, vf total) {
#if CLUSTERS == 1
  return one_f();
#else
  return (vf)scene->clusters[CLUSTER_WORDS * (CLUSTERS - 1) + CLUSTER_POWER] / total;
#endif
}
#endif

#endif
#endif
