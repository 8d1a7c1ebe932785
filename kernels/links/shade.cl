// Pixels lit by their vertices. Stage kind "links_shade".
//
//   vpl_camera_rays, trace, vpl_point_step   the point that each camera path sees     (kernels/vpl/points.cl)
//   links_interpolate                        irradiance between the vertices about it, times its albedo over pi
//   links_resolve                            a pixel's samples -> its record
#include "kernels/links/mesh.h"
#include "kernels/lost_samples.h"
#include "kernels/vpl_records.h"
#include "kernels/wide.h"

// `irradiance`: rows of RADIOSITY_WORDS.
kernel WIDE void links_interpolate(SCENE_PARAMETERS, global const uint* restrict mesh,
                                   global const float* restrict irradiance, global const float* restrict points,
                                   uint count, global float* restrict radiance) {
  uint block = (uint)get_global_id(0);
  uint first_lane = block * LANES;
  if (first_lane >= count) return;
  Scene scene_value = SCENE_FROM_PARAMETERS;
  const Scene* scene = &scene_value;
  vu lane = (vu)first_lane + lane_index();
  vf w[16];
  load_words(points, min(lane, (vu)(count - 1u)) * POINT_WORDS, w);
  vi active = (as_vu(w[POINT_TRIANGLE]) != GLEANER_NONE) & (lane < count);
  v3 sum = splat3(zero_f());
  if (any_lane(active)) {
    Mesh m = load_mesh(mesh);
    vu triangle = pick_u((vu)0u, as_vu(w[POINT_TRIANGLE]), active);
    vf b1 = pick(zero_f(), w[POINT_B1], active), b2 = pick(zero_f(), w[POINT_B2], active);
    Hit h = load_hit(scene, triangle, (vu)GLEANER_NONE, b1, b2, active);
    // The point's normal is the hit's, on the viewer's side.
    vu side = pick_u((vu)0u, (vu)1u, dot3(h.normal, words3(w, POINT_NORMAL)) < zero_f());
    Corners c = corners_at(&m, triangle, b1, b2);
    vf outside[3];
    for (uint k = 0; k < 3u; ++k)
      outside[k] = gather_f(irradiance + RADIOSITY_OUTSIDE, (c.vertex[k] * 2u + side) * RADIOSITY_WORDS);
    weigh_outside(&c, outside);
    for (uint k = 0; k < 3u; ++k)
      sum = mad3(gather3(irradiance + RADIOSITY_IRRADIANCE, (c.vertex[k] * 2u + side) * RADIOSITY_WORDS), c.weight[k],
                 sum);
    sum = pick3(splat3(zero_f()), mul3(sum, words3(w, POINT_ALBEDO)), active);
  }
  scatter3(radiance, lane * 3u, sum);
}

// A pixel's samples, in their order.
kernel void links_resolve(uint samples, uint count, global const float* restrict radiance,
                          global float* restrict records, global uint* restrict report) {
  uint item = (uint)get_global_id(0);
  if (item >= count) return;
  float sum[3] = {0, 0, 0};
  for (uint s = 0; s < samples; ++s) {
    uint path = ((item >> 4) * samples + s) * 16u + (item & 15u);
    for (uint k = 0; k < 3u; ++k) sum[k] += radiance[3u * path + k];
  }
  int fine = 1;
  for (uint k = 0; k < 3u; ++k) fine = fine && fabs(sum[k]) <= 3.402823466e38f;
  report_lost(report, item, fine ? 0u : samples);
  for (uint k = 0; k < 3u; ++k) records[3u * item + k] = fine ? sum[k] / (float)samples : 0.0f;
}
