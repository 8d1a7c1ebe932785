#pragma once
#include "scene/model/blob.h"

namespace gleaner::scene {

// Most triangles that a leaf holds; the encoding has room for 15.
inline constexpr std::uint32_t kMaxLeafTriangles = 4;

// The binary BVHs of the OpenCL tracer, one a part (scene/model/blob.h), built by Embree's rtcBuildBVH (medium quality:
// deterministic, for any number of threads). Nodes lie depth first, child 0 of an inner node right behind it. A box is
// the exact union of its triangles' corners, neither padded nor clipped: a traversal must allow for its own rounding.
//
// Left out are triangles without area (the cross product of two edges, in double precision, is zero) and those with a
// corner that no valid scene has: non-finite, or farther out than kMaxCoordinate (Embree aborts on them).
//
// A part always has a root node. Where fewer than two leaves exist, the missing ones are empty: leaf bit set, first
// slot 0, count 0, lower = FLT_MAX and upper = -FLT_MAX. max_depth counts edges from the root to the deepest leaf: at
// least 1, at most kMaxBvhDepth, whatever the scene.
//
// Throws Error::failed where Embree cannot build (out of memory).
Bvh build_bvh(const Scene& scene);

}  // namespace gleaner::scene
