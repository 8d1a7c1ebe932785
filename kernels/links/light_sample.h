// Direct light of a diffuse layer by a light sample.
#ifndef GLEANER_KERNELS_LINKS_LIGHT_SAMPLE_H
#define GLEANER_KERNELS_LINKS_LIGHT_SAMPLE_H

#include "kernels/lights.h"
#include "kernels/links/lobes.h"
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
// A light sample of its own for each sample of a key.
FN LightSample draw_light(const Scene* scene, const Vertex* v, vu key, vu sample) {
  vf u_choice, u_spare, l0, l1;
  sample_pair(key, sample, LINKS_MOST_SAMPLES, 0u, &u_choice, &u_spare);
  sample_pair(key, sample, LINKS_MOST_SAMPLES, 1u, &l0, &l1);
  return sample_light(scene, v->hit.p, u_choice, l0, l1);
}

// What the layer gets of light from a direction.
FN vf layer_share(const Scene* scene, const Vertex* v, v3 direction) {
  vf cosine = dot3(v->frame.normal, direction);
  return cosine * left_above(scene, &v->surface, clamp_f(cosine, (vf)1e-6f, one_f()));
}

#ifdef LINKS_LOBES
// What the lobe sends of it to the viewer, times pi, as elements send the layer's light.
FN v3 lobe_share(const Scene* scene, const Vertex* v, v3 direction) {
  v3 l = make3(dot3(v->frame.tangent, direction), dot3(v->frame.bitangent, direction),
               max_f(dot3(v->frame.normal, direction), (vf)1e-6f));
  return scale3(eval_lobe(scene, &v->surface, v->frame.view, l), (vf)3.14159265f);
}
#endif

// What the light adds where so much of it is received, and the shadow ray that asks for it.
FN Connection light_connection(const Vertex* v, const LightSample* from, v3 received, vi active,
                               global uint* counters) {
  Connection c = no_connection();
  LightSample light = *from;
  vf cosine = dot3(v->frame.normal, light.direction);
#ifdef NEED_BENT_NORMALS
  received = scale3(received, geometric_share(&v->frame, light.direction, cosine));
#endif
  c.contribution = mul3(light.radiance, scale3(received, one_f() / light.pdf));
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
