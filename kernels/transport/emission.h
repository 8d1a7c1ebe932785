// Emission: the first ray of a light path, from every kind of light.
//
//   light     <- by its share of the scene's power (cumulated shares, kernels/scene_layout.h: EMISSION_...)
//   point     <- uniform on the triangle | the light's place | a disc across the scene's bounding sphere
//   direction <- cosine-weighted over the triangle's front, or both faces | uniform in the spot's cone | the distant
//                light's own
//   flux      <- what the light emits there / the density of these choices
//
// The mean of `flux` over all paths is the scene's emitted power. Include it where light is followed from its source;
// NEED_LIGHTS must be defined.
#ifndef GLEANER_KERNELS_TRANSPORT_EMISSION_H
#define GLEANER_KERNELS_TRANSPORT_EMISSION_H

#include "kernels/lights.h"

typedef struct {
  v3 origin, direction;
  v3 flux;   // W, RGB
  vf range;  // of the punctual light's window (KHR_lights_punctual), which weighs the first segment; 0: none
  vi valid;
  vi punctual;  // of a point, spot or directional light
#ifdef NEED_MEDIA
  vu media_high, media_low;  // the solids that the light stands in (kernels/surface.h: Media)
#endif
} EmittedRay;

#ifdef NEED_EMISSIVE_TRIANGLES
FN void emit_from_triangle(const Scene* scene, const vf* e, vf u0, vf u1, vf d0, vf d1, vi here, EmittedRay* ray) {
  v3 e1 = words3(e, EMITTER_E1), e2 = words3(e, EMITTER_E2);
  vf b1, b2;
  sample_triangle(u0, u1, &b1, &b2);
  v3 error;
  v3 q = surface_point(words3(e, EMITTER_P0), e1, e2, b1, b2, &error);
  v3 n = cross3(e1, e2);
  vf doubled = length3(n);
  n = normalize3(n);
#ifdef NEED_TWO_SIDED_EMITTERS
  // The direction's second number says which face, and what is left of it aims.
  vi two_sided = is_two_sided(e), back = two_sided & (d1 >= (vf)0.5f);
  n = pick3(n, negate3(n), back);
  doubled = pick(doubled, 2.0f * doubled, two_sided);
  d1 = pick(d1, 2.0f * d1 - pick(zero_f(), one_f(), back), two_sided);
#endif
  v3 s, t;
  basis3(n, &s, &t);
  v3 lobe = sample_cosine(d0, d1);
  v3 w = normalize3(add3(add3(scale3(s, lobe.x), scale3(t, lobe.y)), scale3(n, lobe.z)));
  ray->origin = pick3(ray->origin, offset_ray_origin(q, error, n, w), here);
  ray->direction = pick3(ray->direction, w, here);
  // Cosine-weighted over a face: pi times the area of each that shines.
  ray->flux =
      pick3(ray->flux, scale3(emitter_radiance(scene, e, b1, b2, here), doubled * (vf)1.5707963267948966f), here);
}
#endif

#if defined(NEED_PUNCTUAL_LIGHTS) || defined(NEED_ENVIRONMENT)
// A point on the disc of the scene's radius that stands across unit `w`, about the origin.
FN v3 sample_scene_disc(v3 w, vf radius, vf u0, vf u1) {
  v3 s, t;
  vf sine, cosine;
  basis3(w, &s, &t);
  vf r = radius * sqrt(u1);
  sincos_2pi(u0, &sine, &cosine);
  return add3(scale3(s, r * cosine), scale3(t, r * sine));
}
#endif

#ifdef NEED_PUNCTUAL_LIGHTS
FN void emit_from_punctual(const vf* e, v3 center, vf radius, vf u0, vf u1, vf d0, vf d1, vi positional, vi directional,
                           EmittedRay* ray) {
  v3 axis = words3(e, EMITTER_DIRECTION), intensity = words3(e, EMITTER_RADIANCE);
  vf inner = e[EMITTER_COS_INNER], outer = e[EMITTER_COS_OUTER];
  // Uniform over the cone (a point light's is the sphere).
  vf z = one_f() - d1 * (one_f() - outer);
  vf r = safe_sqrt(one_f() - z * z), sine, cosine;
  sincos_2pi(d0, &sine, &cosine);
  v3 s, t;
  v3 pole = pick3(axis, uniform3(0.0f, 0.0f, 1.0f), dot3(axis, axis) <= zero_f());
  basis3(pole, &s, &t);
  v3 w = normalize3(add3(add3(scale3(s, r * cosine), scale3(t, r * sine)), scale3(pole, z)));
  vf cone = clamp_f((z - outer) / max_f((vf)1e-4f, inner - outer), zero_f(), one_f());
  cone = pick(cone * cone, one_f(), outer <= (vf)-1.0f);
  ray->origin = pick3(ray->origin, words3(e, EMITTER_POSITION), positional);
  ray->direction = pick3(ray->direction, w, positional);
  ray->flux = pick3(ray->flux, scale3(intensity, cone * (one_f() - outer) * (vf)6.28318530717958648f), positional);
  ray->range = pick(ray->range, e[EMITTER_RANGE], positional);
  v3 disc = sample_scene_disc(axis, radius, u0, u1);
  ray->origin = pick3(ray->origin, add3(center, mad3(axis, -radius, disc)), directional);
  ray->direction = pick3(ray->direction, axis, directional);
  ray->flux = pick3(ray->flux, scale3(intensity, radius * radius * (vf)3.14159265358979324f), directional);
}
#endif

#ifdef NEED_ENVIRONMENT
FN void emit_from_environment(const Scene* scene, v3 center, vf radius, vf u0, vf u1, vf d0, vf d1, vi here,
                              EmittedRay* ray) {
  vf pdf;
  v3 radiance;
  v3 w = environment_sample(scene, d0, d1, &pdf, &radiance);
  v3 disc = sample_scene_disc(w, radius, u0, u1);
  ray->origin = pick3(ray->origin, add3(center, mad3(w, radius, disc)), here);
  ray->direction = pick3(ray->direction, negate3(w), here);
  ray->flux =
      pick3(ray->flux, scale3(radiance, radius * radius * (vf)3.14159265358979324f / pdf), here & (pdf > zero_f()));
}
#endif

// The entry of the table of lights that u_light falls on; `share`: of the scene's power.
FN vu choose_emitter(global const float* emission, vf u_light, vf* share) {
  global const uint* header = (global const uint*)emission;
  uint entries = header[EMISSION_COUNT];
  global const float* cdf = emission + EMISSION_HEADER;
  vu low = (vu)0u;
  for (uint step = header[EMISSION_STEP]; step > 0u; step >>= 1) {
    vu probe = low + step;
    vi inside = probe < entries;
    low = pick_u(low, probe, inside & (gather_f(cdf, pick_u((vu)0u, probe - 1u, inside)) <= u_light));
  }
  *share = gather_f(cdf, low) - pick(zero_f(), gather_f(cdf, pick_u((vu)0u, low - 1u, low > 0u)), low > 0u);
  return low;
}

// `emission`: the scene's table of lights. u_light chooses the light, (u0, u1) the point on it, (d0, d1) the direction.
FN EmittedRay emit_light(const Scene* scene, global const float* emission, vf u_light, vf u0, vf u1, vf d0, vf d1) {
  global const uint* header = (global const uint*)emission;
  vf share;
  vu entry = choose_emitter(emission, u_light, &share);
  v3 center = uniform3(emission[EMISSION_CENTER], emission[EMISSION_CENTER + 1], emission[EMISSION_CENTER + 2]);
  vf radius = (vf)emission[EMISSION_RADIUS];
  // The environment has the last entry, and no row among the emitters.
  vi environment = (entry == header[EMISSION_COUNT] - 1u) & ((vu)header[EMISSION_ENVIRONMENT] != 0u);
  vf e[16];
  load_words(scene->emitters, pick_u(entry, (vu)0u, environment) * EMITTER_WORDS, e);
  vu kind = gather_u((global const uint*)scene->clusters + CLUSTER_KIND, emitter_cluster(e) * CLUSTER_WORDS);
  EmittedRay ray;
  ray.origin = center;
  ray.direction = uniform3(0.0f, 0.0f, 1.0f);
  ray.flux = splat3(zero_f());
  ray.range = zero_f();
  ray.punctual = none(environment) & (kind != CLUSTER_TRIANGLES);
#ifdef NEED_MEDIA
  vu media = entry * 2u + header[EMISSION_COUNT] + EMISSION_HEADER;
  ray.media_high = gather_u(header, media);
  ray.media_low = gather_u(header + 1u, media);
#endif
#ifdef NEED_EMISSIVE_TRIANGLES
  emit_from_triangle(scene, e, u0, u1, d0, d1, none(environment) & (kind == CLUSTER_TRIANGLES), &ray);
#endif
#ifdef NEED_PUNCTUAL_LIGHTS
  emit_from_punctual(e, center, radius, u0, u1, d0, d1, none(environment) & (kind == CLUSTER_POSITIONAL),
                     none(environment) & (kind == CLUSTER_DIRECTIONAL), &ray);
#endif
#ifdef NEED_ENVIRONMENT
  if (any_lane(environment)) emit_from_environment(scene, center, radius, u0, u1, d0, d1, environment, &ray);
#endif
  ray.flux = scale3(ray.flux, one_f() / share);
  ray.valid = (share > zero_f()) & finite3(ray.flux) & (max_component(ray.flux) > zero_f());
  return ray;
}

#endif
