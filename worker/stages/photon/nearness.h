#pragma once
// How far surfaces are from places, by rays that the host makes.

#include <array>
#include <span>
#include <vector>

#include "worker/stages/splat/points.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

// `direction`: a unit vector.
struct HostRay {
  std::array<float, 3> origin, direction;
};

// m, to what each ray meets first; infinite where it meets nothing. `result` counts the rays.
std::vector<float> distances_along(const StageRun& run, std::span<const HostRay> rays, BatchResult& result);

// The same from places along the triangle's normal.
std::vector<float> distances_ahead(const StageRun& run, std::span<const SplatPoint> places, BatchResult& result);

}  // namespace gleaner::worker
