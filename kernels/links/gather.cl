// One bounce of light: every element gathers over its links what the others send. Stage kind "links_gather".
//
//   for each element
//     irradiance = sum over its links of weight * what the link's end sends               (eq. 3)
//     sends      = albedo * (direct light + irradiance)                                   (eq. 4)
//     noise of the irradiance, where it is asked for
//
// After k such stages, each of which reads the last one's whole vector, light of k bounces is there.
#include "kernels/lanes.h"
#include "kernels/links_records.h"

// What the end of a link sends. An end that is no element sends what the last one does, and is told of.
FN float4 sent_by(global const float4* sent, uint end, uint last, uint* beyond) {
  *beyond |= end > last ? 1u : 0u;
  return sent[min(end, last)];
}

// With what each sum rounds away (Kahan 1965): hundreds of links would round to more than one part in a million.
FN float4 gather_exact(global const float4* sent, global const uint* ends, uint links, uint last, uint* beyond) {
  float4 sum = (float4)(0.0f), lost = (float4)(0.0f);
  for (uint k = 0; k < links; ++k) {
    float4 term = as_float(ends[links + k]) * sent_by(sent, ends[k], last, beyond) - lost;
    float4 next = sum + term;
    lost = (next - sum) - term;
    sum = next;
  }
  return sum;
}

#if LANES == 16
// Links are read once, in two short runs a row, which processors do not load ahead by themselves.
FN void load_ahead(global const uint* words) { __builtin_prefetch((const void*)(size_t)(words + 512)); }
#else
FN void load_ahead(global const uint* words) {}
#endif

// Two weights a word, in units of 1 / 65535. Four sums: one would wait for itself at each link.
FN float4 gather_packed(global const float4* sent, global const uint* ends, uint links, uint last, uint* beyond) {
  global const uint* weights = ends + links;
  float4 sum[4] = {(float4)(0.0f), (float4)(0.0f), (float4)(0.0f), (float4)(0.0f)};
  uint k = 0u;
  for (; k + 15u < links; k += 16u) {
    load_ahead(ends + k);
    load_ahead(weights + (k >> 1));
    uint16 end = vload16(0, ends + k);
    if (any(end > last)) {
      *beyond = 1u;
      return sum[0];
    }
    float16 weight = convert_float16(vload16(0, (global const ushort*)(weights + (k >> 1))));
#define FOUR(i, a, b, c, d)                       \
  sum[0] += weight.s##a * sent[ends[k + i]];      \
  sum[1] += weight.s##b * sent[ends[k + i + 1u]]; \
  sum[2] += weight.s##c * sent[ends[k + i + 2u]]; \
  sum[3] += weight.s##d * sent[ends[k + i + 3u]];
    FOUR(0u, 0, 1, 2, 3)
    FOUR(4u, 4, 5, 6, 7)
    FOUR(8u, 8, 9, a, b)
    FOUR(12u, c, d, e, f)
#undef FOUR
  }
  for (; k + 3u < links; k += 4u) {
    uint low = weights[k >> 1], high = weights[(k >> 1) + 1u];
    sum[0] += (float)(low & 0xffffu) * sent_by(sent, ends[k], last, beyond);
    sum[1] += (float)(low >> 16) * sent_by(sent, ends[k + 1u], last, beyond);
    sum[2] += (float)(high & 0xffffu) * sent_by(sent, ends[k + 2u], last, beyond);
    sum[3] += (float)(high >> 16) * sent_by(sent, ends[k + 3u], last, beyond);
  }
  for (; k < links; ++k) {
    uint pair = weights[k >> 1];
    sum[0] += (float)(k & 1u ? pair >> 16 : pair & 0xffffu) * sent_by(sent, ends[k], last, beyond);
  }
  return ((sum[0] + sum[1]) + (sum[2] + sum[3])) * (1.0f / 65535.0f);
}

FN float weight_of(global const uint* weights, uint k, uint exact) {
  if (exact) return as_float(weights[k]);
  uint pair = weights[k >> 1];
  return (float)(k & 1u ? pair >> 16 : pair & 0xffffu) * (1.0f / 65535.0f);
}

// Standard deviation of an element's irradiance, of its noisiest channel, were its rays independent. They are not, but
// spread evenly, which is less noisy. A link's light counts as if a whole ray saw its end: convexity has that no less
// than what three ends together show.
FN float noise_of(global const float4* sent, global const uint* ends, uint links, uint last, uint exact,
                  uint directions, float4 mean) {
  float4 squares = (float4)(0.0f);
  for (uint k = 0; k < links; ++k) {
    float4 light = sent[min(ends[k], last)];
    squares += weight_of(ends + links, k, exact) * light * light;
  }
  float4 variance = squares - mean * mean;
  return sqrt(fmax(fmax(fmax(variance.x, variance.y), variance.z), 0.0f) / (float)directions);
}

// Elements base to count - 1 of a batch. `words`: their links, those of element e from starts[e] on. `sent`: of all
// elements. Elements with an end that is none count in `faults`.
kernel void links_gather(global const LinksGatherParameters* restrict parameters, uint base, uint count,
                         global const uint* restrict words, global const uint* restrict starts,
                         global const float4* restrict sent, global const float4* restrict light,
                         global const float4* restrict albedo, global float4* restrict records,
                         global uint* restrict faults) {
  uint element = base + (uint)get_global_id(0);
  if (element >= count) return;
  uint first = starts[element], total = starts[element + 1u] - first, last = parameters->elements - 1u;
  uint beyond = 0u;
  uint links = parameters->exact ? total / 2u : 2u * total / 3u;
  float4 sum = parameters->exact ? gather_exact(sent, words + first, links, last, &beyond)
                                 : gather_packed(sent, words + first, links, last, &beyond);
  records[2u * element + 1u] = albedo[element] * (light[2u * element] + sum);
  if (parameters->directions)
    sum.w = noise_of(sent, words + first, links, last, parameters->exact, parameters->directions, sum);
  records[2u * element] = sum;
  if (beyond) atomic_inc(faults);
}
