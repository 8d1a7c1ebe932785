// Direct light of elements: light links. Stage kind "links_light".
//
//   for each element, for each of its samples
//     links_light_rays   a point of the one-ring and a light sample: a shadow ray
//   trace                any hit
//   shadow_connect       samples that arrived are added to their slots         (kernels/transport/shadow_rays.h)
//   links_light_sum      a slot a sample -> the element's irradiance, and what it sends
//
// The points are spread over the one-ring as the paper's 1:4 oversampling has them: divided once, the small triangle at
// the vertex holds half of the samples, its neighbours the rest.
#include "kernels/links/light_sample.h"
#include "kernels/lost_samples.h"
#include "kernels/wide.h"

// Sample s of element first + e is number e * samples + s of `count`, which is its slot.
kernel WIDE void links_light_rays(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                                  global const uint* restrict mesh, global const uint* restrict lobes, uint first,
                                  uint count, global float* restrict shadows, global float* restrict slots,
                                  uint slot_count, global uint* counters) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint samples = parameters->samples;
  uint element = first + first_lane / samples;
  vu slot = (vu)first_lane + lane_index();
  for (uint k = 0; k < SLOT_WORDS; ++k) store_f(slots + (ulong)SLOT_WORDS * first_lane + k * LANES, 0, zero_f());
  Connection c = no_connection();
  Vertex v = no_vertex();
#ifdef NEED_LIGHTS
  Mesh m = load_mesh(mesh);
  vi active = (vi)(element < parameters->elements ? all_lanes() : no_lanes());
  if (any_lane(active)) {
    vu sample = (vu)(first_lane % samples) + lane_index();
    uint owner = owner_of(&m, lobes, element);
    vu key = element_key(parameters, &m, owner, 0x4cu + 0x100u * bin_of(&m, element));
    RingPoint at = random_ring_point(&m, owner, 1.0f, key, sample);
    LightSample light;
    v3 received;
#ifdef LINKS_LOBES
    if (is_lobe(&m, element)) {
      vf u0, u1;
      sample_pair(key, sample, LINKS_MOST_SAMPLES, 6u, &u0, &u1);
      v = lobe_surface(scene, &at, owner, bin_of(&m, element), u0, u1, active);
      active = active & v.active;
      light = draw_light(scene, &v, key, sample);
      // The colour is the element's albedo.
      received = splat3(lobe_luminance(lobe_share(scene, &v, light.direction)));
    } else
#endif
    {
      v = element_surface(scene, &at, element, active);
      light = draw_light(scene, &v, key, sample);
      received = splat3(layer_share(scene, &v, light.direction));
    }
    c = light_connection(&v, &light, received, active, counters);
  }
#endif
  write_connection(shadows, block, &c, &v, slot, slot_count);
}

// Sums each element's samples in their order. Samples that are not finite are left out and reported.
kernel void links_light_sum(global const LinksParameters* restrict parameters, uint count,
                            global const float* restrict slots, global const float* restrict albedo,
                            global float* restrict records, global uint* restrict report) {
  uint element = (uint)get_global_id(0);
  if (element >= count) return;
  uint samples = parameters->samples, lost = 0u;
  float sum[3] = {0, 0, 0};
  for (uint s = 0; s < samples; ++s) {
    global const float* slot = slots + (ulong)SLOT_WORDS * (element * samples + s);
    int fine = finite_words(slot, 3u);
    for (uint k = 0; k < 3u && fine; ++k) sum[k] += slot[k];
    lost += fine ? 0u : 1u;
  }
  global float* record = records + RADIOSITY_WORDS * element;
  for (uint k = 0; k < 4u; ++k) {
    float light = k < 3u ? sum[k] / (float)samples : 0.0f;
    record[RADIOSITY_IRRADIANCE + k] = light;
    record[RADIOSITY_SENT + k] = light * albedo[ALBEDO_WORDS * element + k];
  }
  report_lost(report, element, lost);
}
