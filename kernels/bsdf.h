// The glTF 2.0 material: GGX with separable Smith masking and Schlick's Fresnel (appendix B), over a Lambert layer that
// gets what the specular lobe leaves, reciprocally: f_d = base/pi (1 - s E(n.v)) (1 - s E(n.l)) / (1 - s M), so that a
// white surface reflects exactly 1. Glass: exact Fresnel, smooth or GGX (Walter et al. 2007), solid or a thin sheet.
// Metal hides glass: of a surface's light, `metallic` meets metal, and of the rest `transmission` meets glass. The lobe
// may be longer one way (KHR_materials_anisotropy), lie under a thin film (kernels/bsdf/thin_film.h), a coat or sheen
// (kernels/bsdf/layers.h). Of a sheet that light shines through (KHR_materials_diffuse_transmission), a share has,
// under the same lobe, a layer that sends all light to the far side; it is chosen as glass is, and counts as glass for
// all that asks who carries which light. Local frames: z is the normal.
#ifndef GLEANER_KERNELS_BSDF_H
#define GLEANER_KERNELS_BSDF_H

#include "kernels/bsdf/glass.h"
#include "kernels/bsdf/opaque.h"
#include "kernels/bsdf/shining.h"

// Does glass scatter, or a layer let light shine through? Light samples find their way then.
FN vi scatters_through(const Surface* m) {
  vi scatters = no_lanes();
#ifdef NEED_ROUGH_TRANSMISSIVE
  scatters = m->blurs;
#endif
#ifdef NEED_DIFFUSE_TRANSMISSION
  scatters = scatters | (m->shining > zero_f());
#endif
  return scatters;
}

#ifdef NEED_ROUGH_TRANSMISSIVE
// Rough glass and the layer that light shines through, in the proportion in which they are there; else as eval_glass().
OUTLINED v3 eval_transmissive(const Scene* scene, const Surface* m, v3 v, v3 l, vf* pdf) {
  v3 f = eval_glass(m, v, l, pdf);
#ifdef NEED_DIFFUSE_TRANSMISSION
  if (any_lane(m->shining > zero_f())) {
    vi above = l.z > zero_f();
    v3 across = make3(l.x, l.y, max_f(fabs(l.z), (vf)1e-6f));
    vf pdf_above, pdf_below;
    v3 reflected = eval_above_shining(scene, m, v, across, &pdf_above);
    v3 shining = pick3(eval_shining_layer(scene, m, v, across, &pdf_below), reflected, above);
    f = mad3(shining, m->shining, scale3(f, one_f() - m->shining));
    *pdf = mix(*pdf, pick(pdf_below, pdf_above, above), m->shining);
  }
#endif
  return f;
}
#endif

// Draws a direction: u_lobe chooses, (u0, u1) aim. Weight 0: the path ends. `v` is local, v.z > 0.
OUTLINED BsdfSample sample_bsdf(const Scene* scene, const Surface* m, v3 v, vf u_lobe, vf u_glass, vf u0, vf u1) {
  vi by_lobe, mirrored;
  BsdfSample b = sample_opaque(scene, m, v, u_lobe, u0, u1, &by_lobe, &mirrored);
#ifdef NEED_TRANSMISSIVE
  // Light samples weigh against the density over all samples, of which glass takes its share.
  b.pdf *= one_f() - m->transmission;
  vi glass = u_glass < m->transmission;
#ifdef NEED_DIFFUSE_TRANSMISSION
  vi shining = u_glass < m->transmission * m->shining;
  if (any_lane(shining)) sample_shining(scene, m, v, shining, by_lobe, mirrored, &b);
  glass = glass & none(shining);
#endif
  if (any_lane(glass)) sample_glass(m, v, u_lobe, u0, u1, glass, &b);
#ifdef NEED_ROUGH_TRANSMISSIVE
  // Both kinds of samples may take any direction here; light samples weigh against the density of them together.
  vi scatters = scatters_through(m) & none(glass & none(m->blurs)) & (glass | none(mirrored));
  if (any_lane(scatters)) {
    vf glass_pdf, opaque_pdf;
    eval_transmissive(scene, m, v, b.direction, &glass_pdf);
    eval_bsdf(scene, m, v, make3(b.direction.x, b.direction.y, fabs(b.direction.z)), &opaque_pdf);
    opaque_pdf = pick(zero_f(), opaque_pdf, b.direction.z > zero_f());
    vf both = fma(m->transmission, glass_pdf, (one_f() - m->transmission) * opaque_pdf);
    b.pdf = pick(b.pdf, both, scatters & (max_component(b.weight) > zero_f()));
  }
#endif
#endif
  return b;
}

#endif
