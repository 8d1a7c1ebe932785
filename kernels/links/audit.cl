// How far the light between vertices is off, at points that pixels show. Stage kind "links_audit".
//
//   for each point, twice, for each of the directions
//     links_audit_rays   a cosine-weighted ray from the point itself
//   trace                closest hits
//   links_audit_hits     what the elements about the hit send; and what it sends by indirect light of the elements and
//                        a light sample of its own: a shadow ray
//   trace                any hit
//   shadow_connect       samples that arrived are added to their slots         (kernels/transport/shadow_rays.h)
//   links_audit_sum      the means, as the pixel would show them; and what it shows, of links_interpolate (shade.cl)
//
// Rays are as many as a vertex has, of the same kind: what elements send to both halves differs by a vertex' noise.
#include "kernels/links/light_sample.h"
#include "kernels/links/ray.h"
#include "kernels/lost_samples.h"
#include "kernels/vpl_records.h"

// Numbers of a ray: RGB of what elements send, and of what the hit sends by their indirect light.
#define SEEN_WORDS 6u

// Ray r of point `first` + e is number e * 2 * directions + r of `count`. `points`: from the first on.
kernel WIDE void links_audit_rays(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                                  global const float* restrict points, uint first, uint count, uint side,
                                  global float* restrict rays) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  uint directions = parameters->directions, number = first_lane / directions, half_of_rays = number & 1u;
  global const float* point = points + POINT_WORDS * (number / 2u);
  uint triangle = as_uint(point[POINT_TRIANGLE]);
  vi active = (vi)(triangle != GLEANER_NONE ? all_lanes() : no_lanes());
  RingPoint at;
  at.triangle = (vu)(triangle != GLEANER_NONE ? triangle : 0u);
  at.b1 = (vf)(triangle != GLEANER_NONE ? point[POINT_B1] : 0.0f);
  at.b2 = (vf)(triangle != GLEANER_NONE ? point[POINT_B2] : 0.0f);
  Hit h = load_hit(scene, at.triangle, (vu)GLEANER_NONE, at.b1, at.b2, active);
  v3 normal = make3((vf)point[POINT_NORMAL], (vf)point[POINT_NORMAL + 1u], (vf)point[POINT_NORMAL + 2u]);
  // All lanes are at one point.
  uint back = any_lane(active & (dot3(h.normal, normal) < zero_f())) ? 1u : 0u;
  Vertex from = element_surface(scene, &at, back, active);
  vu key = named_key(parameters, (vu)(2u * (first + number / 2u) + half_of_rays), 0x55u);
  vu ray = (vu)(first_lane % directions) + lane_index();
  v3 above = grid_direction(ray, side, key);
  send_ray(&from, above, layer_weight(scene, &from, above), active, rays, block);
}

// `radiosity`: rows of RADIOSITY_WORDS; `seen`: rows of SEEN_WORDS. The ray's number is its slot.
kernel WIDE void links_audit_hits(global const LinksParameters* restrict parameters, SCENE_PARAMETERS,
                                  global const uint* restrict mesh, global const uint* restrict lobes,
                                  global const uint* restrict sides, global const float* restrict albedos,
                                  global const float* restrict radiosity, uint first, uint count,
                                  global const float* restrict rays, global float* restrict seen,
                                  global float* restrict shadows, global float* restrict slots, uint slot_count,
                                  global uint* counters) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu slot = (vu)first_lane + lane_index();
  for (uint k = 0; k < SLOT_WORDS; ++k) store_f(slots + (ulong)SLOT_WORDS * first_lane + k * LANES, 0, zero_f());
  vi hit = (row_f(rays, LINK_ROWS, block, ROW_WEIGHT) > zero_f()) &
           (row_u(rays, LINK_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  v3 sent = splat3(zero_f()), indirect = splat3(zero_f());
  Connection c = no_connection();
  SeenElements elements;
  elements.hit = no_vertex();
  if (any_lane(hit)) {
    Mesh m = load_mesh(mesh);
    elements = seen_elements(scene, &m, lobes, sides, rays, block, hit);
    vf weight = zero_f();
    for (uint k = 0; k < 3u; ++k) {
      vu at = elements.element[k] * RADIOSITY_WORDS;
      sent = mad3(gather3(radiosity + RADIOSITY_SENT, at), elements.weight[k], sent);
      indirect = mad3(gather3(radiosity + RADIOSITY_IRRADIANCE, at), elements.weight[k], indirect);
      weight += elements.weight[k];
    }
    v3 albedo = own_albedo(&elements.hit);
    vf lobe_weight = zero_f();
    v3 sent_by_lobes = splat3(zero_f()), indirect_by_lobes = splat3(zero_f());
#ifdef LINKS_LOBES
    for (uint k = 0; k < 3u; ++k) {
      vu at = elements.lobe[k] * RADIOSITY_WORDS;
      v3 passed =
          mul3(gather3(radiosity + RADIOSITY_IRRADIANCE, at), gather3(albedos, elements.lobe[k] * ALBEDO_WORDS));
      sent_by_lobes = mad3(gather3(radiosity + RADIOSITY_SENT, at), elements.lobe_weight[k], sent_by_lobes);
      indirect_by_lobes = mad3(passed, elements.lobe_weight[k], indirect_by_lobes);
      lobe_weight += elements.lobe_weight[k];
    }
#endif
    hit = hit & elements.hit.active & (weight + lobe_weight > zero_f());
    sent = pick3(splat3(zero_f()), add3(sent, sent_by_lobes), hit);
    indirect = pick3(splat3(zero_f()), add3(mul3(indirect, albedo), indirect_by_lobes), hit);
#ifdef NEED_LIGHTS
    uint number = first_lane / parameters->directions;
    vu key = named_key(parameters, (vu)(2u * (first + number / 2u) + (number & 1u)), 0x56u);
    LightSample light = draw_light(scene, &elements.hit, key, (vu)(first_lane % parameters->directions) + lane_index());
    v3 received = scale3(albedo, weight * layer_share(scene, &elements.hit, light.direction));
#ifdef LINKS_LOBES
    received = mad3(lobe_share(scene, &elements.hit, light.direction), lobe_weight, received);
#endif
    c = light_connection(&elements.hit, &light, received, hit, counters);
#endif
  }
  scatter3(seen, slot * SEEN_WORDS, sent);
  scatter3(seen + 3, slot * SEEN_WORDS, indirect);
  write_connection(shadows, block, &c, &elements.hit, slot, slot_count);
}

// The mean of `directions` rays: what elements send, and what the hits do. Samples that are not finite are left out.
FN uint audit_means(global const float* seen, global const float* slots, uint directions, float* means) {
  uint lost = 0u;
  for (uint k = 0; k < SEEN_WORDS; ++k) means[k] = 0.0f;
  for (uint r = 0; r < directions; ++r) {
    global const float* row = seen + SEEN_WORDS * r;
    global const float* slot = slots + SLOT_WORDS * r;
    int fine = finite_words(slot, 3u);
    for (uint k = 0; k < 3u && fine; ++k) {
      means[k] += row[k];
      means[3u + k] += row[3u + k] + slot[k];
    }
    lost += fine ? 0u : 1u;
  }
  for (uint k = 0; k < SEEN_WORDS; ++k) means[k] /= (float)directions;
  return lost;
}

// `shown`: what links_interpolate gave, RGB a point.
kernel void links_audit_sum(global const LinksParameters* restrict parameters, uint count,
                            global const float* restrict points, global const float* restrict shown,
                            global const float* restrict seen, global const float* restrict slots,
                            global float* restrict records, global uint* restrict report) {
  uint number = (uint)get_global_id(0);
  if (number >= count) return;
  global const float* point = points + POINT_WORDS * number;
  global float* record = records + AUDIT_WORDS * number;
  int exists = as_uint(point[POINT_TRIANGLE]) != GLEANER_NONE;
  uint directions = parameters->directions, lost = 0u;
  for (uint k = 0; k < 3u; ++k) record[AUDIT_SHOWN + k] = exists ? shown[3u * number + k] : 0.0f;
  for (uint h = 0; h < 2u; ++h) {
    float means[SEEN_WORDS];
    ulong ray = (ulong)directions * (2u * number + h);
    lost += audit_means(seen + SEEN_WORDS * ray, slots + SLOT_WORDS * ray, directions, means);
    for (uint k = 0; k < 3u; ++k) {
      float factor = exists ? point[POINT_ALBEDO + k] : 0.0f;
      record[AUDIT_BY_ELEMENTS + 3u * h + k] = exists ? factor * means[k] : 0.0f;
      record[AUDIT_HALVES + 3u * h + k] = exists ? factor * means[3u + k] : 0.0f;
    }
  }
  report_lost(report, number, lost);
}
