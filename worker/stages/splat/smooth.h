#pragma once
// What the stage kind "splat_smooth" does, for tests and the bench.

#include <vector>

#include "worker/stages/splat/points.h"

namespace gleaner::worker {

// The records in their order, each blended with what its neighbours say of its place (smooth.cpp). The same bits by any
// number of threads.
std::vector<CacheRecord> smooth_cache(std::vector<CacheRecord> records, unsigned threads);

}  // namespace gleaner::worker
