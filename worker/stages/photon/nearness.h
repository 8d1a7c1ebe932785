#pragma once
// How far the next surface is ahead of places.

#include <span>
#include <vector>

#include "worker/stages/splat/points.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

// m, along the triangle's normal; infinite where there is none. `result` counts the rays.
std::vector<float> distances_ahead(const StageRun& run, std::span<const SplatPoint> places, BatchResult& result);

}  // namespace gleaner::worker
