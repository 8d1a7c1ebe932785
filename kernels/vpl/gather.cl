// Light from virtual point lights at points. Stage kind "vpl_shade".
//
//   vpl_memberships   the FUZZINESS nearest point clusters of each point, with weights by distance   (eq. 9-10)
//   vpl_gather        for each light that one of them sees
//                       visibility = sum of the weights of the clusters that see it                  (eq. 6)
//                       radiance  += visibility * flux * bounded geometry term * reflectance
//                     a near cluster of VPLs shines from its members' places
//   residual samples  how far the clusters' visibility is off, measured and corrected     (kernels/vpl/residual.cl)
//   vpl_resolve       a pixel's samples -> its record
//
// A point near no cluster is unclustered: it queries lights itself.

// How steeply a cluster's place may rise above a point's plane (as a sine) for the two to be of one surface.
#define SAME_SURFACE 0.25f

#include "kernels/cluster_grid.h"
#include "kernels/lost_samples.h"
#include "kernels/vpl/lobes.h"
#include "kernels/vpl/memberships.h"
#include "kernels/wide.h"

// Algorithm 2. Rows of no meaning have weight 0.
kernel WIDE void vpl_memberships(global const VplPointParameters* restrict parameters,
                                 global const float* restrict points, uint count, global const float* restrict grid,
                                 global const uint* restrict cells, global const float* restrict seeds,
                                 float least_cosine, global uint* restrict rows, global float* restrict weights,
                                 global uint* restrict unclustered) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(points, min(lane, (vu)(count - 1u)) * POINT_WORDS, w);
  vi active = (as_vu(w[POINT_TRIANGLE]) != GLEANER_NONE) & (lane < count);
  vf best[FUZZINESS];
  vu who[FUZZINESS];
  nearest_seeds(words3(w, POINT_POSITION), words3(w, POINT_NORMAL), active, grid, cells, seeds, least_cosine, best,
                who);
  // A point on a representative is that one's alone.
  vi on_it = best[0] <= zero_f();
  vf total = zero_f();
  vf share[FUZZINESS];
  for (uint f = 0; f < FUZZINESS; ++f) {
    share[f] = parameters->equal_weights ? one_f() : one_f() / sqrt(best[f]);
    share[f] = pick(share[f], f == 0u ? one_f() : zero_f(), on_it);
    share[f] = pick(zero_f(), share[f], who[f] != GLEANER_NONE);
    total += share[f];
  }
  for (uint f = 0; f < FUZZINESS; ++f) {
    store_u(rows + (ulong)FUZZINESS * first_lane + f * LANES, 0, pick_u((vu)0u, who[f], who[f] != GLEANER_NONE));
    store_f(weights + (ulong)FUZZINESS * first_lane + f * LANES, 0, pick(zero_f(), share[f] / total, total > zero_f()));
  }
  store_u(unclustered + first_lane, 0, pick_u((vu)0u, (vu)1u, active & (who[0] == GLEANER_NONE)));
}

#ifdef NEED_LOBE
// As light_brings(), where the point or the light has a rough lobe.
FN v3 lobes_bring(const Scene* scene, global const float* light, v3 flux, v3 p, v3 n, const PointLobe* lobe,
                  vf clamp_to, vf* inverse_out, v3* glossy) {
  vf at_point, side, inverse;
  uint light_table = ((global const uint*)light)[VPL_TABLE];
  vf g = geometry_of(light, p, n, (vf)INFINITY, &at_point, &side, &inverse);
  *inverse_out = inverse;
  vi facing = g > zero_f();
  vf r = sqrt(inverse), gain = one_f(), cosine = pick(one_f(), side * r, facing);
  vf left = light_table != GLEANER_NONE ? left_at(scene, (vu)light_table, (vf)light[VPL_ROW], cosine) : one_f();
  v3 q = uniform3(light[VPL_POSITION], light[VPL_POSITION + 1], light[VPL_POSITION + 2]);
  v3 toward = scale3(sub3(q, p), r);
  if (light[VPL_ALPHA] > 0.0f) {
    v3 normal = uniform3(light[VPL_NORMAL], light[VPL_NORMAL + 1], light[VPL_NORMAL + 2]);
    v3 incoming = uniform3(light[VPL_INCOMING], light[VPL_INCOMING + 1], light[VPL_INCOMING + 2]);
    v3 sent = uniform3(light[VPL_SENT], light[VPL_SENT + 1], light[VPL_SENT + 2]);
    v3 f0 = uniform3(light[VPL_F0], light[VPL_F0 + 1], light[VPL_F0 + 2]);
    vf f90 = (vf)light[VPL_F90];
    v3 value = rough_lobe(f0, f90, (vf)light[VPL_ALPHA], normal, incoming, negate3(toward));
    v3 layer = layer_flux(flux, mul3(sent, mean_lobe(f0, f90, dot3(normal, incoming))));
    flux = add3(scale3(layer, left), mul3(sent, value));
    gain = lobe_gain(value);
  } else {
    flux = scale3(flux, left);
  }
  v3 own = splat3(zero_f());
  if (lobe->lobes) {
    own = rough_lobe(lobe->f0, lobe->f90, pick(one_f(), lobe->alpha, lobe->rough), n, lobe->view, toward);
    own = pick3(splat3(zero_f()), own, lobe->rough & facing);
    gain *= lobe_gain(own);
  }
  g = pick(zero_f(), min_f(g, clamp_to / gain), facing);
  flux = pick3(splat3(zero_f()), scale3(flux, g), facing);
  if (lobe->lobes) *glossy = mul3(flux, mul3(own, lobe->throughput));
  if (lobe->tables)
    flux = scale3(flux, left_at(scene, lobe->table, lobe->table_row, pick(one_f(), at_point * r, facing)));
  return flux;
}
#endif

// Contribution of an unshadowed light to a point: to the diffuse layer, and to `glossy` what the point's rough lobe
// makes of it. The geometry term is bounded (eq. 4), together with the lobes' gain at both ends; lobes take their part
// from the layers below them.
FN v3 plain_light_brings(const Scene* scene, global const float* light, v3 p, v3 n, const PointLobe* lobe, vf clamp_to,
                         vf* inverse_out, v3* glossy) {
  v3 flux = uniform3(light[VPL_FLUX], light[VPL_FLUX + 1], light[VPL_FLUX + 2]);
  *glossy = splat3(zero_f());
  vf at_point, side;
#ifdef NEED_LOBE
  if (lobe->lobes || light[VPL_ALPHA] > 0.0f)
    return lobes_bring(scene, light, flux, p, n, lobe, clamp_to, inverse_out, glossy);
  uint light_table = ((global const uint*)light)[VPL_TABLE];
  vf g = geometry_of(light, p, n, clamp_to, &at_point, &side, inverse_out);
  vf r = sqrt(*inverse_out);
  if (lobe->tables) g *= left_at(scene, lobe->table, lobe->table_row, at_point * r);
  if (light_table != GLEANER_NONE) g *= left_at(scene, (vu)light_table, (vf)light[VPL_ROW], side * r);
  return scale3(flux, g);
#else
  vf g = geometry_of(light, p, n, clamp_to, &at_point, &side, inverse_out);
  return scale3(flux, g);
#endif
}

// The same, less what geometry takes of it.
FN v3 light_brings(const Scene* scene, global const float* light, v3 p, v3 n, const PointLobe* lobe, vf clamp_to,
                   vf* inverse_out, v3* glossy) {
  v3 brought = plain_light_brings(scene, light, p, n, lobe, clamp_to, inverse_out, glossy);
#ifdef NEED_BENT_NORMALS
  v3 q = uniform3(light[VPL_POSITION], light[VPL_POSITION + 1], light[VPL_POSITION + 2]);
  vf share = lit_at_point(lobe, n, sub3(q, p));
  *glossy = scale3(*glossy, share);
  brought = scale3(brought, share);
#endif
  return brought;
}

// A point in deep shadow is as exact as one that gets this share of the contributions of the lights its clusters see.
#define LEAST_LIT_SHARE 0.1f

// Over one slice of the lights, which the sixteen points of a block share. `own`: point `chosen[i]` reads row i of
// `bits`, which holds its slice alone; else every point reads its clusters' rows of `bits`.
kernel WIDE void vpl_gather(global const VplPointParameters* restrict parameters, SCENE_PARAMETERS,
                            global const float* restrict points, global const uint* restrict chosen, uint own,
                            uint count, global const float* restrict lights, uint width, uint slices,
                            global const uint* restrict bits, uint row_words, global const uint* restrict rows,
                            global const float* restrict weights, uint behind, global float* restrict radiance,
                            global float* restrict level, global const float* restrict lobes) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu lane = (vu)first_lane + lane_index();
  uint leader = own ? chosen[first_lane] : first_lane;
  vu point = own ? load_u(chosen + first_lane, 0) : lane;
  vi active = (lane < count) & (point != GLEANER_NONE);
  point = pick_u((vu)leader, point, active);
  vf w[16];
  load_words(points, point * POINT_WORDS, w);
  active = active & (as_vu(w[POINT_TRIANGLE]) != GLEANER_NONE);
  v3 sum = splat3(zero_f()), glossy = sum;
  vf unshadowed = zero_f();
  if (any_lane(active)) {
    v3 p = words3(w, POINT_POSITION), n = words3(w, POINT_NORMAL);
    PointLobe lobe = load_point_lobe(scene, w, lobes, point, active);
    uint words = width / 32u;
    uint slice = (leader >> 4) & (slices - 1u);
    vf clamp_to = (vf)parameters->clamp;
    vu row[FUZZINESS];
    vf weight[FUZZINESS];
    if (own) {
      for (uint f = 0; f < FUZZINESS; ++f) {
        row[f] = lane * words;
        weight[f] = f == 0u ? one_f() : zero_f();
      }
    } else {
      load_memberships(rows, weights, first_lane, row_words, slice * words, row, weight);
    }
    for (uint word = 0; word < words; ++word) {
      vu seen[FUZZINESS];
      vu any = (vu)0u;
      for (uint f = 0; f < FUZZINESS; ++f) {
        seen[f] = visible_lights(bits, row[f] + word, active & (weight[f] > zero_f()));
        any |= seen[f];
      }
      uint pending = any_bits(any);
      global const float* l = lights + (ulong)VPL_WORDS * (slice * width + 32u * word);
      for (; pending; pending &= pending - 1u) {
        uint k = 31u - clz(pending & (0u - pending));
        global const float* light = l + VPL_WORDS * k;
        vf visible = zero_f();
        for (uint f = 0; f < FUZZINESS; ++f) visible += pick(zero_f(), weight[f], (seen[f] & (1u << k)) != 0u);
        vf inverse;
        v3 gloss;
        v3 brought = light_brings(scene, light, p, n, &lobe, clamp_to, &inverse, &gloss);
        vi near = active & is_near(light, inverse);
        if (any_lane(near)) {
          v3 all = splat3(zero_f()), all_gloss = all;
          global const float* member = lights + (ulong)VPL_WORDS * first_member(light);
          for (uint left = light_members(light); left; --left, member += VPL_WORDS) {
            v3 its_gloss;
            all = add3(all, light_brings(scene, member, p, n, &lobe, clamp_to, &inverse, &its_gloss));
            all_gloss = add3(all_gloss, its_gloss);
          }
          brought = pick3(brought, all, near);
          gloss = pick3(gloss, all_gloss, near);
        }
        sum = mad3(brought, visible, sum);
        glossy = mad3(gloss, visible, glossy);
        unshadowed += brought.y;
      }
    }
    if (!own)
      store_f(level + first_lane, 0, pick(zero_f(), max_f(luminance(sum), LEAST_LIT_SHARE * unshadowed), active));
    sum = pick3(splat3(zero_f()), add3(mul3(sum, words3(w, POINT_ALBEDO)), glossy), active);
  } else if (!own) {
    store_f(level + first_lane, 0, zero_f());
  }
  // Others of a listed block write behind the points.
  vu at = pick_u(own ? (vu)behind : lane, point, active) * 3u;
  scatter3(radiance, at, sum);
}

// A pixel's samples, in their order, each of which saw a slice of the lights: their sum saw all of them. What was
// sampled of the clusters' error is subtracted as far as it exceeds its own noise (James & Stein 1961).
kernel void vpl_resolve(global const VplPointParameters* restrict parameters, uint count,
                        global const float* restrict radiance, global const float* restrict sampled,
                        global float* restrict records, global uint* restrict report) {
  uint item = (uint)get_global_id(0);
  if (item >= count) return;
  uint samples = parameters->samples;
  float sum[3] = {0, 0, 0}, change[3] = {0, 0, 0}, square = 0;
  for (uint s = 0; s < samples; ++s) {
    uint path = ((item >> 4) * samples + s) * 16u + (item & 15u);
    for (uint k = 0; k < 3; ++k) sum[k] += radiance[3 * path + k];
    for (uint k = 0; k < 3; ++k) change[k] += sampled[4 * path + k];
    square += sampled[4 * path + 3];
  }
  float mean = luminance_of(change[0], change[1], change[2]);
  float share = mean * mean > square ? 1.0f - square / (mean * mean) : 0.0f;
  int fine = 1;
  for (uint k = 0; k < 3; ++k) {
    // Where all its light is in question, the sum may come out below nothing.
    float all = sum[k] + share * change[k];
    fine = fine && fabs(all) <= 3.402823466e38f;
    sum[k] = all > 0.0f ? all : 0.0f;
  }
  report_lost(report, item, fine ? 0u : samples);
  for (uint k = 0; k < 3; ++k) records[3 * item + k] = fine ? sum[k] : 0.0f;
}
