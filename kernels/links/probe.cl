// Where irradiance bends: elements' irradiance by test lights; and which elements lie inside of something. Stage kind
// "links_probe".
//
//   for each element, for each of its directions
//     links_rays        a cosine-weighted ray                                       (kernels/links/rays.h)
//   trace               closest hits
//   links_probe_hits    what each test light sends from there: waves through space, one where nothing is met
//   links_probe_sum     the means over the even rays and over the odd ones; how many hits are on surfaces' backs
//
// A mesh that interpolates this light well does so with any light of no finer structure: what is measured knows
// nothing of the scene's lights, and links are kept while these move.
#define SEES_NO_COLOR
#include "kernels/links/rays.h"

// The wave's direction and length, and its phase.
constant float probe_waves[4u * PROBE_LIGHTS] = {0.8f, 0.5f,  0.33f, 0.7f, -0.9f, 1.3f, 1.1f,  2.9f,
                                                 1.7f, -2.1f, 1.9f,  4.3f, 3.1f,  2.3f, -3.7f, 5.6f};

kernel WIDE void links_probe_hits(global const LinksParameters* restrict parameters, SCENE_PARAMETERS, uint count,
                                  global const float* restrict rays, global float* restrict seen,
                                  global float* restrict faces) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vi asked = row_f(rays, LINK_ROWS, block, ROW_WEIGHT) > zero_f();
  vi hit = asked & (row_u(rays, LINK_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  Vertex v = meet_surface(scene, rays, LINK_ROWS, block, hit);
  v3 p = scale3(v.hit.p, (vf)parameters->wave);
  v3 direction = row_3(rays, LINK_ROWS, block, ROW_DIRECTION);
  vi back = hit & (dot3(v.hit.outward, direction) > zero_f());
  // 0: no hit, 1: on a front, 2: on a back.
  store_f(faces + first_lane, 0, pick(zero_f(), pick(one_f(), (vf)2.0f, back), hit));
  vu to = ((vu)first_lane + lane_index()) * PROBE_LIGHTS;
  for (uint k = 0; k < PROBE_LIGHTS; ++k) {
    constant float* w = probe_waves + 4u * k;
    vf turn = (p.x * w[0] + p.y * w[1] + p.z * w[2] + w[3]) * (vf)0.15915494f;
    vf s, c;
    sincos_2pi(turn - floor(turn), &s, &c);
    scatter_f(seen + k, to, pick(zero_f(), pick(one_f(), s, hit), asked));
  }
}

kernel void links_probe_sum(global const LinksParameters* restrict parameters, uint count,
                            global const float* restrict seen, global const float* restrict faces,
                            global float* restrict records) {
  uint element = (uint)get_global_id(0);
  if (element >= count) return;
  uint directions = parameters->directions;
  float sum[2u * PROBE_LIGHTS] = {0};
  for (uint r = 0; r < directions; ++r)
    for (uint k = 0; k < PROBE_LIGHTS; ++k)
      // Neighbouring rays alternate along both axes of their block.
      sum[((r ^ (r >> 2)) & 1u) * PROBE_LIGHTS + k] += seen[(ulong)PROBE_LIGHTS * (element * directions + r) + k];
  for (uint k = 0; k < 2u * PROBE_LIGHTS; ++k) records[PROBE_WORDS * element + k] = 2.0f * sum[k] / (float)directions;
  uint hits = 0u, backs = 0u;
  for (uint r = 0; r < directions; ++r) {
    float face = faces[element * directions + r];
    hits += face > 0.0f ? 1u : 0u;
    backs += face > 1.0f ? 1u : 0u;
  }
  records[PROBE_WORDS * element + PROBE_BACKS] = hits ? (float)backs / (float)hits : 0.0f;
  records[PROBE_WORDS * element + PROBE_HITS] = (float)hits / (float)directions;
}
