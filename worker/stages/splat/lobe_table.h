#pragma once
// Rough lobes in hemispherical harmonics, times the cosine: c_l^m of Gautron et al. 2005, eq. 9, by roughness and view.

#include <cstdint>
#include <vector>

#include "kernels/splat_records.h"

namespace gleaner::worker {

// A lobe is f0 a + f90 b (kernels/bsdf/lobe.h: rough_lobe()), seen from an azimuth of 0; so it has no sines. Rows of
// LOBE_TABLE_WORDS(order) of kernels/splat_records.h: a's coefficients, then b's, of LOBE_TABLE_VIEWS cosines of each
// of LOBE_TABLE_ALPHAS roughnesses. Takes a second.
std::vector<float> make_lobe_table(std::uint32_t order);

}  // namespace gleaner::worker
