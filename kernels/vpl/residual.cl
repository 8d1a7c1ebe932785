// Residual samples: how far the light of interpolated visibility is off, estimated with a few rays of each point's own
// and taken off again (control variates). Stage kind "vpl_shade", where the setting vpl.residual_threshold is above 0.
//
//   vpl_residual_select   for each light, its possible contribution (less where the point's clusters agree):
//                           above the point's threshold -> selected for certain
//                           else -> selected with a chance in proportion to it (systematic sampling)
//   vpl_residual_rays     a visibility ray for each, and what radiance its answer is worth
//   trace                 any hit
//   vpl_residual_apply    radiance += worth / chance * (answer - interpolated visibility)
//
// A point near no cluster has no other light than what it selects.
#include "kernels/sampling.h"
#include "kernels/transport/visibility.h"
#include "kernels/vpl/lobes.h"
#include "kernels/vpl/memberships.h"
#include "kernels/wide.h"

// What lights on which the point's clusters agree count for.
#define AGREED 0.2f
// Lights too weak to be certain, were they so many times brighter, are looked at one in so many.
#define SUBSAMPLING 4u
#define SUBSAMPLED_BITS 0x11111111u

// Upper bound of the contribution of any of the 32 lights in `box` to a point: both cosines are at most 1, the point's
// at most what its plane leaves.
FN vf most_of_box(global const float* box, v3 p, v3 n, vf clamp_to) {
  v3 beyond = make3(max_f(fabs(p.x - box[0]) - box[3], zero_f()), max_f(fabs(p.y - box[1]) - box[4], zero_f()),
                    max_f(fabs(p.z - box[2]) - box[5], zero_f()));
  vf above = n.x * (box[0] - p.x) + n.y * (box[1] - p.y) + n.z * (box[2] - p.z) + fabs(n.x) * box[3] +
             fabs(n.y) * box[4] + fabs(n.z) * box[5];
  vf near2 = dot3(beyond, beyond);
  return min_f(clamp_to, min_f(one_f(), max_f(above, zero_f()) / sqrt(near2)) / near2) * box[LIGHT_BOX_BRIGHTEST];
}

// What an unclustered point would get of the slice's lights, from every SUBSAMPLING-th of them.
FN vf subsampled_light(global const float* first_light, uint width, uint random, v3 p, v3 n, vf clamp_to) {
  vf all = zero_f();
  for (uint k = random & (SUBSAMPLING - 1u); k < width; k += SUBSAMPLING) {
    global const float* light = first_light + VPL_WORDS * k;
    vf at_point, side, inverse;
    all += geometry_of(light, p, n, clamp_to, &at_point, &side, &inverse) * light_luminance(light);
  }
  return all;
}

// Which of a word's 32 lights the point's clusters disagree about.
FN vu disputed_lights(global const uint* bits, const vu* row, const vf* weight, uint word, vi open) {
  vu any = (vu)0u, all = (vu)0xffffffffu;
  for (uint f = 0; f < FUZZINESS; ++f) {
    vi member = open & (weight[f] > zero_f());
    vu seen = visible_lights(bits, row[f] + word, member);
    any |= seen;
    all &= pick_u((vu)0xffffffffu, seen, member);
  }
  return any & ~all;
}

// At most MAX_RESIDUAL_SAMPLES a point; `counts`: how many. `level`: each point's light by its clusters.
kernel WIDE void vpl_residual_select(global const VplPointParameters* restrict parameters,
                                     global const float* restrict points, uint count,
                                     global const float* restrict lights, global const float* restrict boxes,
                                     uint width, uint slices, global const uint* restrict bits, uint row_words,
                                     global const uint* restrict rows, global const float* restrict weights,
                                     global const float* restrict level, global uint* restrict selected, uint behind,
                                     global uint* restrict counts, global float* restrict spacings) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(points, min(lane, (vu)(count - 1u)) * POINT_WORDS, w);
  vi active = (as_vu(w[POINT_TRIANGLE]) != GLEANER_NONE) & (lane < count);
  if (!any_lane(active)) {
    store_u(counts + first_lane, 0, (vu)0u);
    return;
  }
  vu row[FUZZINESS];
  vf weight[FUZZINESS];
  uint words = width / 32u;
  uint slice = (first_lane >> 4) & (slices - 1u);
  load_memberships(rows, weights, first_lane, row_words, slice * words, row, weight);
  vi unclustered = active & none(weight[0] > zero_f());
  // A sole cluster has nobody to disagree with.
  vu alone = (vu)0u;
  if (FUZZINESS > 1u) alone = pick_u((vu)0xffffffffu, (vu)0u, weight[1u % FUZZINESS] > zero_f());
  alone = pick_u(alone, (vu)0xffffffffu, unclustered);
  v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL);
  vf clamp_to = (vf)parameters->clamp;
  global const float* first_light = lights + (ulong)VPL_WORDS * (slice * width);
  uint shared_random = ((global const uint*)points)[(ulong)POINT_WORDS * first_lane + POINT_B1] * 0x9e3779b9u;
  // The samples of a pixel see a slice each: what one of them lacks is so much less of the pixel's light.
  vf spacing = load_f(level + first_lane, 0) * parameters->residual_threshold * (float)slices;
  if (any_lane(unclustered))
    spacing = pick(spacing,
                   subsampled_light(first_light, width, shared_random, p, n, clamp_to) *
                       (vf)(SUBSAMPLING / (0.75f * MAX_RESIDUAL_SAMPLES)),
                   unclustered);
  spacing = max_f(spacing, (vf)1e-30f);
  vu random = hash_combine(hash_combine(as_vu(w[POINT_B1]), as_vu(w[POINT_B2])), (vu)parameters->pass);
  vf offset = to_f(random >> 8) * (vf)5.9604644775390625e-8f;
  vu found = (vu)0u;
  // A point that selects more than there is room for begins again and selects fewer.
  vi open = active;
  while (any_lane(open)) {
    vf threshold = offset * spacing, passed = zero_f();
    found = pick_u(found, (vu)0u, open);
    for (uint word = 0; word < words; ++word) {
      vu disputed_bits = disputed_lights(bits, row, weight, word, open) | alone;
      // The same ones for all lanes. No number of this launch enters: pixels are the same in any batch.
      uint subsampled = SUBSAMPLED_BITS << (any_bits(hash_u((vu)(shared_random + word))) & (SUBSAMPLING - 1u));
      global const float* l = first_light + VPL_WORDS * 32u * word;
      vf most = most_of_box(boxes + LIGHT_BOX_WORDS * (slice * words + word), p, n, clamp_to);
      vi is_subsampled = most * (vf)(float)SUBSAMPLING <= spacing;
      vf represents = pick(one_f(), (vf)(float)SUBSAMPLING, is_subsampled);
      for (uint looked = any_lane(open & none(is_subsampled)) ? 0xffffffffu : subsampled; looked;
           looked &= looked - 1u) {
        uint bit = looked & (0u - looked), k = 31u - clz(bit);
        global const float* light = l + VPL_WORDS * k;
        vf at_point, side, inverse;
        vf g = geometry_of(light, p, n, clamp_to, &at_point, &side, &inverse);
        vi near = open & is_near(light, inverse);
        vi disputed = (disputed_bits & bit) != 0u;
        // The light itself, then, where it is near, its members.
        uint members = any_lane(near) ? light_members(light) : 0u;
        uint row_of = slice * width + 32u * word + k;
        for (uint m = 0; m <= members; ++m) {
          if (m) {
            row_of = first_member(light) + m - 1u;
            global const float* member = lights + (ulong)VPL_WORDS * row_of;
            g = geometry_of(member, p, n, clamp_to, &at_point, &side, &inverse) * light_luminance(member);
          } else {
            g *= light_luminance(light);
          }
          vi eligible = open & (m ? near : none(near));
          vf contribution = pick(zero_f(), g * pick((vf)AGREED, one_f(), disputed) * represents, eligible);
          if (!(subsampled & bit)) contribution = pick(contribution, zero_f(), is_subsampled);
          vi certain = contribution >= spacing;
          passed += pick(contribution, zero_f(), certain);
          vi here = eligible & (certain | (passed > threshold));
          if (!any_lane(here)) continue;
          threshold += pick(zero_f(), spacing, here & none(certain));
          found += pick_u((vu)0u, (vu)1u, here);
          here = here & (found <= MAX_RESIDUAL_SAMPLES);
          vu at = pick_u((vu)behind, lane * MAX_RESIDUAL_SAMPLES + found - 1u, here);
          // Without an answer of a cluster there is nothing to correct, and no noise to weigh it against.
          vu stochastic = pick_u((vu)RESIDUAL_STOCHASTIC, (vu)0u, unclustered | (certain & none(is_subsampled)));
          vu agreed = pick_u((vu)RESIDUAL_AGREED, (vu)0u, disputed);
          vu sure =
              pick_u((vu)0u, pick_u((vu)RESIDUAL_CERTAIN, (vu)(RESIDUAL_CERTAIN | RESIDUAL_SUBSAMPLED), is_subsampled),
                     certain);
          scatter_u(selected, at, (vu)row_of | stochastic | agreed | sure);
        }
      }
    }
    open = open & (found > MAX_RESIDUAL_SAMPLES) & (spacing < (vf)INFINITY);
    spacing *= pick(one_f(), to_f(found) * (vf)(1.25f / MAX_RESIDUAL_SAMPLES), open);
  }
  store_u(counts + first_lane, 0, pick_u((vu)0u, min(found, (vu)MAX_RESIDUAL_SAMPLES), active));
  store_f(spacings + first_lane, 0, spacing);
}

#ifdef NEED_LOBE
// As lobes_bring() of kernels/vpl/gather.cl, of a light a lane: flux to the diffuse layer (before its own table and the
// geometry term), what the point's rough lobe makes of a unit of it, and the gain that the term's bound is divided by.
FN v3 lobe_flux(const Scene* scene, const vf* l, const vf* second, const PointLobe* lobe, v3 n, v3 toward, vf cosine,
                v3* own, vf* gain) {
  v3 flux = words3(l, VPL_FLUX), light_normal = words3(l, VPL_NORMAL);
  vf alpha = second[VPL_ALPHA - 16u];
  vi rough_light = alpha > zero_f();
  v3 layer = flux, sent = splat3(zero_f());
  *gain = one_f();
  if (any_lane(rough_light)) {
    v3 incoming = words3(second, VPL_INCOMING - 16u), f0 = words3(second, VPL_F0 - 16u);
    vf f90 = second[VPL_F90 - 16u];
    v3 value = rough_lobe(f0, f90, pick(one_f(), alpha, rough_light), light_normal, incoming, negate3(toward));
    v3 mean = mul3(words3(second, VPL_SENT - 16u), mean_lobe(f0, f90, dot3(light_normal, incoming)));
    layer = layer_flux(flux, pick3(splat3(zero_f()), mean, rough_light));
    sent = pick3(sent, mul3(words3(second, VPL_SENT - 16u), value), rough_light);
    *gain = pick(*gain, lobe_gain(value), rough_light);
  }
  *own = splat3(zero_f());
  if (lobe->lobes) {
    *own = rough_lobe(lobe->f0, lobe->f90, pick(one_f(), lobe->alpha, lobe->rough), n, lobe->view, toward);
    *own = pick3(splat3(zero_f()), *own, lobe->rough);
    *gain *= lobe_gain(*own);
  }
  return mad3(layer, left_at(scene, as_vu(l[VPL_TABLE]), l[VPL_ROW], cosine), sent);
}
#endif

// The rays of `count` residual samples, by their places; and their terms: what radiance the answer of each is worth,
// RGB.
kernel WIDE void vpl_residual_rays(global const VplPointParameters* restrict parameters, SCENE_PARAMETERS,
                                   global const float* restrict points, global const float* restrict lights,
                                   global const uint* restrict places, uint base, uint count,
                                   global const uint* restrict selected, global const float* restrict spacings,
                                   global float* restrict rays, global float* restrict terms,
                                   global const float* restrict lobes) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vi active = (vu)first_lane + lane_index() < count;
  vu place = gather_u(places, (vu)base + min((vu)first_lane + lane_index(), (vu)(count - 1u)));
  vf w[16], l[16], second[16], t[16];
  vu point = place / MAX_RESIDUAL_SAMPLES;
  load_words(points, point * POINT_WORDS, w);
  vu sample = gather_u(selected, place);
  vu at = (sample & (vu)RESIDUAL_LIGHT) * VPL_WORDS;
  load_words(lights, at, l);
  load_words(lights + 16u, at, second);
  vu triangle = as_vu(w[POINT_TRIANGLE]);
  load_words(scene->triangles, triangle * TRIANGLE_WORDS, t);
  v3 p0 = words3(t, TRIANGLE_P0);
  v3 e1 = sub3(words3(t, TRIANGLE_P1), p0), e2 = sub3(words3(t, TRIANGLE_P2), p0), error;
  v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL), q = words3(l, VPL_POSITION);
  v3 light_normal = words3(l, VPL_NORMAL), flux = words3(l, VPL_FLUX);
  vf clamp_to = (vf)parameters->clamp;
  vf at_point, side, inverse;
  vf g = bounded_geometry(p, n, q, light_normal, words3(l, VPL_GEOMETRIC), clamp_to, &at_point, &side, &inverse);
  vf contribution = g * luminance(flux) * pick(one_f(), (vf)AGREED, (sample & RESIDUAL_AGREED) != 0u);
  // One selected at random represents as much as lies between two thresholds.
  vf times = pick(gather_f(spacings, point) / contribution,
                  pick(one_f(), (vf)(float)SUBSAMPLING, (sample & RESIDUAL_SUBSAMPLED) != 0u),
                  (sample & RESIDUAL_CERTAIN) != 0u);
  v3 glossy = splat3(zero_f());
#if defined(NEED_LOBE) || defined(NEED_BENT_NORMALS)
  // Of all lanes: those behind the last sample write its term as well.
  PointLobe lobe = load_point_lobe(scene, w, lobes, point, all_lanes());
#endif
#ifdef NEED_LOBE
  vf r = sqrt(inverse), gain;
  v3 own;
  flux = lobe_flux(scene, l, second, &lobe, n, scale3(sub3(q, p), r), side * r, &own, &gain);
  g = bounded_geometry(p, n, q, light_normal, words3(l, VPL_GEOMETRIC), clamp_to / gain, &at_point, &side, &inverse);
  glossy = mul3(mul3(flux, own), lobe.throughput);
  flux = scale3(flux, left_at(scene, lobe.table, lobe.table_row, at_point * r));
#endif
#ifdef NEED_BENT_NORMALS
  g *= lit_at_point(&lobe, n, sub3(q, p));
#endif
  v3 term = scale3(add3(mul3(flux, words3(w, POINT_ALBEDO)), glossy), g * times);
  // Lanes behind the last sample write its own term once more.
  scatter3(terms, place * 3u, term);
  vu instance = (vu)0u;
#ifdef NEED_INSTANCES
  instance = as_vu(w[POINT_INSTANCE]);
  vf placing[16];
  load_words(scene->instances, instance_row(instance), placing);
  error = placed_error(placing, e1, e2, p);
  e1 = place_vector(placing, e1);
  e2 = place_vector(placing, e2);
#else
  surface_point(p0, e1, e2, w[POINT_B1], w[POINT_B2], &error);
#endif
  v3 start, direction;
  connect_points(p, error, normalize3(cross3(e1, e2)), q, words3(second, VPL_ERROR - 16u), words3(l, VPL_GEOMETRIC),
                 &start, &direction);
  active = active & finite3(start) & finite3(direction);
  set_visibility_ray(rays, block, start, direction, active, triangle, instance);
}

// What the answers change, point by point, sample by sample: at once where the light was certain to be queried. What
// was selected at random goes to `sampled`, its sum and the sum of its squared luminance.
kernel void vpl_residual_apply(uint count, global const uint* restrict firsts, global const uint* restrict counts,
                               global const uint* restrict selected, global const float* restrict terms,
                               global const uint* restrict answers, global const float* restrict lights, uint clusters,
                               global const uint* restrict bits, uint row_words, global const uint* restrict rows,
                               global const float* restrict weights, global float* restrict radiance,
                               global float* restrict sampled) {
  uint point = (uint)get_global_id(0);
  if (point >= count) return;
  float certain[3] = {0, 0, 0}, stochastic[3] = {0, 0, 0}, square = 0;
  ulong member = (ulong)FUZZINESS * (point / LANES * LANES) + point % LANES;
  for (uint k = 0; k < counts[point]; ++k) {
    uint place = point * MAX_RESIDUAL_SAMPLES + k;
    uint sample = selected[place], row = sample & RESIDUAL_LIGHT;
    // A member has the visibility that the point's clusters have of its VPL cluster.
    if (row >= clusters) row = ((global const uint*)lights)[(ulong)VPL_WORDS * row + VPL_FIRST];
    float interpolated = 0;
    for (uint f = 0; f < FUZZINESS; ++f) {
      float weight = weights[member + f * LANES];
      if (weight > 0.0f && ((bits[(ulong)rows[member + f * LANES] * row_words + row / 32u] >> (row & 31u)) & 1u))
        interpolated += weight;
    }
    uint ray = firsts[point] + k;
    float seen = (answers[ray >> 5] >> (ray & 31u)) & 1u ? 1.0f : 0.0f;
    float brought[3];
    for (uint c = 0; c < 3; ++c) brought[c] = terms[3 * place + c] * (seen - interpolated);
    if (sample & RESIDUAL_STOCHASTIC) {
      float much = luminance_of(brought[0], brought[1], brought[2]);
      square += much * much;
      for (uint c = 0; c < 3; ++c) stochastic[c] += brought[c];
    } else {
      for (uint c = 0; c < 3; ++c) certain[c] += brought[c];
    }
  }
  for (uint c = 0; c < 3; ++c) radiance[3 * point + c] += certain[c];
  for (uint c = 0; c < 3; ++c) sampled[4 * point + c] = stochastic[c];
  sampled[4 * point + 3] = square;
}
