// A sheet that light shines through (KHR_materials_diffuse_transmission): under the lobe, a layer that sends all light
// to the far side.
#ifndef GLEANER_KERNELS_BSDF_SHINING_H
#define GLEANER_KERNELS_BSDF_SHINING_H

#include "kernels/bsdf/opaque.h"

#ifdef NEED_DIFFUSE_TRANSMISSION
// The layer that light shines through, under the lobe and all that lies on it: BSDF times |n.l| towards the mirror
// image of `across` below the surface (across.z > 0), and the density with which sample_shining() takes it.
FN v3 eval_shining_layer(const Scene* scene, const Surface* m, v3 v, v3 across, vf* pdf) {
  vf cosine = across.z * INV_PI;
  *pdf = cosine;
#ifdef NEED_LOBE
  cosine *= m->left_view * left_to_layer(scene, m, across.z) * (one_f() - m->metallic) / m->left_mean;
#ifdef NEED_LAYERS
  cosine *= eval_layers(scene, m, v, across).left_bent;
#endif
  *pdf *= one_f() - m->lobe_share;
#endif
  return scale3(m->shining_color, cosine);
}

// What lies above the layer, which reflects alone.
FN v3 eval_above_shining(const Scene* scene, const Surface* m, v3 v, v3 l, vf* pdf) {
  Surface lobes = *m;
  lobes.layer_kept = zero_f();
  return eval_bsdf(scene, &lobes, v, l, pdf);
}

// Makes of a sample of the opaque surface, in `shining` lanes, one of the surface that light shines through: what the
// layer scattered goes to the far side. Lanes of `mirrored` keep their sample.
FN void sample_shining(const Scene* scene, const Surface* m, v3 v, vi shining, vi by_lobe, vi mirrored, BsdfSample* b) {
  v3 d = b->direction;
  v3 across = make3(d.x, d.y, max_f(d.z, (vf)1e-6f));
  vf pdf_above, pdf_below;
  v3 above = eval_above_shining(scene, m, v, across, &pdf_above);
  v3 below = eval_shining_layer(scene, m, v, across, &pdf_below);
  vf pdf = pick(pdf_below, pdf_above, by_lobe);
  v3 weight = scale3(pick3(below, above, by_lobe), one_f() / pdf);
  weight = pick3(splat3(zero_f()), weight, (d.z > (vf)1e-6f) & (pdf > zero_f()));
  vi drawn = shining & none(mirrored);
  b->weight = pick3(b->weight, weight, drawn);
  b->direction.z = pick(d.z, -d.z, drawn & none(by_lobe));
  b->crosses = drawn & none(by_lobe) & m->solid;
}
#endif

#endif
