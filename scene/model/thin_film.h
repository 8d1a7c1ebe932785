#pragma once
// Reflectance of a thin film on a surface (KHR_materials_iridescence), as kernels/bsdf/thin_film.h has it.

#include <array>

namespace gleaner::scene {

// RGB in [0, 1], of a film `thickness` nanometres thick, seen from air at `cosine`, above a base of reflectance f0 in
// air. Belcour & Barla 2017, "A Practical Extension to Microfacet Theory for the Modeling of Varying Iridescence".
std::array<double, 3> thin_film(double cosine, double film_ior, double thickness, const std::array<double, 3>& f0);

}  // namespace gleaner::scene
