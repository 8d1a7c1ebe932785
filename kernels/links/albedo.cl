// What elements' diffuse layers reflect. Stage kind "links_albedo".
//
//   for each element, for each of its samples
//     links_albedo_samples   a point of the one-ring: the diffuse layer's colour there, and how opaque it is
//   links_albedo_mean        the mean over the samples, weighted by opacity: textures are integrated over the one-ring
#include "kernels/links/lobes.h"
#include "kernels/links/mesh.h"
#include "kernels/wide.h"

// Sample s of element first + e is number e * samples + s of `count`.
kernel WIDE void links_albedo_samples(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                                      global const uint* restrict mesh, global const uint* restrict lobes, uint first,
                                      uint count, global float* restrict colors) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint samples = parameters->samples;
  uint element = first + first_lane / samples;
  Mesh m = load_mesh(mesh);
  vi active = (vi)(element < parameters->elements ? all_lanes() : no_lanes());
  if (!any_lane(active)) return;
  vu sample = (vu)(first_lane % samples) + lane_index();
  uint owner = owner_of(&m, lobes, element);
  vu key = element_key(parameters, &m, owner, 0x41u + 0x100u * bin_of(&m, element));
  RingPoint at = random_ring_point(&m, owner, 1.0f, key, sample);
#ifdef LINKS_LOBES
  if (is_lobe(&m, element)) {
    // The colour, weighted by how much is sent.
    vf u0, u1, u2, u3;
    sample_pair(key, sample, LINKS_MOST_SAMPLES, 6u, &u0, &u1);
    sample_pair(key, sample, LINKS_MOST_SAMPLES, 7u, &u2, &u3);
    Vertex metal = lobe_surface(scene, &at, owner, bin_of(&m, element), u0, u1, active);
    LobeSample s = sample_lobe(scene, &metal, u2, u3);
    vu slot = ((vu)first_lane + lane_index()) * ALBEDO_WORDS;
    scatter3(colors, slot, s.weight);
    scatter_f(colors + 3, slot, lobe_luminance(s.weight));
    return;
  }
#endif
  Vertex v = element_surface(scene, &at, element, active);
  v3 albedo = own_albedo(&v);
  vf opacity = one_f();
#ifdef NEED_ALPHA
  opacity = v.surface.opacity;
#endif
  vu to = ((vu)first_lane + lane_index()) * ALBEDO_WORDS;
  scatter3(colors, to, scale3(albedo, opacity));
  scatter_f(colors + 3, to, opacity);
}

kernel void links_albedo_mean(global const LinksParameters* restrict parameters, uint count,
                              global const float* restrict colors, global float* restrict records) {
  uint element = (uint)get_global_id(0);
  if (element >= count) return;
  uint samples = parameters->samples;
  float sum[ALBEDO_WORDS] = {0, 0, 0, 0};
  for (uint s = 0; s < samples; ++s)
    for (uint k = 0; k < ALBEDO_WORDS; ++k) sum[k] += colors[(ulong)ALBEDO_WORDS * (element * samples + s) + k];
  for (uint k = 0; k < 3u; ++k) {
    float mean = sum[3] > 0.0f ? sum[k] / sum[3] : 0.0f;
    records[ALBEDO_WORDS * element + k] = mean >= 0.0f && mean <= 3.402823466e38f ? mean : 0.0f;
  }
  records[ALBEDO_WORDS * element + 3u] = 0.0f;
}
