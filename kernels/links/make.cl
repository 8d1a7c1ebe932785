// Links between elements. Stage kind "links_make".
//
//   for each element, for each of its directions
//     links_rays       (kernels/links/rays.h) 16 neighbouring directions at once: a point of the one-ring, a
//     cosine-weighted ray
//   trace              closest hits
//   links_hits         three links a hit, to the vertices about it, weighted by its barycentric coordinates
//   links_compress     links of the same end become one; the element's row is packed
//
// A link's weight is the share of the element's hemisphere that its rays see of the other's hat function, less what
// opacity and the layers above both diffuse layers take.
#ifndef LINKS_LOBES
#define SEES_NO_COLOR
#endif
#include "kernels/links/rays.h"

// ENDS ends and weights a ray: three, and with lobes as many more for what these send; weight 0: no link.
#ifdef LINKS_LOBES
#define ENDS 6u
#else
#define ENDS 3u
#endif

kernel WIDE void links_hits(SCENE_PARAMETERS, global const uint* restrict mesh, global const uint* restrict lobes,
                            global const uint* restrict sides, uint count, global const float* restrict rays,
                            global uint* restrict ends, global float* restrict weights) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vf weight = row_f(rays, LINK_ROWS, block, ROW_WEIGHT);
  vi hit = (weight > zero_f()) & (row_u(rays, LINK_ROWS, block, ROW_GEOMETRY) != GLEANER_NONE);
  vu to = ((vu)first_lane + lane_index()) * ENDS;
  if (!any_lane(hit)) {
    for (uint k = 0; k < ENDS; ++k) scatter_f(weights + k, to, zero_f());
    return;
  }
  Mesh m = load_mesh(mesh);
  SeenElements seen = seen_elements(scene, &m, lobes, sides, rays, block, hit);
  for (uint k = 0; k < 3u; ++k) {
    scatter_u(ends + k, to, LINK_END(seen.element[k], m.elements >> 1));
    scatter_f(weights + k, to, seen.weight[k]);
#ifdef LINKS_LOBES
    scatter_u(ends + 3u + k, to, seen.lobe[k]);
    scatter_f(weights + 3u + k, to, seen.lobe_weight[k]);
#endif
  }
}

#define WEIGHT_UNITS 65535u

// Merges links of one end, in place and in the order of the rays; returns how many are left. `place`: `slots` words, a
// power of two.
uint merge_links(global uint* end, global float* weight, uint raw, global uint* place, uint slots) {
  for (uint k = 0; k < slots; ++k) place[k] = 0u;
  uint links = 0u;
  for (uint k = 0; k < raw; ++k) {
    float w = weight[k];
    if (!(w > 0.0f)) continue;
    uint id = end[k], slot = (id * 0x9e3779b1u) & (slots - 1u);
    while (place[slot] != 0u && end[place[slot] - 1u] != id) slot = (slot + 1u) & (slots - 1u);
    if (place[slot] == 0u) {
      end[links] = id;
      weight[links] = w;
      place[slot] = ++links;
    } else {
      weight[place[slot] - 1u] += w;
    }
  }
  return links;
}

uint drop_empty_links(global uint* end, global float* weight, uint raw) {
  uint links = 0u;
  for (uint k = 0; k < raw; ++k)
    if (weight[k] > 0.0f) {
      end[links] = end[k];
      weight[links++] = weight[k];
    }
  return links;
}

// One work-item an element: row `element` of `packed`, of 2 * ENDS * directions words; `words` gets how many of them it
// uses. `table`: `slots` words for each; `plain`: elements of the mesh.
kernel void links_compress(global const LinksParameters* restrict parameters, uint count, uint plain, uint slots,
                           global uint* ends, global float* weights, global uint* restrict table,
                           global uint* restrict packed, global uint* restrict words) {
  uint element = (uint)get_global_id(0);
  if (element >= count) return;
  uint raw = ENDS * parameters->directions;
  global uint* end = ends + (ulong)raw * element;
  global float* weight = weights + (ulong)raw * element;
  uint links = parameters->compress ? merge_links(end, weight, raw, table + (ulong)slots * element, slots)
                                    : drop_empty_links(end, weight, raw);
  global uint* row = packed + (ulong)(2u * raw) * element;
  for (uint k = 0; k < links; ++k) row[k] = end[k];
  float scale = 1.0f / (float)parameters->directions;
  if (parameters->exact) {
    for (uint k = 0; k < links; ++k) row[links + k] = as_uint(weight[k] * scale);
    words[element] = 2u * links;
    return;
  }
  // The running sum is rounded, so that the weights' sum is right to one unit, and at most 1: of layers and of lobes.
  float sum[2] = {0.0f, 0.0f};
  uint before[2] = {0u, 0u};
  for (uint k = 0; k < links; ++k) {
    uint of_lobe = end[k] < plain ? 0u : 1u;
    sum[of_lobe] += weight[k] * scale;
    uint now = min((uint)(min(sum[of_lobe], 1.0f) * (float)WEIGHT_UNITS + 0.5f), WEIGHT_UNITS);
    uint units = now - before[of_lobe];
    before[of_lobe] = now;
    global uint* pair = row + links + (k >> 1);
    *pair = k & 1u ? *pair | (units << 16) : units;
  }
  words[element] = links + (links + 1u) / 2u;
}
