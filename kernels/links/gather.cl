// One bounce of light: every element gathers over its links what the others send. Stage kind "links_gather".
//
//   for each element
//     irradiance = sum over its links of weight * what the link's end sends               (eq. 3)
//     sends      = albedo * (direct light + irradiance)                                   (eq. 4)
//
// After k such stages, each of which reads the last one's whole vector, light of k bounces is there.
#include "kernels/links_records.h"
#include "kernels/wide.h"

// Elements base to count - 1 of a batch. `words`: their links, those of element e from starts[e] on. An end that is no
// element counts in `faults` and is left out.
kernel void links_gather(global const LinksGatherParameters* restrict parameters, uint base, uint count,
                         global const uint* restrict words, global const uint* restrict starts,
                         global const float4* restrict radiosity, global const float4* restrict light,
                         global const float4* restrict albedo, global float4* restrict records,
                         global uint* restrict faults) {
  uint element = base + (uint)get_global_id(0);
  if (element >= count) return;
  uint first = starts[element], total = starts[element + 1u] - first, elements = parameters->elements;
  global const uint* ends = words + first;
  float4 sum = (float4)(0.0f);
  uint beyond = 0u;
  if (parameters->exact) {
    uint links = total / 2u;
    for (uint k = 0; k < links; ++k) {
      uint end = ends[k];
      beyond |= end >= elements ? 1u : 0u;
      sum += as_float(ends[links + k]) * radiosity[2u * min(end, elements - 1u) + 1u];
    }
  } else {
    uint links = 2u * total / 3u;
    global const uint* weights = ends + links;
    float4 odd = (float4)(0.0f);
    for (uint k = 0; k + 1u < links; k += 2u) {
      uint a = ends[k], b = ends[k + 1u], pair = weights[k >> 1];
      beyond |= (a >= elements ? 1u : 0u) | (b >= elements ? 1u : 0u);
      sum += (float)(pair & 0xffffu) * radiosity[2u * min(a, elements - 1u) + 1u];
      odd += (float)(pair >> 16) * radiosity[2u * min(b, elements - 1u) + 1u];
    }
    if (links & 1u) {
      uint a = ends[links - 1u];
      beyond |= a >= elements ? 1u : 0u;
      sum += (float)(weights[links >> 1] & 0xffffu) * radiosity[2u * min(a, elements - 1u) + 1u];
    }
    sum = (sum + odd) * (1.0f / 65535.0f);
  }
  records[2u * element] = sum;
  records[2u * element + 1u] = albedo[element] * (light[2u * element] + sum);
  if (beyond) atomic_inc(faults);
}
