#pragma once
#include "scene/model/blob.h"

namespace gleaner::scene {

// The binary BVH of the OpenCL tracer, built by Embree's rtcBuildBVH (medium quality: deterministic).
// Triangles without area or with non-finite corners are left out.
Bvh build_bvh(const Scene& scene);

}  // namespace gleaner::scene
