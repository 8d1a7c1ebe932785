#pragma once
// Some of a cache's records, gathered with few rays before all of them are: they tell how noisy these would be.

#include <cstdint>
#include <optional>
#include <string>

#include "coordinator/plan/graph.h"
#include "coordinator/plan/pixel_cache.h"
#include "kernels/splat_records.h"

namespace gleaner::coordinator {

// Of the new records some, spread evenly over all of them.
struct RecordLook {
  std::uint32_t records = 0, stride = 1;  // stride: places from one to the next
  Strata strata;                          // of each

  // Of records that would have so many rays each. None: they are too few, or a look would take too much beside them.
  static std::optional<RecordLook> at(std::uint64_t records, std::uint32_t rays);
  // Of what a stage gathers that begins at place `first`.
  kernels::SplatGatherParameters parameters(kernels::SplatGatherParameters all, std::uint64_t first) const;
  // Stage `name` of that kind, whose records noise_of() reads: ray_noise() of them.
  StageSpec stage(const std::string& name, const char* kind, int priority) const;
  double noise_of(const Graph::Artifact& looked, double albedo, std::uint32_t word = CACHE_NOISE) const;
};

}  // namespace gleaner::coordinator
