// Direct light of a diffuse layer by a light sample.
#ifndef GLEANER_KERNELS_LINKS_LIGHT_SAMPLE_H
#define GLEANER_KERNELS_LINKS_LIGHT_SAMPLE_H

#include "kernels/lights.h"
#include "kernels/links/mesh.h"
#include "kernels/transport/shadow_rays.h"

FN Connection no_connection(void) {
  Connection c;
  c.origin = c.direction = c.contribution = splat3(zero_f());
  c.far = (vf)-1.0f;
  c.total = one_f();
  c.bits = (vu)0u;
  c.connected = no_lanes();
#ifdef NEED_MEDIA
  c.media = media_of(0u, 0u);
#endif
  return c;
}

// Of no surface: what write_connection() reads of a vertex that asks for no light.
FN Vertex no_vertex(void) {
  Vertex v;
  v.primitive = (vu)GLEANER_NONE;
#ifdef NEED_INSTANCES
  v.hit.instance = (vu)GLEANER_NONE;
#endif
  return v;
}

#ifdef NEED_LIGHTS
// What a light sample adds to the irradiance of the layer, and the shadow ray that asks for it.
FN Connection light_connection(const Scene* scene, const Vertex* v, vu key, vu sample, vi active,
                               global uint* counters) {
  Connection c = no_connection();
  vf u_choice, u_spare, l0, l1;
  sample_pair(key, sample, LINKS_MOST_SAMPLES, 0u, &u_choice, &u_spare);
  sample_pair(key, sample, LINKS_MOST_SAMPLES, 1u, &l0, &l1);
  LightSample light = sample_light(scene, v->hit.p, u_choice, l0, l1);
  vf cosine = dot3(v->frame.normal, light.direction);
  vf share = cosine * left_above(scene, &v->surface, clamp_f(cosine, (vf)1e-6f, one_f()));
#ifdef NEED_BENT_NORMALS
  share *= geometric_share(&v->frame, light.direction, cosine);
#endif
  c.contribution = scale3(light.radiance, share / light.pdf);
  c.connected = active & (cosine > (vf)1e-6f) & (light.pdf > zero_f()) & (max_component(c.contribution) > zero_f());
  c.origin = offset_ray_origin(v->hit.p, v->hit.error, v->hit.geometric, light.direction);
  c.direction = pick3(sub3(light.target, c.origin), light.direction, light.infinite);
  c.far = pick((vf)-1.0f, pick((vf)SHADOW_FAR, (vf)INFINITY, light.infinite), c.connected);
#ifdef TRANSPARENT_SHADOWS
  c.bits = pick_u((vu)0u, (vu)SHADOW_INFINITE, light.infinite);
#endif
  uint asked;
  rank_lanes(c.connected, &asked);
  if (asked) atomic_add(counters + COUNTER_SHADOW, asked);
  return c;
}
#endif

#endif
