// Broad and sharp parts of a surface, one of which scatters a ray.
//
// A surface's broad part is its diffuse layer and, where it is rough, its specular lobe (has_rough_lobe()); the rest is
// its sharp part: mirrors, glass, other lobes. Methods that store light on surfaces store what broad parts get, and
// tell by these parts whose light is whose: camera paths (kernels/path_filter.h) and light paths
// (kernels/photon/trace.cl) split each scattering alike.
#ifndef GLEANER_KERNELS_TRANSPORT_PARTS_H
#define GLEANER_KERNELS_TRANSPORT_PARTS_H

#include "kernels/bsdf.h"

#ifdef NEED_LOBE
// Whether the broad part scattered a ray or the sharp one: at random, in proportion to what each sends this way, which
// *factor makes up for. `rough`: lanes whose lobe belongs to the broad part; `gain`: of such a lobe.
FN vi choose_part(const Scene* scene, const Surface* m, v3 view, v3 direction, vi opaque, vi rough, vf u, vf* gain,
                  v3* factor) {
  vf unused_pdf;
  vf z = max_f(direction.z, (vf)1e-6f);
  v3 both = eval_bsdf(scene, m, view, make3(direction.x, direction.y, z), &unused_pdf);
  v3 broad = eval_layer(scene, m, z);
  *gain = pick(one_f(), lobe_gain(scale3(sub3(both, broad), one_f() / z)), rough & opaque);
  broad = pick3(broad, both, rough);
  vf chance = clamp_f((broad.x + broad.y + broad.z) / (both.x + both.y + both.z), zero_f(), one_f());
  vi by_broad = opaque & (u < chance);
  v3 part = pick3(sub3(both, broad), broad, by_broad);
  vf odds = one_f() / pick(one_f() - chance, chance, by_broad);
  *factor = make3(pick(zero_f(), max_f(part.x, zero_f()) / both.x * odds, both.x > zero_f()),
                  pick(zero_f(), max_f(part.y, zero_f()) / both.y * odds, both.y > zero_f()),
                  pick(zero_f(), max_f(part.z, zero_f()) / both.z * odds, both.z > zero_f()));
  return by_broad;
}
#endif

#endif
