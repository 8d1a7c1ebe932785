#pragma once
// A record of incoming radiance: its coefficients in hemispherical harmonics and their gradients, from light over
// strata of equal solid angle.

#include <cstddef>
#include <span>

#include "worker/stages/splat/irradiance.h"

namespace gleaner::worker {

// Words of a record: RADIANCE_WORDS(order) of kernels/splat_records.h.
// `samples`: one a stratum, ring by ring from the normal on; rings are equally high.
void make_radiance_record(const SplatPoint& place, const HemisphereGrid& grid,
                          std::span<const HemisphereSample> samples, std::uint32_t order, std::span<float> record);

}  // namespace gleaner::worker
