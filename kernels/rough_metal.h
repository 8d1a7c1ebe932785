// Rough metal: surfaces whose lobe radiance links carry beside diffuse layers (kernels/links/lobes.h).
#ifndef GLEANER_KERNELS_ROUGH_METAL_H
#define GLEANER_KERNELS_ROUGH_METAL_H

#include "kernels/bsdf.h"

#ifdef NEED_LOBE
// At least half metal, whose lobe is most of what it sends, and no glass. After prepare_lobe().
FN vi is_rough_metal(const Surface* m) {
  vi metal = has_rough_lobe(m) & (m->metallic >= (vf)0.5f);
#ifdef NEED_TRANSMISSIVE
  metal = metal & (m->transmission <= zero_f());
#endif
  return metal;
}
#endif

#endif
