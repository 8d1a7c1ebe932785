// Reflectance of a thin film on a surface, by Belcour & Barla 2017, "A Practical Extension to Microfacet Theory for the
// Modeling of Varying Iridescence", as KHR_materials_iridescence has it: Schlick's Fresnel at both interfaces, no
// polarization, the spectrum integrated in Fourier space. scene/model/thin_film.cpp is the same in double precision.
#ifndef GLEANER_KERNELS_BSDF_THIN_FILM_H
#define GLEANER_KERNELS_BSDF_THIN_FILM_H

#include "kernels/vec3.h"

FN vf film_schlick(vf f0, vf cosine) {
  vf away = one_f() - cosine, away2 = away * away;
  return fma(one_f() - f0, away2 * away2 * away, f0);
}

// F0 of an interface between indices a and b.
FN vf interface_f0(vf a, vf b) {
  vf r = (a - b) / (a + b);
  return r * r;
}

// What the eye makes of a cosine of wavelength, XYZ: `path` is the optical path difference in nm, `shift` a phase.
FN v3 film_sensitivity(vf path, v3 shift) {
  vf phase = path * (vf)6.28318530717958648e-9f, p2 = phase * phase;
  // Peaks of the colour matching functions: height * sqrt(2 pi variance) / 1.0685e-7, position, variance.
  vf x = (vf)0.84659000f * cos(fma(phase, (vf)1.6810e6f, shift.x)) * exp(-p2 * (vf)4.3278e9f);
  vf y = (vf)1.00022189f * cos(fma(phase, (vf)1.7953e6f, shift.y)) * exp(-p2 * (vf)9.3046e9f);
  vf z = (vf)1.00112249f * cos(fma(phase, (vf)2.2084e6f, shift.z)) * exp(-p2 * (vf)6.6121e9f);
  x += (vf)0.15386831f * cos(fma(phase, (vf)2.2399e6f, shift.x)) * exp(-p2 * (vf)4.5282e9f);
  return make3(3.2404542f * x - 1.5371385f * y - 0.4985314f * z, -0.9692660f * x + 1.8760108f * y + 0.0415560f * z,
               0.0556434f * x - 0.2040259f * y + 1.0572252f * z);
}

// One colour's second interface.
typedef struct {
  vf direct;  // C0: without interference
  vf first;   // of the first order; `ratio` times it of the next
  vf ratio;
  vf phase;
} FilmColor;

FN FilmColor film_color(vf f0, vf film_ior, vf r12, vf cosine2) {
  FilmColor c;
  vf root = sqrt(clamp_f(f0, zero_f(), (vf)0.9999f));
  vf base_ior = (one_f() + root) / (one_f() - root);
  vf r23 = film_schlick(interface_f0(base_ior, film_ior), cosine2);
  // Reflection from within turns the phase by pi at the film's upper face, and at a base of a lower index as well.
  c.phase = pick((vf)3.14159265358979324f, (vf)6.28318530717958648f, base_ior < film_ior);
  vf r123 = clamp_f(r12 * r23, (vf)1e-5f, (vf)0.9999f);
  vf t121 = one_f() - r12;
  vf rs = t121 * t121 * r23 / (one_f() - r123);
  c.direct = r12 + rs;
  c.ratio = sqrt(r123);
  c.first = (rs - t121) * c.ratio;
  return c;
}

// Reflectance, RGB in [0, 1], of a film `thickness` nm thick at `cosine` to the normal, above a base of reflectance f0
// in air.
OUTLINED v3 thin_film(vf cosine, vf film_ior, vf thickness, v3 f0) {
  // A film of no thickness is none.
  vf t = clamp_f(thickness * (vf)(1.0f / 0.03f), zero_f(), one_f());
  film_ior = mix(one_f(), film_ior, t * t * (3.0f - 2.0f * t));
  cosine = clamp_f(cosine, zero_f(), one_f());
  vf cosine2_squared = one_f() - (one_f() - cosine * cosine) / (film_ior * film_ior);
  vf cosine2 = safe_sqrt(cosine2_squared);
  vf r12 = film_schlick(interface_f0(film_ior, one_f()), cosine);
  FilmColor r = film_color(f0.x, film_ior, r12, cosine2), g = film_color(f0.y, film_ior, r12, cosine2),
            b = film_color(f0.z, film_ior, r12, cosine2);
  vf path = 2.0f * film_ior * thickness * cosine2;
  v3 shift = make3(r.phase, g.phase, b.phase);
  v3 s1 = film_sensitivity(path, shift), s2 = film_sensitivity(2.0f * path, scale3(shift, (vf)2.0f));
  v3 sum = make3(fma(2.0f * r.first, fma(r.ratio, s2.x, s1.x), r.direct),
                 fma(2.0f * g.first, fma(g.ratio, s2.y, s1.y), g.direct),
                 fma(2.0f * b.first, fma(b.ratio, s2.z, s1.z), b.direct));
  sum = make3(clamp_f(sum.x, zero_f(), one_f()), clamp_f(sum.y, zero_f(), one_f()), clamp_f(sum.z, zero_f(), one_f()));
  return pick3(sum, splat3(one_f()), cosine2_squared < zero_f());
}

#endif
