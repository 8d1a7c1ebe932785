// How a virtual point light sees a point: the bounded geometry term (eq. 4 of Colom et al. 2022), and the members by
// which a near cluster of VPLs shines.
#ifndef GLEANER_KERNELS_VPL_GEOMETRY_H
#define GLEANER_KERNELS_VPL_GEOMETRY_H

#include "kernels/vec3.h"
#include "kernels/vpl_records.h"

// The bounded geometry term between a point and a light, 1/m^2. `side`: the cosine at the light, by its normal for
// shading, times the distance; `at_point` likewise; `inverse`: one over the squared distance.
FN vf bounded_geometry(v3 p, v3 n, v3 q, v3 light_normal, v3 light_geometric, vf clamp_to, vf* at_point, vf* side,
                       vf* inverse) {
  v3 d = sub3(q, p);
  vf d2 = dot3(d, d);
  *at_point = dot3(n, d);
  *side = -dot3(light_normal, d);
  *inverse = one_f() / d2;
  vf height = dot3(light_geometric, d);
  vf g = min_f(*at_point * fabs(height) * *inverse * *inverse, clamp_to);
#ifdef NEED_BENT_NORMALS
  // Geometry decides the side that a light shines to, as it does for a camera path (kernels/surface.h: shading_frame).
  vi shines = height < zero_f();
  *side = max_f(*side, (vf)1e-3f * sqrt(d2));
#else
  vi shines = *side > zero_f();
#endif
  return pick(zero_f(), g, (*at_point > zero_f()) & shines & (d2 > zero_f()));
}

// The same with a light that all lanes share.
FN vf geometry_of(global const float* light, v3 p, v3 n, vf clamp_to, vf* at_point, vf* side, vf* inverse) {
  return bounded_geometry(p, n, uniform3(light[VPL_POSITION], light[VPL_POSITION + 1], light[VPL_POSITION + 2]),
                          uniform3(light[VPL_NORMAL], light[VPL_NORMAL + 1], light[VPL_NORMAL + 2]),
                          uniform3(light[VPL_GEOMETRIC], light[VPL_GEOMETRIC + 1], light[VPL_GEOMETRIC + 2]), clamp_to,
                          at_point, side, inverse);
}

FN float light_luminance(global const float* light) {
  return luminance_of(light[VPL_FLUX], light[VPL_FLUX + 1], light[VPL_FLUX + 2]);
}

// NEAR_RADII of kernels/vpl_records.h.
FN vi is_near(global const float* light, vf inverse) {
  return inverse * (light[VPL_RADIUS] * light[VPL_RADIUS] * (NEAR_RADII * NEAR_RADII)) > one_f();
}

// How many members of a light are looked at one by one where it is near; they begin at the row VPL_FIRST.
FN uint light_members(global const float* light) { return light[VPL_RADIUS] > 0.0f ? (uint)light[VPL_COUNT] : 0u; }
FN uint first_member(global const float* light) { return ((global const uint*)light)[VPL_FIRST]; }

#endif
